// SPDX-License-Identifier: Apache-2.0
/// @file Launches over the points of a window: costs, derivatives, steps of points, results.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/window/detail/centre_cost.hpp"
#include "ft/kernels/window/detail/residual.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Threads that share a point: thread l takes views l, l + 16, ...
inline constexpr int window_lanes = sum_lanes / window_group;

/// The points of a block: `lane[k][l][q]` is lane l's part of sum k of point q. Lanes are added in
/// order.
struct window_point_scratch {
  static constexpr int sums = window_terms + 1;  ///< A, f and the cost
  double lane[sums][window_lanes][window_group];
  std::uint64_t mask[window_lanes][window_group];
  vec3<double> X[window_group];
  double link[max_window_views];  ///< costs of views by links and centres
  ordered_sum_scratch<2, double> judge;

  FT_HOST_DEVICE double sum(int k, int q, int lanes) const {
    window_real total = 0.0;
    for (int l = 0; l < lanes; ++l) { total += window_real(lane[k][l][q]); }
    return total.value;
  }
};

/// One problem and one group of its points. Only of a problem that runs: the counts of others may
/// be written meanwhile, for their next adjustment.
struct window_points {
  window_problem_view const& problem;
  window_workspace const& work;
  int b;
  int base;   ///< first point
  int count;  ///< points of the problem
  int views;  ///< of the problem
  int fixed;  ///< likewise

  FT_HOST_DEVICE window_points(window_problem_view const& in, window_workspace const& w, int item)
      : problem(in),
        work(w),
        b(item / w.groups()),
        base(item % w.groups() * window_group),
        count(in.point_count[b]),
        views(in.view_count[b]),
        fixed(in.fixed_count[b]) {}

  FT_HOST_DEVICE bool sound() const {
    return count >= 1 && count <= problem.points && views >= 1 && views <= problem.views &&
           fixed >= 0 && fixed < views && views - fixed <= work.moving;
  }
  FT_HOST_DEVICE int lanes() const { return min_of(window_lanes, views); }
  FT_HOST_DEVICE bool has(int q) const { return base + q < count; }
};

/// The state after the newest evaluation. Every thread of the group gets it.
/// @param start the evaluation is that of the start
template <typename Group>
FT_HOST_DEVICE window_state judged(Group g, ordered_sum_scratch<2, double>& s,
                                   window_state const& before, window_points const& in, bool start,
                                   window_params const& params) {
  if (!before.running) { return before; }
  window_cost_part const* const parts = in.work.parts_of(in.b);
  ordered_sum(g, s, ceil_div(in.count, window_group), [&](int i, sum_terms<2, double>& acc) {
    acc.of[0] += parts[i].cost;
    acc.of[1] += parts[i].linked;
  });
  return judge_window(before, start, {s.total.of[0], s.total.of[1]}, in.work.solved[in.b] != 0,
                      params);
}

/// 0, or NaN if an entry of T is not finite.
FT_HOST_DEVICE inline window_real not_finite(rigid<window_real> const& T) {
  window_real sum = T.t.x + T.t.y + T.t.z;
  for (int i = 0; i < 9; ++i) { sum += T.R.m[i]; }
  return sum - sum;
}

FT_HOST_DEVICE inline void add_terms(window_normal& to, window_normal const& from) {
  to.A = {to.A.xx + from.A.xx, to.A.xy + from.A.xy, to.A.xz + from.A.xz,
          to.A.yy + from.A.yy, to.A.yz + from.A.yz, to.A.zz + from.A.zz};
  to.f = to.f + from.f;
}
FT_HOST_DEVICE inline void store_terms(window_normal const& n, double* at, std::ptrdiff_t step) {
  double const terms[window_terms] = {n.A.xx.value, n.A.xy.value, n.A.xz.value,
                                      n.A.yy.value, n.A.yz.value, n.A.zz.value,
                                      n.f.x.value,  n.f.y.value,  n.f.z.value};
  FT_UNROLL
  for (int i = 0; i < window_terms; ++i) { at[i * step] = terms[i]; }
}
FT_HOST_DEVICE inline symmetric_3<window_real> load_curvature(double const* at,
                                                              std::ptrdiff_t step) {
  return {at[0], at[step], at[2 * step], at[3 * step], at[4 * step], at[5 * step]};
}
FT_HOST_DEVICE inline vec3<window_real> load_gradient(double const* at, std::ptrdiff_t step) {
  return {at[6 * step], at[7 * step], at[8 * step]};
}

/// Adds up the lanes of evaluate_points().
template <typename Group>
FT_HOST_DEVICE void gather_points(Group g, window_point_scratch& s, window_points const& in,
                                  int to) {
  int const lanes = in.lanes();
  constexpr int rows = window_terms + 2;  // the cost and the mask come last
  FT_NO_UNROLL
  for (int k = g.rank(); k < rows * window_group; k += g.size()) {
    int const row = k / window_group;
    int const q = k % window_group;
    if (!in.has(q)) { continue; }
    int const p = in.base + q;
    if (row < window_terms) {
      in.work.terms_of_points(to, in.b)[row * static_cast<std::ptrdiff_t>(in.work.points) + p] =
          s.sum(row, q, lanes);
    } else if (row == window_terms) {
      s.X[q].x = s.sum(row, q, lanes);
    } else {
      std::uint64_t mask = 0;
      for (int l = 0; l < lanes; ++l) { mask |= s.mask[l][q]; }
      in.work.masks_of(to, in.b)[p] = mask;
      s.mask[0][q] = mask;
    }
  }
  g.sync();
  if (g.rank() == 0) {
    window_real cost = 0.0;
    window_real linked = 0.0;
    for (int v = 0; in.base == 0 && v < in.views; ++v) { cost += window_real(s.link[v]); }
    for (int q = 0; q < window_group && in.has(q); ++q) {
      cost += window_real(s.X[q].x);
      linked += window_real(s.mask[0][q] != 0 ? 1.0 : 0.0);
    }
    in.work.parts_of(in.b)[in.base / window_group] = {cost.value, linked.value};
  }
}

/// H + damping diag(H), inverted. False if it is not positive definite: such a point stays.
FT_HOST_DEVICE inline bool damped_inverse(symmetric_3<window_real> H, window_real damping,
                                          symmetric_3<window_real>& inverse) {
  window_real const factor = window_real(1.0) + damping;
  window_real const least = window_real(1e-9);
  H.xx = H.xx * factor + least;
  H.yy = H.yy * factor + least;
  H.zz = H.zz * factor + least;
  return H.invert(inverse);
}

/// Evaluates the points of `s.X` in the views `T_cw`: terms and masks into buffer `to`, the cost
/// into this group's part. Every thread of the group calls it.
/// @param refuse_nan makes the cost NaN if a point or a view is not finite
template <typename Rig, typename Group>
FT_HOST_DEVICE void evaluate_points(Group g, window_point_scratch& s, Rig const& rig,
                                    window_params const& params, window_points const& in,
                                    rigid<double> const* T_cw, int to, bool refuse_nan) {
  using real = window_real;
  for (int v = g.rank(); in.base == 0 && v < in.views; v += g.size()) {
    s.link[v] =
        (real(link_cost(in.problem, in.b, v, T_cw)) + real(centre_cost(in.problem, in.b, v, T_cw)))
            .value;
  }
  FT_NO_UNROLL
  for (int k = g.rank(); k < window_lanes * window_group; k += g.size()) {
    int const lane = k / window_group;
    int const q = k % window_group;
    window_normal all = window_normal::zero();
    std::uint64_t mask = 0;
    if (in.has(q)) {
      vec3<real> const X = to_real(s.X[q]);
      if (refuse_nan && !scalar::is_finite(X.x + X.y + X.z)) { all.cost = X.x + X.y + X.z; }
      FT_NO_UNROLL
      for (int v = lane; v < in.views; v += window_lanes) {
        rigid<real> const T = T_cw[v].template cast<real>();
        if (refuse_nan) { all.cost += not_finite(T); }
        window_normal own = window_normal::zero();
        FT_NO_UNROLL
        for (int c = 0; c < in.problem.cameras; ++c) {
          window_observation const o =
              in.problem.seen[in.problem.sighting(in.b, in.base + q, v, c)];
          if (!(o.inv_sigma2 > 0)) { continue; }
          window_residual<Rig> const residual{rig, o, T * X};
          own.add(residual.first(c), T.R, params);
          if (residual.has_second()) { own.add(residual.second(params, c), T.R, params); }
        }
        all.cost += own.cost;
        if (!own.linked) { continue; }
        add_terms(all, own);
        if (v >= in.fixed) {
          mask |= std::uint64_t{1} << (v - in.fixed);
          store_terms(own, in.work.terms_of_view(to, in.b, v - in.fixed) + in.base + q,
                      in.work.points);
        }
      }
    }
    store_terms(all, &s.lane[0][lane][q], window_lanes * window_group);
    s.lane[window_terms][lane][q] = all.cost.value;
    s.mask[lane][q] = mask;
  }
  g.sync();
  gather_points(g, s, in, to);
}

/// One item: a group of points of a problem, evaluated at the start.
template <typename Rig>
struct start_window {
  using scratch = window_point_scratch;
  Rig rig;
  window_params params;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, window_problem_view const& problem,
                                 window_workspace const& w, int const* selected) const {
    int const b = item / w.groups();
    bool const begins = item % w.groups() == 0;
    bool const chosen = selected == nullptr || selected[b] != 0;
    if (!chosen) {
      if (begins && g.rank() == 0) { set_state(w, b, -1, false); }
      return;
    }
    window_points const in(problem, w, item);
    bool const runs = in.sound();
    rigid<double> const* const T_cw = problem.T_cw + problem.view(b, 0);
    if (begins) {
      if (g.rank() == 0) { set_state(w, b, 0, runs); }
      for (int v = g.rank(); runs && v < in.views; v += g.size()) {
        w.views_of(0, b)[v] = w.views_of(1, b)[v] = T_cw[v];
      }
    }
    if (!runs || in.base >= in.count) { return; }
    for (int q = g.rank(); q < window_group && in.has(q); q += g.size()) {
      s.X[q] = problem.position[problem.point(in.b, in.base + q)];
      w.points_of(0, in.b)[in.base + q] = s.X[q];
    }
    g.sync();
    evaluate_points(g, s, rig, params, in, T_cw, 0, true);
  }

private:
  /// @param steps -1 = not selected
  FT_HOST_DEVICE void set_state(window_workspace const& w, int b, int steps, bool runs) const {
    w.state_of(0, b) = {0, 0, params.first_damping, steps, 0, runs ? 1 : 0, 0};
    w.solved[b] = 0;
  }
};

/// One item: a group of points of a problem. Moves them along with the views' trial, and evaluates
/// them there.
template <typename Rig>
struct try_points {
  using scratch = window_point_scratch;
  Rig rig;
  window_params params;
  int turn;  ///< of the state that says what is tried

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, window_problem_view const& problem,
                                 window_workspace const& w) const {
    int const b = item / w.groups();
    window_state const state = w.state_of(turn, b);
    if (!state.running || !w.solved[b]) { return; }
    window_points const in(problem, w, item);
    if (in.base >= in.count) { return; }
    FT_NO_UNROLL
    for (int k = g.rank(); k < window_lanes * window_group; k += g.size()) {
      add_view_steps(s, in, state.buffer, k / window_group, k % window_group);
    }
    g.sync();
    for (int q = g.rank(); q < window_group && in.has(q); q += g.size()) {
      s.X[q] = moved_point(s, in, state, q);
      w.points_of(1 - state.buffer, b)[in.base + q] = s.X[q];
    }
    g.sync();
    evaluate_points(g, s, rig, params, in, w.views_of(1 - state.buffer, b), 1 - state.buffer,
                    false);
  }

private:
  /// The part of a lane's views in the right-hand side of a point: A (w x (X - C) + u), where the
  /// view turns by w and moves by u.
  FT_HOST_DEVICE static void add_view_steps(scratch& s, window_points const& in, int from, int lane,
                                            int q) {
    vec3<window_real> sum{0.0, 0.0, 0.0};
    if (in.has(q)) {
      std::uint64_t const mask = in.work.masks_of(from, in.b)[in.base + q];
      vec3<window_real> const X = to_real(in.work.points_of(from, in.b)[in.base + q]);
      FT_NO_UNROLL
      for (int v = lane; v < in.views - in.fixed; v += window_lanes) {
        if ((mask >> v & 1) == 0) { continue; }
        auto const T = in.work.views_of(from, in.b)[in.fixed + v].template cast<window_real>();
        double const* const d = in.work.steps_of(in.b) + 6 * v;
        vec3<window_real> const motion =
            cross(vec3<window_real>{d[0], d[1], d[2]}, X - T.centre()) +
            vec3<window_real>{d[3], d[4], d[5]};
        double const* const terms = in.work.terms_of_view(from, in.b, v) + in.base + q;
        sum = sum + load_curvature(terms, in.work.points) * motion;
      }
    }
    s.lane[0][lane][q] = sum.x.value;
    s.lane[1][lane][q] = sum.y.value;
    s.lane[2][lane][q] = sum.z.value;
  }
  FT_HOST_DEVICE static vec3<double> moved_point(scratch const& s, window_points const& in,
                                                 window_state const& state, int q) {
    int const lanes = min_of(window_lanes, in.views - in.fixed);
    double const* const terms = in.work.terms_of_points(state.buffer, in.b) + in.base + q;
    vec3<window_real> const X = to_real(in.work.points_of(state.buffer, in.b)[in.base + q]);
    symmetric_3<window_real> inverse;
    if (!damped_inverse(load_curvature(terms, in.work.points), state.damping, inverse)) {
      return from_real(X);
    }
    vec3<window_real> const right =
        -(load_gradient(terms, in.work.points) +
          vec3<window_real>{s.sum(0, q, lanes), s.sum(1, q, lanes), s.sum(2, q, lanes)});
    return from_real(X + inverse * right);
  }
};

/// One item: a group of points of a problem. Writes the results.
template <typename Rig>
struct finish_window {
  using scratch = window_point_scratch;
  Rig rig;
  window_params params;
  int turn;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, window_problem_view const& problem,
                                 window_workspace const& w) const {
    int const b = item / w.groups();
    window_state const before = w.state_of(turn, b);
    if (before.steps < 0) { return; }  // not selected
    window_points const in(problem, w, item);
    window_state const state = judged(g, s.judge, before, in, params.steps == 0, params);
    if (in.base == 0) {
      if (g.rank() == 0) {
        problem.outcome[b] = state.valid
                                 ? window_outcome{state.first_cost, state.cost, state.steps, 1}
                                 : window_outcome{0, 0, 0, 0};
      }
      for (int v = in.fixed + g.rank(); state.valid && v < in.views; v += g.size()) {
        problem.T_cw[problem.view(b, v)] = w.views_of(state.buffer, b)[v];
      }
    }
    if (!state.valid || in.base >= in.count) { return; }
    for (int q = g.rank(); q < window_group && in.has(q); q += g.size()) {
      problem.position[problem.point(b, in.base + q)] = w.points_of(state.buffer, b)[in.base + q];
    }
    FT_NO_UNROLL
    for (int k = g.rank(); k < window_lanes * window_group; k += g.size()) {
      mark_outliers(in, state.buffer, k / window_group, k % window_group);
    }
  }

private:
  FT_HOST_DEVICE void mark_outliers(window_points const& in, int from, int lane, int q) const {
    if (!in.has(q)) { return; }
    vec3<window_real> const X = to_real(in.work.points_of(from, in.b)[in.base + q]);
    FT_NO_UNROLL
    for (int v = lane; v < in.views; v += window_lanes) {
      auto const T = in.work.views_of(from, in.b)[v].template cast<window_real>();
      FT_NO_UNROLL
      for (int c = 0; c < in.problem.cameras; ++c) {
        std::ptrdiff_t const at = in.problem.sighting(in.b, in.base + q, v, c);
        window_observation const o = in.problem.seen[at];
        int bits = 0;
        if (o.inv_sigma2 > 0) {
          window_residual<Rig> const residual{rig, o, T * X};
          if (is_outlier(residual.first(c))) { bits |= outlying_pixel; }
          if (residual.has_second() && is_outlier(residual.second(params, c))) {
            bits |= outlying_right;
          }
        }
        in.problem.outlier[at] = static_cast<unsigned char>(bits);
      }
    }
  }
  FT_HOST_DEVICE bool is_outlier(window_error const& r) const {
    return !(r.valid() && r.chi2() < window_real(params.outlier2));
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
