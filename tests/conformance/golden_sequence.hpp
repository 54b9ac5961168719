// SPDX-License-Identifier: Apache-2.0
/// @file Runs every stage on the recorded inputs of a golden folder and counts what is identical.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/fisheye_matches.hpp"
#include "ft/containers/frame.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/windows.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "tests/support/corners.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

struct stage_result {
  long items = 0;
  long identical = 0;
  double max_abs_diff = 0;

  void add(bool same, double difference = 0) {
    ++items;
    identical += static_cast<long>(same);
    max_abs_diff = std::max(max_abs_diff, std::abs(difference));
  }
  double share() const {
    return items == 0 ? 1.0 : static_cast<double>(identical) / static_cast<double>(items);
  }
};
using conformance_table = std::map<std::string, stage_result>;

inline void print(conformance_table const& table, std::string const& title) {
  std::printf("%s\n%-22s %10s %10s %10s %14s\n", title.c_str(), "stage", "items", "identical",
              "share", "max diff");
  for (auto const& [name, r] : table) {
    std::printf("%-22s %10ld %10ld %9.4f%% %14.3g\n", name.c_str(), r.items, r.identical,
                100 * r.share(), r.max_abs_diff);
  }
}

/// One golden sequence on one executor.
template <typename Exec>
class golden_sequence {
public:
  golden_sequence(Exec const& exec, std::string folder) : exec_(exec), folder_(std::move(folder)) {
    std::ifstream file(folder_ + "/params.json");
    json_ = nlohmann::json::parse(file);
    params_.width = json_["width"];
    params_.height = json_["height"];
    params_.features = json_["nfeatures"];
    params_.levels = json_["nlevels"];
    params_.scale_factor = json_["scaleFactor"];
    params_.ini_threshold = json_["iniThFAST"];
    params_.min_threshold = json_["minThFAST"];
    fisheye_ = json_["camera"] == "KannalaBrandt8";
    auto const overlap = [&](char const* key) {
      return ft::stereo_overlap{json_[key][0].template get<float>(),
                                json_[key][1].template get<float>()};
    };
    orb_ = ft::orb_extractor<Exec>(exec_, params_, 2, {overlap("lappingL"), overlap("lappingR")});
    std::vector<float> const c1 = json_["camera1_params"];
    if (fisheye_) {
      std::vector<float> const c2 = json_["camera2_params"];
      std::vector<float> const T = json_["Tlr_rowmajor"];
      ft::pose const T_lr{{{T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10]}},
                          {T[3], T[7], T[11]}};
      fisheye_rig_ = {{c1[0], c1[1], c1[2], c1[3], c1[4], c1[5], c1[6], c1[7]},
                      {c2[0], c2[1], c2[2], c2[3], c2[4], c2[5], c2[6], c2[7]},
                      T_lr.cast<ft::strict_float>().inverse().template cast<float>()};
    } else {
      rectified_rig_ = ft::rectified_rig::from_bf({c1[0], c1[1], c1[2], c1[3]},
                                                  json_["bf"].template get<float>());
    }
  }

  void run(conformance_table& table) {
    for (int k = 0; exists(path("frame", k, "kpL")); ++k) { run_frame(table, k); }
    for (int k = 1; exists(path("pair", k, "sbp_last")); ++k) {
      if (fisheye_) {
        run_pair(table, k, fisheye_rig_);
      } else {
        run_pair(table, k, rectified_rig_);
      }
    }
  }

private:
  using fisheye_rig_type = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

  std::string path(char const* kind, int k, std::string const& name) const {
    char number[16];
    std::snprintf(number, sizeof number, "_%03d/", k);
    return folder_ + "/" + kind + number + name + ".npy";
  }
  template <typename T>
  std::vector<T> get_array(T const* data, std::size_t count) {
    return from_exec(exec_, data, count);
  }

  void run_frame(conformance_table& table, int k) {
    for (int c = 0; c < 2; ++c) {
      auto const image = read_npy<std::uint8_t>(path("frame", k, c == 0 ? "imgL" : "imgR"));
      orb_.upload(exec_, c, {image.data.data(), params_.width, params_.height, params_.width});
      exec_.wait();
    }
    orb_.extract(exec_);
    exec_.wait();
    auto const pyramid_bytes = static_cast<std::size_t>(orb_.geometry().bytes) * 2;
    auto const pyramid = get_array<std::uint8_t>(orb_.pyramid().data, pyramid_bytes);
    auto const blurred = get_array<std::uint8_t>(orb_.blurred().data, pyramid_bytes);
    auto const cv = orb_.corners();
    auto list = get_array<ft::corner>(cv.list, static_cast<std::size_t>(cv.layout.total_slots) * 2);
    auto const list_count =
        get_array<int>(cv.list_count, static_cast<std::size_t>(2 * params_.levels));
    auto const dv = orb_.distribution();
    auto const kept = get_array<ft::corner>(dv.kept, static_cast<std::size_t>(dv.layout.total) * 2);
    auto const kept_count =
        get_array<int>(dv.kept_count, static_cast<std::size_t>(2 * params_.levels));
    for (int c = 0; c < 2; ++c) {
      std::string const side = c == 0 ? "L_" : "R_";
      for (int l = 0; l < params_.levels; ++l) {
        std::string const level = side + std::to_string(l);
        compare_image(table["pyramid"], path("frame", k, "pyr" + level), pyramid, c, l);
        compare_image(table["blur"], path("frame", k, "blur" + level), blurred, c, l);
        int const found = list_count[static_cast<std::size_t>(c * params_.levels + l)];
        ft::corner* const first = list.data() + c * cv.layout.total_slots + cv.layout.first_slot[l];
        test::sort_corners(first, found, cv.layout, l);
        compare_corners(table["corners"], path("frame", k, "cand" + level), first, found);
        compare_corners(table["distribution"], path("frame", k, "quad" + level),
                        kept.data() + c * dv.layout.total + dv.layout.first[l],
                        kept_count[static_cast<std::size_t>(c * params_.levels + l)]);
      }
    }
    compare_keypoints(table, k);
    compare_grid(table["grid"], k);
    if (fisheye_) {
      compare_fisheye(table["stereo_fisheye"], k);
      compare_end_to_end(table["end_to_end"], k, fisheye_rig_);
    } else {
      compare_stereo(table, k);
      compare_end_to_end(table["end_to_end"], k, rectified_rig_);
    }
  }

  /// Images in; keypoints, descriptors and stereo out, with nothing recorded in between.
  template <typename Rig>
  void compare_end_to_end(stage_result& r, int k, Rig const& rig) {
    ft::stereo_matcher<Exec, Rig> matcher(rig, orb_);
    matcher.match(exec_, orb_);
    auto const kp = orb_.keypoints();
    auto const capacity = static_cast<std::size_t>(kp.capacity);
    auto const x = column<ft::field::x>(exec_, kp);
    auto const y = column<ft::field::y>(exec_, kp);
    auto const angle = column<ft::field::angle>(exec_, kp);
    auto const octave = column<ft::field::octave>(exec_, kp);
    auto const orb = column<ft::field::orb>(exec_, kp);
    auto const count = get_array<int>(kp.count, 2);
    std::vector<float> right_x(capacity, -1.0f);
    std::vector<int> partner(2 * capacity, -1);
    npy<float> want_right;
    npy<std::int32_t> want_partner[2];
    if constexpr (Rig::rectified) {
      right_x = column<ft::field::right_x>(exec_, matcher.matches());
      want_right = read_npy<float>(path("frame", k, "mvuRight"));
    } else {
      partner = get_array<int>(matcher.fisheye_matches().partner, 2 * capacity);
      want_partner[0] = read_npy<std::int32_t>(path("frame", k, "l2r"));
      want_partner[1] = read_npy<std::int32_t>(path("frame", k, "r2l"));
    }
    for (int c = 0; c < 2; ++c) {
      auto const want = read_npy<float>(path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(path("frame", k, c == 0 ? "descL" : "descR"));
      int const n = count[static_cast<std::size_t>(c)];
      for (int i = 0; i < std::max(n, want.rows()); ++i) {
        auto const at = static_cast<std::size_t>(c) * capacity + static_cast<std::size_t>(i);
        bool same = i < n && i < want.rows() && x[at] == want(i, 0) && y[at] == want(i, 1) &&
                    angle[at] == want(i, 3) && static_cast<float>(octave[at]) == want(i, 5) &&
                    std::memcmp(&orb[at], &desc(i, 0), 32) == 0;
        if constexpr (Rig::rectified) {
          same = same && (c == 1 || right_x[at] == want_right(i));
        } else {
          int const got = partner[at] < 0 || c == 1 ? partner[at] : partner[at] - kp.capacity;
          same = same && got == want_partner[c](i);
        }
        r.add(same);
      }
    }
  }

  void compare_image(stage_result& r, std::string const& file,
                     std::vector<std::uint8_t> const& slab, int c, int l) {
    if (!exists(file)) { return; }
    auto const want = read_npy<std::uint8_t>(file);
    auto const& g = orb_.geometry();
    for (int y = 0; y < want.rows(); ++y) {
      for (int x = 0; x < want.cols(); ++x) {
        int const got =
            y < g.height[l] && x < g.width[l]
                ? slab[static_cast<std::size_t>(c * g.bytes + g.offset[l] + y * g.stride[l] + x)]
                : -1;
        r.add(got == want(y, x), got - want(y, x));
      }
    }
  }

  void compare_corners(stage_result& r, std::string const& file, ft::corner const* got, int count) {
    if (!exists(file)) { return; }
    auto const want = read_npy<float>(file);
    for (int i = 0; i < std::max(want.rows(), count); ++i) {
      bool const same = i < want.rows() && i < count &&
                        static_cast<float>(got[i].x) == want(i, 0) &&
                        static_cast<float>(got[i].y) == want(i, 1) &&
                        static_cast<float>(got[i].response) == want(i, 2);
      r.add(same);
    }
  }

  void compare_keypoints(conformance_table& table, int k) {
    auto const kp = orb_.keypoints();
    auto const x = column<ft::field::x>(exec_, kp);
    auto const y = column<ft::field::y>(exec_, kp);
    auto const angle = column<ft::field::angle>(exec_, kp);
    auto const response = column<ft::field::response>(exec_, kp);
    auto const octave = column<ft::field::octave>(exec_, kp);
    auto const orb = column<ft::field::orb>(exec_, kp);
    auto const count = get_array<int>(kp.count, 2);
    auto const mono = get_array<int>(orb_.mono_count(), 2);
    for (int c = 0; c < 2; ++c) {
      auto const want = read_npy<float>(path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(path("frame", k, c == 0 ? "descL" : "descR"));
      if (fisheye_) {
        auto const want_mono = read_npy<std::int32_t>(path("frame", k, "mono"));
        table["keypoint_order"].add(want_mono(c) == mono[static_cast<std::size_t>(c)]);
      }
      for (int i = 0; i < std::max(want.rows(), count[static_cast<std::size_t>(c)]); ++i) {
        bool const there = i < want.rows() && i < count[static_cast<std::size_t>(c)];
        auto const at = static_cast<std::size_t>(c * kp.capacity + i);
        table["keypoint_order"].add(
            there && x[at] == want(i, 0) && y[at] == want(i, 1) &&
            static_cast<float>(orb_.geometry().patch_size(octave[at])) == want(i, 2) &&
            response[at] == want(i, 4) && static_cast<float>(octave[at]) == want(i, 5));
        table["orientation"].add(there && angle[at] == want(i, 3),
                                 there ? angle[at] - want(i, 3) : 0.0f);
        table["descriptor"].add(there && std::memcmp(&orb[at], &desc(i, 0), 32) == 0);
      }
    }
  }

  void compare_grid(stage_result& r, int k) {
    auto const geometry = ft::grid_geometry::over(0, 0, static_cast<float>(params_.width),
                                                  static_cast<float>(params_.height));
    ft::feature_grid<Exec::space> grid(geometry, orb_.capacity(), 2);
    load_frame(k);
    ft::build_grid<ft::nearest_cell>(exec_, frame_keypoints_.view(), 0, 1, 2, grid.view());
    for (int c = 0; c < 2; ++c) {
      std::string const name = c == 0 ? "grid" : "gridR";
      if (!exists(path("frame", k, name + "_count"))) { continue; }
      auto const count = read_npy<std::int32_t>(path("frame", k, name + "_count"));
      auto const index = read_npy<std::int32_t>(path("frame", k, name + "_index"));
      auto const view = grid.view().slice(c);
      auto const start = get_array<int>(view.start, static_cast<std::size_t>(geometry.cells() + 1));
      auto const indices = get_array<int>(view.indices, static_cast<std::size_t>(view.capacity));
      for (std::size_t i = 0; i < count.data.size(); ++i) {
        r.add(start[i + 1] - start[i] == count.data[i]);
      }
      for (std::size_t i = 0; i < index.data.size(); ++i) { r.add(indices[i] == index.data[i]); }
    }
  }

  /// The recorded keypoints of frame k into `frame_keypoints_`.
  void load_frame(int k) { load_frame(k, frame_keypoints_); }
  void load_frame(int k, ft::keypoints<Exec::space>& to) {
    if (to.capacity() == 0) { to = ft::keypoints<Exec::space>(orb_.capacity(), 2); }
    auto const view = to.view();
    for (int c = 0; c < 2; ++c) {
      auto const kp = read_npy<float>(path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(path("frame", k, c == 0 ? "descL" : "descR"));
      int const n = kp.rows();
      auto const slice = view.slice(c);
      auto const put = [&](auto* target, auto const& values) {
        ft::copy(exec_, target, values.data(), values.size());
        exec_.wait();
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
      std::vector<ft::descriptor> orb(static_cast<std::size_t>(n));
      if (n > 0) { std::memcpy(orb.data(), desc.data.data(), desc.data.size()); }
      put(ft::array_of<ft::field::orb>(slice), orb);
      put(slice.count, std::vector<int>{n});
    }
  }

  void compare_stereo(conformance_table& table, int k) {
    load_frame(k);
    ft::stereo_matches<Exec::space> matches(orb_.capacity());
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = params_.height;
    ft::feature_grid<Exec::space> right_rows(rows, orb_.capacity());
    ft::stereo_params params;
    params.bf = rectified_rig_.bf();
    params.max_disparity = rectified_rig_.bf() / rectified_rig_.baseline_length().value;
    ft::match_stereo_rectified(exec_, orb_.pyramid(), frame_keypoints_.view(), params,
                               matches.view(), right_rows.view());
    auto const right_x = column<ft::field::right_x>(exec_, matches.view());
    auto const depth = column<ft::field::depth>(exec_, matches.view());
    auto const want_u = read_npy<float>(path("frame", k, "mvuRight"));
    auto const want_d = read_npy<float>(path("frame", k, "mvDepth"));
    for (int i = 0; i < want_u.rows(); ++i) {
      auto const at = static_cast<std::size_t>(i);
      // The stage's items are the matches and the refined column; the depth, a division of it, may
      // round differently in a reference that contracts.
      table["stereo_rectified"].add(right_x[at] == want_u(i) && (depth[at] > 0) == (want_d(i) > 0),
                                    depth[at] - want_d(i));
      table["stereo_depth"].add(depth[at] == want_d(i), depth[at] - want_d(i));
    }
  }

  void compare_fisheye(stage_result& r, int k) {
    load_frame(k);
    int const capacity = orb_.capacity();
    auto const mono = to_exec(exec_, read_npy<std::int32_t>(path("frame", k, "mono")).data);
    ft::fisheye_matches_view matches;
    ft::arena<Exec::space> memory([&](ft::carver& c) { ft::carve(c, matches, capacity, 1); });
    ft::fisheye_stereo<std::decay_t<decltype(fisheye_rig_)>> const stereo{
        fisheye_rig_, orb_.geometry(), mono.data(), {}};
    ft::match_stereo_fisheye(exec_, stereo, frame_keypoints_.view(), matches);
    auto const partner = get_array<int>(matches.partner, static_cast<std::size_t>(2 * capacity));
    auto const point =
        get_array<ft::vec3<float>>(matches.point, static_cast<std::size_t>(capacity));
    auto const l2r = read_npy<std::int32_t>(path("frame", k, "l2r"));
    auto const r2l = read_npy<std::int32_t>(path("frame", k, "r2l"));
    auto const p3d = read_npy<float>(path("frame", k, "stereo3d"));
    for (int i = 0; i < l2r.rows(); ++i) {
      int const got = partner[static_cast<std::size_t>(i)];
      auto const& p = point[static_cast<std::size_t>(i)];
      double const diff = got < 0 || l2r(i) < 0
                              ? 0.0
                              : std::max({std::abs(p.x - p3d(i, 0)), std::abs(p.y - p3d(i, 1)),
                                          std::abs(p.z - p3d(i, 2))});
      r.add((got < 0 ? -1 : got - capacity) == l2r(i), diff);
    }
    for (int j = 0; j < r2l.rows(); ++j) {
      r.add(partner[static_cast<std::size_t>(capacity + j)] == r2l(j));
    }
  }

  ft::pose read_pose(int k, std::string const& name) {
    auto const m = read_npy<float>(path("pair", k, name));
    return {{{m(0, 0), m(0, 1), m(0, 2), m(1, 0), m(1, 1), m(1, 2), m(2, 0), m(2, 1), m(2, 2)}},
            {m(0, 3), m(1, 3), m(2, 3)}};
  }

  template <typename Rig>
  void run_pair(conformance_table& table, int k, Rig const& rig) {
    int const cameras = fisheye_ ? 2 : 1;
    int const capacity = orb_.capacity();
    load_frame(k);
    load_frame(k - 1, last_keypoints_);
    auto const counts = get_array<int>(frame_keypoints_.view().count, 2);
    auto const last_counts = get_array<int>(last_keypoints_.view().count, 2);

    // Map points of this pair.
    auto const xyz = read_npy<float>(path("pair", k, "mp_xyz"));
    auto const normal = read_npy<float>(path("pair", k, "mp_normal"));
    auto const range = read_npy<float>(path("pair", k, "mp_dist_min_max"));
    auto const desc = read_npy<std::uint8_t>(path("pair", k, "mp_desc"));
    auto const nobs = read_npy<std::int32_t>(path("pair", k, "mp_nobs"));
    int const points = xyz.rows();
    ft::map_points<ft::memory_space::host> host_map(points);
    auto const hm = host_map.view();
    for (int i = 0; i < points; ++i) {
      hm.position(i) = {xyz(i, 0), xyz(i, 1), xyz(i, 2)};
      hm.normal(i) = {normal(i, 0), normal(i, 1), normal(i, 2)};
      hm.min_distance(i) = range(i, 0);
      hm.max_distance(i) = range(i, 1);
      std::memcpy(&hm.orb(i), &desc(i, 0), 32);
      hm.observations(i) = nobs(i);
    }
    *hm.count = points;
    ft::map_points<Exec::space> map(points);
    ft::copy(exec_, map.view(), hm);
    exec_.wait();

    // The frame.
    auto const geometry = ft::grid_geometry::over(0, 0, static_cast<float>(params_.width),
                                                  static_cast<float>(params_.height));
    ft::feature_grid<Exec::space> grid(geometry, capacity, cameras);
    ft::build_grid<ft::nearest_cell>(exec_, frame_keypoints_.view(), 0, 1, cameras, grid.view());
    auto const numbers = static_cast<std::size_t>(cameras * capacity);
    // Golden arrays are left then right without a gap; ours leave room up to the capacity.
    auto const spread = [&](std::vector<std::int32_t> const& packed, std::vector<int> const& n) {
      std::vector<int> v(numbers, -1);
      for (int i = 0; i < static_cast<int>(packed.size()); ++i) {
        int const at = i < n[0] ? i : capacity + i - n[0];
        v[static_cast<std::size_t>(at)] = packed[static_cast<std::size_t>(i)];
      }
      return v;
    };
    std::vector<float> right_x(static_cast<std::size_t>(capacity), -1.0f);
    std::vector<int> partner(numbers, -1);
    if (fisheye_) {
      auto const l2r = read_npy<std::int32_t>(path("frame", k, "l2r"));
      auto const r2l = read_npy<std::int32_t>(path("frame", k, "r2l"));
      for (int i = 0; i < l2r.rows(); ++i) {
        if (l2r(i) >= 0) { partner[static_cast<std::size_t>(i)] = capacity + l2r(i); }
      }
      for (int i = 0; i < r2l.rows(); ++i) {
        if (r2l(i) >= 0) { partner[static_cast<std::size_t>(capacity + i)] = r2l(i); }
      }
    } else {
      auto const u = read_npy<float>(path("frame", k, "mvuRight"));
      std::copy(u.data.begin(), u.data.end(), right_x.begin());
    }
    auto const d_right = to_exec(exec_, right_x);
    auto const d_partner = to_exec(exec_, partner);
    ft::buffer<int, Exec::space> holder(numbers);
    ft::frame_view frame;
    frame.keypoints = frame_keypoints_.view();
    frame.cameras = cameras;
    frame.grids = grid.view();
    frame.right_x = fisheye_ ? nullptr : d_right.data();
    frame.partner = fisheye_ ? d_partner.data() : nullptr;
    frame.holder = holder.data();

    // 1. search from the last frame
    auto const last_mp = read_npy<std::int32_t>(path("pair", k, "last_mp"));
    auto const outlier = read_last_outlier(k, last_mp.rows());
    std::vector<std::int32_t> held(last_mp.data);
    for (std::size_t i = 0; i < held.size(); ++i) {
      if (outlier[i] != 0) { held[i] = -1; }
    }
    auto const d_last = to_exec(exec_, spread(held, last_counts));
    ft::last_frame_view last{last_keypoints_.view(), 2, cameras, d_last.data()};
    auto const d_pred = to_exec(exec_, std::vector<ft::pose>{read_pose(k, "Tcw_pred")});
    auto const d_tlw = to_exec(exec_, std::vector<ft::pose>{read_pose(k, "Tlw")});
    int const most = std::max(cameras * capacity, points);
    ft::search_buffers buffers;
    ft::observations_view observations;
    ft::arena<Exec::space> memory([&](ft::carver& c) {
      ft::carve(c, buffers.windows, most, 1, cameras);
      ft::carve(c, buffers.work, most, capacity, 1, cameras);
      ft::carve(c, observations, cameras * capacity, 1);
    });
    for (int ori = 1; ori >= 0; --ori) {
      std::string const name = ori != 0 ? "sbp_last" : "sbp_last_noori";
      auto const setting = read_npy<float>(path("pair", k, name + "_th_nnratio_n"));
      ft::last_search<std::decay_t<decltype(rig)>> search;
      search.rig = rig;
      search.T_cw = d_pred.data();
      search.last_T_cw = d_tlw.data();
      search.last = last;
      search.geometry = orb_.geometry();
      search.params.window_radius = setting(0);
      search.params.reference_quirks = true;
      search.params.max_x = static_cast<float>(params_.width);
      search.params.max_y = static_cast<float>(params_.height);
      search.params.orientation_check = ori != 0;
      ft::search_last_frame(exec_, search, frame, map.view(), buffers);
      compare_holders(table["search_last_frame"],
                      spread(read_npy<std::int32_t>(path("pair", k, name)).data, counts), counts,
                      get_array<int>(frame.holder, numbers));
      table["search_last_frame"].add(get_array<int>(buffers.work.matches, 1)[0] ==
                                     static_cast<int>(setting(2)));
    }

    // 2. and 5. pose optimisation
    for (std::string const po : {"po1_", "po2_"}) {
      compare_pose(table["pose_optimization"], k, po, rig, observations);
    }

    // 3. frustum
    auto const local = read_npy<std::int32_t>(path("pair", k, "local_mp"));
    auto const skip = read_npy<std::uint8_t>(path("pair", k, "local_skip"));
    int const q = local.rows();
    std::vector<std::int32_t> slots(static_cast<std::size_t>(most), -1);
    for (int i = 0; i < q; ++i) {
      slots[static_cast<std::size_t>(i)] = skip(i) != 0 ? -1 : local(i);
    }
    auto const d_slots = to_exec(exec_, slots);
    auto const d_count = to_exec(exec_, std::vector<int>{q});
    auto const d_local = to_exec(exec_, std::vector<ft::pose>{read_pose(k, "Tcw_local")});
    ft::buffer<ft::visibility, Exec::space> seen(static_cast<std::size_t>(most * cameras));
    auto const setting = read_npy<float>(path("pair", k, "sbp_local_th_nnratio_n"));
    ft::frustum_params fp;
    fp.max_x = static_cast<float>(params_.width);
    fp.max_y = static_cast<float>(params_.height);
    fp.log_scale_factor = ft::log_rounded(params_.scale_factor);
    fp.levels = params_.levels;
    ft::local_search_params lp;
    lp.radius_factor = setting(0);
    using rig_type = std::decay_t<decltype(rig)>;
    ft::find_visible_points(exec_,
                            ft::local_search<rig_type>{rig,
                                                       d_local.data(),
                                                       d_slots.data(),
                                                       d_count.data(),
                                                       {},
                                                       fp,
                                                       orb_.geometry(),
                                                       lp,
                                                       seen.data()},
                            map.view(), buffers.windows);
    auto const vis =
        get_array<ft::visibility>(seen.data(), static_cast<std::size_t>(most * cameras));
    auto const inview = read_npy<std::int32_t>(path("pair", k, "local_inview"));
    auto const level = read_npy<std::int32_t>(path("pair", k, "local_level"));
    auto const proj = read_npy<float>(path("pair", k, "local_proj"));
    for (int i = 0; i < q; ++i) {
      if (skip(i) != 0) { continue; }
      for (int c = 0; c < cameras; ++c) {
        auto const& v = vis[static_cast<std::size_t>(c * most + i)];
        double diff = 0;
        if (v.level >= 0 && c == 0 && inview(i, 0) != 0) {
          diff = std::max(std::abs(v.x - proj(i, 0)), std::abs(v.y - proj(i, 1)));
        }
        table["frustum"].add(
            (v.level >= 0) == (inview(i, c) != 0) && (v.level < 0 || v.level == level(i, c)), diff);
      }
    }

    // 4. search in the local map, from the recorded projections
    auto const before =
        spread(read_npy<std::int32_t>(path("pair", k, "cur_mp_before_local")).data, counts);
    ft::copy(exec_, holder.data(), before.data(), numbers);
    std::vector<ft::search_window> recorded(static_cast<std::size_t>(most * cameras),
                                            ft::search_window::none());
    auto const right_proj =
        fisheye_ ? read_npy<float>(path("pair", k, "local_projR")) : npy<float>{};
    for (int i = 0; i < q; ++i) {
      for (int c = 0; c < cameras; ++c) {
        if (inview(i, c) == 0) { continue; }
        ft::visibility const v =
            c == 0 ? ft::visibility{proj(i, 0), proj(i, 1), proj(i, 2),
                                    proj(i, 3), proj(i, 4), level(i, 0)}
                   : ft::visibility{right_proj(i, 0), right_proj(i, 1), 0,
                                    right_proj(i, 2), right_proj(i, 3), level(i, 1)};
        recorded[static_cast<std::size_t>(c * most + i)] =
            ft::window_of(v, local(i), c == 0 ? setting(0) : 1.0f, !fisheye_, orb_.geometry());
      }
    }
    ft::copy(exec_, buffers.windows.windows, recorded.data(), recorded.size());
    ft::search_params sp;
    sp.ratio = setting(1);
    ft::search_by_projection(exec_, frame, map.view(), sp, buffers);
    compare_holders(
        table["search_local_map"],
        spread(read_npy<std::int32_t>(path("pair", k, "cur_mp_after_local")).data, counts), counts,
        get_array<int>(frame.holder, numbers));
    table["search_local_map"].add(get_array<int>(buffers.work.matches, 1)[0] ==
                                  static_cast<int>(setting(2)));
  }

  std::vector<int> read_last_outlier(int k, int n) {
    auto const file = path("pair", k, "last_outlier");
    std::vector<int> v;
    auto const a = read_npy<std::uint8_t>(file);
    for (int i = 0; i < n; ++i) { v.push_back(a(i)); }
    return v;
  }

  void compare_holders(stage_result& r, std::vector<int> const& want,
                       std::vector<int> const& counts, std::vector<int> const& got) {
    int const capacity = orb_.capacity();
    for (int c = 0; c < (fisheye_ ? 2 : 1); ++c) {
      for (int i = 0; i < counts[static_cast<std::size_t>(c)]; ++i) {
        auto const at = static_cast<std::size_t>(c * capacity + i);
        r.add(want[at] == got[at]);
      }
    }
  }

  template <typename Rig>
  void compare_pose(stage_result& r, int k, std::string const& po, Rig const& rig,
                    ft::observations_view const& memory) {
    if (!exists(path("pair", k, po + "Xw"))) { return; }
    auto const X = read_npy<float>(path("pair", k, po + "Xw"));
    auto const obs = read_npy<float>(path("pair", k, po + "obs"));
    auto const w = read_npy<float>(path("pair", k, po + "invSigma2"));
    auto const outlier = read_npy<std::uint8_t>(path("pair", k, po + "outlier"));
    auto const right = read_npy<std::uint8_t>(path("pair", k, po + "right"));
    int const n = X.rows();
    std::vector<ft::observation> items;
    for (int i = 0; i < n; ++i) {
      items.push_back({{X(i, 0), X(i, 1), X(i, 2)},
                       obs(i, 0),
                       obs(i, 1),
                       fisheye_ ? -1.0f : obs(i, 2),
                       w(i),
                       right(i)});
    }
    ft::copy(exec_, memory.items, items.data(), items.size());
    auto const start = to_exec(exec_, std::vector<ft::pose>{read_pose(k, po + "Tin")});
    ft::buffer<ft::pose, Exec::space> result(1);
    ft::optimize_pose(
        exec_, rig, {memory.items, n, start.data(), result.data(), memory.outlier, memory.inliers});
    auto const got = get_array<ft::pose>(result.data(), 1)[0];
    auto const flags = get_array<unsigned char>(memory.outlier, static_cast<std::size_t>(n));
    auto const want = read_pose(k, po + "Tout");
    double worst = 0;
    for (int i = 0; i < 9; ++i) {
      worst = std::max(worst, static_cast<double>(std::abs(got.R.m[i] - want.R.m[i])));
    }
    worst = std::max({worst, std::abs(static_cast<double>(got.t.x - want.t.x)),
                      std::abs(static_cast<double>(got.t.y - want.t.y)),
                      std::abs(static_cast<double>(got.t.z - want.t.z))});
    r.add(worst < 1e-4, worst);
    for (int i = 0; i < n; ++i) { r.add(flags[static_cast<std::size_t>(i)] == outlier(i)); }
  }

  Exec exec_;
  std::string folder_;
  nlohmann::json json_;
  ft::orb_params params_;
  bool fisheye_ = false;
  ft::orb_extractor<Exec> orb_;
  ft::rectified_rig rectified_rig_{};
  fisheye_rig_type fisheye_rig_{};
  ft::keypoints<Exec::space> frame_keypoints_;
  ft::keypoints<Exec::space> last_keypoints_;
};

}  // namespace test
