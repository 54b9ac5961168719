// SPDX-License-Identifier: Apache-2.0
/// @file Stage: predicts the state of a frame from an earlier one and the integral between them.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// Preintegrated measurements as they are with another bias, to first order.

/// Motion between two images with a bias of the caller's; frames and units as in preintegrated.
struct preintegrated_motion {
  mat3<float> dR;
  vec3<float> dV;
  vec3<float> dP;
  vec3<float> turn;  ///< dR is the integral's times Exp(turn): JRg times the bias' change, rad
};

/// The motion that was integrated, with another bias: nothing is integrated again. The same bits on
/// every executor. Source: Forster et al., T-RO 2017, section VI-C.
/// @param bias near the integral's own; what is left out grows with the square of the distance
FT_HOST_DEVICE inline preintegrated_motion change_bias(preintegrated const& integral,
                                                       imu_bias const& bias) {
  using real = strict_float;
  using vector = vec3<real>;
  auto const strict_of = [](mat3<float> const& a) { return a.cast<real>(); };
  vector const dg = bias.gyro.cast<real>() - integral.bias.gyro.cast<real>();
  vector const da = bias.accel.cast<real>() - integral.bias.accel.cast<real>();
  vector const turn = strict_of(integral.JRg) * dg;
  preintegrated_motion out;
  out.dR = detail::nearest_rotation(strict_of(integral.dR) * detail::rotation_exp(turn))
               .template cast<float>();
  out.dV =
      ((integral.dV.cast<real>() + strict_of(integral.JVg) * dg) + strict_of(integral.JVa) * da)
          .template cast<float>();
  out.dP =
      ((integral.dP.cast<real>() + strict_of(integral.JPg) * dg) + strict_of(integral.JPa) * da)
          .template cast<float>();
  out.turn = turn.cast<float>();
  return out;
}

/// From where a frame is predicted: the last frame, or where the map has changed since, the last
/// keyframe.
struct prediction_start {
  stored_inertial_state from;                ///< as it is now, with its present bias
  int integral;                              ///< of the time since then; -1: none
  vec3<float> gravity = standard_gravity();  ///< in the world, m/s^2
};

struct predicted_state {
  stored_inertial_state frame;  ///< has the bias of the start
  /// Of the integral; not_finite for a start that is not a number. Unless usable(), the state is
  /// the start's.
  integration_status status;
};

namespace detail {

FT_HOST_DEVICE inline bool is_finite(vec3<float> v) {
  return scalar::is_finite(v.x) && scalar::is_finite(v.y) && scalar::is_finite(v.z);
}
FT_HOST_DEVICE inline bool is_finite(stored_inertial_state const& s) {
  return is_finite(vec3<float>{s.q_cw.x, s.q_cw.y, s.q_cw.z}) && scalar::is_finite(s.q_cw.w) &&
         is_finite(s.t_cw) && is_finite(s.v) && is_finite(s.bias.gyro) && is_finite(s.bias.accel);
}

}  // namespace detail

/// A body's state after the time of an integral. The bias stays. Equal bits on every executor.
/// Source: Forster et al., T-RO 2017, section VI.
/// @param gravity in the world, m/s^2
FT_HOST_DEVICE inline inertial_state<float> predict_state(
    inertial_state<float> const& from, preintegrated const& integral,
    vec3<float> gravity = standard_gravity()) {
  using real = strict_float;
  preintegrated_motion const moved = change_bias(integral, {from.bg, from.ba});
  mat3<real> const R = from.R.cast<real>();
  vec3<real> const v = from.v.cast<real>();
  vec3<real> const g = gravity.cast<real>();
  real const t = integral.dT;
  inertial_state<float> out = from;
  out.R = detail::nearest_rotation(R * moved.dR.cast<real>()).template cast<float>();
  out.p = (from.p.cast<real>() + scaled(v, t) + scaled(g, real(0.5f) * t * t) +
           R * moved.dP.cast<real>())
              .template cast<float>();
  out.v = (v + scaled(g, t) + R * moved.dV.cast<real>()).template cast<float>();
  return out;
}

namespace detail {

/// Item: a frame.
struct predict_from_integral {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, prediction_start const* starts,
                                 preintegrated const* integrals, imu_mount const& mount,
                                 predicted_state* out) const {
    prediction_start const start = starts[item];
    predicted_state result{start.from, integration_status::no_samples};
    if (start.integral >= 0) {
      preintegrated const& integral = integrals[start.integral];
      result.status = integral.status;
      if (usable(integral.status)) {
        stored_inertial_state const then = stored_state(
            predict_state(body_state(start.from, mount), integral, start.gravity), mount);
        if (is_finite(then)) {
          result.frame = then;
        } else {
          result.status = integration_status::not_finite;
        }
      }
    }
    out[item] = result;
  }
};

}  // namespace detail

/// Predicts the states of frames. Asynchronous on `exec`; allocates nothing; one launch. Equal bits
/// on every executor.
/// @param starts, out one for each frame
template <typename Exec>
void predict_states(Exec const& exec, span<prediction_start const> starts,
                    preintegrated const* integrals, imu_mount const& mount, predicted_state* out) {
  for_each_item<per_thread>(exec, starts.size, detail::predict_from_integral{}, starts.data,
                            integrals, mount, out);
}

}  // namespace FT_ABI
}  // namespace ft
