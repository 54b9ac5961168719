// SPDX-License-Identifier: Apache-2.0
/// @file Preintegrated measurements as they are with another bias, to first order.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/rotation.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

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

}  // namespace FT_ABI
}  // namespace ft
