// SPDX-License-Identifier: Apache-2.0
/// @file What an initialisation of a body with an IMU takes and gives.
#pragma once

#include <limits>

#include "ft/containers/inertial.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

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

/// Parameters of initialize_inertial(). Positions are in the unit of the poses: metres, if their
/// scale is known.
struct initialization_params {
  float gravity = 9.81f;          ///< m/s^2
  bool known_scale = true;        ///< false: the poses of one camera
  int least_keyframes = 4;        ///< 3 or more
  float position_sigma = 0.005f;  ///< of a pose; it weighs poses against the bias' prior
  float rotation_sigma = 0.001f;  ///< of a pose, rad
  float accel_bias_sigma = 0.5f;  ///< the prior: biases of that size are usual, m/s^2
  float rest_distance = 0.01f;    ///< from the first pose, while the body rests
  float rest_angle = 0.005f;      ///< likewise, rad
  float max_gyro_sigma = 0.005f;  ///< limits of little_motion: gyro bias, rad/s;
  /// direction of gravity, rad; at rest the prior alone makes it 0.072;
  float max_tilt_sigma = 0.08f;
  float max_velocity_sigma = 0.1f;  ///< last velocity, m/s;
  float max_scale_sigma = 0.03f;    ///< share of the scale
  float max_position_rms = 0.05f;   ///< limits of inconsistent: m,
  float max_rotation_rms = 0.02f;   ///< and rad for an interval

  /// @throws bad_argument naming the value and the limit
  void check() const {
    constexpr float most = std::numeric_limits<float>::max();
    detail::require_range("gravity", gravity, 0.1f, 100.0f);
    detail::require_range("least_keyframes", least_keyframes, 3, 1 << 20);
    detail::require_range("position_sigma", position_sigma, 1e-9f, most);
    detail::require_range("rotation_sigma", rotation_sigma, 1e-9f, most);
    detail::require_range("accel_bias_sigma", accel_bias_sigma, 1e-9f, 1e6f);
    detail::require_range("rest_distance", rest_distance, 0.0f, most);
    detail::require_range("rest_angle", rest_angle, 0.0f, most);
  }
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
