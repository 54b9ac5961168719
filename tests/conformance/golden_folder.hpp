// SPDX-License-Identifier: Apache-2.0
/// @file A golden folder of images: its parameters, and the recorded arrays in an executor's
/// memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

template <typename Exec>
struct golden_folder {
  using fisheye_rig_type = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

  Exec exec;
  std::string folder;
  nlohmann::json json;
  ft::orb_params params;
  bool fisheye = false;
  ft::orb_extractor<Exec> orb;
  ft::rectified_rig rectified_rig{};
  fisheye_rig_type fisheye_rig{};

  golden_folder(Exec const& on, std::string from) : exec(on), folder(std::move(from)) {
    std::ifstream file(folder + "/params.json");
    json = nlohmann::json::parse(file);
    params.width = json["width"];
    params.height = json["height"];
    params.features = json["nfeatures"];
    params.levels = json["nlevels"];
    params.scale_factor = json["scaleFactor"];
    params.ini_threshold = json["iniThFAST"];
    params.min_threshold = json["minThFAST"];
    fisheye = json["camera"] == "KannalaBrandt8";
    auto const overlap = [&](char const* key) {
      return ft::stereo_overlap{json[key][0].template get<float>(),
                                json[key][1].template get<float>()};
    };
    orb = ft::orb_extractor<Exec>(exec, params, 2, {overlap("lappingL"), overlap("lappingR")});
    std::vector<float> const c1 = json["camera1_params"];
    if (fisheye) {
      std::vector<float> const c2 = json["camera2_params"];
      std::vector<float> const T = json["Tlr_rowmajor"];
      ft::pose const T_lr{{{T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10]}},
                          {T[3], T[7], T[11]}};
      fisheye_rig = {{c1[0], c1[1], c1[2], c1[3], c1[4], c1[5], c1[6], c1[7]},
                     {c2[0], c2[1], c2[2], c2[3], c2[4], c2[5], c2[6], c2[7]},
                     T_lr.cast<ft::strict_float>().inverse().template cast<float>()};
    } else {
      rectified_rig = ft::rectified_rig::from_bf({c1[0], c1[1], c1[2], c1[3]},
                                                 json["bf"].template get<float>());
    }
  }

  /// @param kind "frame" or "pair"
  std::string path(char const* kind, int k, std::string const& name) const {
    char number[16];
    std::snprintf(number, sizeof number, "_%03d/", k);
    return folder + "/" + kind + number + name + ".npy";
  }
  template <typename T>
  std::vector<T> get_array(T const* data, std::size_t count) const {
    return from_exec(exec, data, count);
  }
  /// The recorded keypoints of frame k.
  void load_frame(int k, ft::keypoints<Exec::space>& to) {
    if (to.capacity() == 0) { to = ft::keypoints<Exec::space>(orb.capacity(), 2); }
    auto const view = to.view();
    for (int c = 0; c < 2; ++c) {
      auto const kp = read_npy<float>(path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(path("frame", k, c == 0 ? "descL" : "descR"));
      int const n = kp.rows();
      auto const slice = view.slice(c);
      auto const put = [&](auto* target, auto const& values) {
        ft::copy(exec, target, values.data(), values.size());
        exec.wait();
      };
      auto const floats = [&](int column) {
        std::vector<float> v;
        for (int i = 0; i < n; ++i) { v.push_back(kp(i, column)); }
        return v;
      };
      put(ft::array_of<ft::field::x>(slice), floats(0));
      put(ft::array_of<ft::field::y>(slice), floats(1));
      put(ft::array_of<ft::field::angle>(slice), floats(3));
      put(ft::array_of<ft::field::response>(slice), floats(4));
      std::vector<int> octave;
      for (int i = 0; i < n; ++i) { octave.push_back(static_cast<int>(kp(i, 5))); }
      put(ft::array_of<ft::field::octave>(slice), octave);
      std::vector<ft::descriptor> descriptors(static_cast<std::size_t>(n));
      if (n > 0) { std::memcpy(descriptors.data(), desc.data.data(), desc.data.size()); }
      put(ft::array_of<ft::field::orb>(slice), descriptors);
      put(slice.count, std::vector<int>{n});
    }
  }
  ft::pose read_pose(int k, std::string const& name) const {
    auto const m = read_npy<float>(path("pair", k, name));
    return {{{m(0, 0), m(0, 1), m(0, 2), m(1, 0), m(1, 1), m(1, 2), m(2, 0), m(2, 1), m(2, 2)}},
            {m(0, 3), m(1, 3), m(2, 3)}};
  }
};

}  // namespace test
