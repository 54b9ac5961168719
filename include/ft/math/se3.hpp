// SPDX-License-Identifier: Apache-2.0
/// @file Rigid motions and their twists: exponential and logarithm. Equal bits on every executor.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

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
  // What the series leave out is below 1e-16 of the result.
  rotation_terms<Real> const s = rotation_series<5>(theta2);
  rigid<Real> t;
  t.R = one_plus(s.a, s.b, w, theta2);
  t.t = one_plus(s.b, s.c, w, theta2) * u;
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

/// A twist: axis times angle in rad, and the velocity whose integral is the translation.
struct twist {
  vec3<strict_double> w, u;
};

/// Logarithm of a rigid motion that turns by less than half a turn. Error below 1e-13 of its
/// length, up to 3 rad. Source: Barfoot, "State estimation for robotics", 2017, section 7.1.
FT_HOST_DEVICE inline twist log_se3(rigid<strict_double> const& T) {
  using real = strict_double;
  quaternion<real> const q = quaternion_of(T.R);
  vec3<real> const w = log_so3(q);
  real const theta2 = dot(w, w);
  // V^-1 = I - W / 2 + c W^2 with c = (1 - a cot a) / theta^2, a = theta / 2.
  real c = 0;
  if (theta2 < real(0.25)) {
    real const terms[] = {1.0 / 12,           1.0 / 720,      1.0 / 30240,
                          1.0 / 1209600,      1.0 / 47900160, 691.0 / 1307674368000.0,
                          1.0 / 74724249600.0};
    FT_UNROLL
    for (int k = 6; k >= 0; --k) { c = terms[k] + theta2 * c; }
  } else {
    real const s = scalar::sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
    real const theta = scalar::sqrt(theta2);
    c = (real(1) - real(0.5) * theta * (q.w / s)) / theta2;
  }
  return {w, one_plus(real(-0.5), c, w, theta2) * T.t};
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
