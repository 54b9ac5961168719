// SPDX-License-Identifier: Apache-2.0
/// @file The odometry's options and poses as types of ft.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "examples/track_sequence/odometry.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace app {

inline ft::pose to_ft(rigid_pose const& T) {
  ft::pose p;
  for (std::size_t i = 0; i < 9; ++i) { p.R.m[i] = static_cast<float>(T.R[i]); }
  p.t = {static_cast<float>(T.t[0]), static_cast<float>(T.t[1]), static_cast<float>(T.t[2])};
  return p;
}

inline rigid_pose from_ft(ft::pose const& p) {
  rigid_pose T;
  for (std::size_t i = 0; i < 9; ++i) { T.R[i] = static_cast<double>(p.R.m[i]); }
  T.t = {static_cast<double>(p.t.x), static_cast<double>(p.t.y), static_cast<double>(p.t.z)};
  T.orthonormalize();
  return T;
}

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

/// The options' rig as a type of ft.
template <typename Rig>
Rig rig_of(odometry_options const& o) {
  auto const f = [](double v) { return static_cast<float>(v); };
  if constexpr (Rig::rectified) {
    return ft::rectified_rig::make({f(o.fx), f(o.fy), f(o.cx), f(o.cy)}, f(o.baseline));
  } else {
    auto const camera = [&](std::array<double, 8> const& p) {
      return ft::kannala_brandt<float>{f(p[0]), f(p[1]), f(p[2]), f(p[3]),
                                       f(p[4]), f(p[5]), f(p[6]), f(p[7])};
    };
    return {camera(o.left), camera(o.right), to_ft(o.T_right_left)};
  }
}

inline ft::tracker_params tracker_params_of(odometry_options const& o) {
  ft::tracker_params p;
  p.orb.width = o.width;
  p.orb.height = o.height;
  p.orb.features = o.features;
  p.orb.levels = o.levels;
  p.orb.scale_factor = static_cast<float>(o.scale_factor);
  p.orb.ini_threshold = o.ini_threshold;
  p.orb.min_threshold = o.min_threshold;
  p.optimize_last = o.optimize != pose_optimization::off;
  p.optimize_local = o.optimize == pose_optimization::both;
  p.map_slots = std::max(1 << 17, 8 * o.features);
  p.updates = std::max(1 << 13, 2 * o.features);
  p.measure_stages = true;
  return p;
}

}  // namespace app
