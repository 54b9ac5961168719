// SPDX-License-Identifier: Apache-2.0
/// @file Levenberg-Marquardt for a pose. Source: Nielsen, "Damping parameter in Marquardt's
/// method", 1999; specification section 11.
#pragma once

#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// An observation's part of the normal equations of a pose.
//
// A small twist (w, t) moves the point p by w x p + t. Let P be the derivative of the prediction
// by p, W the weights, e the error, M = P^T W P and f = P^T W e. Then the blocks of the curvature
// are [p]x M [p]x^T, [p]x M and M, and those of the gradient are p x f and f.

namespace detail {

/// Sums of a pose: 6 of the gradient, 21 of the curvature's upper triangle by rows, the cost.
inline constexpr int pose_terms = 28;

/// Gradient and curvature by the position of the point.
template <typename Number>
struct point_equations {
  vec3<Number> f;
  symmetric_3<Number> M;
};

/// @param P d prediction / d point, three rows
/// @param W weights of the rows; 0 for a row that is absent
/// @param e error
template <typename Number>
FT_HOST_DEVICE point_equations<Number> rectified_equations(mat3<Number> const& P, vec3<Number> W,
                                                           vec3<Number> e) {
  // P[0][1], P[1][0] and P[2][1] are 0.
  Number const w0 = W.x * P.m[0];
  Number const w2 = W.z * P.m[6];
  Number const w1 = W.y * P.m[4];
  Number const w02 = W.x * P.m[2];
  Number const w12 = W.y * P.m[5];
  Number const w22 = W.z * P.m[8];
  return {{w0 * e.x + w2 * e.z, w1 * e.y, w02 * e.x + w12 * e.y + w22 * e.z},
          {w0 * P.m[0] + w2 * P.m[6], Number(0.0f), w02 * P.m[0] + w22 * P.m[6], w1 * P.m[4],
           w12 * P.m[4], w02 * P.m[2] + w12 * P.m[5] + w22 * P.m[8]}};
}

/// The same for three rows of any form.
template <typename Number>
FT_HOST_DEVICE point_equations<Number> displaced_equations(mat3<Number> const& P, vec3<Number> W,
                                                           vec3<Number> e) {
  auto const column = [&](int k) { return vec3<Number>{P.m[k], P.m[3 + k], P.m[6 + k]}; };
  auto const weighted = [&](int k) {
    return vec3<Number>{W.x * P.m[k], W.y * P.m[3 + k], W.z * P.m[6 + k]};
  };
  // Added in the order of the rows, as rectified_equations() does.
  auto const sum = [](vec3<Number> a, vec3<Number> b) { return a.x * b.x + a.y * b.y + a.z * b.z; };
  vec3<Number> const x = weighted(0);
  vec3<Number> const y = weighted(1);
  vec3<Number> const z = weighted(2);
  return {{sum(x, e), sum(y, e), sum(z, e)},
          {sum(x, column(0)), sum(y, column(0)), sum(z, column(0)), sum(y, column(1)),
           sum(z, column(1)), sum(z, column(2))}};
}

/// The same for two rows of any form.
template <typename Number>
FT_HOST_DEVICE point_equations<Number> monocular_equations(mat3<Number> const& P, vec3<Number> W,
                                                           vec3<Number> e) {
  vec3<Number> const u{W.x * P.m[0], W.x * P.m[1], W.x * P.m[2]};
  vec3<Number> const v{W.y * P.m[3], W.y * P.m[4], W.y * P.m[5]};
  return {{u.x * e.x + v.x * e.y, u.y * e.x + v.y * e.y, u.z * e.x + v.z * e.y},
          {u.x * P.m[0] + v.x * P.m[3], u.x * P.m[1] + v.x * P.m[4], u.x * P.m[2] + v.x * P.m[5],
           u.y * P.m[1] + v.y * P.m[4], u.y * P.m[2] + v.y * P.m[5], u.z * P.m[2] + v.z * P.m[5]}};
}

/// Adds an observation to the sums of the gradient and of the curvature.
/// @param p the point
/// @param sums the first 27 are added to
template <typename Number, int Terms>
FT_HOST_DEVICE void add_motion_terms(vec3<Number> p, point_equations<Number> const& point,
                                     plain_scalar_t<Number> (&sums)[Terms]) {
  static_assert(Terms >= 27, "6 of the gradient, 21 of the curvature");
  auto const add = [&](int at, Number v) { sums[at] += v.value; };
  auto const add_vector = [&](int at, vec3<Number> v) {
    add(at, v.x);
    add(at + 1, v.y);
    add(at + 2, v.z);
  };
  auto const& M = point.M;
  add_vector(0, cross(p, point.f));
  add_vector(3, point.f);
  // Columns and rows of [p]x M.
  vec3<Number> const a = cross(p, {M.xx, M.xy, M.xz});
  vec3<Number> const b = cross(p, {M.xy, M.yy, M.yz});
  vec3<Number> const c = cross(p, {M.xz, M.yz, M.zz});
  vec3<Number> const first{a.x, b.x, c.x};
  vec3<Number> const second{a.y, b.y, c.y};
  vec3<Number> const third{a.z, b.z, c.z};
  add_vector(6, cross(p, first));
  add_vector(9, first);
  add(12, cross(p, second).y);
  add(13, cross(p, second).z);
  add_vector(14, second);
  add(17, cross(p, third).z);
  add_vector(18, third);
  add_vector(21, {M.xx, M.xy, M.xz});
  add(24, M.yy);
  add(25, M.yz);
  add(26, M.zz);
}

/// Sums of a descent in `Number`, strict_float or strict_double.
template <typename Number>
using pose_sums = sum_terms<pose_terms, plain_scalar_t<Number>>;

/// Levenberg-Marquardt state machine, run by one thread: propose() gives a trial pose, judge()
/// takes its cost.
template <typename Number>
struct damped_descent {
  using real = Number;
  using plain = plain_scalar_t<Number>;
  real cost;      ///< at the best pose so far
  real expected;  ///< decrease of the cost that the model predicts
  real damping;
  real growth;
  int steps_left;
  int trials_left;
  int small_gains;  ///< the last steps that lowered the cost by less than 0.1 %
  bool running;

  /// @param sums at the start
  FT_HOST_DEVICE void begin(pose_sums<real> const& sums, pose_params const& params) {
    steps_left = params.steps;
    plain largest = 0;
    int at = 6;
    for (int a = 0; a < 6; ++a) {
      largest = max_of(largest, sums.of[at]);
      at += 6 - a;
    }
    damping = real(plain(1e-5)) * real(largest);
    growth = plain(2);
    cost = sums.of[pose_terms - 1];
    trials_left = params.trials;
    small_gains = 0;
    running = steps_left > 0;
  }

  /// @param there the trial's cost
  /// @return whether the trial is now the best pose
  FT_HOST_DEVICE bool judge(real there, pose_params const& params) {
    real const decrease = cost - there;
    if (!(decrease > real(0) && scalar::is_finite(there))) {
      refuse();
      running = running && decrease != real(0);
      return false;
    }
    damping = damping * factor_after(decrease);
    growth = plain(2);
    small_gains = decrease * real(1000) < cost ? small_gains + 1 : 0;
    cost = there;
    trials_left = params.trials;
    running = --steps_left > 0 && small_gains < 3;
    return true;
  }

  /// The next trial, or, no longer `running`, the answer.
  /// @param sums at T
  /// @param T the best pose so far
  /// @param small a step whose components are all shorter ends the descent, unevaluated
  FT_HOST_DEVICE rigid<real> propose(pose_sums<real> const& sums, rigid<real> const& T,
                                     pose_params const& params, float small) {
    real step[6];
    while (running && !solve(sums, step)) { refuse(); }
    if (!running) { return T; }
    expected = plain(1e-3);
    bool all_small = true;
    for (int k = 0; k < 6; ++k) {
      expected = expected + step[k] * (damping * step[k] + real(sums.of[k]));
      all_small = all_small && scalar::abs(step[k]) < real(static_cast<plain>(small));
    }
    running = !all_small;
    // After a refused trial the step is small because of the damping: a longer one was no better.
    return all_small && trials_left < params.trials ? T : exp_se3(step) * T;
  }

private:
  /// Float is for many observations, which leave blocks that are well conditioned, and for speed.
  FT_HOST_DEVICE bool solve(pose_sums<real> const& sums, real (&step)[6]) const {
    if constexpr (std::is_same_v<plain, float>) {
      return solve_6_in_blocks(sums.of, damping, step);
    } else {
      return solve_6(sums.of, damping, step);
    }
  }
  /// Nielsen's factor of the damping after an accepted trial.
  FT_HOST_DEVICE real factor_after(real decrease) const {
    real const least = plain(1.0 / 3.0);
    // There the cube below is above 2/3. Most steps are as good, and are spared the division.
    if (decrease > real(plain(0.94)) * expected) { return least; }
    real const m = real(2) * (decrease / expected) - real(1);
    return max_of(least, min_of(real(1) - m * m * m, real(plain(2.0 / 3.0))));
  }
  /// Increases the damping after a refused trial, or ends the descent.
  FT_HOST_DEVICE void refuse() {
    damping = damping * growth;
    growth = growth * real(2);
    running = --trials_left > 0 && scalar::is_finite(damping);
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
