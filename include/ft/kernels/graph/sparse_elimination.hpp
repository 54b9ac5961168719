// SPDX-License-Identifier: Apache-2.0
/// @file Elimination of a pose graph's sparse columns, round by round, and what they leave of the
/// dense part.
///
/// The matrix is factored as L L^T in blocks of 6 x 6. A block of a round takes what all columns of
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
template <typename Group>
struct own_entries {
  static constexpr int count = Group::max_threads == 1 ? 36 : 2;
  real64 of[count];

  FT_HOST_DEVICE static bool any(Group g) { return g.rank() * count < 36; }
  FT_HOST_DEVICE static int entry(Group g, int k) { return g.rank() * count + k; }
};

/// One item: a block of a round, its rows as they are before the division by the diagonal block;
/// or, past these, a column's right-hand side.
struct reduce_blocks {
  struct scratch {
    common_columns common;
    real64 part[30];
  };
  int first;         ///< block
  int blocks;        ///< items that are blocks
  int first_column;  ///< of the others
  double damping;    ///< relative to the diagonal

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, graph_system_view const& A) const {
    if (item < blocks) {
      reduce(g, s.common, first + item, A);
    } else {
      reduce_right(g, s, first_column + item - blocks, A);
    }
  }

private:
  template <typename Group>
  FT_HOST_DEVICE void reduce(Group g, common_columns& common, int b,
                             graph_system_view const& A) const {
    using own = own_entries<Group>;
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
          int const transposed = e % 6 * 6 + e / 6;
          sum.of[k] +=
              code % 4 == between_transposed ? terms[72 + transposed] : terms[36 * (code % 4) + e];
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
        double const* const l = L + own::entry(g, k) / 6 * 6;
        double const* const m = M + own::entry(g, k) % 6 * 6;
        real64 const p = real64(l[0]) * m[0] + real64(l[1]) * m[1];
        real64 const q = real64(l[2]) * m[2] + real64(l[3]) * m[3];
        real64 const r = real64(l[4]) * m[4] + real64(l[5]) * m[5];
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
        *A.dense_at(6 * (i - A.plan.columns) + e / 6, 6 * (j - A.plan.columns) + e % 6) =
            sum.of[k].value;
      }
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void damp(Group g, int i, own_entries<Group>& sum,
                           graph_system_view const& A) const {
    FT_UNROLL
    for (int k = 0; k < own_entries<Group>::count; ++k) {
      int const e = own_entries<Group>::entry(g, k);
      if (e % 7 != 0) { continue; }
      A.diagonal[6 * i + e / 7] = sum.of[k].value;
      // An unknown that no edge tells of stays: its row and column are 0.
      sum.of[k] = sum.of[k] == real64(0.0) ? real64(1.0) : sum.of[k] + sum.of[k] * real64(damping);
    }
  }

  /// Five threads an unknown, each with every fifth column.
  template <typename Group>
  FT_HOST_DEVICE void reduce_right(Group g, scratch& s, int i, graph_system_view const& A) const {
    int const begin = A.plan.row_begin[i];
    int const end = A.plan.row_begin[i + 1];
    for (int k = g.rank(); k < 30; k += g.size()) {
      real64 sum = 0.0;
      for (int at = begin + k / 6; at < end; at += 5) {
        double const* const L = A.block(A.plan.row_block[at]) + k % 6 * 6;
        double const* const y = A.right + 6 * A.plan.row_column[at];
        FT_UNROLL
        for (int m = 0; m < 6; ++m) { sum += real64(L[m]) * y[m]; }
      }
      s.part[k] = sum;
    }
    g.sync();
    int const b = A.plan.diagonal(i);
    for (int k = g.rank(); k < 6; k += g.size()) {
      real64 right = 0.0;
      for (int at = A.plan.term_begin[b]; at < A.plan.term_begin[b + 1]; ++at) {
        int const code = A.plan.term[at];
        right -= A.terms_of(code / 4)[108 + 6 * (code % 4) + k];
      }
      A.gradient[6 * i + k] = right.value;
      FT_UNROLL
      for (int m = 0; m < 5; ++m) { right -= s.part[6 * m + k]; }
      A.right[6 * i + k] = right.value;
    }
  }
};

/// One item: a block of a round, or, past these, a column's right-hand side: the division by the
/// factor of the diagonal block. The item of the diagonal writes that factor.
struct divide_blocks {
  using scratch = no_scratch;
  int first, blocks, first_column;  ///< as in reduce_blocks

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, graph_system_view const& A) const {
    int const b = first + item;
    bool const right = item >= blocks;
    int const j = right ? first_column + item - blocks : A.plan.block_column[b];
    int const diagonal = A.plan.column_begin[j];
    block_factor const factor(A.block(diagonal), 6);
    if (right) {
      if (g.rank() == 0) { factor.divide(A.right + 6 * j); }
    } else if (b == diagonal) {
      if (g.rank() == 0) {
        double* const out = A.pivot + static_cast<std::ptrdiff_t>(j) * 36;
        FT_UNROLL
        for (int r = 0; r < 6; ++r) {
          FT_UNROLL
          for (int c = 0; c < r; ++c) { out[6 * r + c] = factor.c[r][c].value; }
          out[7 * r] = factor.inverse[r].value;
        }
      }
    } else {
      for (int r = g.rank(); r < 6; r += g.size()) { factor.divide(A.block(b) + 6 * r); }
    }
  }
};

/// One item: a column of a round; rounds in descending order. Its part of the solution.
struct substitute_column {
  struct scratch {
    real64 part[30];
  };
  int first;  ///< column

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, graph_system_view const& A) const {
    int const j = first + item;
    int const begin = A.plan.column_begin[j] + 1;
    int const end = A.plan.column_begin[j + 1];
    for (int k = g.rank(); k < 30; k += g.size()) {
      real64 sum = 0.0;
      for (int b = begin + k / 6; b < end; b += 5) {
        double const* const L = A.block(b) + k % 6;
        double const* const x = A.solution + 6 * A.plan.block_row[b];
        FT_UNROLL
        for (int m = 0; m < 6; ++m) { sum += real64(L[6 * m]) * x[m]; }
      }
      s.part[k] = sum;
    }
    g.sync();
    if (g.rank() != 0) { return; }
    double const* const C = A.pivot + static_cast<std::ptrdiff_t>(j) * 36;
    real64 x[6];
    FT_UNROLL
    for (int k = 5; k >= 0; --k) {
      x[k] = A.right[6 * j + k];
      FT_UNROLL
      for (int m = 0; m < 5; ++m) { x[k] -= s.part[6 * m + k]; }
      FT_UNROLL
      for (int m = 5; m > k; --m) { x[k] -= real64(C[6 * m + k]) * x[m]; }
      x[k] *= real64(C[7 * k]);
      A.solution[6 * j + k] = x[k].value;
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
