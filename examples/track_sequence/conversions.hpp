// SPDX-License-Identifier: Apache-2.0
/// @file The odometry's options and poses as types of ft.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <type_traits>

#include "examples/track_sequence/odometry.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/odometry.hpp"

namespace app {

inline rigid_pose from_ft(ft::rigid<double> const& p) {
  rigid_pose T;
  for (std::size_t i = 0; i < 9; ++i) { T.R[i] = p.R.m[i]; }
  T.t = {p.t.x, p.t.y, p.t.z};
  return T;
}

inline ft::pose to_ft(rigid_pose const& p) {
  auto const f = [](double v) { return static_cast<float>(v); };
  ft::pose T;
  for (std::size_t i = 0; i < 9; ++i) { T.R.m[i] = f(p.R[i]); }
  T.t = {f(p.t[0]), f(p.t[1]), f(p.t[2])};
  return T;
}

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

/// The options' rig as a type of ft.
template <typename Rig>
Rig rig_of(odometry_options const& o) {
  auto const f = [](double v) { return static_cast<float>(v); };
  ft::pinhole<float> const pinhole{f(o.fx), f(o.fy), f(o.cx), f(o.cy)};
  auto const fisheye = [&](std::array<double, 8> const& p) {
    return ft::kannala_brandt<float>{f(p[0]), f(p[1]), f(p[2]), f(p[3]),
                                     f(p[4]), f(p[5]), f(p[6]), f(p[7])};
  };
  if constexpr (std::is_same_v<Rig, ft::monocular_rig<ft::pinhole<float>>>) {
    return Rig::make(pinhole);
  } else if constexpr (ft::is_monocular_v<Rig>) {
    return Rig::make(fisheye(o.left));
  } else if constexpr (std::is_same_v<Rig, ft::rgbd_rig<>>) {
    Rig rig = Rig::make(pinhole, f(o.baseline), f(o.depth_unit));
    rig.min_depth = f(o.min_depth);
    rig.max_depth = f(o.max_depth);
    rig.check();
    return rig;
  } else if constexpr (Rig::rectified) {
    return Rig::make(pinhole, f(o.baseline));
  } else {
    return {fisheye(o.left), fisheye(o.right), to_ft(o.T_right_left)};
  }
}

inline ft::vec3<float> narrowed(std::array<double, 3> const& v) {
  auto const f = [](double x) { return static_cast<float>(x); };
  return {f(v[0]), f(v[1]), f(v[2])};
}

inline ft::imu_params imu_params_of(imu_options const& o) {
  auto const f = [](double v) { return static_cast<float>(v); };
  ft::imu_params p;
  p.present = true;
  for (std::size_t i = 0; i < 9; ++i) { p.T_bc.R.m[i] = o.T_imu_left.R[i]; }
  p.T_bc.t = {o.T_imu_left.t[0], o.T_imu_left.t[1], o.T_imu_left.t[2]};
  p.noise = {f(o.gyro_noise), f(o.accel_noise), f(o.gyro_walk), f(o.accel_walk), f(o.rate_hz)};
  p.time_offset_s = o.time_offset_s;
  return p;
}

inline imu_outcome outcome_of(ft::imu_tracking const& t, ft::imu_params const& params) {
  auto const wide = [](ft::vec3<float> v) {
    return std::array<double, 3>{static_cast<double>(v.x), static_cast<double>(v.y),
                                 static_cast<double>(v.z)};
  };
  return {t.known,
          t.optimized,
          {t.velocity.x, t.velocity.y, t.velocity.z},
          wide(t.bias.gyro),
          wide(t.bias.accel),
          {t.gravity.x, t.gravity.y, t.gravity.z},
          ft::imu_warnings(t, params)};
}

inline ft::odometry_params odometry_params_of(odometry_options const& o) {
  ft::odometry_params p;
  p.orb.width = o.width;
  p.orb.height = o.height;
  p.orb.features = o.features;
  p.orb.levels = o.levels;
  p.orb.scale_factor = static_cast<float>(o.scale_factor);
  p.orb.ini_threshold = o.ini_threshold;
  p.orb.min_threshold = o.min_threshold;
  p.rules.near_depth = static_cast<float>(o.near_depth);
  p.map_slots = std::max(p.map_slots, 8 * o.features);
  if (o.imu) { p.imu = imu_params_of(*o.imu); }
  p.measure_stages = o.measure_stages;
  p.prefetch = o.prefetch;
  return p;
}

}  // namespace app
