// SPDX-License-Identifier: Apache-2.0
/// @file Stage: bundle adjustment of small windows of views and points.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/window/detail/centre_cost.hpp"
#include "ft/kernels/window/detail/evaluate.hpp"
#include "ft/kernels/window/detail/residual.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/math/block_systems.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// The reduced system of a window: the normal equations of its views, points eliminated.
//
// For a view let d be the vector from its centre to a point, A and f the point's curvature and
// gradient in the view, all along the axes of the world, and G = (-[d]x, I) the motion of the
// point seen from the view. With H the sum of A over views, damped, and b the negative sum of f,
// blocks of views i and j are
//
//     S_ij = [i = j] sum G^T A G - sum G_i^T A_i H^-1 A_j G_j,   r_i = -sum G_i^T (f_i + A_i H^-1
//     b)
//
// over the points that they see. Source: Triggs and others, "Bundle adjustment - a modern
// synthesis", 1999.

namespace detail {

/// Sums of three rows of a block: 3 x 6 of S, then 3 of the undamped diagonal and 3 of the
/// right-hand side.
inline constexpr int reduced_terms = 24;

/// Three rows of S_ij, those of rotation or of translation, as a sum over points.
struct reduced_rows {
  using real = window_real;
  double const* first;   ///< terms of view i
  double const* second;  ///< terms of view j
  double const* point;   ///< terms of the points
  vec3<double> const* position;
  std::ptrdiff_t step;   ///< between the terms of a point
  vec3<real> centre[2];  ///< of the views
  real damping;
  bool diagonal;  ///< i = j
  bool rotation;  ///< the rows of rotation

  FT_HOST_DEVICE void add(int p, sum_terms<reduced_terms, double>& acc) const {
    symmetric_3<real> inverse;
    symmetric_3<real> const H = load_curvature(point + p, step);
    bool const moves = damped_inverse(H, damping, inverse);
    symmetric_3<real> const A = load_curvature(first + p, step);
    vec3<real> const X = to_real(position[p]);
    vec3<real> const d = X - centre[0];
    vec3<real> M[3] = {{A.xx, A.xy, A.xz}, {A.xy, A.yy, A.yz}, {A.xz, A.yz, A.zz}};
    if (!moves) { inverse = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0}; }
    if (diagonal) {
      add_right(p, A, d, inverse, acc);
      for (auto& row : M) { row = row - A * (inverse * row); }
    } else {
      symmetric_3<real> const B = load_curvature(second + p, step);
      for (auto& row : M) { row = -(B * (inverse * row)); }
    }
    vec3<real> const e = X - centre[1];
    vec3<real> const D[3] = {cross(e, M[0]), cross(e, M[1]), cross(e, M[2])};
    add_rows(d, D, acc, 0);
    add_rows(d, M, acc, 3);
  }

private:
  FT_HOST_DEVICE static void add_to(double& sum, real v) { sum += v.value; }
  /// Columns from, from + 1, from + 2 of the rows.
  FT_HOST_DEVICE void add_rows(vec3<real> d, vec3<real> const (&m)[3],
                               sum_terms<reduced_terms, double>& acc, int from) const {
    auto const add = [&](int row, vec3<real> v) {
      add_to(acc.of[6 * row + from], v.x);
      add_to(acc.of[6 * row + from + 1], v.y);
      add_to(acc.of[6 * row + from + 2], v.z);
    };
    if (!rotation) {
      for (int k = 0; k < 3; ++k) { add(k, m[k]); }
      return;
    }
    add(0, scaled(m[2], d.y) - scaled(m[1], d.z));
    add(1, scaled(m[0], d.z) - scaled(m[2], d.x));
    add(2, scaled(m[1], d.x) - scaled(m[0], d.y));
  }
  FT_HOST_DEVICE void add_right(int p, symmetric_3<real> const& A, vec3<real> d,
                                symmetric_3<real> const& inverse,
                                sum_terms<reduced_terms, double>& acc) const {
    vec3<real> const b = -load_gradient(point + p, step);
    vec3<real> const q = load_gradient(first + p, step) + A * (inverse * b);
    vec3<real> const right = rotation ? cross(d, q) : q;
    vec3<real> diagonal_of_H{A.xx, A.yy, A.zz};
    if (rotation) {
      diagonal_of_H = {turned(A.yy, A.zz, A.yz, d.z, d.y), turned(A.zz, A.xx, A.xz, d.x, d.z),
                       turned(A.xx, A.yy, A.xy, d.y, d.x)};
    }
    add_to(acc.of[18], diagonal_of_H.x);
    add_to(acc.of[19], diagonal_of_H.y);
    add_to(acc.of[20], diagonal_of_H.z);
    add_to(acc.of[21], -right.x);
    add_to(acc.of[22], -right.y);
    add_to(acc.of[23], -right.z);
  }
  /// (-u, v) times ((a, c), (c, b)) times its transpose.
  FT_HOST_DEVICE static real turned(real a, real b, real c, real u, real v) {
    return a * (u * u) + b * (v * v) - real(2.0) * (c * (u * v));
  }
};

/// One item: three rows of a block of the lower triangle of a problem's reduced system. Judges the
/// trial of the preceding turn first; every item comes to the same result.
struct reduce_window {
  struct scratch {
    ordered_sum_scratch<2, double> judge;
    ordered_sum_scratch<reduced_terms, double> sums;
  };
  window_params params;
  int turn;  ///< of the state before; 0 = nothing was tried yet

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, window_problem_view const& problem,
                                 window_workspace const& w) const {
    int const of_problem = 2 * w.pairs();
    int const b = item / of_problem;
    int const rows = item % of_problem;
    window_state const before = w.state_of(turn, b);
    if (!before.running) {
      if (rows == 0 && g.rank() == 0) { w.state_of(turn + 1, b) = before; }
      return;
    }
    window_points const in(problem, w, b * w.groups());
    window_state const state = judged(g, s.judge, before, in, turn == 0, params);
    if (rows == 0 && g.rank() == 0) { w.state_of(turn + 1, b) = state; }
    if (!state.running) { return; }
    int i = 0;
    while ((i + 1) * (i + 2) / 2 <= rows / 2) { ++i; }
    int const j = rows / 2 - i * (i + 1) / 2;
    int const moving = in.views - in.fixed;
    if (i >= moving) { return; }
    reduced_rows const terms = rows_of(in, state, i, j, rows % 2 == 0);
    std::uint64_t const* const mask = w.masks_of(state.buffer, b);
    std::uint64_t const both = std::uint64_t{1} << i | std::uint64_t{1} << j;
    ordered_sum(g, s.sums, in.count, [&](int p, sum_terms<reduced_terms, double>& acc) {
      if ((mask[p] & both) == both) { terms.add(p, acc); }
    });
    int const side = 6 * moving + 1;
    int const row = 6 * i + (terms.rotation ? 0 : 3);
    double* const S = w.matrix_of(b);
    for (int k = g.rank(); k < reduced_terms; k += g.size()) {
      double const sum = s.sums.total.of[k];
      if (k < 18) {
        int const r = k / 6;
        int const c = k % 6;
        bool const damped = i == j && c == r + (terms.rotation ? 0 : 3);
        S[(row + r) * side + 6 * j + c] = damped ? damp(sum, s.sums.total.of[18 + r], state) : sum;
      } else if (i == j && k >= 21) {
        S[(side - 1) * side + row + k - 21] = sum;
      }
    }
  }

private:
  FT_HOST_DEVICE static reduced_rows rows_of(window_points const& in, window_state const& state,
                                             int i, int j, bool rotation) {
    window_workspace const& w = in.work;
    rigid<double> const* const T_cw = w.views_of(state.buffer, in.b) + in.fixed;
    return {w.terms_of_view(state.buffer, in.b, i),
            w.terms_of_view(state.buffer, in.b, j),
            w.terms_of_points(state.buffer, in.b),
            w.points_of(state.buffer, in.b),
            w.points,
            {T_cw[i].cast<window_real>().centre(), T_cw[j].cast<window_real>().centre()},
            state.damping,
            i == j,
            rotation};
  }
  FT_HOST_DEVICE static double damp(double sum, double H, window_state const& state) {
    return (window_real(sum) + (window_real(H) * window_real(state.damping) + window_real(1e-9)))
        .value;
  }
};

// Solution of a window's reduced system, and the step of its views.

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
    link_terms const by_views{system.a, system.side(), state.damping};
    add_links(g, problem, b, w.views_of(state.buffer, b), by_views);
    add_centres(g, problem, b, w.views_of(state.buffer, b), by_views);
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

/// Views and points with the smallest robust reprojection error: Levenberg-Marquardt with the
/// points eliminated.
///
/// An observation costs its squared weighted error, from `huber2` on Huber's function of it, and
/// `no_image` where the point has no image. A disparity of a rectified pair is an observation of
/// its own. A link costs its squared weighted errors; see detail/residual.hpp. Centres cost what
/// window_problem_view says. A step that does not
/// lower the cost is refused, and the next one has ten times the damping. The descent ends after
/// `steps` tried ones, or with one that lowers the cost by a share below `enough`. Problems that
/// have ended skip the remaining launches.
///
/// A problem that is not valid is left as it is: with counts out of range, no view that moves, no
/// point that such a view sees, a view, a link of one that moves, or a point that is not finite, or
/// a first system that cannot be solved. Fixed views give the scale and the frame; without any,
/// damping keeps both near the start.
///
/// Asynchronous on `exec`; allocates nothing; 2 + 3 steps launches for all problems. Results have
/// the same bits on every executor and in every batch. Sources: Triggs and others, "Bundle
/// adjustment - a modern synthesis", 1999; Huber, "Robust estimation of a location parameter",
/// 1964.
/// @param rig rectified_rig, for one camera a view, stereo_rig, for two, or multi_rig
/// @param problems start and result
/// @param selected [batch] in executor memory: problems that are 0 are not touched. Null: all
/// @throws bad_argument for shapes that do not fit together
template <typename Exec, typename Rig>
void adjust_window(Exec const& exec, Rig const& rig, window_problem_view const& problems,
                   int const* selected, window_params const& params, window_workspace const& work) {
  detail::require(problems.cameras <= Rig::cameras,
                  "a window has more cameras a view than its rig");
  detail::require(problems.views == work.views && problems.points == work.points &&
                      problems.batch == work.batch,
                  "a window's workspace has the shape of its problems");
  check(params);
  using block = per_block<sum_lanes>;
  int const groups = problems.batch * work.groups();
  std::size_t const matrix = sizeof(double) * static_cast<std::size_t>(work.side()) *
                             static_cast<std::size_t>(work.side());
  std::size_t const extra =
      min_of(matrix, extra_scratch<sum_lanes, detail::solve_window>(exec, problems.batch));
  for_each_item<block>(exec, groups, detail::start_window<Rig>{rig, params}, problems, work,
                       selected);
  for (int turn = 0; turn < params.steps; ++turn) {
    for_each_item<block>(exec, problems.batch * work.pairs() * 2,
                         detail::reduce_window{params, turn}, problems, work);
    for_each_item<block>(exec, problems.batch, detail::solve_window{turn + 1, extra}, problems,
                         work);
    for_each_item<block>(exec, groups, detail::try_points<Rig>{rig, params, turn + 1}, problems,
                         work);
  }
  for_each_item<block>(exec, groups, detail::finish_window<Rig>{rig, params, params.steps},
                       problems, work);
}

}  // namespace FT_ABI
}  // namespace ft
