// SPDX-License-Identifier: Apache-2.0
/// @file The dense part of a pose graph's system: a Cholesky factorisation in tiles of 48 x 48 and
/// the solution. Every entry takes its terms in a fixed order.
#pragma once

#include <cstddef>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/math/small_matrices.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Threads of a block that factors or updates a tile.
inline constexpr int tile_threads = 256;
/// Rows of tiles in shared memory have an odd length, so that columns lie in different banks.
inline constexpr int tile_stride = tile_side + 1;

/// One item: an unknown past the poses, up to whole tiles: row of an identity. Before each
/// factorisation: one that fails leaves no numbers there.
struct pad_dense {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, graph_system_view const& A) const {
    int const row = 6 * A.plan.dense + item;
    for (int c = g.rank(); c <= row; c += g.size()) { *A.dense_at(row, c) = c == row ? 1.0 : 0.0; }
    if (g.rank() == 0) { A.dense_right()[row] = 0.0; }
  }
};

/// One item: a tile of column `step` at or below the diagonal. All factor the diagonal tile; the
/// first writes that factor and its part of the right-hand side, the others their own tile.
struct factor_tiles {
  struct scratch {
    real64 a[2 * tile_side][tile_stride];
  };
  int step;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, graph_system_view const& A) const {
    bool const first = item == 0;
    int const origin = step * tile_side;
    int const rows = tile_side + (first ? 1 : tile_side);
    auto const outside = [&](int r, int c) -> double& {
      int const below = r - tile_side;
      if (below < 0) { return *A.dense_at(origin + r, origin + c); }
      return first ? A.dense_right()[origin + c]
                   : *A.dense_at(origin + item * tile_side + below, origin + c);
    };
    for (int k = g.rank(); k < rows * tile_side; k += g.size()) {
      s.a[k / tile_side][k % tile_side] = outside(k / tile_side, k % tile_side);
    }
    g.sync();
    for (int c = 0; c < tile_side; c += 6) { factor_columns(g, s, c, rows); }
    double* const factor =
        A.dense_factor + static_cast<std::ptrdiff_t>(step) * tile_side * tile_side;
    for (int k = g.rank(); k < rows * tile_side; k += g.size()) {
      real64 const v = s.a[k / tile_side][k % tile_side];
      if (k >= tile_side * tile_side) {
        outside(k / tile_side, k % tile_side) = v.value;
      } else if (first) {
        factor[k] = v.value;
      }
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void factor_columns(Group g, scratch& s, int c, int rows) {
    block_factor const factor(&s.a[c][c], tile_stride);
    g.sync();
    int const next = c + 6;
    if (g.rank() == 0) {
      FT_UNROLL
      for (int r = 0; r < 6; ++r) {
        FT_UNROLL
        for (int k = 0; k <= r; ++k) { s.a[c + r][c + k] = factor.c[r][k]; }
      }
    }
    for (int r = next + g.rank(); r < rows; r += g.size()) { factor.divide(&s.a[r][c]); }
    g.sync();
    int const columns = tile_side - next;
    for (int k = g.rank(); k < (rows - next) * columns; k += g.size()) {
      int const r = next + k / columns;
      int const m = next + k % columns;
      if (m > r) { continue; }
      real64 sum = s.a[r][m];
      FT_UNROLL
      for (int q = c; q < c + 6; ++q) { sum -= s.a[r][q] * s.a[m][q]; }
      s.a[r][m] = sum;
    }
    g.sync();
  }
};

/// One item: a tile of the lower triangle right of column `step`, which is taken out of it; those
/// of the diagonal take it out of the right-hand side, too.
struct update_tiles {
  struct scratch {
    real64 row[tile_side][tile_stride];
    real64 column[tile_side][tile_stride];  ///< transposed
  };
  static constexpr bool wide_on_host = true;
  static constexpr int each = 3;  ///< rows and columns of a thread
  static constexpr int apart = tile_side / each;
  int step;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, graph_system_view const& A) const {
    int i = 0;
    while ((i + 1) * (i + 2) / 2 <= item) { ++i; }
    int const j = item - i * (i + 1) / 2;
    int const origin = step * tile_side;
    int const row = origin + (i + 1) * tile_side;
    int const column = origin + (j + 1) * tile_side;
    for (int k = g.rank(); k < tile_side * tile_side; k += g.size()) {
      int const r = k / tile_side;
      int const c = k % tile_side;
      s.row[r][c] = *A.dense_at(row + r, origin + c);
      s.column[c][r] = *A.dense_at(column + r, origin + c);
    }
    g.sync();
    if constexpr (Group::max_threads == 1) {
      for (int r = 0; r < tile_side; ++r) { subtract_row(s, r, A.dense_at(row + r, column)); }
    } else {
      for (int k = g.rank(); k < apart * apart; k += g.size()) {
        subtract(s, k / apart, k % apart, A, row, column);
      }
    }
    if (i != j) { return; }
    double* const right = A.dense_right();
    for (int c = g.rank(); c < tile_side; c += g.size()) {
      real64 sum = right[column + c];
      for (int m = 0; m < tile_side; ++m) { sum -= real64(right[origin + m]) * s.column[m][c]; }
      right[column + c] = sum.value;
    }
  }

private:
  /// By one thread, so that the host's compiler sees vectors. The order of terms is the same.
  FT_HOST_DEVICE FT_INLINE static void subtract_row(scratch const& s, int r, double* of_row) {
    real64 sum[tile_side];
    for (int c = 0; c < tile_side; ++c) { sum[c] = of_row[c]; }
    for (int m = 0; m < tile_side; ++m) {
      real64 const x = s.row[r][m];
      for (int c = 0; c < tile_side; ++c) { sum[c] -= x * s.column[m][c]; }
    }
    for (int c = 0; c < tile_side; ++c) { of_row[c] = sum[c].value; }
  }
  FT_HOST_DEVICE static void subtract(scratch const& s, int r, int c, graph_system_view const& A,
                                      int row, int column) {
    real64 sum[each][each];
    FT_UNROLL
    for (int u = 0; u < each; ++u) {
      FT_UNROLL
      for (int v = 0; v < each; ++v) {
        sum[u][v] = *A.dense_at(row + r + u * apart, column + c + v * apart);
      }
    }
    for (int m = 0; m < tile_side; ++m) {
      real64 x[each];
      real64 y[each];
      FT_UNROLL
      for (int u = 0; u < each; ++u) {
        x[u] = s.row[r + u * apart][m];
        y[u] = s.column[m][c + u * apart];
      }
      FT_UNROLL
      for (int u = 0; u < each; ++u) {
        FT_UNROLL
        for (int v = 0; v < each; ++v) { sum[u][v] -= x[u] * y[v]; }
      }
    }
    FT_UNROLL
    for (int u = 0; u < each; ++u) {
      FT_UNROLL
      for (int v = 0; v < each; ++v) {
        *A.dense_at(row + r + u * apart, column + c + v * apart) = sum[u][v].value;
      }
    }
  }
};

/// One item, the whole dense part: back substitution, from the last tile.
struct substitute_dense {
  struct scratch {
    real64 x[tile_side];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, graph_system_view const& A) const {
    double* const right = A.dense_right();
    for (int step = A.plan.tiles() - 1; step >= 0; --step) {
      int const origin = step * tile_side;
      for (int k = g.rank(); k < tile_side; k += g.size()) { s.x[k] = right[origin + k]; }
      g.sync();
      double const* const L =
          A.dense_factor + static_cast<std::ptrdiff_t>(step) * tile_side * tile_side;
      for (int c = tile_side - 6; c >= 0; c -= 6) { solve_six(g, s, L, c); }
      for (int k = g.rank(); k < tile_side; k += g.size()) {
        A.dense_solution()[origin + k] = s.x[k].value;
      }
      for (int c = g.rank(); c < origin; c += g.size()) {
        real64 sum = right[c];
        for (int m = 0; m < tile_side; ++m) { sum -= real64(*A.dense_at(origin + m, c)) * s.x[m]; }
        right[c] = sum.value;
      }
      g.sync();
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE static void solve_six(Group g, scratch& s, double const* L, int c) {
    real64 x[6];
    FT_UNROLL
    for (int k = 5; k >= 0; --k) {
      x[k] = s.x[c + k];
      FT_UNROLL
      for (int m = 5; m > k; --m) { x[k] -= real64(L[(c + m) * tile_side + c + k]) * x[m]; }
      x[k] = x[k] / real64(L[(c + k) * tile_side + c + k]);
    }
    g.sync();
    if (g.rank() == 0) {
      FT_UNROLL
      for (int k = 0; k < 6; ++k) { s.x[c + k] = x[k]; }
    }
    for (int r = g.rank(); r < c; r += g.size()) {
      real64 sum = s.x[r];
      FT_UNROLL
      for (int m = 5; m >= 0; --m) { sum -= real64(L[(c + m) * tile_side + r]) * x[m]; }
      s.x[r] = sum;
    }
    g.sync();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
