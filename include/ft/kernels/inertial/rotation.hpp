// SPDX-License-Identifier: Apache-2.0
/// @file Rotations in single precision: the exponential map, its right Jacobian, and the nearest
/// rotation. Equal bits on every executor.
///
/// Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry",
/// T-RO 2017, section III.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using strict_vec3 = vec3<strict_float>;
using strict_mat3 = mat3<strict_float>;

FT_HOST_DEVICE inline strict_mat3 sum(strict_mat3 const& a, strict_mat3 const& b) {
  strict_mat3 c;
  FT_UNROLL
  for (int i = 0; i < 9; ++i) { c.m[i] = a.m[i] + b.m[i]; }
  return c;
}

/// a [v], where [v] u = v x u.
FT_HOST_DEVICE inline strict_mat3 times_cross(strict_mat3 const& a, strict_vec3 v) {
  strict_mat3 c;
  FT_UNROLL
  for (int i = 0; i < 9; i += 3) {
    c.m[i] = a.m[i + 1] * v.z - a.m[i + 2] * v.y;
    c.m[i + 1] = a.m[i + 2] * v.x - a.m[i] * v.z;
    c.m[i + 2] = a.m[i] * v.y - a.m[i + 1] * v.x;
  }
  return c;
}

/// I + a [w] + b [w]^2, where [w] u = w x u.
FT_HOST_DEVICE inline strict_mat3 cross_polynomial(strict_vec3 w, strict_float a, strict_float b) {
  strict_vec3 const aw = scaled(w, a);
  strict_vec3 const bw = scaled(w, b);
  strict_float const one = 1.0f;
  strict_float const xx = bw.x * w.x;
  strict_float const yy = bw.y * w.y;
  strict_float const zz = bw.z * w.z;
  strict_float const xy = bw.x * w.y;
  strict_float const xz = bw.x * w.z;
  strict_float const yz = bw.y * w.z;
  return {{one - (yy + zz), xy - aw.z, xz + aw.y, xy + aw.z, one - (xx + zz), yz - aw.x, xz - aw.y,
           yz + aw.x, one - (xx + yy)}};
}

/// The rotation by |w| about w, and the derivative of Exp(w + d) = Exp(w) Exp(Jr d).
struct rotation_and_jacobian {
  strict_mat3 E;
  strict_mat3 Jr;
};

/// Coefficients of both for an angle d = |w|.
struct rotation_terms {
  strict_float a;  ///< sin d / d
  strict_float b;  ///< (1 - cos d) / d^2
  strict_float c;  ///< (d - sin d) / d^3
};
FT_HOST_DEVICE inline rotation_terms terms_of_rotation(strict_float d2) {
  strict_float const one = 1.0f;
  if (d2 < strict_float(1.0f)) {
    // Series in d^2; what is left out is below 2e-8 of the result.
    rotation_terms t{one, one, one};
    FT_UNROLL
    for (int k = 5; k > 0; --k) {
      double const n = 2.0 * k;
      t.a = one - d2 * strict_float(static_cast<float>(1.0 / (n * (n + 1.0)))) * t.a;
      t.b = one - d2 * strict_float(static_cast<float>(1.0 / ((n + 1.0) * (n + 2.0)))) * t.b;
      t.c = one - d2 * strict_float(static_cast<float>(1.0 / ((n + 2.0) * (n + 3.0)))) * t.c;
    }
    return {t.a, t.b * strict_float(0.5f), t.c * strict_float(static_cast<float>(1.0 / 6.0))};
  }
  strict_float const d = scalar::sqrt(d2);
  strict_float const s = scalar::sin(d);
  strict_float const c = scalar::cos(d);
  return {s / d, (one - c) / d2, (d - s) / (d * d2)};
}

/// Below this angle in rad Exp(w) = I + [w] and Jr(w) = I, as in the reference.
FT_HOST_DEVICE constexpr float small_rotation() { return 1e-4f; }

FT_HOST_DEVICE inline strict_mat3 rotation_exp(strict_vec3 w) {
  strict_float const d2 = dot(w, w);
  if (scalar::sqrt(d2) < strict_float(small_rotation())) { return cross_polynomial(w, 1.0f, 0.0f); }
  rotation_terms const t = terms_of_rotation(d2);
  return cross_polynomial(w, t.a, t.b);
}

FT_HOST_DEVICE inline rotation_and_jacobian rotation_exp_and_jacobian(strict_vec3 w) {
  strict_float const d2 = dot(w, w);
  if (scalar::sqrt(d2) < strict_float(small_rotation())) {
    return {cross_polynomial(w, 1.0f, 0.0f), strict_mat3::identity()};
  }
  rotation_terms const t = terms_of_rotation(d2);
  return {cross_polynomial(w, t.a, t.b), cross_polynomial(w, -t.b, t.c)};
}

FT_HOST_DEVICE inline strict_mat3 rotation_jacobian(strict_vec3 w) {
  return rotation_exp_and_jacobian(w).Jr;
}

/// The rotation nearest to a matrix that is nearly one, by two steps of Newton and Schulz: each
/// squares the departure from orthonormality, so 0.01 becomes less than a float resolves. Source:
/// Higham, "Functions of matrices", 2008, section 8.3.
FT_HOST_DEVICE inline strict_mat3 nearest_rotation(strict_mat3 R) {
  FT_UNROLL
  for (int step = 0; step < 2; ++step) {
    // R + R (I - R^T R) / 2: the correction is small, so it costs no digits.
    strict_mat3 rest = R.transposed() * R;
    FT_UNROLL
    for (int i = 0; i < 9; ++i) {
      strict_float const one = i % 4 == 0 ? 0.5f : 0.0f;
      rest.m[i] = one - strict_float(0.5f) * rest.m[i];
    }
    R = sum(R, R * rest);
  }
  return R;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
