// SPDX-License-Identifier: Apache-2.0
/// @file Stage: links the keyframes of an adjustment by what the IMU measured between them.
#pragma once

#include <cstddef>

#include "ft/containers/inertial.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/odometry/begin_inertial.hpp"
#include "ft/kernels/odometry/inertial_track.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// How exact the biases and velocities are from which the motion between two keyframes follows:
/// standard deviations.
struct inertial_link_sigmas {
  /// rad/s. All links have one bias, and what it is off by adds up over them: more than the
  /// deviation of its estimate.
  float gyro_bias = 5e-3f;
  float accel_bias = 0.05f;  ///< m/s^2; of gravity, too
  float velocity = 0.05f;    ///< m/s
};

/// How keyframes are linked.
struct inertial_linking {
  imu_mount mount;
  inertial_link_sigmas sigmas;
};

namespace detail {

/// Item: a camera.
struct link_views {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, int const* flags,
                                 keyframes_view const& keyframes, inertial_linking const& how,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources, inertial_view const& v) const {
    if (flags[b] == 0) { return; }
    inertial_track const& t = v.tracks[b];
    for (int i = 1 + g.rank(); i < problem.view_count[b]; i += g.size()) {
      int const number = sources.keyframe[problem.view(b, i)];
      preintegrated const& integral = v.between[v.at(b, keyframes.position(number))];
      keyframe_motion const& before = v.motion[v.at(b, keyframes.position(number - 1))];
      window_link& link = problem.link[problem.view(b, i)];
      link = {rigid<double>::identity(), 0, 0};
      if (!t.known() || !usable(integral.status)) { continue; }
      vec3<float> const rate = v.motion[v.at(b, keyframes.position(number))].rate;
      real const clock = wide(t.clock_sigma);
      vec3<real> const late =
          scaled(turn_by_clock(integral, before.rate, rate).cast<real>(), clock);
      rigid<double> const& from = problem.T_cw[problem.view(b, i - 1)];
      rigid<double> const& to = problem.T_cw[problem.view(b, i)];
      link_by(from, before, integral, t, how, dot(late, late), link);
      if (contradicts(link, from, to)) { link = {rigid<double>::identity(), 0, 0}; }
    }
  }

private:
  using real = strict_double;
  /// Of the turn between two keyframes by their images, where few or blurred, rad.
  static constexpr double pose_sigma = 2e-3;
  static constexpr double most_deviations = 5;

  FT_HOST_DEVICE static real wide(float x) { return real(static_cast<double>(x)); }
  FT_HOST_DEVICE static real square(real x) { return x * x; }
  /// The sum of the variances of three numbers: no axis has a greater one. @param at of the first
  FT_HOST_DEVICE static real variance(preintegrated const& integral, int at) {
    float const* const C = integral.C + 10 * at;
    return wide(C[0]) + wide(C[10]) + wide(C[20]);
  }
  /// Whether the gyroscope has turned by more than its errors and those of the poses explain: what
  /// was measured after the images have contradicted it enters no map.
  FT_HOST_DEVICE static bool contradicts(window_link const& link, rigid<double> const& from,
                                         rigid<double> const& to) {
    if (!(link.rotation_weight > 0)) { return false; }
    mat3<real> const seen = to.R.cast<real>() * from.R.cast<real>().transposed();
    vec3<real> const off = rotation_log(link.motion.R.cast<real>().transposed() * seen);
    real const turn = real(1.0) / real(link.rotation_weight) + square(real(pose_sigma));
    return dot(off, off) > square(real(most_deviations)) * turn;
  }
  /// @param T_cw of the keyframe before
  /// @param by_clock variance of the turn by the offset of the clocks, rad^2
  FT_HOST_DEVICE static void link_by(rigid<double> const& T_cw, keyframe_motion const& before,
                                     preintegrated const& integral, inertial_track const& t,
                                     inertial_linking const& how, real by_clock,
                                     window_link& link) {
    stored_inertial_state from = at_pose(t.keyframe, T_cw);
    from.bias = t.bias;
    from.v = before.moves != 0 ? before.v : vec3<float>{0, 0, 0};
    stored_inertial_state const to =
        stored_state(predict_state(body_state(from, how.mount), integral, t.gravity), how.mount);
    if (!is_finite(to)) { return; }
    real const time = wide(integral.dT);
    real const turn = variance(integral, 0) + square(wide(how.sigmas.gyro_bias) * time) + by_clock;
    real const shift = variance(integral, 6) + square(wide(how.sigmas.velocity) * time) +
                       square(real(0.5) * wide(how.sigmas.accel_bias) * square(time));
    if (!(turn > real(0.0)) || !(shift > real(0.0))) { return; }
    rigid<real> const motion = pose_of(to).template cast<real>() * T_cw.cast<real>().inverse();
    link.motion = motion.orthonormalized().cast<double>();
    link.rotation_weight = (real(1.0) / turn).value;
    link.translation_weight = before.moves != 0 ? (real(1.0) / shift).value : 0;
  }
};

}  // namespace detail

/// Links the views of adjustments that begin, after gather_window(): each to the one before it,
/// where gravity and biases are known and there is an integral between the two, which turned as the
/// poses did. Without a known velocity the link is of rotation alone. Asynchronous on `exec`;
/// allocates nothing; one launch.
/// @param flags [batch] 1 = the adjustment begins
template <typename Exec>
void link_windows(Exec const& exec, int const* flags, keyframes_view const& keyframes,
                  inertial_linking const& how, window_problem_view const& problem,
                  window_sources_view const& sources, inertial_view const& v) {
  for_each_item<per_block<64>>(exec, v.batch, detail::link_views{}, flags, keyframes, how, problem,
                               sources, v);
}

}  // namespace FT_ABI
}  // namespace ft
