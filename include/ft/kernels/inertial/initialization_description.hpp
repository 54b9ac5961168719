// SPDX-License-Identifier: Apache-2.0
/// @file What an initialisation of a body with an IMU has found, and how certain that is. Not API.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/kernels/inertial/initialization_solver.hpp"
#include "ft/kernels/inertial/initialization_system.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The least turn that makes a direction point along z.
FT_HOST_DEVICE inline mat3<double> turn_upwards(wide_vec3 up) {
  wide const c = up.z;
  wide_mat3 R{{1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0}};  // half a turn about x
  if (c > wide(-1.0 + 1e-12)) {
    wide const k = wide(1.0) / (wide(1.0) + c);
    R = {{wide(1.0) - k * up.x * up.x, -(k * up.x * up.y), -up.x, -(k * up.x * up.y),
          wide(1.0) - k * up.y * up.y, -up.y, up.x, up.y, c}};
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
  wide_vec3 const v0{of.x[0], of.x[1], of.x[2]};
  wide_vec3 const ba{of.x[6], of.x[7], of.x[8]};
  joined_integrals joined = joined_integrals::none();
  wide_vec3 v = v0;
  int const last = in.count - 1;
  FT_NO_UNROLL
  for (int k = 0; k <= last; ++k) {
    joined = of.joined_up_to(k, joined);
    v = v0 + scaled(of.gravity, joined.T) + joined.U + joined.W * ba;
    if (velocities != nullptr && of.g.rank() == 0) { velocities[k] = v.template cast<double>(); }
  }
  wide_vec3 const from_origin = of.camera(last) + in.T_wc[0].t.template cast<wide>();
  out.newest.R = of.rotation(last).template cast<double>();
  out.newest.p = (scaled(from_origin, of.scale) + of.lever(last)).template cast<double>();
  out.newest.v = v.template cast<double>();
  out.newest.bg = of.gyro_bias.template cast<double>();
  out.newest.ba = ba.template cast<double>();
  out.gravity = of.gravity.template cast<double>();
  wide const G = static_cast<double>(of.params.gravity);
  out.R_up = turn_upwards(scaled(of.gravity, wide(-1.0) / G));
  out.scale = of.scale.value;
  return joined;
}

/// Writes standard deviations and what the poses are off by.
/// @param squares of what the poses are off by, summed
template <typename Group>
FT_HOST_DEVICE void describe_certainty(inertial_initializer<Group> const& of, wide squares,
                                       joined_integrals const& joined,
                                       inertial_initialization& out) {
  using I = inertial_initializer<Group>;
  using unknown_row = typename I::unknown_row;
  auto const& equations = of.s.equations;
  int const count = of.in.count;
  wide const sigma = of.scale * wide(static_cast<double>(of.params.position_sigma));
  wide const freedom = static_cast<double>(max_of(3 * count - of.unknowns(), 1));
  // the given deviation may be too small
  wide const factor = max_of(wide(1.0), scalar::sqrt(squares / freedom) / sigma);
  auto const deviation = [&](wide variance) {
    return static_cast<float>((factor * scalar::sqrt(variance)).value);
  };
  wide tilt = 0.0;
  for (int j = 0; j < of.directions; ++j) {
    unknown_row row;
    row.x[I::direction + j] = 1.0;
    tilt += equations.variance(row.x);
  }
  wide most = 0.0;
  wide moving = 0.0;
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
      static_cast<float>(scalar::sqrt(squares / wide(static_cast<double>(3 * count))).value);
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
