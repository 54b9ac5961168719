// SPDX-License-Identifier: Apache-2.0
/// @file The cost of the centres of a window's views, and its terms of the reduced system.
#pragma once

#include <cstddef>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/window/detail/residual.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

// A view whose points move by u has its centre at C - u: see stepped_view().

FT_HOST_DEVICE inline vec3<window_real> centre_off(window_problem_view const& problem, int b, int v,
                                                   rigid<double> const* T_cw) {
  vec3<window_real> const goal = problem.centre_goal[problem.view(b, v)].cast<window_real>();
  return T_cw[v].cast<window_real>().centre() - goal;
}

/// Half the derivative of the cost by the centre of view v of problem b.
FT_HOST_DEVICE inline vec3<window_real> centre_pull(window_problem_view const& problem, int b,
                                                    int v, rigid<double> const* T_cw) {
  double const* const row = problem.centre_information + problem.view(b, v) * problem.views;
  vec3<window_real> pull{0.0, 0.0, 0.0};
  for (int u = 0; u < problem.view_count[b]; ++u) {
    if (row[u] != 0) { pull = pull + scaled(centre_off(problem, b, u, T_cw), window_real(row[u])); }
  }
  return pull;
}

/// The share of view v in the cost of problem b. The sum over all views is the cost.
FT_HOST_DEVICE inline double centre_cost(window_problem_view const& problem, int b, int v,
                                         rigid<double> const* T_cw) {
  if (problem.centre_information == nullptr) { return 0; }
  return dot(centre_off(problem, b, v, T_cw), centre_pull(problem, b, v, T_cw)).value;
}

/// Adds the terms of the centres of a problem. Every thread of the group calls it.
template <typename Group>
FT_HOST_DEVICE void add_centres(Group g, window_problem_view const& problem, int b,
                                rigid<double> const* T_cw, link_terms const& to) {
  if (problem.centre_information == nullptr) { return; }
  int const fixed = problem.fixed_count[b];
  for (int v = fixed + g.rank(); v < problem.view_count[b]; v += g.size()) {
    double const* const row = problem.centre_information + problem.view(b, v) * problem.views;
    for (int u = fixed; u <= v; ++u) { to.add_stiffness(v - fixed, u - fixed, row[u]); }
    to.add_pull(v - fixed, centre_pull(problem, b, v, T_cw));
  }
  g.sync();
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
