// SPDX-License-Identifier: Apache-2.0
/// @file Rotations as unit quaternions: from and to matrices, logarithm.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Quaternion of a rotation, scalar part not negative. Source: Shepperd, "Quaternion from rotation
/// matrix", 1978.
template <typename Real>
FT_HOST_DEVICE quaternion<Real> quaternion_of(mat3<Real> const& R) {
  auto const& m = R.m;
  Real const trace = m[0] + m[4] + m[8];
  quaternion<Real> q;
  if (trace >= m[0] && trace >= m[4] && trace >= m[8]) {
    q = {m[7] - m[5], m[2] - m[6], m[3] - m[1], Real(1) + trace};
  } else if (m[0] >= m[4] && m[0] >= m[8]) {
    q = {Real(1) + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6], m[7] - m[5]};
  } else if (m[4] >= m[8]) {
    q = {m[1] + m[3], Real(1) - m[0] + m[4] - m[8], m[5] + m[7], m[2] - m[6]};
  } else {
    q = {m[2] + m[6], m[5] + m[7], Real(1) - m[0] - m[4] + m[8], m[3] - m[1]};
  }
  Real const n = scalar::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
  Real const s = (q.w < Real(0) ? Real(-1) : Real(1)) / n;
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}

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

/// Axis times angle of a rotation. The angle is halved until the series of the arc sine converges
/// fast, so the bits do not depend on a library's functions.
FT_HOST_DEVICE inline vec3<strict_double> log_so3(quaternion<strict_double> q) {
  using real = strict_double;
  real factor = 2;
  real squared = q.x * q.x + q.y * q.y + q.z * q.z;
  FT_NO_UNROLL
  for (int i = 0; i < 4 && squared > real(1.0 / 64); ++i) {
    real const w = scalar::sqrt((real(1) + q.w) * real(0.5));
    real const s = real(0.5) / w;
    q = {q.x * s, q.y * s, q.z * s, w};
    squared = q.x * q.x + q.y * q.y + q.z * q.z;
    factor = factor + factor;
  }
  // asin(x) / x, from the innermost bracket.
  real sum = 1;
  FT_UNROLL
  for (int k = 10; k > 0; --k) {
    double const odd = 2.0 * k - 1.0;
    sum = real(1) + squared * real(odd * odd / (2.0 * k * (2.0 * k + 1.0))) * sum;
  }
  real const f = factor * sum;
  return {q.x * f, q.y * f, q.z * f};
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
