// SPDX-License-Identifier: Apache-2.0
/// @file What an initialisation of a body with an IMU has found, and how certain that is. Not API.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/detail/initialization_solver.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The least turn that makes a direction point along z.
FT_HOST_DEVICE inline mat3<double> turn_upwards(strict_vec3d up) {
  real64 const c = up.z;
  strict_mat3d R{{1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0}};  // half a turn about x
  if (c > real64(-1.0 + 1e-12)) {
    real64 const k = real64(1.0) / (real64(1.0) + c);
    R = {{real64(1.0) - k * up.x * up.x, -(k * up.x * up.y), -up.x, -(k * up.x * up.y),
          real64(1.0) - k * up.y * up.y, -up.y, up.x, up.y, c}};
  }
  return R.cast<double>();
}

/// Writes gravity, the last state and, if asked for, all velocities.
/// @return the integrals of the whole window
template <typename Group>
FT_HOST_DEVICE joined_integrals describe_state(inertial_initializer<Group> const& of,
                                               inertial_initialization& out,
                                               vec3<double>* velocities) {
  initialization_window const& in = of.in;
  strict_vec3d const v0{of.x[0], of.x[1], of.x[2]};
  strict_vec3d const ba{of.x[6], of.x[7], of.x[8]};
  joined_integrals joined = joined_integrals::none();
  strict_vec3d v = v0;
  int const last = in.count - 1;
  FT_NO_UNROLL
  for (int k = 0; k <= last; ++k) {
    joined = of.joined_up_to(k, joined);
    v = v0 + scaled(of.gravity, joined.T) + joined.U + joined.W * ba;
    if (velocities != nullptr && of.g.rank() == 0) { velocities[k] = v.template cast<double>(); }
  }
  strict_vec3d const from_origin = of.camera(last) + in.T_wc[0].t.template cast<real64>();
  out.newest.R = of.rotation(last).template cast<double>();
  out.newest.p = (scaled(from_origin, of.scale) + of.lever(last)).template cast<double>();
  out.newest.v = v.template cast<double>();
  out.newest.bg = of.gyro_bias.template cast<double>();
  out.newest.ba = ba.template cast<double>();
  out.gravity = of.gravity.template cast<double>();
  real64 const G = static_cast<double>(of.params.gravity);
  out.R_up = turn_upwards(scaled(of.gravity, real64(-1.0) / G));
  out.scale = of.scale.value;
  return joined;
}

/// Writes standard deviations and what the poses are off by.
/// @param squares of what the poses are off by, summed
template <typename Group>
FT_HOST_DEVICE void describe_certainty(inertial_initializer<Group> const& of, real64 squares,
                                       joined_integrals const& joined,
                                       inertial_initialization& out) {
  using I = inertial_initializer<Group>;
  using unknown_row = typename I::unknown_row;
  auto const& equations = of.s.equations;
  int const count = of.in.count;
  real64 const sigma = of.scale * real64(static_cast<double>(of.params.position_sigma));
  real64 const freedom = static_cast<double>(max_of(3 * count - of.unknowns(), 1));
  // the given deviation may be too small
  real64 const factor = max_of(real64(1.0), scalar::sqrt(squares / freedom) / sigma);
  auto const deviation = [&](real64 variance) {
    return static_cast<float>((factor * scalar::sqrt(variance)).value);
  };
  real64 tilt = 0.0;
  for (int j = 0; j < of.directions; ++j) {
    unknown_row row;
    row.x[I::direction + j] = 1.0;
    tilt += equations.variance(row.x);
  }
  real64 most = 0.0;
  real64 moving = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    unknown_row row;
    row.x[I::bias + axis] = 1.0;
    most = max_of(most, equations.variance(row.x));
    for (int j = 0; j < 3; ++j) { row.x[I::bias + j] = joined.W.m[3 * axis + j]; }
    row.x[I::velocity + axis] = 1.0;
    for (int j = 0; j < of.directions; ++j) {
      row.x[I::direction + j] = joined.T * component(of.basis[j], axis);
    }
    moving += equations.variance(row.x);
  }
  out.position_rms =
      static_cast<float>(scalar::sqrt(squares / real64(static_cast<double>(3 * count))).value);
  out.tilt_sigma = deviation(tilt);
  out.accel_bias_sigma = deviation(most);
  out.velocity_sigma = deviation(moving);
  if (of.scale_is_sought()) {
    unknown_row row;
    row.x[I::direction + of.directions] = 1.0;
    out.scale_sigma = deviation(equations.variance(row.x) / (of.scale * of.scale));
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
