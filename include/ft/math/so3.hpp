// SPDX-License-Identifier: Apache-2.0
/// @file Rotations and their vectors w, |w| the angle: exponential, logarithm, right Jacobian,
/// nearest rotation. Equal bits on every executor.
///
/// Float and double each have the order of operations of their reference, so most functions are
/// here twice. Source: Forster et al., "On-manifold preintegration for real-time visual-inertial
/// odometry", T-RO 2017, section III.
#pragma once

#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Below this square of an angle, rad^2, logarithms and Jacobians in double are those of no
/// rotation, as in the reference.
inline constexpr double tiny_angle2 = 1e-10;
/// Below this one, series replace the closed forms in double.
inline constexpr double series_angle2 = 1.0 / 16;
/// Below this angle in rad Exp(w) = I + [w] and Jr(w) = I in float, as in the reference.
FT_HOST_DEVICE constexpr float small_rotation() { return 1e-4f; }

/// I + a W + b W^2 with W = [w]x, so that W^2 = w w^T - (w.w) I.
template <typename Real>
FT_HOST_DEVICE mat3<Real> one_plus(Real a, Real b, vec3<Real> w, Real theta2) {
  vec3<Real> const aw{a * w.x, a * w.y, a * w.z};
  vec3<Real> const bw{b * w.x, b * w.y, b * w.z};
  Real const xy = bw.x * w.y;
  Real const xz = bw.x * w.z;
  Real const yz = bw.y * w.z;
  Real const rest = Real(1) - b * theta2;
  return {{rest + bw.x * w.x, xy - aw.z, xz + aw.y, xy + aw.z, rest + bw.y * w.y, yz - aw.x,
           xz - aw.y, yz + aw.x, rest + bw.z * w.z}};
}

/// The same where [w] u = w x u, with the sums on the diagonal in another order: what the reference
/// has in float.
FT_HOST_DEVICE inline strict_mat3f cross_polynomial(strict_vec3f w, strict_float a,
                                                    strict_float b) {
  strict_vec3f const aw = scaled(w, a);
  strict_vec3f const bw = scaled(w, b);
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

/// Coefficients of exponentials and their derivatives, for an angle d.
template <typename Real>
struct rotation_terms {
  Real a;  ///< sin d / d
  Real b;  ///< (1 - cos d) / d^2
  Real c;  ///< (d - sin d) / d^3
};

/// By series in d^2 with `Count` terms after the first, from the innermost bracket.
template <int Count, typename Real>
FT_HOST_DEVICE rotation_terms<Real> rotation_series(Real d2) {
  using plain = plain_scalar_t<Real>;
  Real const one = Real(1);
  rotation_terms<Real> t{one, one, one};
  FT_UNROLL
  for (int k = Count; k > 0; --k) {
    double const n = 2.0 * k;
    t.a = one - d2 * Real(static_cast<plain>(1.0 / (n * (n + 1.0)))) * t.a;
    t.b = one - d2 * Real(static_cast<plain>(1.0 / ((n + 1.0) * (n + 2.0)))) * t.b;
    t.c = one - d2 * Real(static_cast<plain>(1.0 / ((n + 2.0) * (n + 3.0)))) * t.c;
  }
  return {t.a, t.b * Real(static_cast<plain>(1.0 / 2.0)),
          t.c * Real(static_cast<plain>(1.0 / 6.0))};
}

/// Where the series are used, what they leave out is below 2e-8 of the result in float, and below
/// its rounding in double.
FT_HOST_DEVICE inline rotation_terms<strict_float> terms_of_rotation(strict_float d2) {
  strict_float const one = 1.0f;
  if (d2 < strict_float(1.0f)) { return rotation_series<5>(d2); }
  strict_float const d = scalar::sqrt(d2);
  strict_float const s = scalar::sin(d);
  strict_float const c = scalar::cos(d);
  return {s / d, (one - c) / d2, (d - s) / (d * d2)};
}
FT_HOST_DEVICE inline rotation_terms<real64> terms_of_rotation(real64 d2) {
  real64 const one = 1.0;
  if (d2 < real64(series_angle2)) { return rotation_series<6>(d2); }
  real64 const d = scalar::sqrt(d2);
  sine_and_cosine const at = strict_sin_cos(d);
  return {at.sine / d, (one - at.cosine) / d2, (d - at.sine) / (d * d2)};
}

/// The rotation by |w| about w, and the derivative of Exp(w + d) = Exp(w) Exp(Jr d).
template <typename Real>
struct rotation_and_jacobian {
  mat3<Real> E;
  mat3<Real> Jr;
};

// In float, as the reference preintegrates.

FT_HOST_DEVICE inline strict_mat3f rotation_exp(strict_vec3f w) {
  strict_float const d2 = dot(w, w);
  if (scalar::sqrt(d2) < strict_float(small_rotation())) { return cross_polynomial(w, 1.0f, 0.0f); }
  rotation_terms<strict_float> const t = terms_of_rotation(d2);
  return cross_polynomial(w, t.a, t.b);
}

FT_HOST_DEVICE inline rotation_and_jacobian<strict_float> rotation_exp_and_jacobian(
    strict_vec3f w) {
  strict_float const d2 = dot(w, w);
  if (scalar::sqrt(d2) < strict_float(small_rotation())) {
    return {cross_polynomial(w, 1.0f, 0.0f), strict_mat3f::identity()};
  }
  rotation_terms<strict_float> const t = terms_of_rotation(d2);
  return {cross_polynomial(w, t.a, t.b), cross_polynomial(w, -t.b, t.c)};
}

/// The rotation nearest to a matrix that is nearly one, by two steps of Newton and Schulz: each
/// squares the departure from orthonormality, so 0.01 becomes less than a float resolves. Source:
/// Higham, "Functions of matrices", 2008, section 8.3.
FT_HOST_DEVICE inline strict_mat3f nearest_rotation(strict_mat3f R) {
  FT_UNROLL
  for (int step = 0; step < 2; ++step) {
    // R + R (I - R^T R) / 2: the correction is small, so it costs no digits.
    strict_mat3f rest = R.transposed() * R;
    FT_UNROLL
    for (int i = 0; i < 9; ++i) {
      strict_float const one = i % 4 == 0 ? 0.5f : 0.0f;
      rest.m[i] = one - strict_float(0.5f) * rest.m[i];
    }
    R = sum(R, R * rest);
  }
  return R;
}

// In double. Exp has no case of small rotations, and sums on the diagonal are others than in float.

/// The rotation by |w| about w.
FT_HOST_DEVICE inline strict_mat3d rotation_exp(strict_vec3d w) {
  real64 const d2 = dot(w, w);
  rotation_terms<real64> const t = terms_of_rotation(d2);
  return one_plus(t.a, t.b, w, d2);
}
FT_HOST_DEVICE inline rotation_and_jacobian<real64> rotation_exp_and_jacobian(strict_vec3d w) {
  real64 const d2 = dot(w, w);
  rotation_terms<real64> const t = terms_of_rotation(d2);
  return {one_plus(t.a, t.b, w, d2), one_plus(-t.b, t.c, w, d2)};
}

/// Jr; that of no rotation for small ones.
FT_HOST_DEVICE inline strict_mat3d rotation_jacobian(strict_vec3d w) {
  real64 const d2 = dot(w, w);
  if (d2 < real64(tiny_angle2)) { return strict_mat3d::identity(); }
  rotation_terms<real64> const t = terms_of_rotation(d2);
  return one_plus(-t.b, t.c, w, d2);
}

/// The inverse of Jr.
FT_HOST_DEVICE inline strict_mat3d inverse_rotation_jacobian(strict_vec3d w) {
  real64 const d2 = dot(w, w);
  if (d2 < real64(tiny_angle2)) { return strict_mat3d::identity(); }
  real64 b;  // 1 / d^2 - (1 + cos d) / (2 d sin d)
  if (d2 < real64(series_angle2)) {
    constexpr double terms[] = {691.0 / 1307674368000.0, 1.0 / 47900160.0, 1.0 / 1209600.0,
                                1.0 / 30240.0, 1.0 / 720.0};
    b = 0.0;
    FT_UNROLL
    for (int k = 0; k < 5; ++k) { b = d2 * (b + real64(terms[k])); }
    b = b + real64(1.0 / 12.0);
  } else {
    rotation_terms<real64> const t = terms_of_rotation(d2);
    b = (real64(1.0) - t.a / (t.b + t.b)) / d2;
  }
  return one_plus(real64(0.5), b, w, d2);
}

/// w of Exp(w) = R. For an R that is no rotation, as in the reference: the antisymmetric part.
FT_HOST_DEVICE inline strict_vec3d rotation_log(strict_mat3d const& R) {
  auto const& m = R.m;
  real64 const one_half = 0.5;
  strict_vec3d const w{(m[7] - m[5]) * one_half, (m[2] - m[6]) * one_half,
                       (m[3] - m[1]) * one_half};
  real64 const c = ((m[0] + (m[4] + m[8])) - real64(1.0)) * one_half;
  real64 const rest = real64(1.0) - c;
  // |sin| < 1e-5, or no cosine.
  if (!(c <= real64(1.0) && c >= real64(-1.0)) || rest * (real64(1.0) + c) < real64(tiny_angle2)) {
    return w;
  }
  real64 ratio = 1.0;  // t / sin t
  if (rest < real64(1.0 / 64)) {
    FT_UNROLL
    for (int n = 9; n > 0; --n) {
      ratio = real64(1.0) + rest * real64(n / (2.0 * n + 1.0)) * ratio;
    }
  } else {
    real64 const s = scalar::sqrt(rest * (real64(1.0) + c));
    ratio = strict_atan2(s, c) / s;
  }
  return scaled(w, ratio);
}

inline constexpr double no_angle = std::numeric_limits<double>::quiet_NaN();

/// The same, NaN for no rotation at all, and where rounding makes the cosine of the angle larger
/// than 1: MLPnP's reference counts on it.
FT_HOST_DEVICE inline strict_vec3d rotation_vector(strict_mat3d const& R) {
  auto const& m = R.m;
  real64 const c = (m[0] + m[4] + m[8] - real64(1.0)) * real64(0.5);
  if (!(c <= real64(1.0) && c >= real64(-1.0))) { return {no_angle, no_angle, no_angle}; }
  real64 const angle = strict_atan2(scalar::sqrt((real64(1.0) - c) * (real64(1.0) + c)), c);
  real64 const sine = strict_sin_cos(angle).sine;
  return scaled(strict_vec3d{m[7] - m[5], m[2] - m[6], m[3] - m[1]}, angle / (sine + sine));
}

/// The rotation nearest to a matrix that is one to single precision: a step of Newton and Schulz.
FT_HOST_DEVICE inline strict_mat3d nearest_rotation(strict_mat3d const& R) {
  strict_mat3d rest = R.transposed() * R;
  FT_UNROLL
  for (int i = 0; i < 9; ++i) {
    rest.m[i] = real64(i % 4 == 0 ? 1.5 : 0.0) - real64(0.5) * rest.m[i];
  }
  return R * rest;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
