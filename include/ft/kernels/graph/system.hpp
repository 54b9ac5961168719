// SPDX-License-Identifier: Apache-2.0
/// @file The sparse linear system of a pose graph, in blocks of N x N, on an executor.
/// N is the number of unknowns of a pose: 6, or 7 with a scale.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/small_matrices.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Numbers that an edge adds to the system: blocks of its first pose, of its second one and between
/// them (row: first pose), by rows; then the gradients of both.
template <int N>
inline constexpr int edge_terms = 3 * N* N + 2 * N;
/// Unknowns of a tile of the dense part: whole poses.
inline constexpr int most_tile_side = 48;
template <int N>
inline constexpr int tile_side = most_tile_side / N* N;

/// Where a term of an edge enters a block.
enum term_part : int { first_pose = 0, second_pose = 1, between = 2, between_transposed = 3 };

/// The order of elimination and what it makes of the matrix: arrays in executor memory that one
/// elimination_order has made. Positions number the free poses in order of elimination; the first
/// `columns` of them are sparse columns, the others form a dense matrix.
///
/// Block b is that of row block_row[b] and column block_column[b]. Blocks of a sparse column follow
/// each other, the diagonal first, then rows in ascending order; dense ones come last, by rows of
/// the lower triangle.
struct graph_plan_view {
  int columns = 0;        ///< sparse ones
  int dense = 0;          ///< poses of the dense part
  int sparse_blocks = 0;  ///< blocks before the dense ones
  int blocks = 0;
  int const* column_begin = nullptr;  ///< [columns + 1] block of the diagonal
  int const* block_row = nullptr;     ///< [blocks] position
  int const* block_column = nullptr;  ///< [blocks] position
  int const* row_begin = nullptr;     ///< [positions + 1] into the next two
  int const* row_column = nullptr;    ///< sparse columns of a row left of the diagonal, ascending
  int const* row_block = nullptr;     ///< their blocks
  int const* term_begin = nullptr;    ///< [blocks + 1]
  int const* term = nullptr;          ///< 4 * edge + term_part, by edges
  int const* pose = nullptr;          ///< [positions] pose at a position

  FT_HOST_DEVICE int positions() const { return columns + dense; }
  /// Block of the diagonal at a position.
  FT_HOST_DEVICE int diagonal(int position) const {
    if (position < columns) { return column_begin[position]; }
    int const a = position - columns;
    return sparse_blocks + a * (a + 1) / 2 + a;
  }
};

/// Numbers of the system. Matrices are by rows.
template <int N>
struct graph_system_view {
  graph_plan_view plan;
  double* edge_term = nullptr;  ///< [edges][edge_terms<N>]
  double* value = nullptr;      ///< [sparse blocks][N * N] of the reduced matrix, then its factor
  double* pivot = nullptr;      ///< [columns][N * N] factors of diagonal blocks
  double* dense = nullptr;      ///< square, of whole tiles; only the lower triangle is used
  double* dense_factor = nullptr;  ///< [tiles][tile_side<N>][the same] factors of diagonal tiles
  double* right = nullptr;         ///< right-hand sides: [positions][N], to whole tiles
  double* solution = nullptr;      ///< the same
  double* gradient = nullptr;      ///< the same: right-hand sides before elimination
  double* diagonal = nullptr;      ///< the same: diagonal of the matrix without damping

  FT_HOST_DEVICE int tiles() const { return ceil_div(N * plan.dense, tile_side<N>); }
  FT_HOST_DEVICE std::ptrdiff_t side() const {
    return static_cast<std::ptrdiff_t>(tiles()) * tile_side<N>;
  }
  FT_HOST_DEVICE double* block(int b) const {
    return value + static_cast<std::ptrdiff_t>(b) * (N * N);
  }
  FT_HOST_DEVICE double* dense_at(int row, int column) const {
    return dense + static_cast<std::ptrdiff_t>(row) * side() + column;
  }
  FT_HOST_DEVICE double* dense_right() const { return right + N * plan.columns; }
  FT_HOST_DEVICE double* dense_solution() const { return solution + N * plan.columns; }
  FT_HOST_DEVICE double const* terms_of(int edge) const {
    return edge_term + static_cast<std::ptrdiff_t>(edge) * edge_terms<N>;
  }
};
static_assert(std::is_trivially_copyable<graph_system_view<6>>::value, "passed to kernels");

/// Cholesky factor C of a symmetric positive definite N x N block, of which the lower triangle is
/// read, and the inverse of its diagonal. NaN where it is not positive definite.
template <int N>
struct block_factor {
  real64 c[N][N];
  real64 inverse[N];

  /// @param stride between rows
  template <typename Number>
  FT_HOST_DEVICE block_factor(Number const* a, int stride) {
    FT_UNROLL
    for (int r = 0; r < N; ++r) {
      FT_UNROLL
      for (int k = 0; k <= r; ++k) { c[r][k] = a[r * stride + k]; }
    }
    FT_UNROLL
    for (int k = 0; k < N; ++k) {
      FT_UNROLL
      for (int m = 0; m < k; ++m) { c[k][k] -= c[k][m] * c[k][m]; }
      c[k][k] = scalar::sqrt(c[k][k]);
      inverse[k] = scalar::reciprocal(c[k][k]);
      FT_UNROLL
      for (int r = k + 1; r < N; ++r) {
        FT_UNROLL
        for (int m = 0; m < k; ++m) { c[r][k] -= c[r][m] * c[k][m]; }
        c[r][k] *= inverse[k];
      }
    }
  }
  /// x C^-T in place: a row of the factor below the block, or C^-1 x of a right-hand side.
  template <typename Number>
  FT_HOST_DEVICE void divide(Number* x) const {
    real64 v[N];
    FT_UNROLL
    for (int k = 0; k < N; ++k) {
      v[k] = x[k];
      FT_UNROLL
      for (int m = 0; m < k; ++m) { v[k] -= v[m] * c[k][m]; }
      v[k] *= inverse[k];
    }
    FT_UNROLL
    for (int k = 0; k < N; ++k) { x[k] = static_cast<Number>(v[k]); }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
