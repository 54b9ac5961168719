// SPDX-License-Identifier: Apache-2.0
/// @file The views' system of a bundle, points eliminated, by preconditioned conjugate gradients.
///
/// A step multiplies S by the direction in two launches, over the points and over the views, and a
/// third one moves the solution. Launches after the last step return at once. The preconditioner is
/// the inverse of the diagonal blocks of S. Source: Agarwal and others, "Bundle adjustment in the
/// large", 2010; the end by the quadratic model: Nash and Sofer, "Assessing a search direction
/// within a truncated Newton method", 1990.
#pragma once

#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/bundle/system.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Where the system cannot be solved, so that the step is refused.
inline constexpr double no_solution = std::numeric_limits<double>::quiet_NaN();

/// One item: a view that moves. Its right-hand side and the factor of its diagonal block of S.
struct reduce_view {
  struct scratch {
    ordered_sum_scratch<27, double> sums;
  };
  double damping;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, bundle_system_view const& A,
                                 vec3<double> const* position) const {
    int const v = A.moving_view[item];
    strict_vec3d const centre = A.centre[v].cast<real64>();
    int const begin = A.view_begin[v];
    ordered_sum(g, s.sums, A.view_begin[v + 1] - begin, [&](int k, sum_terms<27, double>& acc) {
      int const o = begin + k;
      int const p = A.point[o];
      strict_vec3d const d = position[p].template cast<real64>() - centre;
      auto const C = load_symmetric(entry<6>(A.curvature, o));
      add_block(d, reduced(C, point_solver::load(entry<6>(A.point_factor, p))), acc);
      strict_vec3d const q =
          load_3(entry<3>(A.gradient, o)) + C * load_3(entry<3>(A.point_start, p));
      strict_vec3d const t = cross(d, q);
      real64 const right[6] = {t.x, t.y, t.z, q.x, q.y, q.z};
      FT_UNROLL
      for (int r = 0; r < 6; ++r) { acc.of[21 + r] -= right[r].value; }
    });
    if (g.rank() == 0) { finish(s, item, A); }
  }

private:
  /// C - C H^-1 C
  FT_HOST_DEVICE static symmetric_3<real64> reduced(symmetric_3<real64> const& C,
                                                    point_solver const& H) {
    strict_vec3d const a = H.forward({C.xx, C.xy, C.xz});
    strict_vec3d const b = H.forward({C.xy, C.yy, C.yz});
    strict_vec3d const c = H.forward({C.xz, C.yz, C.zz});
    return {C.xx - dot(a, a), C.xy - dot(a, b), C.xz - dot(a, c),
            C.yy - dot(b, b), C.yz - dot(b, c), C.zz - dot(c, c)};
  }
  /// Adds the upper triangle of G^T S G by rows.
  FT_HOST_DEVICE static void add_block(strict_vec3d const& d, symmetric_3<real64> const& S,
                                       sum_terms<27, double>& acc) {
    strict_vec3d const x = cross(d, {S.xx, S.xy, S.xz});  // columns of [d]x S
    strict_vec3d const y = cross(d, {S.xy, S.yy, S.yz});
    strict_vec3d const z = cross(d, {S.xz, S.yz, S.zz});
    strict_vec3d const rows[3] = {{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}};
    strict_vec3d const first = cross(d, rows[0]);
    strict_vec3d const second = cross(d, rows[1]);
    strict_vec3d const third = cross(d, rows[2]);
    real64 const upper[21] = {first.x,   first.y,   first.z,   rows[0].x, rows[0].y, rows[0].z,
                              second.y,  second.z,  rows[1].x, rows[1].y, rows[1].z, third.z,
                              rows[2].x, rows[2].y, rows[2].z, S.xx,      S.xy,      S.xz,
                              S.yy,      S.yz,      S.zz};
    FT_UNROLL
    for (int k = 0; k < 21; ++k) { acc.of[k] += upper[k].value; }
  }
  FT_HOST_DEVICE void finish(scratch const& s, int item, bundle_system_view const& A) const {
    double lower[36];
    int next = 0;
    for (int r = 0; r < 6; ++r) {
      for (int c = r; c < 6; ++c) { lower[6 * c + r] = s.sums.total.of[next++]; }
      real64 const own = entry<6>(A.view_diagonal, item)[r];
      // An unknown that no observation tells of stays: its row and column are 0.
      lower[7 * r] =
          own == real64(0.0) ? 1.0 : (real64(lower[7 * r]) + own * real64(damping)).value;
    }
    block_factor<6> const factor(lower, 6);
    double* const out = entry<36>(A.block_factor, item);
    for (int r = 0; r < 6; ++r) {
      for (int c = 0; c < r; ++c) { out[6 * r + c] = factor.c[r][c].value; }
      out[7 * r] = factor.inverse[r].value;
      entry<6>(A.right, item)[r] = s.sums.total.of[21 + r];
    }
  }
};

/// H^-1 sum A G x of a point, over its views.
FT_HOST_DEVICE inline strict_vec3d answer_of_point(int p, bundle_system_view const& A,
                                                   strict_vec3d const& X, double* x) {
  strict_vec3d sum{0.0, 0.0, 0.0};
  for (int at = A.point_begin[p]; at < A.point_begin[p + 1]; ++at) {
    int const o = A.sighting[at];
    int const v = A.view[o];
    int const place = A.place[v];
    if (place < 0) { continue; }
    strict_vec3d const d = X - A.centre[v].cast<real64>();
    sum = sum + load_symmetric(entry<6>(A.curvature, o)) * seen_motion(entry<6>(x, place), d);
  }
  return point_solver::load(entry<6>(A.point_factor, p)).solve(sum);
}

/// One item: a point. How it follows the direction.
struct multiply_points {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, bundle_system_view const& A,
                                 vec3<double> const* position) const {
    if (A.state->running == 0) { return; }
    strict_vec3d const X = position[item].template cast<real64>();
    store_3(entry<3>(A.point_answer, item), answer_of_point(item, A, X, A.direction));
  }
};

/// One item: a view that moves. Its rows of S times the direction.
struct multiply_views {
  using scratch = ordered_sum_scratch<6, double>;
  double damping;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, bundle_system_view const& A,
                                 vec3<double> const* position) const {
    if (A.state->running == 0) { return; }
    int const v = A.moving_view[item];
    strict_vec3d const centre = A.centre[v].cast<real64>();
    int const begin = A.view_begin[v];
    double const* const x = entry<6>(A.direction, item);
    ordered_sum(g, s, A.view_begin[v + 1] - begin, [&](int k, sum_terms<6, double>& acc) {
      int const o = begin + k;
      int const p = A.point[o];
      strict_vec3d const d = position[p].template cast<real64>() - centre;
      strict_vec3d const q = load_symmetric(entry<6>(A.curvature, o)) *
                             (seen_motion(x, d) - load_3(entry<3>(A.point_answer, p)));
      strict_vec3d const t = cross(d, q);
      acc.of[0] += t.x.value;
      acc.of[1] += t.y.value;
      acc.of[2] += t.z.value;
      acc.of[3] += q.x.value;
      acc.of[4] += q.y.value;
      acc.of[5] += q.z.value;
    });
    for (int k = g.rank(); k < 6; k += g.size()) {
      real64 const own = entry<6>(A.view_diagonal, item)[k];
      real64 const damped = own == real64(0.0) ? real64(1.0) : own * real64(damping);
      entry<6>(A.product, item)[k] = (real64(s.total.of[k]) + damped * real64(x[k])).value;
    }
  }
};

/// Writes the preconditioned residual to `product`, a view a thread.
template <typename Group>
FT_HOST_DEVICE void precondition(Group g, bundle_system_view const& A) {
  for (int i = g.rank(); i < A.moving; i += g.size()) {
    double const* const C = entry<36>(A.block_factor, i);
    real64 x[6];
    FT_UNROLL
    for (int k = 0; k < 6; ++k) {
      x[k] = entry<6>(A.residual, i)[k];
      FT_UNROLL
      for (int m = 0; m < k; ++m) { x[k] -= real64(C[6 * k + m]) * x[m]; }
      x[k] *= real64(C[7 * k]);
    }
    FT_UNROLL
    for (int k = 5; k >= 0; --k) {
      FT_UNROLL
      for (int m = 5; m > k; --m) { x[k] -= real64(C[6 * m + k]) * x[m]; }
      x[k] *= real64(C[7 * k]);
      entry<6>(A.product, i)[k] = x[k].value;
    }
  }
  g.sync();
}

/// When conjugate gradients end.
struct gradient_limits {
  int steps;
  double enough;  ///< mean gain of a step, as a share of the gain of all, below which they end
};

/// One item, the whole system: the first direction.
struct start_gradients {
  using scratch = ordered_sum_scratch<1, double>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, bundle_system_view const& A) const {
    int const n = 6 * A.moving;
    for (int i = g.rank(); i < n; i += g.size()) {
      A.solution[i] = 0;
      A.residual[i] = A.right[i];
    }
    g.sync();
    precondition(g, A);
    ordered_sum(g, s, n, [&](int i, sum_terms<1, double>& acc) {
      acc.of[0] += (real64(A.residual[i]) * real64(A.product[i])).value;
    });
    double const rho = s.total.of[0];
    bool const sound = rho >= 0 && scalar::is_finite(rho);
    for (int i = g.rank(); i < n; i += g.size()) {
      A.direction[i] = A.product[i];
      if (!sound) { A.solution[i] = no_solution; }
    }
    if (g.rank() == 0) { *A.state = {rho, rho, 0, 0, sound && rho > 0 ? 1 : 0}; }
  }
};

/// One item, the whole system: a step along the direction, and the next direction.
struct advance_gradients {
  struct scratch {
    ordered_sum_scratch<1, double> along;
    ordered_sum_scratch<2, double> after;
  };
  gradient_limits limits;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, bundle_system_view const& A) const {
    gradient_state const before = *A.state;
    if (before.running == 0) { return; }
    int const n = 6 * A.moving;
    ordered_sum(g, s.along, n, [&](int i, sum_terms<1, double>& acc) {
      acc.of[0] += (real64(A.direction[i]) * real64(A.product[i])).value;
    });
    double const along = s.along.total.of[0];
    if (!(along > 0 && scalar::is_finite(along))) {
      stop(g, before, A);
      return;
    }
    real64 const alpha = real64(before.rho) / real64(along);
    for (int i = g.rank(); i < n; i += g.size()) {
      A.solution[i] = (real64(A.solution[i]) + alpha * real64(A.direction[i])).value;
      A.residual[i] = (real64(A.residual[i]) - alpha * real64(A.product[i])).value;
    }
    g.sync();
    precondition(g, A);
    ordered_sum(g, s.after, n, [&](int i, sum_terms<2, double>& acc) {
      real64 const r = A.residual[i];
      acc.of[0] += (r * real64(A.product[i])).value;
      acc.of[1] += (real64(A.solution[i]) * (real64(A.right[i]) + r)).value;
    });
    double const rho = s.after.total.of[0];
    real64 const beta = real64(rho) / real64(before.rho);
    for (int i = g.rank(); i < n; i += g.size()) {
      A.direction[i] = (real64(A.product[i]) + beta * real64(A.direction[i])).value;
    }
    if (g.rank() == 0) { judge(before, rho, s.after.total.of[1], A); }
  }

private:
  /// The matrix is not positive definite along the direction. The solution so far is taken; without
  /// any there is none.
  template <typename Group>
  FT_HOST_DEVICE static void stop(Group g, gradient_state const& before,
                                  bundle_system_view const& A) {
    if (before.steps == 0) {
      for (int i = g.rank(); i < 6 * A.moving; i += g.size()) { A.solution[i] = no_solution; }
    }
    if (g.rank() == 0) { A.state->running = 0; }
  }
  FT_HOST_DEVICE void judge(gradient_state const& before, double rho, double model,
                            bundle_system_view const& A) const {
    int const steps = before.steps + 1;
    real64 const gain = real64(model) - real64(before.model);
    real64 const mean = gain * real64(static_cast<double>(steps));
    // Comparisons are written so that a NaN ends it.
    bool const goes_on = steps < limits.steps && rho > 1e-30 * before.first &&
                         mean > real64(limits.enough) * real64(model);
    *A.state = {rho, before.first, model, steps, goes_on ? 1 : 0};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
