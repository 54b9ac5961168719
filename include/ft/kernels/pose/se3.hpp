// SPDX-License-Identifier: Apache-2.0
/// @file The exponential map of rigid motions.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

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

/// Exponential of a twist (rotation first), by series and repeated squaring. It calls no library
/// function, so its bits are the same on every executor.
template <typename Real>
FT_HOST_DEVICE rigid<Real> exp_se3(Real const (&d)[6]) {
  using plain = plain_scalar_t<Real>;
  vec3<Real> w{d[0], d[1], d[2]};
  vec3<Real> u{d[3], d[4], d[5]};
  Real theta2 = dot(w, w);
  int halvings = 0;
  FT_NO_UNROLL
  while (theta2 > Real(plain(1) / 64) && halvings < 60) {
    Real const one_half = Real(plain(1) / 2);
    w = {w.x * one_half, w.y * one_half, w.z * one_half};
    u = {u.x * one_half, u.y * one_half, u.z * one_half};
    theta2 = theta2 * Real(plain(1) / 4);
    ++halvings;
  }
  // sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3: series in t^2, from the innermost bracket. The
  // truncation error is below 1e-16 of the result.
  Real a = Real(1);
  Real b = Real(1);
  Real c = Real(1);
  FT_UNROLL
  for (int k = 5; k > 0; --k) {
    double const n = 2.0 * k;
    a = Real(1) - theta2 * Real(static_cast<plain>(1.0 / (n * (n + 1.0)))) * a;
    b = Real(1) - theta2 * Real(static_cast<plain>(1.0 / ((n + 1.0) * (n + 2.0)))) * b;
    c = Real(1) - theta2 * Real(static_cast<plain>(1.0 / ((n + 2.0) * (n + 3.0)))) * c;
  }
  b = b * Real(static_cast<plain>(1.0 / 2.0));
  c = c * Real(static_cast<plain>(1.0 / 6.0));
  rigid<Real> t;
  t.R = one_plus(a, b, w, theta2);
  t.t = one_plus(b, c, w, theta2) * u;
  // Each squaring doubles the departure of R from a rotation. In float that adds up after a few.
  constexpr int harmless = 6;
  bool const many = halvings > harmless;
  FT_NO_UNROLL
  for (; halvings > 0; --halvings) {
    t = t * t;
    if (many) { t = t.orthonormalized(); }
  }
  return t;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
