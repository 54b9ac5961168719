// SPDX-License-Identifier: Apache-2.0
/// @file Stage: gravity, velocity and biases of a body with an IMU, from a few keyframes whose
/// poses are known.
///
/// The gyro's bias is the one with which the integrated rotations agree best with those of the
/// poses. Then first velocity, gravity, accelerometer bias and, with one camera, the scale of the
/// poses solve a linear system: the integrals, joined, say where the body is at each keyframe.
/// Gravity's length is known, so it is solved for on the tangent plane of that sphere, a few times.
/// A body at rest has no use for the differences of its poses, which are noise: they are taken as
/// equal. Gravity then is the mean specific force, the gyro's bias the mean rate.
///
/// With poses that are off by 3 mm and 0.5 mrad, an IMU as EuRoC's and hand-held motion, root mean
/// square errors are below 8e-4 rad/s, 0.1 m/s^2, 10 mrad of tilt and 20 mm/s after 2.75 s, below
/// 5e-4 rad/s, 0.01 m/s^2, 1 mrad and 11 mm/s after 5 s.
///
/// Sources: Qin, Li and Shen, "VINS-Mono: a robust and versatile monocular visual-inertial state
/// estimator", T-RO 2018, section V-B (gyro bias, refinement of gravity); Martinelli, "Closed-form
/// solution of visual-inertial structure from motion", IJCV 2014 (one system for velocity, gravity
/// and bias); Campos, Montiel and Tardos, "Inertial-only optimization for visual-inertial
/// initialization", ICRA 2020 (prior of the accelerometer's bias).
#pragma once

#include <cstddef>

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/inertial/detail/initialization_description.hpp"
#include "ft/kernels/inertial/detail/initialization_solver.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// How certain a solved system is. A thread's part.
template <typename Group>
FT_HOST_DEVICE void judge_window(inertial_initializer<Group> const& work,
                                 inertial_initialization& out) {
  initialization_params const& params = work.params;
  describe_certainty(work, out);
  // written so that a NaN fails
  bool const certain =
      out.gyro_bias_sigma <= params.max_gyro_sigma && out.tilt_sigma <= params.max_tilt_sigma &&
      out.velocity_sigma <= params.max_velocity_sigma && out.scale_sigma <= params.max_scale_sigma;
  bool const consistent =
      out.position_rms <= params.max_position_rms && out.rotation_rms <= params.max_rotation_rms;
  out.status = !consistent           ? initialization_status::inconsistent
               : !certain            ? initialization_status::little_motion
               : work.s.resting != 0 ? initialization_status::at_rest
                                     : initialization_status::initialized;
}

/// initialize_window() by a group. Ends with a sync.
/// @param out in memory that its threads share
template <typename Group>
FT_HOST_DEVICE void initialize_window_by(Group g, initialization_scratch& s,
                                         initialization_window const& window,
                                         initialization_params const& params,
                                         vec3<double>* velocities, inertial_initialization& out) {
  inertial_initializer<Group> work(g, s, window, params);
  initialization_status const given = work.check_input();
  if (g.rank() == 0) {
    out = {};
    out.R_up = out.newest.R = mat3<double>::identity();
    out.scale = 1;
    out.status = given;
  }
  g.sync();
  if (given != initialization_status::initialized) { return; }
  work.find_rest();
  bool const solved = work.find_gyro_bias(out) && work.solve();
  if (solved) { find_variances(work, describe_state(work, out, velocities)); }
  if (g.rank() == 0) {
    if (solved) {
      judge_window(work, out);
    } else {
      out.status = initialization_status::little_motion;
    }
  }
  g.sync();
}

}  // namespace detail

/// Gravity, velocity and biases of one body (the description is at the head of the file). Host and
/// device; the same bits on both. Allocates nothing.
/// @param velocities [count], in the world of the poses, m/s; or null. Written on success, and with
///   little_motion and inconsistent, unless no system could be solved
/// @return with its status. Without a solution gravity, biases and velocity are 0, R_up the
/// identity
FT_HOST_DEVICE inline inertial_initialization initialize_window(
    initialization_window const& window, initialization_params const& params,
    vec3<double>* velocities = nullptr) {
  detail::initialization_scratch scratch;
  detail::initialize_window_by(single_group{}, scratch, window, params, velocities, scratch.found);
  return scratch.found;
}

namespace detail {

/// Item: a window.
struct initialize_each {
  using scratch = initialization_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, initialization_windows const& windows,
                                 initialization_params const& params,
                                 inertial_initialization* results, vec3<double>* velocities) const {
    auto const first = static_cast<std::ptrdiff_t>(b) * windows.capacity;
    initialization_window const window{windows.T_wc + first, windows.integrals + first,
                                       min_of(windows.counts[b], windows.capacity), windows.mount};
    initialize_window_by(g, s, window, params, velocities == nullptr ? nullptr : velocities + first,
                         results[b]);
  }
};

}  // namespace detail

/// initialize_window() for a batch. Asynchronous on `exec`; allocates nothing; one launch, a warp
/// per window.
/// @param results [batch]
/// @param velocities [batch * capacity], or null
/// @throws bad_argument naming the value and the limit
template <typename Exec>
void initialize_inertial(Exec const& exec, initialization_windows const& windows,
                         initialization_params const& params, inertial_initialization* results,
                         vec3<double>* velocities = nullptr) {
  check(params);
  for_each_item<per_block<32>>(exec, windows.batch, detail::initialize_each{}, windows, params,
                               results, velocities);
}

}  // namespace FT_ABI
}  // namespace ft
