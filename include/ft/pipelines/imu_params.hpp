// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry knows about an IMU, and what it tells of it.
#pragma once

#include <cstdint>

#include "ft/containers/inertial.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/kernels/inertial/select_samples.hpp"

namespace ft {
inline namespace FT_ABI {

/// The IMU of a rig. All numbers down to the noise come from its calibration.
struct imu_params {
  bool present = false;
  /// From the frame of poses to the IMU's: the left camera, of a distorted_pair the rectified one,
  /// or a multi_rig's body.
  rigid<double> T_bc = rigid<double>::identity();
  imu_noise noise;
  int samples = 4096;     ///< between two frames, at most: with more, there is a gap
  int waiting = 1 << 16;  ///< that wait for their frame, at most: with more, the oldest leave
  /// Range of the sensor, of an axis. A sample that reaches it is left out, as one that is not
  /// finite.
  float max_accel = 156.9064f;  ///< m/s^2; 16 g
  float max_gyro = 34.90659f;   ///< rad/s; 2000 degrees/s
  /// Time of the IMU's clock less that of the images' at the same moment, s: Kalibr's timeshift
  /// cam to imu, t_imu = t_camera + offset. At most max_time_offset_s either way.
  double time_offset_s = 0;
  /// The offset is estimated, where the camera turns at a changing rate. One that differs clearly
  /// from that in use, by 4 standard deviations and 1.5 ms, replaces it: the IMU begins anew.
  bool estimate_time_offset = true;
  static constexpr double max_time_offset_s = 10;
  selection_params selection;  ///< a rate_hz of 0 becomes the noise's
  /// `known_scale` is the rig's: an odometry of one camera sets it.
  initialization_params initialization = {9.81f, true, 8};
  /// Of one camera until its map is metric, as `initialization` has others: of a keyframe, in the
  /// map's unit, which is the median depth of its first points;
  float scale_position_sigma = 5e-4f;
  float scale_sigma = 0.005f;  ///< largest standard deviation of the scale, a share;
  int scale_keyframes = 40;    ///< and keyframes that it is estimated from, at most
  /// What gravity and the accelerometer's bias are off by together, between two images, m/s^2. A
  /// bias looks like a tilt until the body has turned, and the scale of the axes is not exact.
  float accel_sigma = 0.3f;
  double keyframe_period_s = 0.25;  ///< a keyframe is made at least this often while tracking
};

/// A sample of an IMU.
struct imu_measurement {
  std::int64_t time_ns;  ///< on the images' clock, or imu_params::time_offset_s ahead of it
  vec3<float> accel;     ///< specific force, m/s^2; at rest it points up, 9.81 long
  vec3<float> gyro;      ///< rad/s
};

/// Samples of an IMU that were left out since its odometry was made or its camera was reset.
struct imu_left_out {
  long long disordered = 0;    ///< with a time that is not after that of the sample before: doubled
                               ///< or swapped ones
  long long out_of_range = 0;  ///< not finite, or at imu_params::max_accel or max_gyro
  long long crowded_out = 0;   ///< by newer ones, as imu_params::waiting were waiting
};

/// How far the IMU's clock is ahead of that of the images, by how both turn.
struct imu_clock_offset {
  bool known = false;  ///< within a millisecond. Until the rate of turning has changed enough it is
                       ///< not observable
  double offset_s = 0;  ///< as imu_params::time_offset_s
  double sigma_s = 0;   ///< its standard deviation; 0 = there is no estimate
};

/// What the IMU says about a frame. imu_warnings() says in words what is wrong with its samples.
struct imu_tracking {
  bool known = false;  ///< gravity, velocity and biases are known; until then the rest is 0, but
                       ///< what is said of the samples
  bool optimized = false;             ///< the frame's pose was optimised with the IMU
  bool predicted = false;             ///< the frame's pose was predicted with the IMU
  vec3<double> velocity = {0, 0, 0};  ///< of the IMU in the world, m/s
  vec3<double> gravity = {0, 0, 0};   ///< in the world, m/s^2
  imu_bias bias{};
  integration_status samples = integration_status::no_samples;  ///< those since the last frame
  double rate_hz = 0;        ///< at which the last samples came, by their times; 0 = unknown
  double newest_s = 0;       ///< time of the newest sample since the frame's; 0 = there is none
  imu_left_out left_out;     ///< all of them so far
  double time_offset_s = 0;  ///< in use: imu_params::time_offset_s, or one that was found
  imu_clock_offset clock;    ///< found; unknown without imu_params::estimate_time_offset
};

}  // namespace FT_ABI
}  // namespace ft
