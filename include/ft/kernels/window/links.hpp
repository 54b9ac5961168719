// SPDX-License-Identifier: Apache-2.0
/// @file The links of a window: their costs, and their terms of the reduced system.
///
/// For a link from view i to view j = i + 1 let R and C be their rotations and centres, M the
/// measured rotation from frame i to frame j, q the measured vector from C_i to C_j along the axes
/// of the world, and A = R_i^T M^T R_j, the identity if M is right. The errors are
///
///     e = axis of the skew part of A,   s = C_j - C_i - q.
///
/// Where a view turns by w and its points move by u (see reduce.hpp), e changes by w_j - w_i and s
/// by u_i - u_j + w_i x q, up to first order about e = 0.
#pragma once

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/window/residual.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct link_error {
  using real = window_real;
  real turn_weight, shift_weight;
  vec3<real> turn;   ///< e
  vec3<real> shift;  ///< s
  vec3<real> lever;  ///< q

  FT_HOST_DEVICE static link_error of(window_link const& link, rigid<double> const& before,
                                      rigid<double> const& now) {
    auto const measured = [](double weight) { return weight > 0 ? weight : 0.0; };
    real const turn_weight = measured(link.rotation_weight);
    real const shift_weight = measured(link.translation_weight);
    if (!(turn_weight + shift_weight > real(0.0))) { return none(); }
    rigid<real> const M = link.motion.cast<real>();
    rigid<real> const T_i = before.cast<real>();
    rigid<real> const T_j = now.cast<real>();
    mat3<real> const R_wi = T_i.R.transposed();
    mat3<real> const A = R_wi * (M.R.transposed() * T_j.R);
    real const half = 0.5;
    vec3<real> const q = R_wi * M.centre();
    return {turn_weight,
            shift_weight,
            {half * (A.m[7] - A.m[5]), half * (A.m[2] - A.m[6]), half * (A.m[3] - A.m[1])},
            T_j.centre() - T_i.centre() - q,
            q};
  }
  FT_HOST_DEVICE static link_error none() {
    vec3<real> const zero{0.0, 0.0, 0.0};
    return {0.0, 0.0, zero, zero, zero};
  }
  FT_HOST_DEVICE real cost() const {
    return turn_weight * dot(turn, turn) + shift_weight * dot(shift, shift);
  }
};

/// Adds the links' terms of one view to a reduced system. Terms of different views are different
/// entries.
struct link_terms {
  using real = window_real;
  double* a;  ///< the system: lower triangle, and the right-hand side in its last row
  int side;
  real damping;

  /// @param v moving view that the link ends at @param linked whether the view before moves, too
  FT_HOST_DEVICE void add_end(int v, link_error const& e, bool linked) const {
    for (int k = 0; k < 3; ++k) {
      add_diagonal(6 * v + k, e.turn_weight);
      add_diagonal(6 * v + 3 + k, e.shift_weight);
      add_right(6 * v + k, -(e.turn_weight * component(e.turn, k)));
      add_right(6 * v + 3 + k, e.shift_weight * component(e.shift, k));
    }
    if (!linked) { return; }
    int const before = 6 * (v - 1);
    for (int k = 0; k < 3; ++k) {
      add(6 * v + k, before + k, -e.turn_weight);
      add(6 * v + 3 + k, before + 3 + k, -e.shift_weight);
    }
    add_cross(6 * v + 3, before, e.lever, e.shift_weight);
  }
  /// @param v moving view that the link begins at
  FT_HOST_DEVICE void add_begin(int v, link_error const& e) const {
    vec3<real> const q = e.lever;
    vec3<real> const turned = cross(q, e.shift);
    real const square = dot(q, q);
    for (int k = 0; k < 3; ++k) {
      real const own = component(q, k);
      add_diagonal(6 * v + k, e.turn_weight + e.shift_weight * (square - own * own));
      add_diagonal(6 * v + 3 + k, e.shift_weight);
      for (int c = 0; c < k; ++c) {
        add(6 * v + k, 6 * v + c, -(e.shift_weight * (own * component(q, c))));
      }
      add_right(6 * v + k,
                e.turn_weight * component(e.turn, k) - e.shift_weight * component(turned, k));
      add_right(6 * v + 3 + k, -(e.shift_weight * component(e.shift, k)));
    }
    add_cross(6 * v + 3, 6 * v, q, -e.shift_weight);
  }

private:
  FT_HOST_DEVICE static real component(vec3<real> const& v, int k) {
    return k == 0 ? v.x : k == 1 ? v.y : v.z;
  }
  FT_HOST_DEVICE void add(int row, int column, real value) const {
    double& to = a[row * side + column];
    to = (real(to) + value).value;
  }
  FT_HOST_DEVICE void add_diagonal(int row, real value) const {
    add(row, row, value + value * damping);
  }
  FT_HOST_DEVICE void add_right(int row, real value) const { add(side - 1, row, value); }
  /// factor [q]x
  FT_HOST_DEVICE void add_cross(int row, int column, vec3<real> const& q, real factor) const {
    add(row, column + 1, -(factor * q.z));
    add(row, column + 2, factor * q.y);
    add(row + 1, column, factor * q.z);
    add(row + 1, column + 2, -(factor * q.x));
    add(row + 2, column, -(factor * q.y));
    add(row + 2, column + 1, factor * q.x);
  }
};

/// Cost of the link that ends at view v of problem b. 0 where there is none, or no view of it
/// moves.
FT_HOST_DEVICE inline double link_cost(window_problem_view const& problem, int b, int v,
                                       rigid<double> const* T_cw) {
  if (problem.link == nullptr || v < max_of(1, problem.fixed_count[b])) { return 0; }
  return link_error::of(problem.link[problem.view(b, v)], T_cw[v - 1], T_cw[v]).cost().value;
}

/// Adds the terms of all links of a problem. Every thread of the group calls it.
template <typename Group>
FT_HOST_DEVICE void add_links(Group g, window_problem_view const& problem, int b,
                              rigid<double> const* T_cw, link_terms const& to) {
  if (problem.link == nullptr) { return; }
  window_link const* const links = problem.link + problem.view(b, 0);
  int const views = problem.view_count[b];
  int const fixed = problem.fixed_count[b];
  for (int v = fixed + g.rank(); v < views; v += g.size()) {
    if (v > 0) { to.add_end(v - fixed, link_error::of(links[v], T_cw[v - 1], T_cw[v]), v > fixed); }
    if (v + 1 < views) {
      to.add_begin(v - fixed, link_error::of(links[v + 1], T_cw[v], T_cw[v + 1]));
    }
  }
  g.sync();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
