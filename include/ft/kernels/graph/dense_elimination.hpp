// SPDX-License-Identifier: Apache-2.0
/// @file The dense part of a pose graph's system: a Cholesky factorisation in tiles and
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
inline constexpr int tile_stride = most_tile_side + 1;

/// One item: an unknown past the poses, up to whole tiles: row of an identity. Before each
/// factorisation: one that fails leaves no numbers there.
struct pad_dense {
  using scratch = no_scratch;

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, graph_system_view<N> const& A) const {
    int const row = N * A.plan.dense + item;
    for (int c = g.rank(); c <= row; c += g.size()) { *A.dense_at(row, c) = c == row ? 1.0 : 0.0; }
    if (g.rank() == 0) { A.dense_right()[row] = 0.0; }
  }
};

/// One item: a tile of column `step` at or below the diagonal. All factor the diagonal tile; the
/// first writes that factor and its part of the right-hand side, the others their own tile.
struct factor_tiles {
  struct scratch {
    real64 a[2 * most_tile_side][tile_stride];
  };
  int step;

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 graph_system_view<N> const& A) const {
    constexpr int side = tile_side<N>;
    bool const first = item == 0;
    int const origin = step * side;
    int const rows = side + (first ? 1 : side);
    auto const outside = [&](int r, int c) -> double& {
      int const below = r - side;
      if (below < 0) { return *A.dense_at(origin + r, origin + c); }
      return first ? A.dense_right()[origin + c]
                   : *A.dense_at(origin + item * side + below, origin + c);
    };
    for (int k = g.rank(); k < rows * side; k += g.size()) {
      s.a[k / side][k % side] = outside(k / side, k % side);
    }
    g.sync();
    for (int c = 0; c < side; c += N) { factor_columns<N>(g, s, c, rows); }
    double* const factor = A.dense_factor + static_cast<std::ptrdiff_t>(step) * side * side;
    for (int k = g.rank(); k < rows * side; k += g.size()) {
      real64 const v = s.a[k / side][k % side];
      if (k >= side * side) {
        outside(k / side, k % side) = v.value;
      } else if (first) {
        factor[k] = v.value;
      }
    }
  }

private:
  template <int N, typename Group>
  FT_HOST_DEVICE static void factor_columns(Group g, scratch& s, int c, int rows) {
    block_factor<N> const factor(&s.a[c][c], tile_stride);
    g.sync();
    int const next = c + N;
    if (g.rank() == 0) {
      FT_UNROLL
      for (int r = 0; r < N; ++r) {
        FT_UNROLL
        for (int k = 0; k <= r; ++k) { s.a[c + r][c + k] = factor.c[r][k]; }
      }
    }
    for (int r = next + g.rank(); r < rows; r += g.size()) { factor.divide(&s.a[r][c]); }
    g.sync();
    int const columns = tile_side<N> - next;
    for (int k = g.rank(); k < (rows - next) * columns; k += g.size()) {
      int const r = next + k / columns;
      int const m = next + k % columns;
      if (m > r) { continue; }
      real64 sum = s.a[r][m];
      FT_UNROLL
      for (int q = c; q < c + N; ++q) { sum -= s.a[r][q] * s.a[m][q]; }
      s.a[r][m] = sum;
    }
    g.sync();
  }
};

/// One item: a tile of the lower triangle right of column `step`, which is taken out of it; those
/// of the diagonal take it out of the right-hand side, too.
struct update_tiles {
  struct scratch {
    real64 row[most_tile_side][tile_stride];
    real64 column[most_tile_side][tile_stride];  ///< transposed
  };
  static constexpr bool wide_on_host = true;
  static constexpr int each = 3;  ///< rows and columns of a thread
  int step;

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 graph_system_view<N> const& A) const {
    constexpr int side = tile_side<N>;
    constexpr int apart = side / each;
    int i = 0;
    while ((i + 1) * (i + 2) / 2 <= item) { ++i; }
    int const j = item - i * (i + 1) / 2;
    int const origin = step * side;
    int const row = origin + (i + 1) * side;
    int const column = origin + (j + 1) * side;
    for (int k = g.rank(); k < side * side; k += g.size()) {
      int const r = k / side;
      int const c = k % side;
      s.row[r][c] = *A.dense_at(row + r, origin + c);
      s.column[c][r] = *A.dense_at(column + r, origin + c);
    }
    g.sync();
    if constexpr (Group::max_threads == 1) {
      for (int r = 0; r < side; ++r) { subtract_row<N>(s, r, A.dense_at(row + r, column)); }
    } else {
      for (int k = g.rank(); k < apart * apart; k += g.size()) {
        subtract(s, k / apart, k % apart, A, row, column);
      }
    }
    if (i != j) { return; }
    double* const right = A.dense_right();
    for (int c = g.rank(); c < side; c += g.size()) {
      real64 sum = right[column + c];
      for (int m = 0; m < side; ++m) { sum -= real64(right[origin + m]) * s.column[m][c]; }
      right[column + c] = sum.value;
    }
  }

private:
  /// By one thread, so that the host's compiler sees vectors. The order of terms is the same.
  template <int N>
  FT_HOST_DEVICE FT_INLINE static void subtract_row(scratch const& s, int r, double* of_row) {
    constexpr int side = tile_side<N>;
    real64 sum[side];
    for (int c = 0; c < side; ++c) { sum[c] = of_row[c]; }
    for (int m = 0; m < side; ++m) {
      real64 const x = s.row[r][m];
      for (int c = 0; c < side; ++c) { sum[c] -= x * s.column[m][c]; }
    }
    for (int c = 0; c < side; ++c) { of_row[c] = sum[c].value; }
  }
  template <int N>
  FT_HOST_DEVICE static void subtract(scratch const& s, int r, int c, graph_system_view<N> const& A,
                                      int row, int column) {
    constexpr int side = tile_side<N>;
    constexpr int apart = side / each;
    real64 sum[each][each];
    FT_UNROLL
    for (int u = 0; u < each; ++u) {
      FT_UNROLL
      for (int v = 0; v < each; ++v) {
        sum[u][v] = *A.dense_at(row + r + u * apart, column + c + v * apart);
      }
    }
    for (int m = 0; m < side; ++m) {
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
    real64 x[most_tile_side];
  };

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, graph_system_view<N> const& A) const {
    constexpr int side = tile_side<N>;
    double* const right = A.dense_right();
    for (int step = A.tiles() - 1; step >= 0; --step) {
      int const origin = step * side;
      for (int k = g.rank(); k < side; k += g.size()) { s.x[k] = right[origin + k]; }
      g.sync();
      double const* const L = A.dense_factor + static_cast<std::ptrdiff_t>(step) * side * side;
      for (int c = side - N; c >= 0; c -= N) { solve_block<N>(g, s, L, c); }
      for (int k = g.rank(); k < side; k += g.size()) {
        A.dense_solution()[origin + k] = s.x[k].value;
      }
      for (int c = g.rank(); c < origin; c += g.size()) {
        real64 sum = right[c];
        for (int m = 0; m < side; ++m) { sum -= real64(*A.dense_at(origin + m, c)) * s.x[m]; }
        right[c] = sum.value;
      }
      g.sync();
    }
  }

private:
  template <int N, typename Group>
  FT_HOST_DEVICE static void solve_block(Group g, scratch& s, double const* L, int c) {
    constexpr int side = tile_side<N>;
    real64 x[N];
    FT_UNROLL
    for (int k = N - 1; k >= 0; --k) {
      x[k] = s.x[c + k];
      FT_UNROLL
      for (int m = N - 1; m > k; --m) { x[k] -= real64(L[(c + m) * side + c + k]) * x[m]; }
      x[k] = x[k] / real64(L[(c + k) * side + c + k]);
    }
    g.sync();
    if (g.rank() == 0) {
      FT_UNROLL
      for (int k = 0; k < N; ++k) { s.x[c + k] = x[k]; }
    }
    for (int r = g.rank(); r < c; r += g.size()) {
      real64 sum = s.x[r];
      FT_UNROLL
      for (int m = N - 1; m >= 0; --m) { sum -= real64(L[(c + m) * side + r]) * x[m]; }
      s.x[r] = sum;
    }
    g.sync();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
