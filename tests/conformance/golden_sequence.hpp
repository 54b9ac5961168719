// SPDX-License-Identifier: Apache-2.0
/// @file Runs every stage on the recorded inputs of a golden folder and counts what is identical.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "tests/conformance/conformance_table.hpp"
#include "tests/conformance/golden_folder.hpp"
#include "tests/conformance/golden_pair.hpp"
#include "tests/support/corners.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// One golden sequence on one executor.
template <typename Exec>
class golden_sequence {
public:
  golden_sequence(Exec const& exec, std::string folder)
      : of_(exec, std::move(folder)), exec_(exec) {}

  void run(conformance_table& table) {
    for (int k = 0; exists(of_.path("frame", k, "kpL")); ++k) { run_frame(table, k); }
    for (int k = 1; exists(of_.path("pair", k, "sbp_last")); ++k) {
      if (of_.fisheye) {
        golden_pair<Exec, fisheye_rig_type>(of_, of_.fisheye_rig, k).run(table);
      } else {
        golden_pair<Exec, ft::rectified_rig>(of_, of_.rectified_rig, k).run(table);
      }
    }
  }

private:
  using fisheye_rig_type = typename golden_folder<Exec>::fisheye_rig_type;

  void run_frame(conformance_table& table, int k) {
    for (int c = 0; c < 2; ++c) {
      auto const image = read_npy<std::uint8_t>(of_.path("frame", k, c == 0 ? "imgL" : "imgR"));
      of_.orb.upload(exec_, c,
                     {image.data.data(), of_.params.width, of_.params.height, of_.params.width});
      exec_.wait();
    }
    of_.orb.extract(exec_);
    exec_.wait();
    auto const pyramid_bytes = static_cast<std::size_t>(of_.orb.geometry().bytes) * 2;
    auto const pyramid =
        of_.template get_array<std::uint8_t>(of_.orb.pyramid().data, pyramid_bytes);
    auto const blurred =
        of_.template get_array<std::uint8_t>(of_.orb.blurred().data, pyramid_bytes);
    auto const cv = of_.orb.corners();
    auto list = of_.template get_array<ft::corner>(
        cv.list, static_cast<std::size_t>(cv.layout.total_slots) * 2);
    auto const list_count =
        of_.template get_array<int>(cv.list_count, static_cast<std::size_t>(2 * of_.params.levels));
    auto const dv = of_.orb.distribution();
    auto const kept =
        of_.template get_array<ft::corner>(dv.kept, static_cast<std::size_t>(dv.layout.total) * 2);
    auto const kept_count =
        of_.template get_array<int>(dv.kept_count, static_cast<std::size_t>(2 * of_.params.levels));
    for (int c = 0; c < 2; ++c) {
      std::string const side = c == 0 ? "L_" : "R_";
      for (int l = 0; l < of_.params.levels; ++l) {
        std::string const level = side + std::to_string(l);
        compare_image(table["pyramid"], of_.path("frame", k, "pyr" + level), pyramid, c, l);
        compare_image(table["blur"], of_.path("frame", k, "blur" + level), blurred, c, l);
        int const found = list_count[static_cast<std::size_t>(c * of_.params.levels + l)];
        ft::corner* const first = list.data() + c * cv.layout.total_slots + cv.layout.first_slot[l];
        test::sort_corners(first, found, cv.layout, l);
        compare_corners(table["corners"], of_.path("frame", k, "cand" + level), first, found);
        compare_corners(table["distribution"], of_.path("frame", k, "quad" + level),
                        kept.data() + c * dv.layout.total + dv.layout.first[l],
                        kept_count[static_cast<std::size_t>(c * of_.params.levels + l)]);
      }
    }
    compare_keypoints(table, k);
    compare_grid(table["grid"], k);
    if (of_.fisheye) {
      compare_fisheye(table["stereo_fisheye"], k);
      compare_end_to_end(table["end_to_end"], k, of_.fisheye_rig);
    } else {
      compare_stereo(table, k);
      compare_end_to_end(table["end_to_end"], k, of_.rectified_rig);
    }
  }

  /// Images in; keypoints, descriptors and stereo out, with nothing recorded in between.
  template <typename Rig>
  void compare_end_to_end(stage_result& r, int k, Rig const& rig) {
    ft::stereo_matcher<Exec, Rig> matcher(rig, of_.orb);
    matcher.match(exec_, of_.orb);
    auto const kp = of_.orb.keypoints();
    auto const capacity = static_cast<std::size_t>(kp.capacity);
    auto const x = column<ft::field::x>(exec_, kp);
    auto const y = column<ft::field::y>(exec_, kp);
    auto const angle = column<ft::field::angle>(exec_, kp);
    auto const octave = column<ft::field::octave>(exec_, kp);
    auto const orb = column<ft::field::orb>(exec_, kp);
    auto const count = of_.template get_array<int>(kp.count, 2);
    std::vector<float> right_x(capacity, -1.0f);
    std::vector<int> partner(2 * capacity, -1);
    npy<float> want_right;
    npy<std::int32_t> want_partner[2];
    if constexpr (Rig::rectified) {
      right_x = column<ft::field::right_x>(exec_, matcher.matches());
      want_right = read_npy<float>(of_.path("frame", k, "mvuRight"));
    } else {
      partner = of_.template get_array<int>(matcher.fisheye_matches().partner, 2 * capacity);
      want_partner[0] = read_npy<std::int32_t>(of_.path("frame", k, "l2r"));
      want_partner[1] = read_npy<std::int32_t>(of_.path("frame", k, "r2l"));
    }
    for (int c = 0; c < 2; ++c) {
      auto const want = read_npy<float>(of_.path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(of_.path("frame", k, c == 0 ? "descL" : "descR"));
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
    auto const& g = of_.orb.geometry();
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
    auto const kp = of_.orb.keypoints();
    auto const x = column<ft::field::x>(exec_, kp);
    auto const y = column<ft::field::y>(exec_, kp);
    auto const angle = column<ft::field::angle>(exec_, kp);
    auto const response = column<ft::field::response>(exec_, kp);
    auto const octave = column<ft::field::octave>(exec_, kp);
    auto const orb = column<ft::field::orb>(exec_, kp);
    auto const count = of_.template get_array<int>(kp.count, 2);
    auto const mono = of_.template get_array<int>(of_.orb.mono_count(), 2);
    for (int c = 0; c < 2; ++c) {
      auto const want = read_npy<float>(of_.path("frame", k, c == 0 ? "kpL" : "kpR"));
      auto const desc = read_npy<std::uint8_t>(of_.path("frame", k, c == 0 ? "descL" : "descR"));
      if (of_.fisheye) {
        auto const want_mono = read_npy<std::int32_t>(of_.path("frame", k, "mono"));
        table["keypoint_order"].add(want_mono(c) == mono[static_cast<std::size_t>(c)]);
      }
      for (int i = 0; i < std::max(want.rows(), count[static_cast<std::size_t>(c)]); ++i) {
        bool const there = i < want.rows() && i < count[static_cast<std::size_t>(c)];
        auto const at = static_cast<std::size_t>(c * kp.capacity + i);
        table["keypoint_order"].add(
            there && x[at] == want(i, 0) && y[at] == want(i, 1) &&
            static_cast<float>(of_.orb.geometry().patch_size(octave[at])) == want(i, 2) &&
            response[at] == want(i, 4) && static_cast<float>(octave[at]) == want(i, 5));
        table["orientation"].add(there && angle[at] == want(i, 3),
                                 there ? angle[at] - want(i, 3) : 0.0f);
        table["descriptor"].add(there && std::memcmp(&orb[at], &desc(i, 0), 32) == 0);
      }
    }
  }

  void compare_grid(stage_result& r, int k) {
    auto const geometry = ft::grid_geometry::over(0, 0, static_cast<float>(of_.params.width),
                                                  static_cast<float>(of_.params.height));
    ft::feature_grid<Exec::space> grid(geometry, of_.orb.capacity(), 2);
    of_.load_frame(k, keypoints_);
    ft::build_grid<ft::nearest_cell>(exec_, keypoints_.view(), 0, 1, 2, grid.view());
    for (int c = 0; c < 2; ++c) {
      std::string const name = c == 0 ? "grid" : "gridR";
      if (!exists(of_.path("frame", k, name + "_count"))) { continue; }
      auto const count = read_npy<std::int32_t>(of_.path("frame", k, name + "_count"));
      auto const index = read_npy<std::int32_t>(of_.path("frame", k, name + "_index"));
      auto const view = grid.view().slice(c);
      auto const start =
          of_.template get_array<int>(view.start, static_cast<std::size_t>(geometry.cells() + 1));
      auto const indices =
          of_.template get_array<int>(view.indices, static_cast<std::size_t>(view.capacity));
      for (std::size_t i = 0; i < count.data.size(); ++i) {
        r.add(start[i + 1] - start[i] == count.data[i]);
      }
      for (std::size_t i = 0; i < index.data.size(); ++i) { r.add(indices[i] == index.data[i]); }
    }
  }

  void compare_stereo(conformance_table& table, int k) {
    of_.load_frame(k, keypoints_);
    ft::stereo_matches<Exec::space> matches(of_.orb.capacity());
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = of_.params.height;
    ft::feature_grid<Exec::space> right_rows(rows, of_.orb.capacity());
    ft::stereo_params params;
    params.bf = of_.rectified_rig.bf();
    params.max_disparity = of_.rectified_rig.bf() / of_.rectified_rig.baseline_length().value;
    ft::match_stereo_rectified(exec_, of_.orb.pyramid(), keypoints_.view(), params, matches.view(),
                               right_rows.view());
    auto const right_x = column<ft::field::right_x>(exec_, matches.view());
    auto const depth = column<ft::field::depth>(exec_, matches.view());
    auto const want_u = read_npy<float>(of_.path("frame", k, "mvuRight"));
    auto const want_d = read_npy<float>(of_.path("frame", k, "mvDepth"));
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
    of_.load_frame(k, keypoints_);
    int const capacity = of_.orb.capacity();
    auto const mono = to_exec(exec_, read_npy<std::int32_t>(of_.path("frame", k, "mono")).data);
    ft::fisheye_matches_view matches;
    ft::arena<Exec::space> memory([&](ft::carver& c) { ft::carve(c, matches, capacity, 1); });
    ft::fisheye_stereo<fisheye_rig_type> const stereo{
        of_.fisheye_rig, of_.orb.geometry(), mono.data(), {}};
    ft::match_stereo_fisheye(exec_, stereo, keypoints_.view(), matches);
    auto const partner =
        of_.template get_array<int>(matches.partner, static_cast<std::size_t>(2 * capacity));
    auto const point =
        of_.template get_array<ft::vec3<float>>(matches.point, static_cast<std::size_t>(capacity));
    auto const l2r = read_npy<std::int32_t>(of_.path("frame", k, "l2r"));
    auto const r2l = read_npy<std::int32_t>(of_.path("frame", k, "r2l"));
    auto const p3d = read_npy<float>(of_.path("frame", k, "stereo3d"));
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

  golden_folder<Exec> of_;
  Exec exec_;
  ft::keypoints<Exec::space> keypoints_;
};

}  // namespace test
