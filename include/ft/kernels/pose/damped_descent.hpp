// SPDX-License-Identifier: Apache-2.0
/// @file Levenberg-Marquardt for a pose. Source: Nielsen, "Damping parameter in Marquardt's
/// method", 1999; specification section 11.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/normal_equations.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/kernels/pose/solve6.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using pose_sums = sum_terms<pose_terms, double>;

/// Levenberg-Marquardt state machine, run by one thread: propose() gives a trial pose, judge()
/// takes its cost. In double: where few inliers are left the curvature has a lower rank, and the
/// damping alone, 1e-9 of its largest entry, determines the rest of a step.
struct damped_descent {
  using real = strict_double;
  real cost;      ///< at the best pose so far
  real expected;  ///< decrease of the cost that the model predicts
  real damping;
  real growth;
  int steps_left;
  int trials_left;
  int small_gains;  ///< the last steps that lowered the cost by less than 0.1 %
  bool running;

  /// @param sums at the start
  FT_HOST_DEVICE void begin(pose_sums const& sums, pose_params const& params) {
    steps_left = params.steps;
    double largest = 0;
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      largest = max_of(largest, sums.of[at]);
      at += 6 - a;
    }
    damping = real(1e-5) * largest;
    growth = 2.0;
    cost = sums.of[pose_terms - 1];
    trials_left = params.trials;
    small_gains = 0;
    running = steps_left > 0;
  }

  /// @param there the trial's cost
  /// @return whether the trial is now the best pose
  FT_HOST_DEVICE bool judge(real there, pose_params const& params) {
    real const decrease = cost - there;
    if (!(decrease > real(0.0) && scalar::is_finite(there))) {
      refuse();
      running = running && decrease != real(0.0);
      return false;
    }
    damping = damping * factor_after(decrease);
    growth = 2.0;
    small_gains = decrease * real(1e3) < cost ? small_gains + 1 : 0;
    cost = there;
    trials_left = params.trials;
    running = --steps_left > 0 && small_gains < 3;
    return true;
  }

  /// The next trial, or, no longer `running`, the answer.
  /// @param sums at T
  /// @param T the best pose so far
  /// @param small a step whose components are all shorter ends the descent, unevaluated
  FT_HOST_DEVICE rigid<real> propose(pose_sums const& sums, rigid<real> const& T,
                                     pose_params const& params, double small) {
    real step[6];
    while (running && !solve_6(sums.of, damping, step)) { refuse(); }
    if (!running) { return T; }
    expected = 1e-3;
    bool all_small = true;
    for (int k = 0; k < 6; ++k) {
      expected = expected + step[k] * (damping * step[k] + sums.of[k]);
      all_small = all_small && scalar::abs(step[k]) < real(small);
    }
    running = !all_small;
    // After a refused trial the step is small because of the damping: a longer one was no better.
    return all_small && trials_left < params.trials ? T : exp_se3(step) * T;
  }

private:
  /// Nielsen's factor of the damping after an accepted trial.
  FT_HOST_DEVICE real factor_after(real decrease) const {
    real const least = 1.0 / 3.0;
    // There the cube below is above 2/3. Most steps are as good, and are spared the division.
    if (decrease > real(0.94) * expected) { return least; }
    real const m = real(2.0) * (decrease / expected) - real(1.0);
    return max_of(least, min_of(real(1.0) - m * m * m, real(2.0 / 3.0)));
  }
  /// Increases the damping after a refused trial, or ends the descent.
  FT_HOST_DEVICE void refuse() {
    damping = damping * growth;
    growth = growth * real(2.0);
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
