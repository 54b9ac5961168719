// SPDX-License-Identifier: Apache-2.0
/// @file The walk of test::room with an IMU, whose samples come from the walk's own formula.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "ft/math/se3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/odometry_params.hpp"
#include "tests/support/room.hpp"

namespace test {
namespace inertial_walk {

using test::room::stereo_frame;
using vector = ft::vec3<double>;
using matrix = ft::mat3<double>;
constexpr std::int64_t period = 50'000'000;
constexpr int frame_count = 40;

inline std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, frame_count);
  return frames;
}
/// The orientation of make_walk() at a time in frames.
inline matrix orientation(double step) {
  double const yaw = 0.012 * step, pitch = 0.006 * step;
  double const c = std::cos(yaw), s = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  return matrix{{c, 0, s, 0, 1, 0, -s, 0, c}} * matrix{{1, 0, 0, 0, cp, -sp, 0, sp, cp}};
}
constexpr double seconds = 0.05;  // of a frame
inline vector true_velocity() { return {0.02 / seconds, -0.01 / seconds, 0.05 / seconds}; }
constexpr double gravity = 9.81;

// A mount, and biases, that nothing can be right without.
inline ft::rigid<double> mount() {
  double const c = std::cos(0.4), s = std::sin(0.4);
  return {{{c, -s, 0, s, c, 0, 0, 0, 1}}, {0.05, -0.02, 0.03}};
}
inline vector const gyro_bias{0.004, -0.006, 0.003};
inline vector const accel_bias{0.02, -0.03, 0.01};

inline ft::vec3<float> narrow(vector const& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}
inline vector axis_of(matrix const& dR) {  // of a small rotation
  return {0.5 * (dR.m[7] - dR.m[5]), 0.5 * (dR.m[2] - dR.m[6]), 0.5 * (dR.m[3] - dR.m[1])};
}

/// The sample at a time in frames. The y axis of the walk's world points down.
inline ft::imu_measurement sample_at(double step) {
  ft::rigid<double> const T_bc = mount();
  matrix const R_cb = T_bc.R.transposed();
  vector const t_cb = T_bc.inverse().t;  // where the body is, in the camera's frame
  auto const body = [&](double at) {     // its orientation and position in the world
    matrix const R = orientation(at);
    vector const p = R * t_cb;
    return ft::rigid<double>{R * R_cb, {p.x + 0.02 * at, p.y - 0.01 * at, p.z + 0.05 * at}};
  };
  double const h = 1e-3;  // frames
  auto const before = body(step - h), now = body(step), after = body(step + h);
  vector const turn = axis_of(before.R.transposed() * after.R);
  double const dt = h * seconds;
  vector const moved = (after.t - now.t) - (now.t - before.t);
  vector const force{moved.x / (dt * dt), moved.y / (dt * dt) - gravity, moved.z / (dt * dt)};
  vector const rate{turn.x / (2 * dt), turn.y / (2 * dt), turn.z / (2 * dt)};
  return {static_cast<std::int64_t>(std::llround((step + 1) * static_cast<double>(period))),
          narrow(now.R.transposed() * force + accel_bias), narrow(rate + gyro_bias)};
}

inline ft::odometry_params params() {
  auto p = test::room::odometry_params(4096);
  p.imu.present = true;
  p.imu.T_bc = mount();
  p.imu.keyframe_period_s = 0.1;
  p.imu.initialization.least_keyframes = 8;
  return p;
}

}  // namespace inertial_walk
}  // namespace test
