// SPDX-License-Identifier: Apache-2.0
/// @file Samples of an IMU, what is known about it, and what it tells of a frame.
#pragma once

#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace v0 {

/// Specific force and angular rate at one moment, in the body's frame.
struct imu_sample {
  double time_s;
  vec3<float> accel;  ///< m/s^2; at rest it points up, 9.81 long
  vec3<float> gyro;   ///< rad/s
};

/// A sample of an IMU.
struct imu_measurement {
  std::int64_t time_ns;  ///< on the images' clock
  vec3<float> accel;     ///< specific force, m/s^2; at rest it points up, 9.81 long
  vec3<float> gyro;      ///< rad/s
};

/// What an IMU shows in excess of specific force and angular rate.
struct imu_bias {
  vec3<float> gyro;   ///< rad/s
  vec3<float> accel;  ///< m/s^2
};

/// Noise of an IMU as densities, as its settings give them.
struct imu_noise {
  float gyro = 1.7e-4f;          ///< rad/s / sqrt(Hz)
  float accel = 2e-3f;           ///< m/s^2 / sqrt(Hz)
  float gyro_walk = 1.9393e-5f;  ///< rad/s^2 / sqrt(Hz)
  float accel_walk = 3e-3f;      ///< m/s^3 / sqrt(Hz)
  float rate_hz = 200;
};

/// What came of an integration.
enum class integration_status : int {
  integrated = 0,
  no_samples,    ///< the queue was empty, or there was no interval
  one_sample,    ///< no step can be made from one sample
  no_steps,      ///< all samples were older than the interval: an integral over no time
  unordered,     ///< times of samples that do not ascend
  not_finite,    ///< a sample or a time is NaN or infinite
  gap,           ///< the samples leave out a longer time than the limit
  repeated,      ///< integrated, but two samples have one time: a step of no duration among others
  wrong_rate,    ///< the samples come much more or much less often than the noise was stated for
  too_many,      ///< more steps than there is memory for
  contradicted,  ///< integrated, but many matches of images say otherwise
};

/// Whether an integral of that status says how the body moved.
FT_HOST_DEVICE FT_INLINE constexpr bool usable(integration_status status) {
  return status == integration_status::integrated || status == integration_status::repeated;
}

struct selection_params {
  /// A sample that is this much older than an image counts as taken with it.
  double early_s = 0.001;
  /// The longest time without a sample, also at the ends of the interval, where samples are
  /// extrapolated. Infinity: any, as in the reference.
  double longest_gap_s = 0.1;
  /// For which the noise is stated. Intervals of other rates are refused: the time between samples
  /// may be a third of this rate's, or three times as long. 0: any rate.
  float rate_hz = 0;
  static constexpr double rate_tolerance = 3;
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
};

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
  /// from that in use, by 4 standard deviations and 1.5 ms, replaces it: the IMU begins anew. That
  /// of a monocular_rig is only told. As long as it is not known, turns at a changing rate weigh
  /// less; with false, time_offset_s is exact.
  bool estimate_time_offset = true;
  /// The rotation of T_bc is estimated, where the camera turns about two axes. What it is off by
  /// clearly, by 4 standard deviations and 0.3 degrees, turns the samples: the IMU begins anew.
  /// That of a monocular_rig is only told.
  bool estimate_rotation = true;
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

/// Samples of an IMU that were left out since its odometry was made or its camera was reset.
struct imu_left_out {
  long long disordered = 0;    ///< with a time that is not after that of the sample before: doubled
                               ///< or swapped ones
  long long out_of_range = 0;  ///< not finite, or at imu_params::max_accel or max_gyro
  long long crowded_out = 0;   ///< by newer ones, as imu_params::waiting were waiting
  long long frozen = 0;  ///< the sample before to the bit, again and again: a sensor that has shown
                         ///< noise does not measure
  long long spikes = 0;  ///< single rates of turning that no body has between its neighbours'
};

/// How far the IMU's clock is ahead of that of the images, by how both turn.
struct imu_clock_offset {
  bool known = false;  ///< within a millisecond. Until the rate of turning has changed enough it is
                       ///< not observable
  double offset_s = 0;  ///< as imu_params::time_offset_s
  double sigma_s = 0;   ///< its standard deviation; 0 = there is no estimate
};

/// How the IMU is turned from where imu_params::T_bc says, by how images and gyroscope turn.
struct imu_misalignment {
  bool known = false;  ///< within 0.1 degree. Until the camera has turned about two axes it is not
                       ///< observable
  vec3<double> turn = {0, 0, 0};  ///< rotation vector, rad: turns what the IMU measures into its
                                  ///< frame as T_bc has it
  double sigma = 0;               ///< of it, rad; 0 = there is no estimate
};

/// What the IMU says about a frame. In words: explain_imu(), whether it is used; imu_warnings().
struct imu_tracking {
  bool known = false;  ///< gravity, velocity and biases are known; until then the rest is 0, but
                       ///< what is said of the samples
  bool optimized = false;  ///< the frame's pose was optimised with the IMU
  bool predicted = false;  ///< the frame's pose was predicted with the IMU, not by
                           ///< odometry::predict()
  /// What the last estimate of gravity, velocity and biases came to.
  initialization_status estimate = initialization_status::few_keyframes;
  vec3<double> velocity = {0, 0, 0};  ///< of the IMU in the world, m/s
  vec3<double> gravity = {0, 0, 0};   ///< in the world, m/s^2
  imu_bias bias{};
  integration_status samples = integration_status::no_samples;  ///< those since the last frame
  /// Time of tracking in which the samples could have been used and were not, s, less that in
  /// which they were since: at most longest_unused_s(). A frame counts keyframe_period_s at most. 0
  /// again where the IMU begins anew.
  double unused_s = 0;
  double rate_hz = 0;        ///< at which the last samples came, by their times; 0 = unknown
  double newest_s = 0;       ///< time of the newest sample since the frame's; 0 = there is none
  imu_left_out left_out;     ///< all of them so far
  double time_offset_s = 0;  ///< in use: imu_params::time_offset_s, or one that was found
  imu_clock_offset clock;    ///< found; unknown without imu_params::estimate_time_offset
  /// In use: by what samples are turned before they are used, from the IMU's frame as they come to
  /// that which imu_params::T_bc says. Rotation vector, rad, up to half a turn, near which its sign
  /// may change; 0 until one was found, of one camera, or without imu_params::estimate_rotation.
  vec3<double> turn = {0, 0, 0};
  imu_misalignment misalignment;  ///< found; unknown without imu_params::estimate_rotation
};

/// Plugs the IMU of odometry_params::imu into an odometry: the last argument of its constructor.
struct inertial {};

/// Where an IMU is mounted.
struct imu_mount {
  rigid<float> T_bc;  ///< left camera to body, metres
  rigid<float> T_cb;  ///< its inverse
};

/// Preintegrated measurements between two images, in the body's frame at the first one.
struct preintegrated {
  float dT;                ///< seconds
  mat3<float> dR;          ///< second body to first
  vec3<float> dV;          ///< m/s, without gravity
  vec3<float> dP;          ///< metres, without gravity and initial velocity
  mat3<float> JRg;         ///< derivatives by the biases: of dR (right-hand tangent) by the gyro's,
  mat3<float> JVg;         ///< of dV by the gyro's,
  mat3<float> JVa;         ///< of dV by the accelerometer's,
  mat3<float> JPg;         ///< of dP by the gyro's,
  mat3<float> JPa;         ///< of dP by the accelerometer's
  float C[81];             ///< row-major covariance: rotation, velocity, position
  float walk[6];           ///< variances of the biases' change: gyro, accelerometer
  imu_bias bias;           ///< with which was integrated
  vec3<float> mean_accel;  ///< mean of the rotated specific force, for an initialisation, m/s^2
  vec3<float> mean_gyro;   ///< rad/s
  int steps;
  integration_status status;
};
static_assert(std::is_trivially_copyable<preintegrated>::value, "copied between memories");

/// A body's motion and the biases of its IMU.
template <typename S>
struct inertial_state {
  mat3<S> R;   ///< body to world
  vec3<S> p;   ///< position in the world, metres
  vec3<S> v;   ///< velocity in the world, m/s
  vec3<S> bg;  ///< rad/s
  vec3<S> ba;  ///< m/s^2
};

/// A state as frames store it: with the camera's pose as a quaternion.
struct stored_inertial_state {
  quaternion<float> q_cw;  ///< world to left camera
  vec3<float> t_cw;        ///< metres
  vec3<float> v;           ///< of the body in the world, m/s
  imu_bias bias;
};

/// What past measurements say about the state of a frame: a state and an information matrix.
struct inertial_prior {
  inertial_state<double> state;
  /// Row-major 15 x 15, of a small change: rotation (right-hand tangent), position in the body's
  /// frame, velocity, gyro bias, accelerometer bias.
  double information[225];
  int known;  ///< 0: none
};

}  // namespace v0
}  // namespace ft
