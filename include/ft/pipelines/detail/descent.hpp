// SPDX-License-Identifier: Apache-2.0
/// @file The method of Levenberg and Marquardt, for solvers of any problem.
#pragma once

#include <cmath>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Damping of steps, relative to the diagonal of the matrix.
struct step_damping {
  double value;
  double growth = 8;  ///< by refused steps; larger after each one in a row

  bool is_small() const { return value < 1e12; }
  /// A step that gained what the linear system promised needs less damping.
  void accept(double gain, double promised) {
    if (gain >= 0.9 * promised) { value = value > 1e-14 ? value / 8 : value; }
    if (gain < 0.25 * promised) { value = value * 4; }
    growth = 8;
  }
  void refuse() {
    value = (value > 1e-12 ? value : 1e-12) * growth;
    growth *= 4;
  }
};

struct descent_limits {
  int steps;             ///< most steps to try
  double enough;         ///< ends with a step that lowers the cost by a smaller share
  double first_damping;  ///< of the first step
};

template <typename Verdict>
struct descent {
  Verdict best;     ///< that of the result
  int steps = 0;    ///< that were tried, refused ones included
  int refused = 0;  ///< of them
  bool converged = false;
  double damping = 0;  ///< of the step that would be next
};

/// Lowers the cost of a solver's estimate. Ends also where the cost is the rounding of its terms: a
/// 10^20th of the first one's.
/// @param solver has linearize(), which prepares steps from its current estimate,
/// try_step(damping),
///   which returns the verdict about the estimate that a step leads to, its `cost` and the gain
///   `promised` by the linear system, and accept(), which makes that estimate the current one
/// @param best verdict about the current estimate
template <typename Solver, typename Verdict>
descent<Verdict> descend(Solver& solver, Verdict const& best, descent_limits const& limits) {
  descent<Verdict> d{best};
  step_damping damping{limits.first_damping};
  bool linear = false;
  double const rounding = 1e-20 * best.cost;
  auto const is_little = [&](double gain) {
    return std::isfinite(d.best.cost) && damping.value <= 1 &&
           (gain <= limits.enough * d.best.cost || gain <= rounding);
  };
  while (!d.converged && d.steps < limits.steps && damping.is_small()) {
    if (!linear) { solver.linearize(); }
    ++d.steps;
    auto const trial = solver.try_step(damping.value);
    double const gain = d.best.cost - trial.cost;
    bool const better = gain >= 0;  // false for NaN
    if (better) {
      d.converged = is_little(gain) || trial.cost <= rounding;
      damping.accept(gain, trial.promised);
      solver.accept();
      d.best = trial;
    } else {
      ++d.refused;
      d.converged = trial.promised >= 0 && is_little(trial.promised);
      damping.refuse();
    }
    linear = !better;
  }
  d.damping = damping.value;
  return d;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
