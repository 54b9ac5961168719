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

/// Levenberg-Marquardt state machine, run by one thread: propose() gives a trial motion, judge()
/// takes the sums at the trial.
struct damped_descent {
  /// Relative difference below which two costs count as equal: they are sums of float residuals.
  static constexpr float noise = 1e-5f;

  using real = strict_float;
  rigid<real> D;      ///< the best motion so far, from the camera's frame at the start
  rigid<real> trial;  ///< the motion whose sums are needed next
  real step[6];
  real cost;      ///< at D
  real expected;  ///< decrease of the cost that the model predicts
  real damping;
  real growth;
  int steps_left;
  int trials_left;
  bool running;  ///< false once D is the answer

  /// @param sums at the identity
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

  /// @param sums at the trial
  /// @return whether the trial is now the best motion
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

  /// Computes the next trial, or ends the descent.
  /// @param best the sums at D
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
    // After a refused trial the step is small because of the damping: a longer one was no better.
    if (trials_left == params.trials) { D = trial; }
    running = false;
  }

private:
  /// Increases the damping after a refused trial, or ends the descent.
  FT_HOST_DEVICE void refuse() {
    damping = damping * growth;
    growth = growth * 2.0f;
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
