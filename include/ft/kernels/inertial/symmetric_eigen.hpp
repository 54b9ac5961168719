// SPDX-License-Identifier: Apache-2.0
/// @file Eigenvalues of small symmetric matrices, and functions of such matrices.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric matrix of up to 15 rows, and its eigenvectors, by cyclic Jacobi rotations in a fixed
/// order. Threads share the rows of a rotation; the bits do not depend on their number. Source:
/// Golub and Van Loan, "Matrix computations", section 8.5.
struct symmetric_eigen {
  static constexpr int most = 15;
  static constexpr int sweeps = 24;  ///< at most; eight are usual

  wide a[most * most];  ///< row-major, n x n; in the end the eigenvalues are on its diagonal
  wide v[most * most];  ///< column k is the eigenvector of eigenvalue k

  FT_HOST_DEVICE wide value(int k, int n) const { return a[k * n + k]; }

  /// Diagonalises `a`, n x n, whose both triangles are set. The group has synced. Ends with a sync.
  template <typename Group>
  FT_HOST_DEVICE void diagonalize(Group g, int n) {
    for (int k = g.rank(); k < n * n; k += g.size()) { v[k] = k % (n + 1) == 0 ? 1.0 : 0.0; }
    g.sync();
    bool turned = true;
    FT_NO_UNROLL
    for (int sweep = 0; turned && sweep < sweeps; ++sweep) {
      turned = false;
      FT_NO_UNROLL
      for (int p = 0; p + 1 < n; ++p) {
        FT_NO_UNROLL
        for (int q = p + 1; q < n; ++q) { turned = rotate(g, n, p, q) || turned; }
      }
    }
  }

  /// Entry (i, j) of the matrix with the eigenvalues that `map` gives for their numbers.
  template <typename Map>
  FT_HOST_DEVICE wide recomposed(int n, int i, int j, Map const& map) const {
    wide sum = 0.0;
    for (int k = 0; k < n; ++k) { sum += map(k) * (v[i * n + k] * v[j * n + k]); }
    return sum;
  }

private:
  /// Turns rows and columns p and q so that entry (p, q) is 0. Returns whether it was not
  /// negligible.
  template <typename Group>
  FT_HOST_DEVICE bool rotate(Group g, int n, int p, int q) {
    wide const pq = a[p * n + q];
    wide const pp = a[p * n + p];
    wide const qq = a[q * n + q];
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
    g.sync();
    for (int k = g.rank(); k < n; k += g.size()) {
      wide const vp = v[k * n + p];
      wide const vq = v[k * n + q];
      v[k * n + p] = c * vp - s * vq;
      v[k * n + q] = s * vp + c * vq;
      if (k == p) {
        a[p * n + p] = pp - t * pq;
        a[q * n + q] = qq + t * pq;
        a[p * n + q] = a[q * n + p] = 0.0;
      } else if (k != q) {
        wide const kp = a[k * n + p];
        wide const kq = a[k * n + q];
        a[k * n + p] = a[p * n + k] = c * kp - s * kq;
        a[k * n + q] = a[q * n + k] = s * kp + c * kq;
      }
    }
    g.sync();
    return true;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
