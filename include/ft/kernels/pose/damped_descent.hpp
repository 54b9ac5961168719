// SPDX-License-Identifier: Apache-2.0
/// @file Levenberg-Marquardt for a pose. Source: Nielsen, "Damping parameter in Marquardt's
/// method", 1999.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/normal_equations.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/kernels/pose/solve6.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Levenberg-Marquardt as a machine that one thread keeps: it names a trial motion, is told the
/// sums there, and names the next.
struct damped_descent {
  /// Costs that differ by less than this part are the same: they are sums of float residuals.
  static constexpr float noise = 1e-5f;

  using real = strict_float;
  rigid<real> D;      ///< the best motion so far, from the camera's frame at the start
  rigid<real> trial;  ///< where the sums are wanted next
  real step[6];
  real cost;      ///< at the best
  real expected;  ///< decrease of the cost
  real damping;
  real growth;
  int steps_left;
  int trials_left;
  bool running;  ///< false = done, `D` is the answer

  /// @param sums without any motion
  FT_HOST_DEVICE void begin(sum_terms<pose_terms> const& sums, pose_params const& params) {
    D = rigid<real>::identity();
    trial = D;
    steps_left = params.steps;
    float largest = 0;
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      largest = max_of(largest, sums.of[at]);
      at += 6 - a;
    }
    damping = real(1e-5f) * largest;
    growth = 2.0f;
    cost = sums.of[pose_terms - 1];
    trials_left = params.trials;
    running = steps_left > 0;
  }

  /// Whether the trial is the best now. @param sums there
  FT_HOST_DEVICE bool judge(sum_terms<pose_terms> const& sums, pose_params const& params) {
    real const there = sums.of[pose_terms - 1];
    real const decrease = cost - there;
    if (!(decrease > -(real(noise) * cost) && scalar::is_finite(there))) {
      refuse();
      return false;
    }
    real const m = real(2.0f) * (decrease / expected) - 1.0f;
    damping =
        damping * max_of(real(1.0f / 3.0f), min_of(real(1.0f) - m * m * m, real(2.0f / 3.0f)));
    growth = 2.0f;
    D = trial;
    cost = there;
    trials_left = params.trials;
    running = --steps_left > 0;
    return true;
  }

  /// Names the next trial, or ends. @param best the sums at the best
  FT_HOST_DEVICE void propose(sum_terms<pose_terms> const& best, pose_params const& params) {
    while (running && !solve_6(best.of, damping, step)) { refuse(); }
    if (!running) { return; }
    expected = 1e-3f;
    bool small = true;
    for (int k = 0; k < 6; ++k) {
      expected = expected + step[k] * (damping * step[k] + best.of[k]);
      small = small && scalar::abs(step[k]) < params.small_step;
    }
    trial = exp_se3(step) * D;
    if (!small) { return; }
    // Short because it was cut short: a longer one was no better.
    if (trials_left == params.trials) { D = trial; }
    running = false;
  }

private:
  /// After a trial that was no better: more damping, while any is left.
  FT_HOST_DEVICE void refuse() {
    damping = damping * growth;
    growth = growth * 2.0f;
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
