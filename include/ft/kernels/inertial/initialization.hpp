// SPDX-License-Identifier: Apache-2.0
/// @file What an initialisation of a body with an IMU takes and gives.
#pragma once

#include <limits>

#include "ft/containers/inertial.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(initialization_params const& p) {
  constexpr float most = std::numeric_limits<float>::max();
  detail::require_range("gravity", p.gravity, 0.1f, 100.0f);
  detail::require_range("least_keyframes", p.least_keyframes, 3, 1 << 20);
  detail::require_range("position_sigma", p.position_sigma, 1e-9f, most);
  detail::require_range("rotation_sigma", p.rotation_sigma, 1e-9f, most);
  detail::require_range("accel_bias_sigma", p.accel_bias_sigma, 1e-9f, 1e6f);
  detail::require_range("rest_distance", p.rest_distance, 0.0f, most);
  detail::require_range("rest_angle", p.rest_angle, 0.0f, most);
}

/// What came of an initialisation.
enum class initialization_status : int {
  initialized = 0,
  /// Known as well. Of the accelerometer's bias only the vertical part is: a level one looks like a
  /// tilt. tilt_sigma says how much that may be; more is known once the body has moved.
  at_rest,
  few_keyframes,  ///< fewer than initialization_params::least_keyframes
  no_integral,    ///< an interval was not integrated
  not_finite,     ///< a pose or an integral has NaN or infinity
  little_motion,  ///< a result is less certain than its limit: more keyframes, or more motion
  inconsistent,   ///< poses and integrals contradict each other
};

/// Gravity, velocity and biases. Standard deviations come from the poses' given ones, or from
/// what the poses are off by, if that is more.
struct inertial_initialization {
  initialization_status status;
  vec3<double> gravity;           ///< m/s^2, in the world of the poses
  mat3<double> R_up;              ///< turns that world, least of all, so that its z points up
  double scale;                   ///< metres per unit of the poses; 1 if known
  inertial_state<double> newest;  ///< of the last keyframe in the world of the poses, metres
  float gyro_bias_sigma;          ///< rad/s, of an axis
  float accel_bias_sigma;         ///< m/s^2, of the least certain axis of the body at first
  float tilt_sigma;               ///< rad
  float velocity_sigma;           ///< m/s, of the last velocity
  float scale_sigma;              ///< share; 0 if known
  float position_rms;             ///< what the poses are off by, m
  float rotation_rms;             ///< rad, for an interval

  FT_HOST_DEVICE bool succeeded() const {
    return status == initialization_status::initialized || status == initialization_status::at_rest;
  }
};

/// Keyframes of one body, in order of time.
struct initialization_window {
  rigid<double> const* T_wc;       ///< poses of the left camera, in any world
  preintegrated const* integrals;  ///< k: from keyframe k to k + 1, at any bias near the true one
  int count;                       ///< keyframes
  imu_mount mount;
};

/// Windows of a batch: keyframe k of window b is element b * capacity + k, as is the integral that
/// begins with it.
struct initialization_windows {
  rigid<double> const* T_wc;
  preintegrated const* integrals;
  int const* counts;  ///< [batch], at most `capacity`
  int capacity;
  int batch;
  imu_mount mount;
};

}  // namespace FT_ABI
}  // namespace ft
