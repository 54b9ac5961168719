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
#include "ft/kernels/odometry/chain_centres.hpp"
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
  /// m/s^2; of gravity, too: what a tilt hides of the bias until the camera turns.
  float accel_bias = 0.1f;
  float velocity = 0.05f;  ///< m/s, of a keyframe when it was made
  /// Metres, of what an adjustment takes for exact: its fixed views, and points that they see.
  float centre = 3e-3f;
};

/// How keyframes are linked.
struct inertial_linking {
  imu_mount mount;
  inertial_link_sigmas sigmas;
};

namespace detail {

/// Item: a camera.
struct link_views {
  using scratch = chain_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, int const* flags,
                                 keyframes_view const& keyframes, inertial_linking const& how,
                                 window_problem_view const& problem,
                                 window_sources_view const& sources, inertial_view const& v) const {
    if (flags[b] == 0) { return; }
    inertial_track const& t = v.tracks[b];
    for (int i = g.rank(); i < problem.view_count[b]; i += g.size()) {
      rigid<double> const& to = problem.T_cw[problem.view(b, i)];
      chain_step& step = s.steps[i];
      step = {};
      step.arm = arm_of(to, how.mount).template cast<double>();
      if (i == 0) {
        s.first_arm = step.arm;
        continue;
      }
      int const number = sources.keyframe[problem.view(b, i)];
      preintegrated const& integral = v.between[v.at(b, keyframes.position(number))];
      keyframe_motion const& before = v.motion[v.at(b, keyframes.position(number - 1))];
      window_link& link = problem.link[problem.view(b, i)];
      link = {rigid<double>::identity(), 0, 0};
      if (!t.known() || t.doubted != 0 || !usable(integral.status)) { continue; }
      vec3<float> const rate = v.motion[v.at(b, keyframes.position(number))].rate;
      real const clock = wide(t.clock_sigma);
      vec3<real> const late =
          scaled(turn_by_clock(integral, before.rate, rate).cast<real>(), clock);
      rigid<double> const& from = problem.T_cw[problem.view(b, i - 1)];
      link_by(from, before, integral, t, how, dot(late, late), link);
      if (contradicts(link, from, to)) { link = {rigid<double>::identity(), 0, 0}; }
      bool const moves = link.rotation_weight > 0 && !leads_elsewhere(link, from, to, how);
      link.translation_weight = 0;  // the cost of centres has it
      if (moves) { chain_by(from, to, integral, t, how, step); }
    }
    g.sync();
    centre_chain<Group>(g, s, problem, b).build(static_cast<double>(how.sigmas.accel_bias));
  }

private:
  using real = strict_double;
  /// Of the turn between two keyframes by their images, where few or blurred, rad.
  static constexpr double pose_sigma = 2e-3;
  static constexpr double most_deviations = 5;
  /// Of a keyframe's rotation beside that of its neighbours, rad: gravity is turned by it.
  static constexpr double tilt_sigma = 1e-3;
  static constexpr double least_walk = 1e-4;  ///< of the accelerometer's bias, m/s^2

  FT_HOST_DEVICE static real wide(float x) { return real(static_cast<double>(x)); }
  FT_HOST_DEVICE static real square(real x) { return x * x; }
  /// The sum of three entries of the covariance, one below and right of the other. @param row,
  /// column of the first
  FT_HOST_DEVICE static real trace(preintegrated const& integral, int row, int column) {
    float const* const C = integral.C + 9 * row + column;
    return wide(C[0]) + wide(C[10]) + wide(C[20]);
  }
  /// From the camera's centre to the body, along the axes of the world.
  FT_HOST_DEVICE static vec3<real> arm_of(rigid<double> const& T_cw, imu_mount const& mount) {
    return T_cw.R.cast<real>().transposed() * mount.T_cb.t.cast<real>();
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
  /// Likewise of the motion of the centre, as far as its velocity is known.
  FT_HOST_DEVICE static bool leads_elsewhere(window_link const& link, rigid<double> const& from,
                                             rigid<double> const& to, inertial_linking const& how) {
    if (!(link.translation_weight > 0)) { return false; }
    rigid<real> const expected = link.motion.cast<real>() * from.cast<real>();
    vec3<real> const off = to.cast<real>().centre() - expected.centre();
    real const shift = real(1.0) / real(link.translation_weight) + square(wide(how.sigmas.centre));
    return dot(off, off) > square(real(most_deviations)) * shift;
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
    real const turn = trace(integral, 0, 0) + square(wide(how.sigmas.gyro_bias) * time) + by_clock;
    real const shift = trace(integral, 6, 6) + square(wide(how.sigmas.velocity) * time) +
                       square(real(0.5) * wide(how.sigmas.accel_bias) * square(time));
    if (!(turn > real(0.0)) || !(shift > real(0.0))) { return; }
    rigid<real> const motion = pose_of(to).template cast<real>() * T_cw.cast<real>().inverse();
    link.motion = motion.orthonormalized().cast<double>();
    link.rotation_weight = (real(1.0) / turn).value;
    link.translation_weight = before.moves != 0 ? (real(1.0) / shift).value : 0;
  }
  /// @param from,to T_cw of both keyframes
  FT_HOST_DEVICE static void chain_by(rigid<double> const& from, rigid<double> const& to,
                                      preintegrated const& integral, inertial_track const& t,
                                      inertial_linking const& how, chain_step& step) {
    preintegrated_motion const moved = change_bias(integral, t.bias);
    mat3<real> const R_wb = from.R.cast<real>().transposed() * how.mount.T_cb.R.cast<real>();
    vec3<real> const g = t.gravity.cast<real>();
    real const T = wide(integral.dT);
    real const half = real(0.5) * T;
    vec3<real> const V = scaled(g, T) + R_wb * moved.dV.cast<real>();
    vec3<real> const P = scaled(g, half * T) + R_wb * moved.dP.cast<real>();
    if (!scalar::is_finite(dot(V, V) + dot(P, P))) { return; }
    real const third = real(1.0) / real(3.0);
    real const tilt = dot(g, g) * square(real(tilt_sigma));
    real const clock = dot(V, V) * square(wide(t.clock_sigma));
    vec3<real> const turn = rotation_log(to.R.cast<real>() * from.R.cast<real>().transposed());
    real const turned = square(wide(how.sigmas.accel_bias)) * dot(turn, turn);
    step.P = P.template cast<double>();
    step.V = V.template cast<double>();
    step.T = T.value;
    step.pp = (third * trace(integral, 6, 6) + tilt * square(half * T) + clock +
               square(wide(how.sigmas.centre)))
                  .value;
    step.pv = (third * trace(integral, 6, 3) + tilt * half * square(T)).value;
    step.vv = (third * trace(integral, 3, 3) + tilt * square(T)).value;
    step.aa = (turned +
               third * (wide(integral.walk[3]) + wide(integral.walk[4]) + wide(integral.walk[5])) +
               square(real(least_walk)))
                  .value;
  }
};

}  // namespace detail

/// Links the views of adjustments that begin, after gather_window(): each to the one before it,
/// where gravity and biases are known and there is an integral between the two, which turned as the
/// poses did. Links are of rotation; what the accelerometer measured over all views becomes the
/// cost of their centres, whatever their velocities: see chain_centres.hpp. Asynchronous on `exec`;
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
