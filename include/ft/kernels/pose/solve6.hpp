// SPDX-License-Identifier: Apache-2.0
/// @file Solves the 6 x 6 normal equations of a pose.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric 3 x 3 matrix, stored as its upper triangle by rows.
template <typename Real>
struct symmetric_3 {
  Real xx, xy, xz, yy, yz, zz;

  FT_HOST_DEVICE vec3<Real> operator*(vec3<Real> v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z};
  }
  /// By cofactors: one division, short dependency chains. False if it is not positive definite.
  FT_HOST_DEVICE bool invert(symmetric_3& inverse) const {
    symmetric_3 const c{yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz,
                        xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
    Real const determinant = xx * c.xx + xy * c.xy + xz * c.xz;
    if (!(xx > Real(0) && c.zz > Real(0) && determinant > Real(0))) { return false; }
    Real const scale = scalar::reciprocal(determinant);
    inverse = {c.xx * scale, c.xy * scale, c.xz * scale, c.yy * scale, c.yz * scale, c.zz * scale};
    return true;
  }
};

/// Solves the symmetric positive definite system (A + damping I) x = b of size 6 in 3 x 3 blocks
/// (Schur complement).
/// @tparam Real scalar of the solution
/// @param terms b, then the upper triangle of A by rows
/// @return false if the matrix is not positive definite
template <typename Real, typename Number>
FT_HOST_DEVICE bool solve_6(Number const* terms, Real damping, Real (&x)[6]) {
  using plain = plain_scalar_t<Real>;
  auto const at = [&](int i) { return Real(static_cast<plain>(terms[6 + i])); };
  auto const b = [&](int i) { return Real(static_cast<plain>(terms[i])); };
  symmetric_3<Real> const A{at(0) + damping, at(1), at(2),
                            at(6) + damping, at(7), at(11) + damping};
  symmetric_3<Real> const C{at(15) + damping, at(16), at(17),
                            at(18) + damping, at(19), at(20) + damping};
  // Columns of the upper right block.
  vec3<Real> const B[3] = {{at(3), at(8), at(12)}, {at(4), at(9), at(13)}, {at(5), at(10), at(14)}};
  symmetric_3<Real> A_inverse;
  if (!A.invert(A_inverse)) { return false; }
  vec3<Real> const w[3] = {A_inverse * B[0], A_inverse * B[1], A_inverse * B[2]};
  symmetric_3<Real> const S{C.xx - dot(B[0], w[0]), C.xy - dot(B[0], w[1]), C.xz - dot(B[0], w[2]),
                            C.yy - dot(B[1], w[1]), C.yz - dot(B[1], w[2]), C.zz - dot(B[2], w[2])};
  symmetric_3<Real> S_inverse;
  if (!S.invert(S_inverse)) { return false; }
  vec3<Real> const first{b(0), b(1), b(2)};
  vec3<Real> const y = S_inverse * vec3<Real>{b(3) - dot(w[0], first), b(4) - dot(w[1], first),
                                              b(5) - dot(w[2], first)};
  vec3<Real> const z = A_inverse * first;
  x[0] = z.x - (w[0].x * y.x + w[1].x * y.y + w[2].x * y.z);
  x[1] = z.y - (w[0].y * y.x + w[1].y * y.y + w[2].y * y.z);
  x[2] = z.z - (w[0].z * y.x + w[1].z * y.y + w[2].z * y.z);
  x[3] = y.x;
  x[4] = y.y;
  x[5] = y.z;
  return true;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
