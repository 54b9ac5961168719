// SPDX-License-Identifier: Apache-2.0
/// @file Recorded sequences of the reference as frames and map points of the stand-in types.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/npy.hpp"

namespace orbslam3_test {

/// Folders with recorded answers; none where there are none. FT_TEST_EFFORT keeps a share of them,
/// evenly spread; so does the program with OpenCV's types, since the one without has them all.
inline std::vector<std::string> recorded_folders() {
  char const* const data = std::getenv("FT_DATA");
  std::string const root = std::string(data == nullptr ? "../shared" : data) + "/golden";
  std::vector<std::string> found;
  if (!std::filesystem::is_directory(root)) { return found; }
  for (auto const& entry : std::filesystem::directory_iterator(root)) {
    if (std::filesystem::exists(entry.path() / "params.json")) {
      found.push_back(entry.path().string());
    }
  }
  std::sort(found.rbegin(), found.rend());
  auto const wanted = test::effort(static_cast<int>(found.size()));
#if defined(FT_TEST_OPENCV)
  auto const step = found.size() / static_cast<std::size_t>(std::max(1, wanted / 5));
#else
  auto const step = found.size() / static_cast<std::size_t>(wanted);
#endif
  std::vector<std::string> kept;
  for (std::size_t i = 0; i < found.size(); i += step) { kept.push_back(found[i]); }
  return kept;
}

inline stand_in::matrix image_of(test::npy<std::uint8_t> const& pixels) {
  stand_in::matrix m;
  m.create(pixels.rows(), pixels.cols(), 0);
  for (int y = 0; y < pixels.rows(); ++y) {
    std::memcpy(m.data + static_cast<std::size_t>(y) * static_cast<std::size_t>(m.step),
                &pixels(y, 0), static_cast<std::size_t>(pixels.cols()));
  }
  return m;
}

class recorded {
public:
  explicit recorded(std::string folder) : folder_(std::move(folder)) {
    std::ifstream file(folder_ + "/params.json");
    json_ = nlohmann::json::parse(file);
  }

  bool fisheye() const { return json_["camera"] == "KannalaBrandt8"; }
  std::string const& folder() const { return folder_; }

  ft::orbslam3::settings settings() const {
    ft::orbslam3::settings s;
    s.width = json_["width"];
    s.height = json_["height"];
    s.features = json_["nfeatures"];
    s.levels = json_["nlevels"];
    s.scale_factor = json_["scaleFactor"];
    s.ini_threshold = json_["iniThFAST"];
    s.min_threshold = json_["minThFAST"];
    s.bf = json_["bf"];
    s.ties = ft::tie_rule::stable;
    s.left = camera("camera1_params");
    if (fisheye()) {
      s.right = camera("camera2_params");
      for (int i = 0; i < 2; ++i) {
        s.overlap[0][i] = json_["lappingL"][static_cast<std::size_t>(i)];
        s.overlap[1][i] = json_["lappingR"][static_cast<std::size_t>(i)];
      }
      std::vector<float> const T = json_["Tlr_rowmajor"];
      // The inverse: R^T, -R^T t; each product rounded, summed from the left.
      for (std::size_t r = 0; r < 3; ++r) {
        for (std::size_t c = 0; c < 3; ++c) { s.T_rl.R.m[3 * r + c] = T[4 * c + r]; }
        float const a = T[r] * T[3];
        float const b = T[4 + r] * T[7];
        float const d = T[8 + r] * T[11];
        (r == 0 ? s.T_rl.t.x : r == 1 ? s.T_rl.t.y : s.T_rl.t.z) = -((a + b) + d);
      }
    }
    return s;
  }

  int frames() const {
    int k = 0;
    while (test::exists(path("frame", k, "kpL"))) { ++k; }
    return k;
  }
  bool has_pair(int k) const { return test::exists(path("pair", k, "sbp_last")); }

  stand_in::matrix image(int k, int camera) const {
    return image_of(bytes("frame", k, camera == 0 ? "imgL" : "imgR"));
  }

  /// A frame as the reference's constructor leaves it. @param stereo with its stereo matches
  stand_in::frame frame(int k, bool stereo = true) const {
    stand_in::frame f;
    f.mnId = static_cast<unsigned long>(k);
    set_bounds(f);
    f.mvKeys = keypoints(k, "kpL");
    f.mvKeysUn = f.mvKeys;
    f.mvKeysRight = keypoints(k, "kpR");
    f.mDescriptors = image_of(bytes("frame", k, "descL"));
    f.mDescriptorsRight = image_of(bytes("frame", k, "descR"));
    f.N = static_cast<int>(f.mvKeys.size());
    stand_in::set_no_pair(f);
    if (fisheye()) {
      f.T_lr = right_in_left();
      f.Nleft = f.N;
      f.Nright = static_cast<int>(f.mvKeysRight.size());
      f.N += f.Nright;
      auto const mono = ints("frame", k, "mono");
      f.monoLeft = mono(0);
      f.monoRight = mono(1);
    }
    f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
    f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
    if (stereo) { set_stereo(f, k); }
    return f;
  }
  void set_bounds(stand_in::frame& f) const {
    f.mnMinX = json_["mnMinX"];
    f.mnMinY = json_["mnMinY"];
    f.mnMaxX = json_["mnMaxX"];
    f.mnMaxY = json_["mnMaxY"];
  }
  void set_stereo(stand_in::frame& f, int k) const {
    if (fisheye()) {
      f.mvLeftToRightMatch = ints("frame", k, "l2r").data;
      f.mvRightToLeftMatch = ints("frame", k, "r2l").data;
    } else {
      f.mvuRight = floats("frame", k, "mvuRight").data;
      f.mvDepth = floats("frame", k, "mvDepth").data;
    }
  }

  /// The map points of a pair. @param first mnId of the first
  std::vector<std::unique_ptr<stand_in::map_point>> map(int k, unsigned long first) const {
    auto const xyz = floats("pair", k, "mp_xyz");
    auto const normal = floats("pair", k, "mp_normal");
    auto const range = floats("pair", k, "mp_dist_min_max");
    auto const desc = bytes("pair", k, "mp_desc");
    auto const observations = ints("pair", k, "mp_nobs");
    std::vector<std::unique_ptr<stand_in::map_point>> points;
    for (int i = 0; i < xyz.rows(); ++i) {
      auto p = std::make_unique<stand_in::map_point>();
      p->mnId = first + static_cast<unsigned long>(i);
      p->SetWorldPos({xyz(i, 0), xyz(i, 1), xyz(i, 2)});
      p->set_view({normal(i, 0), normal(i, 1), normal(i, 2)}, range(i, 0), range(i, 1));
      p->set_descriptor(&desc(i, 0));
      p->set_observations(observations(i));
      points.push_back(std::move(p));
    }
    return points;
  }

  stand_in::se3 pose(int k, std::string const& name) const {
    auto const m = floats("pair", k, name);
    Eigen::Matrix3f R;
    Eigen::Vector3f t;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) { R(r, c) = m(r, c); }
      t(r) = m(r, 3);
    }
    return {R, t};
  }

  test::npy<float> floats(char const* kind, int k, std::string const& name) const {
    return test::read_npy<float>(path(kind, k, name));
  }
  test::npy<std::int32_t> ints(char const* kind, int k, std::string const& name) const {
    return test::read_npy<std::int32_t>(path(kind, k, name));
  }
  test::npy<std::uint8_t> bytes(char const* kind, int k, std::string const& name) const {
    return test::read_npy<std::uint8_t>(path(kind, k, name));
  }

private:
  stand_in::se3 right_in_left() const {
    std::vector<float> const T = json_["Tlr_rowmajor"];
    Eigen::Matrix3f R;
    for (int i = 0; i < 9; ++i) {
      R(i / 3, i % 3) = T[static_cast<std::size_t>(i / 3 * 4 + i % 3)];
    }
    return {R, Eigen::Vector3f(T[3], T[7], T[11])};
  }
  std::string path(char const* kind, int k, std::string const& name) const {
    char number[16];
    std::snprintf(number, sizeof number, "_%03d/", k);
    return folder_ + "/" + kind + number + name + ".npy";
  }
  ft::orbslam3::camera_parameters camera(char const* key) const {
    std::vector<float> const values = json_[key];
    stand_in::camera c{fisheye() ? 1u : 0u, values};
    ft::orbslam3::camera_parameters p;
    p.kind = fisheye() ? ft::orbslam3::lens::kannala_brandt : ft::orbslam3::lens::pinhole;
    for (int i = 0; i < (fisheye() ? 8 : 4); ++i) { p.values[i] = c.getParameter(i); }
    return p;
  }
  std::vector<stand_in::keypoint> keypoints(int k, std::string const& name) const {
    auto const rows = floats("frame", k, name);
    std::vector<stand_in::keypoint> all(static_cast<std::size_t>(rows.rows()));
    for (int i = 0; i < rows.rows(); ++i) {
      auto& p = all[static_cast<std::size_t>(i)];
      p.pt.x = rows(i, 0);
      p.pt.y = rows(i, 1);
      p.size = rows(i, 2);
      p.angle = rows(i, 3);
      p.response = rows(i, 4);
      p.octave = static_cast<int>(rows(i, 5));
    }
    return all;
  }

  std::string folder_;
  nlohmann::json json_;
};

}  // namespace orbslam3_test
