// SPDX-License-Identifier: Apache-2.0
/// @file Solves the 6 x 6 normal equations of a pose.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
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

/// Solves the symmetric positive definite system (A + damping I) x = b of size 6 by L D L^T, which
/// is stable without pivoting: the error of A is that of its rounding, also where the damping alone
/// makes A invertible. Inverting blocks of it would enlarge that error by their condition.
/// @param terms b, then the upper triangle of A by rows
/// @return false if the matrix is not positive definite
template <typename Real, typename Number>
FT_HOST_DEVICE bool solve_6(Number const* terms, Real damping, Real (&x)[6]) {
  using plain = plain_scalar_t<Real>;
  Real A[6][6];  // upper triangle; what is left of it
  Real b[6];
  int next = 6;
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    b[i] = Real(static_cast<plain>(terms[i]));
    FT_UNROLL
    for (int j = i; j < 6; ++j) { A[i][j] = Real(static_cast<plain>(terms[next++])); }
    A[i][i] = A[i][i] + damping;
  }
  bool positive = true;
  FT_UNROLL
  for (int k = 0; k < 6; ++k) {
    positive = positive && A[k][k] > Real(0);
    Real const inverse = scalar::reciprocal(A[k][k]);
    FT_UNROLL
    for (int i = k + 1; i < 6; ++i) {
      Real const factor = A[k][i] * inverse;
      FT_UNROLL
      for (int j = i; j < 6; ++j) { A[i][j] = A[i][j] - factor * A[k][j]; }
      b[i] = b[i] - factor * b[k];
      A[k][i] = factor;
    }
    b[k] = b[k] * inverse;
  }
  FT_UNROLL
  for (int k = 5; k >= 0; --k) {
    x[k] = b[k];
    FT_UNROLL
    for (int j = 5; j > k; --j) { x[k] = x[k] - A[k][j] * x[j]; }  // the last known last
  }
  return positive;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
