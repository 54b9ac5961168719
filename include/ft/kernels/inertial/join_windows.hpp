// SPDX-License-Identifier: Apache-2.0
/// @file Gravity and the accelerometer's bias from several initialisations of one body.
///
/// While a body keeps its attitude, a bias across gravity looks like a tilt of gravity: a window of
/// keyframes shows their combination alone, and its own estimate of such a bias is near its prior,
/// zero. Combinations of windows with other attitudes tell both apart. So what is summed over
/// windows is not their estimates but their normal equations, in which velocity and position are
/// eliminated by the Schur complement; older windows count less. (The information form of a filter
/// with fading memory: Simon, "Optimal State Estimation", Wiley 2006, sections 6.2 and 7.4.)
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/inertial/detail/initialization_description.hpp"
#include "ft/kernels/inertial/detail/initialization_solver.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Sum of windows' normal equations. The unknowns are the accelerometer's bias in the body and
/// gravity in the world of the poses, in this order, m/s^2. All zero: no window yet.
struct joined_windows {
  static constexpr int unknowns = 6;
  double A[unknowns * unknowns];  ///< symmetric
  double b[unknowns];
  int count;  ///< windows

  FT_HOST_DEVICE static joined_windows none() { return joined_windows{}; }
};

namespace detail {

/// The equations of one window in which velocity and position are eliminated.
template <typename Group>
class window_equations {
  using I = inertial_initializer<Group>;
  static constexpr int n = I::most_unknowns;
  static constexpr int eliminated = I::bias;  ///< velocity and position come before the bias
  static constexpr int kept = joined_windows::unknowns;

public:
  /// @param without_prior `p` without a prior of the bias
  /// @param found of the window, with a solution, in memory that the group shares
  FT_HOST_DEVICE window_equations(Group g, initialization_scratch& s,
                                  initialization_window const& in, initialization_params const& p,
                                  initialization_params const& without_prior,
                                  inertial_initialization const& found)
      : params_(p), work_(g, s, in, without_prior), equations_(s.equations) {
    if (g.rank() == 0) { s.gyro_bias = found.newest.bg.template cast<real64>(); }
    g.sync();
    work_.find_rest();
    work_.join_integrals();
    work_.build();
    known_ = equations_.factor_columns(g, eliminated);
    if (g.rank() == 0) { substitute(); }
    // The poses' given deviation may be too small, as for the window's own certainty.
    real64 const sigma = static_cast<double>(p.position_sigma);
    real64 const rms = static_cast<double>(found.position_rms);
    real64 const count = static_cast<double>(3 * in.count);
    real64 const freedom = max_of(count - real64(9.0), real64(1.0));
    real64 const excess = rms * rms * count / (freedom * sigma * sigma);
    weight_ = real64(1.0) / max_of(real64(1.0), excess);
    g.sync();
  }
  FT_HOST_DEVICE bool known() const { return known_; }

  /// Adds them; a thread has a row. Ends with a sync.
  /// @param keep share of the weights of all earlier windows that remains
  FT_HOST_DEVICE void add_to(joined_windows& sum, float keep) const {
    real64 const k = static_cast<double>(keep);
    Group const g = work_.g;
    for (int i = g.rank(); i < kept; i += g.size()) {
      for (int j = 0; j <= i; ++j) {
        real64 value = equations_.A[n * (eliminated + i) + eliminated + j];
        for (int m = 0; m < eliminated; ++m) { value -= factor(i, m) * factor(j, m) * pivot(m); }
        value = k * real64(sum.A[kept * i + j]) + weight_ * value;
        sum.A[kept * i + j] = sum.A[kept * j + i] = value.value;
      }
      real64 right = equations_.b[eliminated + i];
      for (int m = 0; m < eliminated; ++m) { right -= factor(i, m) * eliminated_right(m); }
      sum.b[i] = (k * real64(sum.b[i]) + weight_ * right).value;
    }
    if (g.rank() == 0) { ++sum.count; }
    g.sync();
  }
  /// Solves the sum, beginning at the window's own gravity, and writes gravity, bias and the
  /// velocity that follows. Ends with a sync.
  FT_HOST_DEVICE bool solve(joined_windows const& sum, inertial_initialization& found) {
    Group const g = work_.g;
    bool solved = false;
    if (g.rank() == 0) { solved = solve_sum(sum, found.gravity.template cast<real64>()); }
    if (!g.any(solved)) { return false; }
    describe_state(work_, found, nullptr);
    return true;
  }

private:
  /// The right-hand sides of velocity and position, once those before are eliminated. They take the
  /// place of a solution, as the system has none.
  FT_HOST_DEVICE real64 eliminated_right(int m) const { return equations_.x[m]; }
  FT_HOST_DEVICE void substitute() {
    real64* const z = equations_.x;
    for (int i = 0; i < eliminated; ++i) {
      z[i] = equations_.b[i];
      for (int k = 0; k < i; ++k) { z[i] -= equations_.A[n * i + k] * z[k]; }
    }
  }
  /// A thread's part of solve().
  FT_HOST_DEVICE bool solve_sum(joined_windows const& sum, strict_vec3d const& gravity) {
    initialization_scratch& s = work_.s;
    least_squares<5>& e = s.sum;
    if (!work_.set_gravity(gravity)) { return false; }
    real64 const prior = static_cast<double>(params_.accel_bias_sigma);
    FT_NO_UNROLL
    for (int step = 0; step <= I::refinements; ++step) {
      single_group const alone;
      e.begin(alone, 5);
      add_sum(sum, e);
      for (int i = 0; i < 3; ++i) { e.pull_to_zero(alone, i, real64(1.0) / (prior * prior)); }
      if (!e.factor(alone)) { return false; }
      e.solve();
      strict_vec3d const pull = s.gravity + scaled(s.basis[0], e.x[3]) + scaled(s.basis[1], e.x[4]);
      strict_vec3d const before = s.gravity;
      if (!work_.set_gravity(pull)) { return false; }
      strict_vec3d const change = s.gravity - before;
      if (dot(change, change) < real64(I::step_tolerance * I::step_tolerance)) { break; }
    }
    set_velocity(e.x);
    return true;
  }

  /// The sum in terms of the bias and of two turns of gravity from where it is.
  FT_HOST_DEVICE void add_sum(joined_windows const& sum, least_squares<5>& e) const {
    initialization_scratch const& s = work_.s;
    // Column j of A times the derivative, and what is right of it, by a row.
    auto const turned = [&](int r, int j) {
      if (j < 3) { return real64(sum.A[kept * r + j]); }
      strict_vec3d const d = s.basis[j - 3];
      return real64(sum.A[kept * r + 3]) * d.x + real64(sum.A[kept * r + 4]) * d.y +
             real64(sum.A[kept * r + 5]) * d.z;
    };
    auto const off = [&](int r) {
      real64 value = sum.b[r];
      for (int axis = 0; axis < 3; ++axis) {
        value -= real64(sum.A[kept * r + 3 + axis]) * component(s.gravity, axis);
      }
      return value;
    };
    auto const project = [&](int i, auto const& of_row) {
      if (i < 3) { return of_row(i); }
      strict_vec3d const d = s.basis[i - 3];
      return d.x * of_row(3) + d.y * of_row(4) + d.z * of_row(5);
    };
    FT_NO_UNROLL
    for (int i = 0; i < 5; ++i) {
      FT_NO_UNROLL
      for (int j = 0; j <= i; ++j) {
        e.A[5 * i + j] = project(i, [&](int r) { return turned(r, j); });
      }
      e.b[i] = project(i, off);
    }
  }
  FT_HOST_DEVICE real64 factor(int i, int m) const {
    return equations_.A[n * (eliminated + i) + m];
  }
  FT_HOST_DEVICE real64 pivot(int m) const { return equations_.A[n * m + m]; }
  /// Velocity and position of the window, by substitution into its own equations.
  FT_HOST_DEVICE void set_velocity(real64 const* bias) {
    initialization_scratch& s = work_.s;
    real64(&x)[n] = s.asked[0];
    for (int i = 0; i < 3; ++i) {
      x[eliminated + i] = bias[i];
      x[eliminated + 3 + i] = component(s.gravity, i);
    }
    for (int i = eliminated - 1; i >= 0; --i) {
      x[i] = eliminated_right(i) / pivot(i);
      for (int k = i + 1; k < eliminated + kept; ++k) { x[i] -= equations_.A[n * k + i] * x[k]; }
    }
    for (int i = 0; i < eliminated + 3; ++i) { s.x[i] = x[i]; }
  }

  initialization_params const& params_;
  I work_;
  typename I::system& equations_;
  real64 weight_;
  bool known_;
};

/// join_window() by a group, whose threads all get the same result. Ends with a sync.
/// @param without_prior see window_equations @param found in memory that the group shares
template <typename Group>
FT_HOST_DEVICE bool join_window_by(Group g, initialization_scratch& s,
                                   initialization_window const& in,
                                   initialization_params const& params,
                                   initialization_params const& without_prior, float keep,
                                   joined_windows& sum, inertial_initialization& found) {
  window_equations<Group> equations(g, s, in, params, without_prior, found);
  if (!equations.known()) { return false; }
  equations.add_to(sum, keep);
  return equations.solve(sum, found);
}

/// Parameters with which a window's equations hold no prior of the accelerometer's bias.
FT_HOST_DEVICE inline initialization_params without_bias_prior(initialization_params p) {
  p.accel_bias_sigma = 1e6f;
  return p;
}

}  // namespace detail

/// Adds what a window says to the sum, and replaces gravity, the accelerometer's bias and the
/// velocity found in it by those of the sum. Host and device; the same bits on both. Allocates
/// nothing.
/// @param in poses in metres @param found of initialize_window() for it, with a solution
/// @param keep share of the weights of all earlier windows that remains, (0, 1]
/// @return false where the equations have no solution; then `found` stays as it was
FT_HOST_DEVICE inline bool join_window(initialization_window const& in,
                                       initialization_params const& params, float keep,
                                       joined_windows& sum, inertial_initialization& found) {
  detail::initialization_scratch scratch;
  return detail::join_window_by(single_group{}, scratch, in, params,
                                detail::without_bias_prior(params), keep, sum, found);
}

}  // namespace FT_ABI
}  // namespace ft
