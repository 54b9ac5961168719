// SPDX-License-Identifier: Apache-2.0
/// @file Conversions between a body's state and the form in which frames store it.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The matrix of a rotation.
template <typename S>
FT_HOST_DEVICE mat3<S> rotation_of(quaternion<S> const& q) {
  S const x2 = q.x + q.x;
  S const y2 = q.y + q.y;
  S const z2 = q.z + q.z;
  S const xx = x2 * q.x;
  S const yy = y2 * q.y;
  S const zz = z2 * q.z;
  S const xy = x2 * q.y;
  S const xz = x2 * q.z;
  S const yz = y2 * q.z;
  S const wx = x2 * q.w;
  S const wy = y2 * q.w;
  S const wz = z2 * q.w;
  S const one = S(1);
  return {{one - (yy + zz), xy - wz, xz + wy, xy + wz, one - (xx + zz), yz - wx, xz - wy, yz + wx,
           one - (xx + yy)}};
}

}  // namespace detail

/// The body's state in a frame that stores the camera's pose. The same bits on every executor.
FT_HOST_DEVICE inline inertial_state<float> body_state(stored_inertial_state const& frame,
                                                       imu_mount const& mount) {
  using real = strict_float;
  quaternion<real> const q{frame.q_cw.x, frame.q_cw.y, frame.q_cw.z, frame.q_cw.w};
  rigid<real> const T_cw{detail::rotation_of(q), frame.t_cw.cast<real>()};
  rigid<real> const T_cb = mount.T_cb.cast<real>();
  mat3<real> const R_wc = T_cw.R.transposed();
  return {(R_wc * T_cb.R).template cast<float>(),
          (R_wc * T_cb.t + T_cw.centre()).template cast<float>(), frame.v, frame.bias.gyro,
          frame.bias.accel};
}

/// The form in which a frame stores a body's state, with a unit quaternion whose scalar part is not
/// negative. The same bits on every executor.
FT_HOST_DEVICE inline stored_inertial_state stored_state(inertial_state<float> const& body,
                                                         imu_mount const& mount) {
  using real = strict_float;
  rigid<real> const T_wb{body.R.cast<real>(), body.p.cast<real>()};
  rigid<real> const T_cw = mount.T_cb.cast<real>() * T_wb.inverse();
  quaternion<strict_double> const q = detail::quaternion_of(T_cw.R.cast<strict_double>());
  auto const narrow = [](strict_double v) { return static_cast<float>(v.value); };
  return {{narrow(q.x), narrow(q.y), narrow(q.z), narrow(q.w)},
          T_cw.t.template cast<float>(),
          body.v,
          {body.bg, body.ba}};
}

}  // namespace FT_ABI
}  // namespace ft
