// SPDX-License-Identifier: Apache-2.0
/// @file Norms, determinants, orthogonal factors, ranks and solutions of 3 x 3 and 6 x 6 matrices,
/// in strict doubles.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

FT_HOST_DEVICE inline wide norm(wide_vec3 v) { return scalar::sqrt(dot(v, v)); }
FT_HOST_DEVICE inline wide_vec3 unit(wide_vec3 v) { return scaled(v, scalar::reciprocal(norm(v))); }
FT_HOST_DEVICE inline wide_vec3 row_of(wide_mat3 const& A, int r) {
  return {A.m[3 * r], A.m[3 * r + 1], A.m[3 * r + 2]};
}
FT_HOST_DEVICE inline wide_vec3 column_of(wide_mat3 const& A, int c) {
  return {A.m[c], A.m[3 + c], A.m[6 + c]};
}
FT_HOST_DEVICE inline wide_mat3 from_rows(wide_vec3 a, wide_vec3 b, wide_vec3 c) {
  return {{a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z}};
}
FT_HOST_DEVICE inline wide determinant(wide_mat3 const& A) {
  return dot(cross(row_of(A, 0), row_of(A, 1)), row_of(A, 2));
}

/// The cube root, with an error of a few units in the last place; 0, infinity and NaN as they are.
/// Halley's iteration triples the correct digits, from 1.3 that a third of the bits, read as a
/// whole number, has.
FT_HOST_DEVICE inline wide cube_root(wide v) {
  if (!(v.value > 1e-300 && v.value < 1e300)) { return v; }
  std::uint64_t bits;
  std::memcpy(&bits, &v.value, sizeof bits);
  bits = bits / 3 + 0x2A9F7893782DA1CEull;
  double start;
  std::memcpy(&start, &bits, sizeof start);
  wide y = start;
  FT_UNROLL
  for (int i = 0; i < 3; ++i) {
    wide const cube = y * y * y;
    y = y * ((cube + v + v) / (cube + cube + v));
  }
  return y;
}

/// A Jacobi rotation that makes columns p and q orthogonal. Returns whether they were not.
FT_HOST_DEVICE inline bool make_orthogonal(wide_vec3& ap, wide_vec3& aq, wide_vec3& vp,
                                           wide_vec3& vq) {
  wide const pp = dot(ap, ap);
  wide const qq = dot(aq, aq);
  wide const pq = dot(ap, aq);
  if (!(pq * pq > wide(1e-32) * pp * qq)) { return false; }  // also for NaN
  wide const d = qq - pp;
  wide const twice = pq + pq;
  wide const root = scalar::sqrt(d * d + twice * twice);
  wide const t = twice / (d < wide(0.0) ? d - root : d + root);
  if (!scalar::is_finite(t)) { return false; }
  wide const c = scalar::reciprocal(scalar::sqrt(t * t + wide(1.0)));
  wide const s = t * c;
  auto const turn = [&](wide_vec3& x, wide_vec3& y) {
    wide_vec3 const before = x;
    x = scaled(before, c) - scaled(y, s);
    y = scaled(before, s) + scaled(y, c);
  };
  turn(ap, aq);
  turn(vp, vq);
  return true;
}

/// U V^T of M = U S V^T, negated if its determinant is negative: for a multiple of a rotation with
/// errors, the nearest rotation. By one-sided Jacobi rotations. NaN for a matrix of rank 1 or 0.
FT_HOST_DEVICE inline wide_mat3 orthogonal_factor(wide_mat3 const& M) {
  wide_vec3 a0 = column_of(M, 0);
  wide_vec3 a1 = column_of(M, 1);
  wide_vec3 a2 = column_of(M, 2);
  wide_vec3 v0{1.0, 0.0, 0.0};
  wide_vec3 v1{0.0, 1.0, 0.0};
  wide_vec3 v2{0.0, 0.0, 1.0};
  bool turned = true;
  FT_NO_UNROLL
  for (int sweep = 0; turned && sweep < 20; ++sweep) {
    turned = make_orthogonal(a0, a1, v0, v1);
    turned = make_orthogonal(a0, a2, v0, v2) || turned;
    turned = make_orthogonal(a1, a2, v1, v2) || turned;
  }
  wide_vec3 u0 = unit(a0);
  wide_vec3 u1 = unit(a1);
  wide_vec3 u2 = unit(a2);
  auto const none = [](wide_vec3 v) { return dot(v, v) == wide(0.0); };
  if (none(a0)) { u0 = cross(u1, u2); }
  if (none(a1)) { u1 = cross(u2, u0); }
  if (none(a2)) { u2 = cross(u0, u1); }
  wide_mat3 R = from_rows(u0, u1, u2).transposed() * from_rows(v0, v1, v2);
  if (determinant(R) < wide(0.0)) { R = scaled(R, wide(-1.0)); }
  return R;
}

/// Rank by Householder's QR with full pivoting: pivots above 6.66e-16 of the largest count. Source:
/// Golub and Van Loan, "Matrix computations", section 5.5.7.
FT_HOST_DEVICE inline int rank_of(wide_mat3 const& M) {
  wide_vec3 column[3] = {column_of(M, 0), column_of(M, 1), column_of(M, 2)};
  wide pivot[3] = {0.0, 0.0, 0.0};
  // Turning the rows of the corner that is left changes no norm, so that the pivot's column alone
  // matters. It is projected out of the others.
  bool used[3] = {false, false, false};
  for (int k = 0; k < 3; ++k) {
    int best = -1;
    wide largest = 0.0;
    for (int c = 0; c < 3; ++c) {
      wide const x = scalar::abs(column[c].x);
      wide const y = scalar::abs(column[c].y);
      wide const z = scalar::abs(column[c].z);
      wide const size = max_of(max_of(x, y), z);
      if (!used[c] && size > largest) {
        largest = size;
        best = c;
      }
    }
    if (best < 0) { break; }
    used[best] = true;
    pivot[k] = norm(column[best]);
    wide_vec3 const u = scaled(column[best], scalar::reciprocal(pivot[k]));
    for (int c = 0; c < 3; ++c) {
      if (!used[c]) { column[c] = column[c] - scaled(u, dot(u, column[c])); }
    }
  }
  wide const limit = wide(6.66e-16) * max_of(max_of(pivot[0], pivot[1]), pivot[2]);
  int rank = 0;
  for (int k = 0; k < 3; ++k) { rank += static_cast<int>(pivot[k] > limit); }
  return rank;
}

/// Solves a symmetric 6 x 6 system by elimination without exchanges, as for a positive definite
/// one. A singular system gives infinities or NaN.
/// @param m the matrix and the right-hand side, 6 x 7, row-major; its lower triangle is not read
FT_HOST_DEVICE inline void solve_symmetric_6(wide const* m, wide (&x)[6]) {
  wide a[6][7];
  wide inverse[6];
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    FT_UNROLL
    for (int k = i; k < 7; ++k) { a[i][k] = m[7 * i + k]; }
  }
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    inverse[i] = scalar::reciprocal(a[i][i]);
    FT_UNROLL
    for (int j = i + 1; j < 6; ++j) {
      wide const f = a[i][j] * inverse[i];
      FT_UNROLL
      for (int k = j; k < 7; ++k) { a[j][k] -= f * a[i][k]; }
    }
  }
  FT_UNROLL
  for (int i = 5; i >= 0; --i) {
    wide sum = a[i][6];
    FT_UNROLL
    for (int k = i + 1; k < 6; ++k) { sum -= a[i][k] * x[k]; }
    x[i] = sum * inverse[i];
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
