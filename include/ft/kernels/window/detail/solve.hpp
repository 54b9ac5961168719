// SPDX-License-Identifier: Apache-2.0
/// @file Solution of a window's reduced system, and the step of its views.
#pragma once

#include <cstddef>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/window/detail/evaluate.hpp"
#include "ft/kernels/window/detail/links.hpp"
#include "ft/kernels/window/detail/residual.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/math/block_systems.hpp"
#include "ft/math/se3.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

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
