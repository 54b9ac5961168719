// SPDX-License-Identifier: Apache-2.0
/// @file Eigenvalues and eigenvectors of symmetric matrices, by a group of threads. Equal bits on
/// every executor.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/math/jacobi.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric matrix of up to `Most` rows, and its eigenvectors, by Jacobi rotations. The pairs of
/// a round have no row in common, so a group turns all of them at once: the latency of a sweep is
/// that of n - 1 rotations. Rounds have a fixed order; the bits do not depend on the number of
/// threads. Source: Golub and Van Loan, "Matrix computations", section 8.5.5.
template <int Most>
struct paired_eigen {
  using real = strict_double;
  static constexpr int sweeps = 30;  ///< at most; eight are usual
  static constexpr int pairs = (Most + 1) / 2;

  real a[Most * Most];  ///< row-major, n x n; in the end the eigenvalues are on its diagonal
  real v[Most * Most];  ///< column k is the eigenvector of eigenvalue k
  real cosine[pairs], sine[pairs], tangent[pairs];  ///< of the round
  int first[pairs], second[pairs];                  ///< rows of the round's pairs; n: there is none

  FT_HOST_DEVICE real value(int k, int n) const { return a[k * n + k]; }

  /// Diagonalises `a`, n x n, whose both triangles are set. The group has synced. Ends with a sync.
  /// @param n 2 to Most
  template <typename Group>
  FT_HOST_DEVICE void diagonalize(Group g, int n) {
    for (int k = g.rank(); k < n * n; k += g.size()) { v[k] = k % (n + 1) == 0 ? 1.0 : 0.0; }
    int const even = n + n % 2;  // an odd matrix has a row more that is never turned
    bool turned = true;
    FT_NO_UNROLL
    for (int sweep = 0; turned && sweep < sweeps; ++sweep) {
      turned = false;
      FT_NO_UNROLL
      for (int round = 0; round + 1 < even; ++round) { turned = turn(g, n, round) || turned; }
    }
    g.sync();
  }
  /// Number of the smallest eigenvalue, the first of equals.
  FT_HOST_DEVICE int smallest(int n) const {
    int best = 0;
    for (int k = 1; k < n; ++k) {
      if (value(k, n) < value(best, n)) { best = k; }
    }
    return best;
  }

private:
  /// Sets pair k of a round, by the circle method of tournaments: all but the last row move round.
  FT_HOST_DEVICE void set_pair(int n, int round, int k) {
    int const ring = n - 1 + n % 2;
    int const up = round + k;
    int const down = round - k;
    int const i = k == 0 ? ring : (up < ring ? up : up - ring);
    int const j = down < 0 ? down + ring : down;
    first[k] = min_of(i, j);
    second[k] = max_of(i, j);
  }
  /// Turns all pairs of a round so that their entries are 0. Returns whether one was not
  /// negligible.
  template <typename Group>
  FT_HOST_DEVICE bool turn(Group g, int n, int round) {
    int const count = (n + 1) / 2;
    bool turned = false;
    g.sync();
    for (int k = g.rank(); k < count; k += g.size()) {
      set_pair(n, round, k);
      tangent[k] = sine[k] = 0.0;
      cosine[k] = 1.0;
      if (second[k] < n && set_angle(n, k)) { turned = true; }
    }
    if (!g.any(turned)) { return false; }
    g.sync();
    if constexpr (Group::max_threads == 1) {
      for (int j = 0; j < count; ++j) {
        for (int i = 0; i <= j; ++i) { turn_block(n, i, j); }
      }
      for (int k = 0; k < count; ++k) {
        for (int row = 0; row < n; ++row) { turn_vector(n, k, row); }
      }
    } else {
      int const blocks = count * (count + 1) / 2;
      int const items = blocks + n * count;
      small_divider const by_rows(n);
      for (int item = g.rank(); item < items; item += g.size()) {
        if (item < blocks) {
          int j = 0;
          int before = 0;  // blocks of columns before j
          for (; before + j + 1 <= item; ++j) { before += j + 1; }
          turn_block(n, item - before, j);
        } else {
          int const k = by_rows(item - blocks);
          turn_vector(n, k, item - blocks - n * k);
        }
      }
    }
    return true;
  }
  /// Sets the angle that makes the entry of pair k 0. False if the entry is negligible.
  FT_HOST_DEVICE bool set_angle(int n, int k) {
    int const p = first[k];
    int const q = second[k];
    real const pq = a[p * n + q];
    real const pp = a[p * n + p];
    real const qq = a[q * n + q];
    if (nothing_to_turn(pq, pp, qq)) { return false; }
    real const t = tangent_by_root(pq, pp, qq);
    if (!scalar::is_finite(t)) { return false; }
    auto const r = jacobi_rotation::with(t);
    tangent[k] = r.tangent;
    cosine[k] = r.cosine;
    sine[k] = r.sine;
    return true;
  }
  /// The four entries where the rows of one pair and the columns of another one meet, and their
  /// mirror images.
  FT_HOST_DEVICE void turn_block(int n, int i, int j) {
    int const p = first[i];
    int const q = second[i];
    if (i == j) {
      if (tangent[i] != real(0.0)) {
        real const step = tangent[i] * a[p * n + q];
        a[p * n + p] -= step;
        a[q * n + q] += step;
        a[p * n + q] = a[q * n + p] = 0.0;
      }
      return;
    }
    int const r = first[j];
    int const s = second[j];
    real const zero = 0.0;
    // A pair of an odd matrix lacks its second row.
    real const x[4] = {a[p * n + r], s < n ? a[p * n + s] : zero, q < n ? a[q * n + r] : zero,
                       q < n && s < n ? a[q * n + s] : zero};
    real const ci = cosine[i];
    real const si = sine[i];
    real const cj = cosine[j];
    real const sj = sine[j];
    real const y[4] = {ci * x[0] - si * x[2], ci * x[1] - si * x[3], si * x[0] + ci * x[2],
                       si * x[1] + ci * x[3]};
    a[p * n + r] = a[r * n + p] = cj * y[0] - sj * y[1];
    if (s < n) { a[p * n + s] = a[s * n + p] = sj * y[0] + cj * y[1]; }
    if (q < n) { a[q * n + r] = a[r * n + q] = cj * y[2] - sj * y[3]; }
    if (q < n && s < n) { a[q * n + s] = a[s * n + q] = sj * y[2] + cj * y[3]; }
  }
  FT_HOST_DEVICE void turn_vector(int n, int k, int row) {
    if (second[k] >= n) { return; }
    jacobi_rotation const r{tangent[k], cosine[k], sine[k]};
    r.turn(v[row * n + first[k]], v[row * n + second[k]]);
  }
};

/// A symmetric matrix of up to 15 rows, and its eigenvectors, by cyclic Jacobi rotations in a fixed
/// order. Threads share the rows of a rotation; the bits do not depend on their number. Source:
/// Golub and Van Loan, "Matrix computations", section 8.5.
struct symmetric_eigen {
  static constexpr int most = 15;
  static constexpr int sweeps = 24;  ///< at most; eight are usual

  real64 a[most * most];  ///< row-major, n x n; in the end the eigenvalues are on its diagonal
  real64 v[most * most];  ///< column k is the eigenvector of eigenvalue k

  FT_HOST_DEVICE real64 value(int k, int n) const { return a[k * n + k]; }

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
  FT_HOST_DEVICE real64 recomposed(int n, int i, int j, Map const& map) const {
    real64 sum = 0.0;
    for (int k = 0; k < n; ++k) { sum += map(k) * (v[i * n + k] * v[j * n + k]); }
    return sum;
  }

private:
  /// Turns rows and columns p and q so that entry (p, q) is 0. Returns whether it was not
  /// negligible.
  template <typename Group>
  FT_HOST_DEVICE bool rotate(Group g, int n, int p, int q) {
    real64 const pq = a[p * n + q];
    real64 const pp = a[p * n + p];
    real64 const qq = a[q * n + q];
    if (nothing_to_turn(pq, pp, qq)) { return false; }
    auto const r = jacobi_rotation::with(tangent_by_ratio(pq, pp, qq));
    g.sync();
    for (int k = g.rank(); k < n; k += g.size()) {
      r.turn(v[k * n + p], v[k * n + q]);
      if (k == p) {
        a[p * n + p] = pp - r.tangent * pq;
        a[q * n + q] = qq + r.tangent * pq;
        a[p * n + q] = a[q * n + p] = 0.0;
      } else if (k != q) {
        r.turn(a[k * n + p], a[k * n + q]);
        a[p * n + k] = a[k * n + p];
        a[q * n + k] = a[k * n + q];
      }
    }
    g.sync();
    return true;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
