// SPDX-License-Identifier: Apache-2.0
/// @file Stage: poses of frames from the map points that their keypoints hold.
#pragma once

#include <cstddef>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/observations.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/pose/pose_problem.hpp"

namespace ft {
inline namespace FT_ABI {

/// One frame: gathers the observations, optimises the pose, and lets keypoints go of outliers.
template <typename Rig>
struct optimize_frame_pose {
  using solver = optimize_pose<Rig>;
  struct scratch {
    typename solver::scratch pose;
    int number[solver::scratch_size];  ///< keypoint number of an observation
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, Rig const& rig,
                                 frame_view const& frame, map_points_view const& map,
                                 pyramid_geometry const& geometry, pose_params const& params,
                                 pose const* start, pose* result,
                                 observations_view const& out) const {
    map_points_view const points = map.slice(b);
    int* const holder = frame.holder + static_cast<std::ptrdiff_t>(b) * frame.numbers();
    std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(b) * out.capacity;
    int const first = *frame.camera(b, 0).count;
    int const all = first + (frame.cameras > 1 ? *frame.camera(b, 1).count : 0);
    if (g.rank() == 0) { s.pose.T = start[b].template cast<strict_double>(); }
    int const n = list_observations(g, s, first, all, frame.capacity(), holder, out.number + at);
    pose_problem const problem{out.items + at, n, start + b, result + b, out.outlier + at,
                               out.inliers + b};
    auto const number_of = [&](int i) {
      return i < solver::scratch_size ? s.number[i] : out.number[at + i];
    };
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      int const number = number_of(i);
      int const c = number < frame.capacity() ? 0 : 1;
      int const k = number - c * frame.capacity();
      keypoints_view const kp = frame.camera(b, c);
      float const right = Rig::rectified && frame.right_x != nullptr
                              ? frame.right_x[static_cast<std::ptrdiff_t>(b) * frame.capacity() + k]
                              : -1.0f;
      observation const o{get<field::position>(points, holder[number]),
                          get<field::x>(kp, k),
                          get<field::y>(kp, k),
                          right,
                          geometry.inv_sigma2[get<field::octave>(kp, k)],
                          c};
      out.items[at + i] = o;
      solver::prepare(s.pose, i, rig, problem, o);
    }
    if (g.rank() == 0) { out.count[b] = n; }
    solver::solve(g, s.pose, rig, problem, params);
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      if (solver::is_outlier(s.pose, i, problem)) { holder[number_of(i)] = -1; }
    }
  }

private:
  /// Lists the numbers of the keypoints that hold a point. Returns how many. @param first keypoints
  /// of the first camera @param all of both
  template <typename Group>
  FT_HOST_DEVICE static int list_observations(Group g, scratch& s, int first, int all, int capacity,
                                              int const* holder, int* listed) {
    // Each part takes a run of keypoints: one scan, over the parts, gives all their places.
    auto const part = g.part();
    int const run = ceil_div(all, g.size()) * part.size();
    int const from = g.part_index() * run;
    int const to = min_of(from + run, all);
    auto const number_of = [&](int k) { return k < first ? k : k - first + capacity; };
    auto const holds = [&](int k) { return k < to && holder[number_of(k)] >= 0; };
    int mine = 0;
    constexpr int at_once = 4;  // loads
    FT_NO_UNROLL
    for (int k = from + part.rank(); k < to; k += at_once * part.size()) {
      FT_UNROLL
      for (int j = 0; j < at_once; ++j) { mine += static_cast<int>(holds(k + j * part.size())); }
    }
    int n = 0;
    int place = part.shuffle(g.exclusive_scan(mine, n), 0);
    FT_NO_UNROLL
    for (int k = from + part.rank(); k - part.rank() < to; k += part.size()) {
      bool const held = holds(k);
      int count = 0;
      int const i = place + part.exclusive_count(held, count);
      if (held) {
        listed[i] = number_of(k);
        if (i < solver::scratch_size) { s.number[i] = number_of(k); }
      }
      place += count;
    }
    g.sync();
    return n;
  }
};

/// Pose of every frame from the map points that its keypoints hold; outliers are released.
/// Asynchronous on `exec`; allocates nothing; one launch. @param start,result [batch] T_cw, may be
/// the same
/// @param out capacity at least frame.numbers()
template <typename Exec, typename Rig>
void optimize_poses(Exec const& exec, Rig const& rig, frame_view const& frame,
                    map_points_view const& map, pyramid_geometry const& geometry,
                    pose_params const& params, pose const* start, pose* result,
                    observations_view const& out) {
  for_each_item<per_block<sum_lanes>>(exec, frame.batch, optimize_frame_pose<Rig>{}, rig, frame,
                                      map, geometry, params, start, result, out);
}

}  // namespace FT_ABI
}  // namespace ft
