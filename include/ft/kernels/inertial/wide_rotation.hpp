// SPDX-License-Identifier: Apache-2.0
/// @file Rotations in double precision: exponential map, logarithm, and the right Jacobians. Equal
/// bits on every executor.
///
/// Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry",
/// T-RO 2017, section III.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using wide = strict_double;
using wide_vec3 = vec3<wide>;
using wide_mat3 = mat3<wide>;

/// Below this square of an angle, rad^2, logarithms and Jacobians are those of no rotation, as in
/// the reference.
inline constexpr double tiny_angle2 = 1e-10;
/// Below this one, series replace the closed forms.
inline constexpr double series_angle2 = 1.0 / 16;

/// [v], where [v] u = v x u.
FT_HOST_DEVICE inline wide_mat3 cross_matrix(wide_vec3 v) {
  wide const zero = 0.0;
  return {{zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero}};
}

/// sin d / d, (1 - cos d) / d^2 and (d - sin d) / d^3 of the angle d.
struct wide_rotation_terms {
  wide a, b, c;
};
FT_HOST_DEVICE inline wide_rotation_terms wide_terms_of_rotation(wide d2) {
  wide const one = 1.0;
  if (d2 < wide(series_angle2)) {
    wide_rotation_terms t{one, one, one};
    FT_UNROLL
    for (int k = 6; k > 0; --k) {  // from the innermost bracket
      double const n = 2.0 * k;
      t.a = one - d2 * wide(1.0 / (n * (n + 1.0))) * t.a;
      t.b = one - d2 * wide(1.0 / ((n + 1.0) * (n + 2.0))) * t.b;
      t.c = one - d2 * wide(1.0 / ((n + 2.0) * (n + 3.0))) * t.c;
    }
    return {t.a, t.b * wide(0.5), t.c * wide(1.0 / 6.0)};
  }
  wide const d = scalar::sqrt(d2);
  sine_and_cosine const at = strict_sin_cos(d);
  return {at.sine / d, (one - at.cosine) / d2, (d - at.sine) / (d * d2)};
}

/// The rotation by |w| about w.
FT_HOST_DEVICE inline wide_mat3 rotation_exp(wide_vec3 w) {
  wide const d2 = dot(w, w);
  wide_rotation_terms const t = wide_terms_of_rotation(d2);
  return one_plus(t.a, t.b, w, d2);
}

/// Jr of Exp(w + d) = Exp(w) Exp(Jr d), for small d.
FT_HOST_DEVICE inline wide_mat3 rotation_jacobian(wide_vec3 w) {
  wide const d2 = dot(w, w);
  if (d2 < wide(tiny_angle2)) { return wide_mat3::identity(); }
  wide_rotation_terms const t = wide_terms_of_rotation(d2);
  return one_plus(-t.b, t.c, w, d2);
}

/// The inverse of Jr.
FT_HOST_DEVICE inline wide_mat3 inverse_rotation_jacobian(wide_vec3 w) {
  wide const d2 = dot(w, w);
  if (d2 < wide(tiny_angle2)) { return wide_mat3::identity(); }
  wide b;  // 1 / d^2 - (1 + cos d) / (2 d sin d)
  if (d2 < wide(series_angle2)) {
    constexpr double terms[] = {691.0 / 1307674368000.0, 1.0 / 47900160.0, 1.0 / 1209600.0,
                                1.0 / 30240.0, 1.0 / 720.0};
    b = 0.0;
    FT_UNROLL
    for (int k = 0; k < 5; ++k) { b = d2 * (b + wide(terms[k])); }
    b = b + wide(1.0 / 12.0);
  } else {
    wide_rotation_terms const t = wide_terms_of_rotation(d2);
    b = (wide(1.0) - t.a / (t.b + t.b)) / d2;
  }
  return one_plus(wide(0.5), b, w, d2);
}

/// w of Exp(w) = R. For an R that is no rotation, as in the reference: the antisymmetric part.
FT_HOST_DEVICE inline wide_vec3 rotation_log(wide_mat3 const& R) {
  auto const& m = R.m;
  wide const one_half = 0.5;
  wide_vec3 const w{(m[7] - m[5]) * one_half, (m[2] - m[6]) * one_half, (m[3] - m[1]) * one_half};
  wide const c = ((m[0] + (m[4] + m[8])) - wide(1.0)) * one_half;
  wide const rest = wide(1.0) - c;
  // |sin| < 1e-5, or no cosine.
  if (!(c <= wide(1.0) && c >= wide(-1.0)) || rest * (wide(1.0) + c) < wide(tiny_angle2)) {
    return w;
  }
  wide ratio = 1.0;  // t / sin t
  if (rest < wide(1.0 / 64)) {
    FT_UNROLL
    for (int n = 9; n > 0; --n) { ratio = wide(1.0) + rest * wide(n / (2.0 * n + 1.0)) * ratio; }
  } else {
    wide const s = scalar::sqrt(rest * (wide(1.0) + c));
    ratio = strict_atan2(s, c) / s;
  }
  return scaled(w, ratio);
}

/// The rotation nearest to a matrix that is one to single precision: a step of Newton and Schulz.
FT_HOST_DEVICE inline wide_mat3 nearest_rotation(wide_mat3 const& R) {
  wide_mat3 rest = R.transposed() * R;
  FT_UNROLL
  for (int i = 0; i < 9; ++i) { rest.m[i] = wide(i % 4 == 0 ? 1.5 : 0.0) - wide(0.5) * rest.m[i]; }
  return R * rest;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
