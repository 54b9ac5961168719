// SPDX-License-Identifier: Apache-2.0
/// @file Conversions between a body's state and the form in which frames store it.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

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

// What a calibration of an IMU says, in the form that the inertial stages read.

/// Densities of noise as variances of one sample: the white noise of a sample grows with the rate,
/// the step of a walk falls with it.
/// @throws bad_argument for a rate outside [1, 1e5] Hz, or a density that is not positive and
/// finite
inline imu_variances variances_of(imu_noise const& noise) {
  detail::require_range("imu.noise.rate_hz", noise.rate_hz, 1.0f, 1e5f);
  using real = strict_float;
  real const root = scalar::sqrt(real(noise.rate_hz));
  float const densities[] = {noise.gyro, noise.accel, noise.gyro_walk, noise.accel_walk};
  char const* const names[] = {"imu.noise.gyro", "imu.noise.accel", "imu.noise.gyro_walk",
                               "imu.noise.accel_walk"};
  imu_variances out{};
  for (int k = 0; k < 4; ++k) {
    detail::require_range(names[k], densities[k], 1e-12f, 1e6f);
    real const s = k < 2 ? real(densities[k]) * root : real(densities[k]) / root;
    float* const to = (k < 2 ? out.measured : out.walk) + k % 2 * 3;
    for (int i = 0; i < 3; ++i) { to[i] = (s * s).value; }
  }
  return out;
}

/// An IMU's mount from the pose of the left camera in the body's frame, as calibration files state
/// it. The rotation is made orthonormal again where its digits were cut.
/// @param T_bc left camera to body, metres
/// @throws bad_argument if its rotation is none, or a number is not finite
inline imu_mount mount_of(rigid<double> const& T_bc) {
  detail::require_rotation(T_bc.R, "the rotation of imu.T_bc");
  detail::require_finite("imu.T_bc.t.x", T_bc.t.x);
  detail::require_finite("imu.T_bc.t.y", T_bc.t.y);
  detail::require_finite("imu.T_bc.t.z", T_bc.t.z);
  using real = strict_double;
  rigid<real> const T{detail::rotation_of(detail::quaternion_of(T_bc.R.cast<real>())),
                      T_bc.t.cast<real>()};
  return {T.cast<float>(), T.inverse().cast<float>()};
}

}  // namespace FT_ABI
}  // namespace ft
