// SPDX-License-Identifier: Apache-2.0
/// @file Eigenvectors of symmetric matrices, singular vectors and orthogonal factors, small enough
/// for one thread. Equal bits on every executor.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A rotation in a plane of two coordinates that makes an entry of a symmetric matrix 0. Source:
/// Golub and Van Loan, "Matrix computations", section 8.5.
struct jacobi_rotation {
  real64 tangent, cosine, sine;

  FT_HOST_DEVICE static jacobi_rotation with(real64 tangent) {
    real64 const c = scalar::reciprocal(scalar::sqrt(tangent * tangent + real64(1.0)));
    return {tangent, c, tangent * c};
  }
  FT_HOST_DEVICE void turn(real64& p, real64& q) const {
    real64 const before = p;
    p = cosine * before - sine * q;
    q = sine * before + cosine * q;
  }
};

/// Whether entry (p, q) is next to nothing: nothing is added to the smaller of two values of one
/// sign by less than that. Also if it is not finite.
FT_HOST_DEVICE inline bool nothing_to_turn(real64 pq, real64 pp, real64 qq) {
  real64 const size = scalar::abs(pq);
  bool const negligible =
      scalar::abs(pp) + size == scalar::abs(pp) && scalar::abs(qq) + size == scalar::abs(qq);
  return negligible || !scalar::is_finite(pq);
}

/// Tangent of the angle, by the ratio of entries. Its last bits differ from those of
/// tangent_by_root and answers depend on them: both stay.
FT_HOST_DEVICE inline real64 tangent_by_ratio(real64 pq, real64 pp, real64 qq) {
  real64 const theta = (qq - pp) / (pq + pq);
  real64 const root = scalar::sqrt(theta * theta + real64(1.0));
  return scalar::is_finite(root)
             ? real64(theta < real64(0.0) ? -1.0 : 1.0) / (scalar::abs(theta) + root)
             : real64(0.5) / theta;
}
/// The same with one division, as the smaller root of t^2 + 2 t (qq - pp) / (2 pq) - 1 = 0. Not
/// finite where squares overflow or all entries are 0.
FT_HOST_DEVICE inline real64 tangent_by_root(real64 pq, real64 pp, real64 qq) {
  real64 const d = qq - pp;
  real64 const twice = pq + pq;
  real64 const root = scalar::sqrt(d * d + twice * twice);
  return twice / (d < real64(0.0) ? d - root : d + root);
}

/// A symmetric N x N matrix, and its eigenvectors, by cyclic Jacobi rotations in a fixed order.
/// Equal bits on every executor. Loops have constant bounds, so that a device keeps the matrices in
/// registers. Source: Golub and Van Loan, "Matrix computations", section 8.5.
template <int N>
struct small_eigen {
  static constexpr int sweeps = 24;  ///< at most; six are usual

  real64 a[N * N];  ///< row-major; in the end the eigenvalues are on its diagonal
  real64 v[N * N];  ///< column k is the eigenvector of eigenvalue k

  /// Diagonalises `a`, whose both triangles are set.
  FT_HOST_DEVICE void diagonalize() {
    FT_UNROLL
    for (int k = 0; k < N * N; ++k) { v[k] = k % (N + 1) == 0 ? 1.0 : 0.0; }
    bool turned = true;
    FT_NO_UNROLL
    for (int sweep = 0; turned && sweep < sweeps; ++sweep) {
      turned = false;
      FT_UNROLL
      for (int p = 0; p + 1 < N; ++p) {
        FT_UNROLL
        for (int q = p + 1; q < N; ++q) { turned = rotate(p, q) || turned; }
      }
    }
  }
  /// Number of the smallest eigenvalue, the first of equals.
  FT_HOST_DEVICE int smallest() const {
    int at = 0;
    real64 least = a[0];
    FT_UNROLL
    for (int k = 1; k < N; ++k) {
      bool const less = a[k * N + k] < least;
      at = less ? k : at;
      least = less ? a[k * N + k] : least;
    }
    return at;
  }
  /// Component i of eigenvector k, which is found without an address.
  FT_HOST_DEVICE real64 component(int i, int k) const {
    real64 c = v[i * N];
    FT_UNROLL
    for (int j = 1; j < N; ++j) { c = j == k ? v[i * N + j] : c; }
    return c;
  }

private:
  /// Turns rows and columns p and q so that entry (p, q) is 0. Returns whether it was not
  /// negligible.
  FT_HOST_DEVICE bool rotate(int p, int q) {
    real64 const pq = a[p * N + q];
    real64 const pp = a[p * N + p];
    real64 const qq = a[q * N + q];
    if (nothing_to_turn(pq, pp, qq)) { return false; }
    auto const r = jacobi_rotation::with(tangent_by_ratio(pq, pp, qq));
    a[p * N + p] = pp - r.tangent * pq;
    a[q * N + q] = qq + r.tangent * pq;
    a[p * N + q] = a[q * N + p] = 0.0;
    FT_UNROLL
    for (int k = 0; k < N; ++k) {
      r.turn(v[k * N + p], v[k * N + q]);
      if (k == p || k == q) { continue; }
      r.turn(a[k * N + p], a[k * N + q]);
      a[p * N + k] = a[k * N + p];
      a[q * N + k] = a[k * N + q];
    }
    return true;
  }
};

/// M^T M.
FT_HOST_DEVICE inline small_eigen<3> eigen_of_square(strict_mat3d const& M) {
  strict_mat3d const S = M.transposed() * M;
  small_eigen<3> eigen;
  for (int k = 0; k < 9; ++k) { eigen.a[k] = S.m[k]; }
  eigen.diagonalize();
  return eigen;
}

/// A matrix as the sum of d_k u_k v_k^T, with d descending.
struct singular_vectors {
  strict_vec3d u[3];
  strict_vec3d v[3];
  real64 d[3];
};

/// Singular value decomposition. Where two singular values are 0, u is NaN.
FT_HOST_DEVICE inline singular_vectors singular_vectors_of(strict_mat3d const& M) {
  small_eigen<3> const eigen = eigen_of_square(M);
  int const last = eigen.smallest();
  int first = last == 0 ? 1 : 0;
  int middle = 3 - last - first;
  auto const value = [&](int k) { return eigen.a[4 * k]; };
  if (value(first) < value(middle)) {
    int const k = first;
    first = middle;
    middle = k;
  }
  singular_vectors s;
  int const order[3] = {first, middle, last};
  for (int k = 0; k < 3; ++k) {
    s.v[k] = {eigen.v[order[k]], eigen.v[3 + order[k]], eigen.v[6 + order[k]]};
  }
  strict_vec3d const longest = M * s.v[0];
  s.d[0] = norm(longest);
  s.u[0] = unit(longest);
  strict_vec3d second = M * s.v[1];
  second = second - scaled(s.u[0], dot(s.u[0], second));
  s.d[1] = norm(second);
  s.u[1] = unit(second);
  s.u[2] = cross(s.u[0], s.u[1]);
  s.d[2] = dot(s.u[2], M * s.v[2]);
  if (s.d[2] < real64(0.0)) {
    s.d[2] = -s.d[2];
    s.u[2] = -s.u[2];
  }
  return s;
}

/// One Jacobi rotation: zeroes a[P][Q] of a symmetric matrix and rotates the columns of e. False if
/// the angle is below the precision of a double.
template <int P, int Q>
FT_HOST_DEVICE bool rotate_4(real64 (&a)[4][4], real64 (&e)[4][4]) {
  real64 const off = a[P][Q];
  real64 const apart = a[Q][Q] - a[P][P];
  constexpr double nothing = 1.0 / (1ull << 60);
  if (scalar::abs(off) <= real64(nothing) * scalar::abs(apart)) { return false; }
  auto const r = jacobi_rotation::with(tangent_by_root(off, a[P][P], a[Q][Q]));
  FT_UNROLL
  for (int k = 0; k < 4; ++k) { r.turn(a[k][P], a[k][Q]); }
  FT_UNROLL
  for (int k = 0; k < 4; ++k) {
    r.turn(a[P][k], a[Q][k]);
    r.turn(e[k][P], e[k][Q]);
  }
  return true;
}

/// Eigenvector of the smallest eigenvalue of a symmetric 4 x 4 matrix, by Jacobi rotations in a
/// fixed order. Entries are turned row by row and column by column, so the bits are not those of
/// small_eigen<4>.
FT_HOST_DEVICE inline void smallest_eigenvector_4(real64 (&a)[4][4], real64 (&v)[4]) {
  real64 e[4][4];
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) { e[i][j] = i == j ? 1.0 : 0.0; }
  }
  FT_NO_UNROLL
  for (int sweep = 0; sweep < 10; ++sweep) {
    bool turned = rotate_4<0, 1>(a, e);
    turned = rotate_4<0, 2>(a, e) || turned;
    turned = rotate_4<0, 3>(a, e) || turned;
    turned = rotate_4<1, 2>(a, e) || turned;
    turned = rotate_4<1, 3>(a, e) || turned;
    turned = rotate_4<2, 3>(a, e) || turned;
    if (!turned) { break; }
  }
  real64 lowest = a[0][0];
  for (int k = 0; k < 4; ++k) { v[k] = e[k][0]; }
  for (int i = 1; i < 4; ++i) {
    if (a[i][i] < lowest) {
      lowest = a[i][i];
      for (int k = 0; k < 4; ++k) { v[k] = e[k][i]; }
    }
  }
}

/// A Jacobi rotation that makes columns p and q orthogonal. Returns whether they were not.
FT_HOST_DEVICE inline bool make_orthogonal(strict_vec3d& ap, strict_vec3d& aq, strict_vec3d& vp,
                                           strict_vec3d& vq) {
  real64 const pp = dot(ap, ap);
  real64 const qq = dot(aq, aq);
  real64 const pq = dot(ap, aq);
  if (!(pq * pq > real64(1e-32) * pp * qq)) { return false; }  // also for NaN
  real64 const t = tangent_by_root(pq, pp, qq);
  if (!scalar::is_finite(t)) { return false; }
  auto const r = jacobi_rotation::with(t);
  auto const turn = [&](strict_vec3d& x, strict_vec3d& y) {
    r.turn(x.x, y.x);
    r.turn(x.y, y.y);
    r.turn(x.z, y.z);
  };
  turn(ap, aq);
  turn(vp, vq);
  return true;
}

/// U V^T of M = U S V^T, negated if its determinant is negative: for a multiple of a rotation with
/// errors, the nearest rotation. By one-sided Jacobi rotations. NaN for a matrix of rank 1 or 0.
FT_HOST_DEVICE inline strict_mat3d orthogonal_factor(strict_mat3d const& M) {
  strict_vec3d a0 = column_of(M, 0);
  strict_vec3d a1 = column_of(M, 1);
  strict_vec3d a2 = column_of(M, 2);
  strict_vec3d v0{1.0, 0.0, 0.0};
  strict_vec3d v1{0.0, 1.0, 0.0};
  strict_vec3d v2{0.0, 0.0, 1.0};
  bool turned = true;
  FT_NO_UNROLL
  for (int sweep = 0; turned && sweep < 20; ++sweep) {
    turned = make_orthogonal(a0, a1, v0, v1);
    turned = make_orthogonal(a0, a2, v0, v2) || turned;
    turned = make_orthogonal(a1, a2, v1, v2) || turned;
  }
  strict_vec3d u0 = unit(a0);
  strict_vec3d u1 = unit(a1);
  strict_vec3d u2 = unit(a2);
  auto const none = [](strict_vec3d v) { return dot(v, v) == real64(0.0); };
  if (none(a0)) { u0 = cross(u1, u2); }
  if (none(a1)) { u1 = cross(u2, u0); }
  if (none(a2)) { u2 = cross(u0, u1); }
  strict_mat3d R = from_rows(u0, u1, u2).transposed() * from_rows(v0, v1, v2);
  if (determinant(R) < real64(0.0)) { R = scaled(R, real64(-1.0)); }
  return R;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
