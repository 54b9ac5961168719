// SPDX-License-Identifier: Apache-2.0
/// @file Eigenvectors of symmetric matrices, and singular vectors, small enough for one thread.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/kernels/matrices/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric N x N matrix, and its eigenvectors, by cyclic Jacobi rotations in a fixed order.
/// Equal bits on every executor. Loops have constant bounds, so that a device keeps the matrices in
/// registers. Source: Golub and Van Loan, "Matrix computations", section 8.5.
template <int N>
struct small_eigen {
  static constexpr int sweeps = 24;  ///< at most; six are usual

  wide a[N * N];  ///< row-major; in the end the eigenvalues are on its diagonal
  wide v[N * N];  ///< column k is the eigenvector of eigenvalue k

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
    wide least = a[0];
    FT_UNROLL
    for (int k = 1; k < N; ++k) {
      bool const less = a[k * N + k] < least;
      at = less ? k : at;
      least = less ? a[k * N + k] : least;
    }
    return at;
  }
  /// Component i of eigenvector k, which is found without an address.
  FT_HOST_DEVICE wide component(int i, int k) const {
    wide c = v[i * N];
    FT_UNROLL
    for (int j = 1; j < N; ++j) { c = j == k ? v[i * N + j] : c; }
    return c;
  }

private:
  /// Turns rows and columns p and q so that entry (p, q) is 0. Returns whether it was not
  /// negligible.
  FT_HOST_DEVICE bool rotate(int p, int q) {
    wide const pq = a[p * N + q];
    wide const pp = a[p * N + p];
    wide const qq = a[q * N + q];
    wide const size = scalar::abs(pq);
    // Nothing is added to the smaller of two values of one sign by less than that.
    bool const negligible =
        scalar::abs(pp) + size == scalar::abs(pp) && scalar::abs(qq) + size == scalar::abs(qq);
    if (negligible || !scalar::is_finite(pq)) { return false; }
    wide const theta = (qq - pp) / (pq + pq);
    wide const root = scalar::sqrt(theta * theta + wide(1.0));
    wide const t = scalar::is_finite(root)
                       ? wide(theta < wide(0.0) ? -1.0 : 1.0) / (scalar::abs(theta) + root)
                       : wide(0.5) / theta;
    wide const c = scalar::reciprocal(scalar::sqrt(t * t + wide(1.0)));
    wide const s = t * c;
    a[p * N + p] = pp - t * pq;
    a[q * N + q] = qq + t * pq;
    a[p * N + q] = a[q * N + p] = 0.0;
    FT_UNROLL
    for (int k = 0; k < N; ++k) {
      wide const vp = v[k * N + p];
      wide const vq = v[k * N + q];
      v[k * N + p] = c * vp - s * vq;
      v[k * N + q] = s * vp + c * vq;
      if (k == p || k == q) { continue; }
      wide const kp = a[k * N + p];
      wide const kq = a[k * N + q];
      a[k * N + p] = a[p * N + k] = c * kp - s * kq;
      a[k * N + q] = a[q * N + k] = s * kp + c * kq;
    }
    return true;
  }
};

/// M^T M.
FT_HOST_DEVICE inline small_eigen<3> eigen_of_square(wide_mat3 const& M) {
  wide_mat3 const S = M.transposed() * M;
  small_eigen<3> eigen;
  for (int k = 0; k < 9; ++k) { eigen.a[k] = S.m[k]; }
  eigen.diagonalize();
  return eigen;
}

/// A matrix as the sum of d_k u_k v_k^T, with d descending.
struct singular_vectors {
  wide_vec3 u[3];
  wide_vec3 v[3];
  wide d[3];
};

/// Singular value decomposition. Where two singular values are 0, u is NaN.
FT_HOST_DEVICE inline singular_vectors singular_vectors_of(wide_mat3 const& M) {
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
  wide_vec3 const longest = M * s.v[0];
  s.d[0] = norm(longest);
  s.u[0] = unit(longest);
  wide_vec3 second = M * s.v[1];
  second = second - scaled(s.u[0], dot(s.u[0], second));
  s.d[1] = norm(second);
  s.u[1] = unit(second);
  s.u[2] = cross(s.u[0], s.u[1]);
  s.d[2] = dot(s.u[2], M * s.v[2]);
  if (s.d[2] < wide(0.0)) {
    s.d[2] = -s.d[2];
    s.u[2] = -s.u[2];
  }
  return s;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
