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

/// Writes gravity, the last state and, if asked for, all velocities. Ends with a sync.
/// @return the integrals of the whole window
template <typename Group>
FT_HOST_DEVICE joined_integrals const& describe_state(inertial_initializer<Group> const& of,
                                                      inertial_initialization& out,
                                                      vec3<double>* velocities) {
  initialization_window const& in = of.in;
  initialization_scratch const& s = of.s;
  strict_vec3d const v0{s.x[0], s.x[1], s.x[2]};
  strict_vec3d const ba{s.x[6], s.x[7], s.x[8]};
  auto const velocity_at = [&](joined_integrals const& joined) {
    return v0 + scaled(s.gravity, joined.T) + joined.U + joined.W * ba;
  };
  int const last = in.count - 1;
  int const first = velocities != nullptr ? 0 : min_of(last, initialization_scratch::most_joined);
  FT_NO_UNROLL
  for (int k = first; k < last; ++k) {
    auto const& joined = of.joined_up_to(k);
    if (velocities != nullptr && of.g.rank() == 0) {
      velocities[k] = velocity_at(joined).template cast<double>();
    }
    of.g.sync();
  }
  joined_integrals const& joined = of.joined_up_to(last);
  if (of.g.rank() == 0) {
    vec3<double> const v = velocity_at(joined).template cast<double>();
    if (velocities != nullptr) { velocities[last] = v; }
    strict_vec3d const from_origin = of.camera(last) + in.T_wc[0].t.template cast<real64>();
    out.newest.R = of.rotation(last).template cast<double>();
    out.newest.p = (scaled(from_origin, s.scale) + of.lever(last)).template cast<double>();
    out.newest.v = v;
    out.newest.bg = s.gyro_bias.template cast<double>();
    out.newest.ba = ba.template cast<double>();
    out.gravity = s.gravity.template cast<double>();
    real64 const G = static_cast<double>(of.params.gravity);
    out.R_up = turn_upwards(scaled(s.gravity, real64(-1.0) / G));
    out.scale = s.scale.value;
  }
  of.g.sync();
  return joined;
}

/// Numbers of variances.
enum : int { of_tilt = 0, of_bias = 3, of_velocity = 6, of_scale = 9 };

/// Variances of what is described, one a thread. Ends with a sync.
template <typename Group>
FT_HOST_DEVICE void find_variances(inertial_initializer<Group> const& of,
                                   joined_integrals const& joined) {
  using I = inertial_initializer<Group>;
  initialization_scratch& s = of.s;
  for (int v = of.g.rank(); v < initialization_scratch::most_variances; v += of.g.size()) {
    bool const known = v < of_bias ? v < s.directions : v != of_scale || of.scale_is_sought();
    if (!known) { continue; }
    auto& row = s.asked[v];
    for (int i = 0; i < I::most_unknowns; ++i) { row[i] = 0.0; }
    if (v < of_bias) {
      row[I::direction + v] = 1.0;
    } else if (v < of_velocity) {
      row[I::bias + v - of_bias] = 1.0;
    } else if (v < of_scale) {
      int const axis = v - of_velocity;
      for (int j = 0; j < 3; ++j) { row[I::bias + j] = joined.W.m[3 * axis + j]; }
      row[I::velocity + axis] = 1.0;
      for (int j = 0; j < s.directions; ++j) {
        row[I::direction + j] = joined.T * component(s.basis[j], axis);
      }
    } else {
      row[I::direction + s.directions] = 1.0;
    }
    s.variance[v] = s.equations.variance(row, s.work[v]);
  }
  of.g.sync();
}

/// Writes standard deviations and what the poses are off by, after find_variances(). A thread's
/// part.
template <typename Group>
FT_HOST_DEVICE void describe_certainty(inertial_initializer<Group> const& of,
                                       inertial_initialization& out) {
  initialization_scratch const& s = of.s;
  int const count = of.in.count;
  real64 const sigma = s.scale * real64(static_cast<double>(of.params.position_sigma));
  real64 const freedom = static_cast<double>(max_of(3 * count - of.unknowns(), 1));
  // the given deviation may be too small
  real64 const factor = max_of(real64(1.0), scalar::sqrt(s.squares / freedom) / sigma);
  auto const deviation = [&](real64 variance) {
    return static_cast<float>((factor * scalar::sqrt(variance)).value);
  };
  real64 tilt = 0.0, most = 0.0, moving = 0.0;
  for (int j = 0; j < s.directions; ++j) { tilt += s.variance[of_tilt + j]; }
  for (int axis = 0; axis < 3; ++axis) {
    most = max_of(most, s.variance[of_bias + axis]);
    moving += s.variance[of_velocity + axis];
  }
  out.position_rms =
      static_cast<float>(scalar::sqrt(s.squares / real64(static_cast<double>(3 * count))).value);
  out.tilt_sigma = deviation(tilt);
  out.accel_bias_sigma = deviation(most);
  out.velocity_sigma = deviation(moving);
  if (of.scale_is_sought()) {
    out.scale_sigma = deviation(s.variance[of_scale] / (s.scale * s.scale));
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
