// SPDX-License-Identifier: Apache-2.0
/// @file Elimination of a pose graph's sparse columns, round by round, and what they leave of the
/// dense part.
///
/// The matrix is factored as L L^T in blocks of N x N. A block of a round takes what all columns of
/// the rounds before have in its row and its column, in ascending order of columns
/// ("left-looking"), so bits do not depend on the number of threads. Source: Davis, "Direct methods
/// for sparse linear systems", 2006, section 4.
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

/// Columns that two rows have in common: pairs of blocks, up to 32 at a time.
struct common_columns {
  int first[32];
  int second[32];
};

/// Calls use(block of row i, block of row j) for each sparse column in both rows, ascending.
template <typename Group, typename Use>
FT_HOST_DEVICE void for_common_columns(Group g, common_columns& found, graph_plan_view const& plan,
                                       int i, int j, Use const& use) {
  int at_i = plan.row_begin[i];
  int const end_i = plan.row_begin[i + 1];
  int at_j = plan.row_begin[j];
  int const end_j = plan.row_begin[j + 1];
  if constexpr (Group::max_threads == 1) {
    static_cast<void>(g);
    static_cast<void>(found);
    while (at_i < end_i && at_j < end_j) {
      int const ci = plan.row_column[at_i];
      int const cj = plan.row_column[at_j];
      if (ci == cj) { use(plan.row_block[at_i], plan.row_block[at_j]); }
      at_i += static_cast<int>(ci <= cj);
      at_j += static_cast<int>(cj <= ci);
    }
  } else {
    // Lanes look columns of row j up in row i.
    for (; at_j < end_j; at_j += g.size()) {
      int const mine = at_j + g.rank();
      int low = at_i;
      bool hit = false;
      if (mine < end_j) {
        int const column = plan.row_column[mine];
        int high = end_i;
        while (low < high) {
          int const middle = (low + high) / 2;
          if (plan.row_column[middle] < column) {
            low = middle + 1;
          } else {
            high = middle;
          }
        }
        hit = low < end_i && plan.row_column[low] == column;
      }
      int count = 0;
      int const before = g.exclusive_count(hit, count);
      if (hit) {
        found.first[before] = plan.row_block[low];
        found.second[before] = plan.row_block[mine];
      }
      g.sync();
      FT_NO_UNROLL
      for (int k = 0; k < count; ++k) { use(found.first[k], found.second[k]); }
      g.sync();
    }
  }
}

/// Entries of a block that a thread of a group has.
template <typename Group, int N>
struct own_entries {
  static constexpr int all = N * N;
  static constexpr int count = Group::max_threads == 1 ? all : 2;
  real64 of[count];

  FT_HOST_DEVICE static bool any(Group g) { return g.rank() * count < all; }
  /// The last thread may have the last entry twice.
  FT_HOST_DEVICE static int entry(Group g, int k) {
    int const e = g.rank() * count + k;
    if constexpr (all % count == 0) {
      return e;
    } else {
      return min_of(e, all - 1);
    }
  }
};
/// Threads that share the sum of an unknown, and numbers that they leave.
template <int N>
inline constexpr int sharers = 32 / N;
inline constexpr int most_parts = 30;

/// One item: a block of a round, its rows as they are before the division by the diagonal block;
/// or, past these, a column's right-hand side.
struct reduce_blocks {
  struct scratch {
    common_columns common;
    real64 part[most_parts];
  };
  int first;         ///< block
  int blocks;        ///< items that are blocks
  int first_column;  ///< of the others
  double damping;    ///< relative to the diagonal

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 graph_system_view<N> const& A) const {
    if (item < blocks) {
      reduce(g, s.common, first + item, A);
    } else {
      reduce_right(g, s, first_column + item - blocks, A);
    }
  }

private:
  template <typename Group, int N>
  FT_HOST_DEVICE void reduce(Group g, common_columns& common, int b,
                             graph_system_view<N> const& A) const {
    using own = own_entries<Group, N>;
    int const i = A.plan.block_row[b];
    int const j = A.plan.block_column[b];
    own sum;
    FT_UNROLL
    for (int k = 0; k < own::count; ++k) { sum.of[k] = 0.0; }
    if (own::any(g)) {
      for (int at = A.plan.term_begin[b]; at < A.plan.term_begin[b + 1]; ++at) {
        int const code = A.plan.term[at];
        double const* const terms = A.terms_of(code / 4);
        FT_UNROLL
        for (int k = 0; k < own::count; ++k) {
          int const e = own::entry(g, k);
          int const transposed = e % N * N + e / N;
          sum.of[k] += code % 4 == between_transposed ? terms[2 * N * N + transposed]
                                                      : terms[N * N * (code % 4) + e];
        }
      }
      if (i == j) { damp(g, i, sum, A); }
    }
    for_common_columns(g, common, A.plan, i, j, [&](int of_i, int of_j) {
      if (!own::any(g)) { return; }
      double const* const L = A.block(of_i);
      double const* const M = A.block(of_j);
      FT_UNROLL
      for (int k = 0; k < own::count; ++k) {
        double const* const l = L + own::entry(g, k) / N * N;
        double const* const m = M + own::entry(g, k) % N * N;
        real64 const p = real64(l[0]) * m[0] + real64(l[1]) * m[1];
        real64 const q = real64(l[2]) * m[2] + real64(l[3]) * m[3];
        real64 r = real64(l[4]) * m[4] + real64(l[5]) * m[5];
        if constexpr (N == 7) { r += real64(l[6]) * m[6]; }
        sum.of[k] -= p + (q + r);
      }
    });
    if (!own::any(g)) { return; }
    FT_UNROLL
    for (int k = 0; k < own::count; ++k) {
      int const e = own::entry(g, k);
      if (j < A.plan.columns) {
        A.block(b)[e] = sum.of[k].value;
      } else {
        *A.dense_at(N * (i - A.plan.columns) + e / N, N * (j - A.plan.columns) + e % N) =
            sum.of[k].value;
      }
    }
  }

  template <typename Group, int N>
  FT_HOST_DEVICE void damp(Group g, int i, own_entries<Group, N>& sum,
                           graph_system_view<N> const& A) const {
    FT_UNROLL
    for (int k = 0; k < own_entries<Group, N>::count; ++k) {
      int const e = own_entries<Group, N>::entry(g, k);
      if (e % (N + 1) != 0) { continue; }
      A.diagonal[N * i + e / (N + 1)] = sum.of[k].value;
      // An unknown that no edge tells of stays: its row and column are 0.
      sum.of[k] = sum.of[k] == real64(0.0) ? real64(1.0) : sum.of[k] + sum.of[k] * real64(damping);
    }
  }

  /// `sharers` threads an unknown, which take turns with the columns.
  template <typename Group, int N>
  FT_HOST_DEVICE void reduce_right(Group g, scratch& s, int i,
                                   graph_system_view<N> const& A) const {
    int const begin = A.plan.row_begin[i];
    int const end = A.plan.row_begin[i + 1];
    for (int k = g.rank(); k < N * sharers<N>; k += g.size()) {
      real64 sum = 0.0;
      for (int at = begin + k / N; at < end; at += sharers<N>) {
        double const* const L = A.block(A.plan.row_block[at]) + k % N * N;
        double const* const y = A.right + N * A.plan.row_column[at];
        FT_UNROLL
        for (int m = 0; m < N; ++m) { sum += real64(L[m]) * y[m]; }
      }
      s.part[k] = sum;
    }
    g.sync();
    int const b = A.plan.diagonal(i);
    for (int k = g.rank(); k < N; k += g.size()) {
      real64 right = 0.0;
      for (int at = A.plan.term_begin[b]; at < A.plan.term_begin[b + 1]; ++at) {
        int const code = A.plan.term[at];
        right -= A.terms_of(code / 4)[3 * N * N + N * (code % 4) + k];
      }
      A.gradient[N * i + k] = right.value;
      FT_UNROLL
      for (int m = 0; m < sharers<N>; ++m) { right -= s.part[N * m + k]; }
      A.right[N * i + k] = right.value;
    }
  }
};

/// One item: a block of a round, or, past these, a column's right-hand side: the division by the
/// factor of the diagonal block. The item of the diagonal writes that factor.
struct divide_blocks {
  using scratch = no_scratch;
  int first, blocks, first_column;  ///< as in reduce_blocks

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, graph_system_view<N> const& A) const {
    int const b = first + item;
    bool const right = item >= blocks;
    int const j = right ? first_column + item - blocks : A.plan.block_column[b];
    int const diagonal = A.plan.column_begin[j];
    block_factor<N> const factor(A.block(diagonal), N);
    if (right) {
      if (g.rank() == 0) { factor.divide(A.right + N * j); }
    } else if (b == diagonal) {
      if (g.rank() == 0) {
        double* const out = A.pivot + static_cast<std::ptrdiff_t>(j) * (N * N);
        FT_UNROLL
        for (int r = 0; r < N; ++r) {
          FT_UNROLL
          for (int c = 0; c < r; ++c) { out[N * r + c] = factor.c[r][c].value; }
          out[(N + 1) * r] = factor.inverse[r].value;
        }
      }
    } else {
      for (int r = g.rank(); r < N; r += g.size()) { factor.divide(A.block(b) + N * r); }
    }
  }
};

/// One item: a column of a round; rounds in descending order. Its part of the solution.
struct substitute_column {
  struct scratch {
    real64 part[most_parts];
  };
  int first;  ///< column

  template <typename Group, int N>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item,
                                 graph_system_view<N> const& A) const {
    int const j = first + item;
    int const begin = A.plan.column_begin[j] + 1;
    int const end = A.plan.column_begin[j + 1];
    for (int k = g.rank(); k < N * sharers<N>; k += g.size()) {
      real64 sum = 0.0;
      for (int b = begin + k / N; b < end; b += sharers<N>) {
        double const* const L = A.block(b) + k % N;
        double const* const x = A.solution + N * A.plan.block_row[b];
        FT_UNROLL
        for (int m = 0; m < N; ++m) { sum += real64(L[N * m]) * x[m]; }
      }
      s.part[k] = sum;
    }
    g.sync();
    if (g.rank() != 0) { return; }
    double const* const C = A.pivot + static_cast<std::ptrdiff_t>(j) * (N * N);
    real64 x[N];
    FT_UNROLL
    for (int k = N - 1; k >= 0; --k) {
      x[k] = A.right[N * j + k];
      FT_UNROLL
      for (int m = 0; m < sharers<N>; ++m) { x[k] -= s.part[N * m + k]; }
      FT_UNROLL
      for (int m = N - 1; m > k; --m) { x[k] -= real64(C[N * m + k]) * x[m]; }
      x[k] *= real64(C[(N + 1) * k]);
      A.solution[N * j + k] = x[k].value;
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
