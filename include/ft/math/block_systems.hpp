// SPDX-License-Identifier: Apache-2.0
/// @file Symmetric positive definite systems of blocks, solved by a group in shared memory.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric system and its right-hand sides, the columns after the matrix. Only the upper
/// triangle of the matrix is read and written.
///
/// Blocks are eliminated one after the other, from the rows above as well (Gauss-Jordan), so that
/// no back substitution follows: entry (i, j) takes its terms in ascending order of the blocks, and
/// the bits do not depend on the number of threads. Inverses of diagonal blocks are by cofactors,
/// with one division for three unknowns. Source: Golub and Van Loan, "Matrix computations", 4.2.
struct block_elimination {
  static constexpr int stride = 32;  ///< of a row; at most so many columns
  static constexpr int most_rows = 30;

  real64 a[most_rows][stride];
  real64 inverse[most_rows / 3][6];  ///< of the diagonal blocks, upper triangle by rows
  int positive;                      ///< whether all eliminated blocks were positive definite

  /// Begins a solution. By one thread; then the group syncs.
  FT_HOST_DEVICE void begin() { positive = 1; }

  /// Eliminates the block of rows `first` to first + 2 from rows `from` to `rows` - 1. Ends with a
  /// sync.
  template <typename Group>
  FT_HOST_DEVICE void eliminate(Group g, int first, int from, int rows, int columns) {
    int const parts = min_of(g.parts(), 8);  // each inverts the block for itself
    if (g.part_index() < parts) {
      symmetric_3<real64> const D{a[first][first],         a[first][first + 1],
                                  a[first][first + 2],     a[first + 1][first + 1],
                                  a[first + 1][first + 2], a[first + 2][first + 2]};
      symmetric_3<real64> inverted{};
      bool const solvable = D.invert(inverted);
      if (g.rank() == 0) { keep(first / 3, inverted, solvable); }
      auto const part = g.part();
      for (int j = first + 3 + part.rank(); j < columns; j += part.size()) {
        strict_vec3d const w =
            inverted * strict_vec3d{a[first][j], a[first + 1][j], a[first + 2][j]};
        int const end = min_of(j + 1, rows);
        for (int i = from + g.part_index(); i < end; i += parts) {
          if (i >= first && i < first + 3) { continue; }
          strict_vec3d const u = i < first
                                     ? strict_vec3d{a[i][first], a[i][first + 1], a[i][first + 2]}
                                     : strict_vec3d{a[first][i], a[first + 1][i], a[first + 2][i]};
          a[i][j] -= dot(u, w);
        }
      }
    }
    g.sync();
  }

  /// Eliminates all blocks of rows `from` to `rows` - 1.
  template <typename Group>
  FT_HOST_DEVICE void eliminate_all(Group g, int from, int rows, int columns) {
    FT_NO_UNROLL
    for (int first = from; first < rows; first += 3) { eliminate(g, first, from, rows, columns); }
  }

  /// Rows `first` to first + 2 of the solution for the right-hand side in a column, after
  /// eliminate_all().
  FT_HOST_DEVICE strict_vec3d solution(int first, int column) const {
    auto const& c = inverse[first / 3];
    symmetric_3<real64> const inverted{c[0], c[1], c[2], c[3], c[4], c[5]};
    return inverted * strict_vec3d{a[first][column], a[first + 1][column], a[first + 2][column]};
  }

private:
  FT_HOST_DEVICE void keep(int block, symmetric_3<real64> const& m, bool solvable) {
    real64 const entries[6] = {m.xx, m.xy, m.xz, m.yy, m.yz, m.zz};
    FT_UNROLL
    for (int k = 0; k < 6; ++k) { inverse[block][k] = entries[k]; }
    if (!solvable) { positive = 0; }
  }
};

/// A symmetric positive definite system of 6 x 6 blocks, solved in place as L D L^T, without
/// pivoting. Source: Golub and Van Loan, "Matrix computations", section 4.1.
///
/// `a` has n + 1 rows and columns. At the start its lower triangle holds the matrix in rows 0 to n
/// - 1 and the right-hand side in row n. Let u_ik = l_ik d_k. Below the diagonal a becomes U, above
/// it L^T, and column n D^-1 L^-1 times the right-hand side. Entry (i, j) takes its terms u_ik l_jk
/// in ascending order of k, and those of the back substitution in descending order, so the bits do
/// not depend on the number of threads.
struct block_system {
  using real = strict_double;
  static constexpr int block = 6;
  double* a;
  int n;

  FT_HOST_DEVICE int side() const { return n + 1; }
  FT_HOST_DEVICE double& at(int i, int j) const { return a[i * side() + j]; }

  /// @return false, for all threads, if a pivot is not positive
  template <typename Group>
  FT_HOST_DEVICE bool factor(Group g) const {
    for (int k = 0; k < n; k += block) {
      if (!factor_panel(g, k)) { return false; }
      g.sync();
      subtract_panel(g, k);
      g.sync();
    }
    return true;
  }

  /// @param x result, n numbers
  template <typename Group>
  FT_HOST_DEVICE void substitute(Group g, double* x) const {
    for (int k = n - block; k >= 0; k -= block) {
      real own[block];
      FT_UNROLL
      for (int r = block - 1; r >= 0; --r) {
        own[r] = at(k + r, n);
        FT_UNROLL
        for (int c = block - 1; c > r; --c) { own[r] -= real(at(k + r, k + c)) * own[c]; }
        if (g.rank() == 0) { x[k + r] = own[r].value; }
      }
      for (int i = g.rank(); i < k; i += g.size()) {
        real sum = at(i, n);
        FT_UNROLL
        for (int c = block - 1; c >= 0; --c) { sum -= real(at(i, k + c)) * own[c]; }
        at(i, n) = sum.value;
      }
      g.sync();
    }
  }

private:
  /// Columns k to k + 5. Every thread computes the factors of the diagonal block.
  template <typename Group>
  FT_HOST_DEVICE bool factor_panel(Group g, int k) const {
    real u[block][block];
    real l[block][block];  // l[r][c] of c > r: L^T
    real inverse[block];
    bool positive = true;
    FT_UNROLL
    for (int r = 0; r < block; ++r) {
      FT_UNROLL
      for (int c = 0; c <= r; ++c) { u[r][c] = at(k + r, k + c); }
    }
    FT_UNROLL
    for (int c = 0; c < block; ++c) {
      positive = positive && u[c][c] > real(0.0) && scalar::is_finite(u[c][c]);
      inverse[c] = scalar::reciprocal(u[c][c]);
      FT_UNROLL
      for (int r = c + 1; r < block; ++r) { l[c][r] = u[r][c] * inverse[c]; }
      FT_UNROLL
      for (int r = c + 1; r < block; ++r) {
        FT_UNROLL
        for (int m = c + 1; m <= r; ++m) { u[r][m] -= u[r][c] * l[c][m]; }
      }
    }
    if (!positive) { return false; }
    if (g.rank() == 0) {
      FT_UNROLL
      for (int c = 0; c < block; ++c) {
        FT_UNROLL
        for (int r = c + 1; r < block; ++r) { at(k + c, k + r) = l[c][r].value; }
      }
    }
    for (int i = k + block + g.rank(); i <= n; i += g.size()) {
      real row[block];
      FT_UNROLL
      for (int c = 0; c < block; ++c) { row[c] = at(i, k + c); }
      FT_UNROLL
      for (int c = 0; c < block; ++c) {
        FT_UNROLL
        for (int m = c + 1; m < block; ++m) { row[m] -= row[c] * l[c][m]; }
      }
      FT_UNROLL
      for (int c = 0; c < block; ++c) {
        at(i, k + c) = row[c].value;
        at(k + c, i) = (row[c] * inverse[c]).value;
      }
    }
    return true;
  }

  /// Takes columns k to k + 5 out of the rest of the matrix.
  template <typename Group>
  FT_HOST_DEVICE void subtract_panel(Group g, int k) const {
    int const begin = k + block;
    int const lanes = g.part().size();
    for (int i = begin + g.part_index(); i <= n; i += g.parts()) {
      real row[block];
      FT_UNROLL
      for (int c = 0; c < block; ++c) { row[c] = at(i, k + c); }
      for (int j = begin + g.part().rank(); j <= i && j < n; j += lanes) {
        real sum = at(i, j);
        FT_UNROLL
        for (int c = 0; c < block; ++c) { sum -= row[c] * real(at(k + c, j)); }
        at(i, j) = sum.value;
      }
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
