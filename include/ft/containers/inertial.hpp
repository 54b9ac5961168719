// SPDX-License-Identifier: Apache-2.0
/// @file Inertial measurements, their integrals, and the state of a body with an IMU.
///
/// The body's frame is the IMU's. The world's z axis points up. Source of terms and formulas:
/// Forster et al., "On-manifold preintegration for real-time visual-inertial odometry", T-RO 2017.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Gravity where the world's z axis points up, m/s^2.
FT_HOST_DEVICE constexpr vec3<float> standard_gravity() { return {0.0f, 0.0f, -9.81f}; }

/// The same as variances of one sample.
struct imu_variances {
  float measured[6];  ///< gyro x 3, accelerometer x 3
  float walk[6];      ///< added to the biases' covariance with each step; gyro, accelerometer
};

/// The time between two images, and the samples among which the ones between them are.
struct imu_interval {
  double from_s, to_s;  ///< stamps of the images
  int first, count;     ///< of the samples, oldest first
};

/// Constant motion for a while: what the samples at both ends of a step average to.
struct imu_step {
  vec3<float> accel;  ///< m/s^2
  vec3<float> gyro;   ///< rad/s
  float dt;           ///< seconds
};

/// Which samples an interval takes.
struct imu_selection {
  int dropped;  ///< older than the interval
  int taken;    ///< the next ones, of which the steps are made
  /// What a queue loses at its front. The sample at or after the second image opens the next
  /// interval and stays.
  int removed;
  int steps;
  integration_status status;

  /// Whether the reference marks the frame as preintegrated: its integral, if any, may be read.
  FT_HOST_DEVICE bool marks_frame() const { return status != integration_status::one_sample; }
};

/// Selections and steps of many intervals.
struct imu_steps_view {
  int intervals = 0;
  int capacity = 0;                 ///< steps of an interval
  imu_selection* chosen = nullptr;  ///< [intervals]
  imu_step* steps = nullptr;        ///< [intervals][capacity]

  FT_HOST_DEVICE imu_step* of(int interval) const {
    return steps + static_cast<std::ptrdiff_t>(interval) * capacity;
  }
};
static_assert(std::is_trivially_copyable<imu_steps_view>::value, "passed to kernels");

inline void carve(carver& c, imu_steps_view& v, int intervals, int capacity) {
  v.intervals = intervals;
  v.capacity = capacity;
  c.place({intervals}, v.chosen);
  c.place({intervals, capacity}, v.steps);
}

}  // namespace FT_ABI
}  // namespace ft
