// SPDX-License-Identifier: Apache-2.0
/// @file Solution of a window's reduced system, and the step of its views.
#pragma once

#include <cstddef>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/kernels/window/evaluate.hpp"
#include "ft/kernels/window/links.hpp"
#include "ft/kernels/window/residual.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A symmetric positive definite system of 6 x 6 blocks, solved in place as L D L^T, without
/// pivoting. Source: Golub and Van Loan, "Matrix computations", section 4.1.
///
/// `a` has n + 1 rows and columns. At the start its lower triangle holds the matrix in rows 0 to n
/// - 1 and the right-hand side in row n. Let u_ik = l_ik d_k. Below the diagonal a becomes U, above
/// it L^T, and column n D^-1 L^-1 times the right-hand side. Entry (i, j) takes its terms u_ik l_jk
/// in ascending order of k, and those of the back substitution in descending order, so the bits do
/// not depend on the number of threads.
struct block_system {
  using real = window_real;
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

/// T_cw after the view turned by (d[0], d[1], d[2]) and moved by the rest, along the axes of the
/// world.
FT_HOST_DEVICE inline rigid<double> stepped_view(rigid<double> const& T_cw, double const* d) {
  using real = window_real;
  rigid<real> const T = T_cw.cast<real>();
  real const turn[6] = {d[0], d[1], d[2], 0.0, 0.0, 0.0};
  mat3<real> const E = exp_se3(turn).R;
  vec3<real> const moved = E * (T.R.transposed() * T.t) + vec3<real>{d[3], d[4], d[5]};
  return rigid<real>{T.R * E, T.R * moved}.orthonormalized().cast<double>();
}

/// One item: a problem.
struct solve_window {
  using scratch = no_scratch;
  int turn;           ///< of the state
  std::size_t extra;  ///< shared memory of a block, bytes

  std::size_t extra_bytes() const { return extra; }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, window_problem_view const& problem,
                                 window_workspace const& w) const {
    window_state const state = w.state_of(turn, b);
    if (!state.running) { return; }
    int const fixed = problem.fixed_count[b];
    int const moving = problem.view_count[b] - fixed;
    block_system system{w.matrix_of(b), 6 * moving};
    std::size_t const bytes = sizeof(double) * static_cast<std::size_t>(system.side()) *
                              static_cast<std::size_t>(system.side());
    if (g.extra() != nullptr && bytes <= extra) {
      double* const own = reinterpret_cast<double*>(g.extra());
      for (int k = g.rank(); k < system.side() * system.side(); k += g.size()) {
        own[k] = system.a[k];
      }
      system.a = own;
      g.sync();
    }
    add_links(g, problem, b, w.views_of(state.buffer, b), {system.a, system.side(), state.damping});
    double* const d = w.steps_of(b);
    bool const solved = system.factor(g);
    if (g.rank() == 0) { w.solved[b] = solved ? 1 : 0; }
    if (!solved) { return; }
    system.substitute(g, d);
    for (int v = g.rank(); v < moving; v += g.size()) {
      w.views_of(1 - state.buffer, b)[fixed + v] =
          stepped_view(w.views_of(state.buffer, b)[fixed + v], d + 6 * v);
    }
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
