// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry with an IMU keeps of each camera from frame to frame.
#pragma once

#include <cstddef>
#include <limits>

#include "ft/containers/inertial.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/inertial/inertial_problem.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/odometry/scale_map.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// From what a frame's state is predicted and optimised.
enum class inertial_source : int {
  none = 0,       ///< the IMU says nothing about this frame
  last_keyframe,  ///< the map has changed since the last frame, or that has no prior
  last_frame,
};

namespace detail {
inline constexpr float unknown_rate = std::numeric_limits<float>::quiet_NaN();
}  // namespace detail

/// What is kept of the IMU of one camera. The world is the odometry's.
struct inertial_track {
  int estimates;                   ///< of gravity and biases that were taken over; 0 = unknown
  initialization_status estimate;  ///< what the last one came to, whether it was taken or not
  vec3<float> gravity;             ///< of the last estimate, m/s^2
  imu_bias bias;                   ///< likewise; that of the gyroscope is a weighted mean
  float gyro_weight;  ///< sum of the weights in it, in which older ones count less, s^2 / rad^2
  stored_inertial_state last;       ///< of the last frame
  stored_inertial_state keyframe;   ///< of the newest keyframe
  stored_inertial_state predicted;  ///< of the current frame
  inertial_source source;           ///< of the prediction
  int given;                        ///< 1 = the caller has predicted the pose of the current frame
  int follows;                      ///< 1 = `last` comes from an optimisation, which left a prior
  /// 1 = the velocities of `last` and of `keyframe` are known. They are not after a frame about
  /// which the IMU said nothing, until an estimate or an optimisation gives them anew.
  int moves, keyframe_moves;
  int restarts;         ///< 1 = the integral from the newest keyframe begins with the next interval
  int metric;           ///< of one camera: 1 = lengths of its map are metres
  int map;              ///< likewise: number of its map, of which all above is known; 0 = none
  int begins;           ///< likewise: 1 = that map begins with the current frame
  vec3<double> origin;  ///< likewise: where the map's first camera is, in the map's unit
  int weak;             ///< 1 = few keypoints of the current frame agree with its pose
  int contradicted;  ///< frames since the last optimised one whose map points the IMU contradicts
  int doubted;       ///< 1 = many matches have outvoted what is known, and no pose has agreed since
  int optimized;     ///< 1 = the current frame's pose was optimised with the IMU
  integration_status status;  ///< of the samples since the last frame
  float unseen_s;             ///< from the newest of them to the current frame; 0 = none
  rigid<double> seen;         ///< T_cw of the last frame by its images alone
  int sees;                   ///< 1 = it comes from many matches
  int gyro_agrees;            ///< 1 = the gyroscope turned as the images until the last frame
  int stale;                  ///< 1 = the next estimate comes from before the IMU began anew
  /// Rates of turning at the current frame, the one before, and the newest keyframe, in the body's
  /// frame there, rad/s; NaN = unknown.
  vec3<float> rate, last_rate, keyframe_rate;
  float clock_sigma;  ///< inertial_input::clock_sigma_s

  FT_HOST_DEVICE bool known() const { return estimates > 0; }
  FT_HOST_DEVICE static vec3<float> no_rate() {
    return {detail::unknown_rate, detail::unknown_rate, detail::unknown_rate};
  }
  FT_HOST_DEVICE static inertial_track initial() {
    inertial_track t{};
    t.last.q_cw = t.keyframe.q_cw = t.predicted.q_cw = {0, 0, 0, 1};
    t.restarts = 1;
    t.status = integration_status::no_samples;
    t.estimate = initialization_status::few_keyframes;
    t.seen = rigid<double>::identity();
    t.rate = t.last_rate = t.keyframe_rate = no_rate();
    return t;
  }
  /// Nothing is known any longer, but the unit of the map. An adjustment that has begun does not
  /// count.
  FT_HOST_DEVICE void begin_anew() {
    inertial_track const old = *this;
    *this = initial();
    metric = old.metric;
    map = old.map;
    origin = old.origin;
    seen = old.seen;
    sees = old.sees;
    gyro_agrees = old.gyro_agrees;
    status = old.status;
    stale = 1;
  }
};

/// Of a keyframe when it was made.
struct keyframe_motion {
  vec3<float> v;     ///< world, m/s
  int moves;         ///< 1 = it is known
  int weak;          ///< as in inertial_track
  vec3<float> rate;  ///< likewise
};

/// Inputs of a frame from the host, one camera.
struct inertial_input {
  double from_s, to_s;  ///< stamps of the last image and of this one; equal = there was none
  int samples;          ///< among which the ones between them are
  int anew;             ///< 1 = what was integrated so far is wrong: the IMU begins anew
  float clock_sigma_s;  ///< how well the offset of the clocks that is in use is known
};

/// What the poses of the current frames are optimised from, as in inertial_poses. Executor memory.
struct inertial_inputs {
  int* from_last_frame = nullptr;          ///< [batch]
  stored_inertial_state* first = nullptr;  ///< [batch]
  stored_inertial_state* start = nullptr;  ///< [batch]
  vec3<float>* gravity = nullptr;          ///< [batch]
  preintegrated* integral = nullptr;       ///< [batch]
};

/// The IMUs of all cameras. Executor memory.
struct inertial_view {
  int batch = 0;
  int positions = 0;         ///< of the keyframe ring
  bool seeks_scale = false;  ///< maps begin without one: those of one camera
  imu_mount mount{};
  float accel_sigma = 0;              ///< of imu_params
  inertial_track* tracks = nullptr;   ///< [batch]
  imu_sample* samples = nullptr;      ///< [batch][steps.capacity] since the last frame
  imu_interval* intervals = nullptr;  ///< [batch] from the last frame to the current one
  imu_steps_view steps;               ///< of these
  integral_start* starts = nullptr;   ///< [2 * batch]
  /// [2 * batch] to the current frame: 2 b from the last frame, 2 b + 1 from the newest keyframe
  preintegrated* integrals = nullptr;
  /// [batch][positions] from the keyframe before to that at a position
  preintegrated* between = nullptr;
  keyframe_motion* motion = nullptr;  ///< [batch][positions]
  inertial_prior* prior = nullptr;    ///< [batch] of the last frames, then of the current ones
  map_scaling* scaling = nullptr;     ///< [batch] what becomes of maps with this frame
  inertial_inputs inputs;             ///< of the poses of the current frames
  inertial_poses poses{};             ///< reads these inputs, and the observations of a frame

  FT_HOST_DEVICE std::ptrdiff_t at(int b, int position) const {
    return static_cast<std::ptrdiff_t>(b) * positions + position;
  }
  FT_HOST_DEVICE preintegrated& from_last(int b) const { return integrals[2 * b]; }
  FT_HOST_DEVICE preintegrated& from_keyframe(int b) const { return integrals[2 * b + 1]; }
};

struct inertial_capacity {
  int positions;     ///< of the keyframe ring
  int samples;       ///< between two images
  int observations;  ///< of a frame
};

inline void carve(carver& c, inertial_view& v, inertial_capacity const& size, int batch) {
  v.batch = batch;
  v.positions = size.positions;
  c.place({batch}, v.tracks);
  c.place({batch, size.samples}, v.samples);
  c.place({batch}, v.intervals);
  carve(c, v.steps, batch, size.samples);
  c.place({2, batch}, v.starts, v.integrals);
  c.place({batch, size.positions}, v.between, v.motion);
  c.place({batch}, v.prior, v.scaling);
  inertial_inputs& in = v.inputs;
  c.place({batch}, in.from_last_frame, in.first, in.start, in.gravity, in.integral);
  inertial_poses& p = v.poses;
  p.problems = batch;
  p.capacity = size.observations;
  p.from_last_frame = in.from_last_frame;
  p.first = in.first;
  p.start = in.start;
  p.gravity = in.gravity;
  p.integral = in.integral;
  p.prior = v.prior;
  p.next_prior = v.prior;
  c.place({batch}, p.result);
  c.place({batch, size.observations, inertial_rounds}, p.chi2);
}

}  // namespace FT_ABI
}  // namespace ft
