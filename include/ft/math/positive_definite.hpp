// SPDX-License-Identifier: Apache-2.0
/// @file Symmetric positive definite systems of 3 and of 6 unknowns, by one thread.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

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

/// Eliminates a symmetric 6 x 6 system in place, without exchanges. Only the upper triangle is read
/// and written; column 6 is the right-hand side.
/// @param inverse of the pivots; infinite or NaN where one is 0
/// @return whether all pivots are positive
template <typename Real>
FT_HOST_DEVICE bool eliminate_6(Real (&a)[6][7], Real (&inverse)[6]) {
  bool positive = true;
  FT_UNROLL
  for (int k = 0; k < 6; ++k) {
    positive = positive && a[k][k] > Real(0);
    inverse[k] = scalar::reciprocal(a[k][k]);
    FT_UNROLL
    for (int i = k + 1; i < 6; ++i) {
      Real const factor = a[k][i] * inverse[k];
      FT_UNROLL
      for (int j = i; j < 7; ++j) { a[i][j] = a[i][j] - factor * a[k][j]; }
    }
  }
  return positive;
}

/// Solves the symmetric positive definite system (A + damping I) x = b of size 6 by L D L^T, which
/// is stable without pivoting: the error of A is that of its rounding, also where the damping alone
/// makes A invertible. Inverting blocks of it would enlarge that error by their condition.
/// @param terms b, then the upper triangle of A by rows
/// @return false if the matrix is not positive definite
template <typename Real, typename Number>
FT_HOST_DEVICE bool solve_6(Number const* terms, Real damping, Real (&x)[6]) {
  using plain = plain_scalar_t<Real>;
  Real a[6][7];
  Real inverse[6];
  int next = 6;
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    a[i][6] = Real(static_cast<plain>(terms[i]));
    FT_UNROLL
    for (int j = i; j < 6; ++j) { a[i][j] = Real(static_cast<plain>(terms[next++])); }
    a[i][i] = a[i][i] + damping;
  }
  bool const positive = eliminate_6(a, inverse);
  FT_UNROLL
  for (int k = 5; k >= 0; --k) {
    x[k] = a[k][6] * inverse[k];
    FT_UNROLL
    for (int j = 5; j > k; --j) {  // the last known last
      x[k] = x[k] - a[k][j] * inverse[k] * x[j];
    }
  }
  return positive;
}

/// The same in 3 x 3 blocks (Schur complement): two divisions one after another instead of six. The
/// error of a block's inverse is that of its rounding times its condition.
template <typename Real, typename Number>
FT_HOST_DEVICE bool solve_6_in_blocks(Number const* terms, Real damping, Real (&x)[6]) {
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

/// Solves a symmetric 6 x 6 system by elimination without exchanges, as for a positive definite
/// one. A singular system gives infinities or NaN. Sums of the back substitution are divided once,
/// as in the reference, so the bits are not those of solve_6.
/// @param m the matrix and the right-hand side, 6 x 7, row-major; its lower triangle is not read
FT_HOST_DEVICE inline void solve_symmetric_6(real64 const* m, real64 (&x)[6]) {
  real64 a[6][7];
  real64 inverse[6];
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    FT_UNROLL
    for (int k = i; k < 7; ++k) { a[i][k] = m[7 * i + k]; }
  }
  eliminate_6(a, inverse);
  FT_UNROLL
  for (int i = 5; i >= 0; --i) {
    real64 sum = a[i][6];
    FT_UNROLL
    for (int k = i + 1; k < 6; ++k) { sum -= a[i][k] * x[k]; }
    x[i] = sum * inverse[i];
  }
}

/// Inverts a symmetric 6 x 6 matrix by a Cholesky factorisation.
/// @param upper its upper triangle by rows
/// @param out result, exactly symmetric
/// @return false, with nothing written, if it is not positive definite
template <typename S>
FT_HOST_DEVICE bool invert_6(S const* upper, double (&out)[36]) {
  using real = strict_double;
  real L[6][6];  // lower factor
  int at = 0;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { L[j][i] = real(static_cast<double>(upper[at++])); }
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      for (int k = 0; k < i; ++k) { L[j][i] = L[j][i] - L[j][k] * L[i][k]; }
    }
    if (!(L[i][i] > real(0))) { return false; }
    real const root = scalar::sqrt(L[i][i]);
    for (int j = i; j < 6; ++j) { L[j][i] = L[j][i] / root; }
  }
  for (int column = 0; column < 6; ++column) {
    real x[6];
    for (int i = 0; i < 6; ++i) {
      x[i] = i == column ? 1.0 : 0.0;
      for (int k = 0; k < i; ++k) { x[i] = x[i] - L[i][k] * x[k]; }
      x[i] = x[i] / L[i][i];
    }
    for (int i = 5; i >= 0; --i) {
      for (int k = i + 1; k < 6; ++k) { x[i] = x[i] - L[k][i] * x[k]; }
      x[i] = x[i] / L[i][i];
      // The lower triangle is written last, from the upper one: exactly symmetric.
      if (i <= column) { out[6 * i + column] = out[6 * column + i] = x[i].value; }
    }
  }
  return true;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
