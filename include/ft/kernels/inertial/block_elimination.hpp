// SPDX-License-Identifier: Apache-2.0
/// @file Symmetric positive definite systems of 3 x 3 blocks, solved by a group in shared memory.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/kernels/pose/solve6.hpp"
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

  wide a[most_rows][stride];
  wide inverse[most_rows / 3][6];  ///< of the diagonal blocks, upper triangle by rows
  int positive;                    ///< whether all eliminated blocks were positive definite

  /// Begins a solution. By one thread; then the group syncs.
  FT_HOST_DEVICE void begin() { positive = 1; }

  /// Eliminates the block of rows `first` to first + 2 from rows `from` to `rows` - 1. Ends with a
  /// sync.
  template <typename Group>
  FT_HOST_DEVICE void eliminate(Group g, int first, int from, int rows, int columns) {
    int const parts = min_of(g.parts(), 8);  // each inverts the block for itself
    if (g.part_index() < parts) {
      symmetric_3<wide> const D{a[first][first],         a[first][first + 1],
                                a[first][first + 2],     a[first + 1][first + 1],
                                a[first + 1][first + 2], a[first + 2][first + 2]};
      symmetric_3<wide> inverted{};
      bool const solvable = D.invert(inverted);
      if (g.rank() == 0) { keep(first / 3, inverted, solvable); }
      auto const part = g.part();
      for (int j = first + 3 + part.rank(); j < columns; j += part.size()) {
        wide_vec3 const w = inverted * wide_vec3{a[first][j], a[first + 1][j], a[first + 2][j]};
        int const end = min_of(j + 1, rows);
        for (int i = from + g.part_index(); i < end; i += parts) {
          if (i >= first && i < first + 3) { continue; }
          wide_vec3 const u = i < first ? wide_vec3{a[i][first], a[i][first + 1], a[i][first + 2]}
                                        : wide_vec3{a[first][i], a[first + 1][i], a[first + 2][i]};
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
  FT_HOST_DEVICE wide_vec3 solution(int first, int column) const {
    auto const& c = inverse[first / 3];
    symmetric_3<wide> const inverted{c[0], c[1], c[2], c[3], c[4], c[5]};
    return inverted * wide_vec3{a[first][column], a[first + 1][column], a[first + 2][column]};
  }

private:
  FT_HOST_DEVICE void keep(int block, symmetric_3<wide> const& m, bool solvable) {
    wide const entries[6] = {m.xx, m.xy, m.xz, m.yy, m.yz, m.zz};
    FT_UNROLL
    for (int k = 0; k < 6; ++k) { inverse[block][k] = entries[k]; }
    if (!solvable) { positive = 0; }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
