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
  /// @param found of the window, with a solution
  FT_HOST_DEVICE window_equations(Group g, initialization_scratch& s,
                                  initialization_window const& in, initialization_params const& p,
                                  inertial_initialization const& found)
      : params_(p), without_prior_(p), work_(g, s, in, without_prior_), equations_(s.equations) {
    without_prior_.accel_bias_sigma = 1e6f;
    work_.gyro_bias = found.newest.bg.template cast<real64>();
    work_.find_rest();
    work_.join_integrals();
    work_.build();
    known_ = equations_.factor_columns(g, eliminated);
    for (int i = 0; i < eliminated; ++i) {
      z_[i] = equations_.b[i];
      for (int k = 0; k < i; ++k) { z_[i] -= equations_.A[n * i + k] * z_[k]; }
    }
    // The poses' given deviation may be too small, as for the window's own certainty.
    real64 const sigma = static_cast<double>(p.position_sigma);
    real64 const rms = static_cast<double>(found.position_rms);
    real64 const count = static_cast<double>(3 * in.count);
    real64 const freedom = max_of(count - real64(9.0), real64(1.0));
    real64 const excess = rms * rms * count / (freedom * sigma * sigma);
    weight_ = real64(1.0) / max_of(real64(1.0), excess);
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
      for (int m = 0; m < eliminated; ++m) { right -= factor(i, m) * z_[m]; }
      sum.b[i] = (k * real64(sum.b[i]) + weight_ * right).value;
    }
    if (g.rank() == 0) { ++sum.count; }
    g.sync();
  }
  /// Solves the sum, beginning at the window's own gravity, and writes gravity, bias and the
  /// velocity that follows.
  FT_HOST_DEVICE bool solve(joined_windows const& sum, inertial_initialization& found) {
    if (!work_.set_gravity(found.gravity.template cast<real64>())) { return false; }
    real64 const prior = static_cast<double>(params_.accel_bias_sigma);
    real64 bias[3];
    FT_NO_UNROLL
    for (int step = 0; step <= I::refinements; ++step) {
      least_squares<5> e;  // each thread's own
      single_group const alone;
      e.begin(alone, 5);
      add_sum(sum, e);
      for (int i = 0; i < 3; ++i) { e.pull_to_zero(alone, i, real64(1.0) / (prior * prior)); }
      real64 x[5] = {e.b[0], e.b[1], e.b[2], e.b[3], e.b[4]};
      if (!e.factor(alone)) { return false; }
      e.solve(x);
      for (int i = 0; i < 3; ++i) { bias[i] = x[i]; }
      strict_vec3d const pull =
          work_.gravity + scaled(work_.basis[0], x[3]) + scaled(work_.basis[1], x[4]);
      strict_vec3d const before = work_.gravity;
      if (!work_.set_gravity(pull)) { return false; }
      strict_vec3d const change = work_.gravity - before;
      if (dot(change, change) < real64(I::step_tolerance * I::step_tolerance)) { break; }
    }
    set_velocity(bias);
    describe_state(work_, found, nullptr);
    return true;
  }

private:
  /// The sum in terms of the bias and of two turns of gravity from where it is.
  FT_HOST_DEVICE void add_sum(joined_windows const& sum, least_squares<5>& e) const {
    real64 turned[kept][5];  // A times the derivative
    real64 off[kept];
    for (int r = 0; r < kept; ++r) {
      off[r] = sum.b[r];
      for (int axis = 0; axis < 3; ++axis) {
        turned[r][axis] = sum.A[kept * r + axis];
        off[r] -= real64(sum.A[kept * r + 3 + axis]) * component(work_.gravity, axis);
      }
      for (int i = 3; i < 5; ++i) {
        turned[r][i] = real64(sum.A[kept * r + 3]) * work_.basis[i - 3].x +
                       real64(sum.A[kept * r + 4]) * work_.basis[i - 3].y +
                       real64(sum.A[kept * r + 5]) * work_.basis[i - 3].z;
      }
    }
    auto const project = [&](int i, real64 const* column, int stride) {
      if (i < 3) { return column[i * stride]; }
      strict_vec3d const d = work_.basis[i - 3];
      return d.x * column[3 * stride] + d.y * column[4 * stride] + d.z * column[5 * stride];
    };
    for (int i = 0; i < 5; ++i) {
      for (int j = 0; j <= i; ++j) { e.A[5 * i + j] = project(i, &turned[0][j], 5); }
      e.b[i] = project(i, off, 1);
    }
  }
  FT_HOST_DEVICE real64 factor(int i, int m) const {
    return equations_.A[n * (eliminated + i) + m];
  }
  FT_HOST_DEVICE real64 pivot(int m) const { return equations_.A[n * m + m]; }
  /// Velocity and position of the window, by substitution into its own equations.
  FT_HOST_DEVICE void set_velocity(real64 const (&bias)[3]) {
    real64 x[eliminated + kept];
    for (int i = 0; i < 3; ++i) {
      x[eliminated + i] = bias[i];
      x[eliminated + 3 + i] = component(work_.gravity, i);
    }
    for (int i = eliminated - 1; i >= 0; --i) {
      x[i] = z_[i] / pivot(i);
      for (int k = i + 1; k < eliminated + kept; ++k) { x[i] -= equations_.A[n * k + i] * x[k]; }
    }
    for (int i = 0; i < eliminated + 3; ++i) { work_.x[i] = x[i]; }
  }

  initialization_params const& params_;
  initialization_params without_prior_;
  I work_;
  typename I::system& equations_;
  real64 z_[eliminated];
  real64 weight_;
  bool known_;
};

/// join_window() by a group, whose threads all get the same result.
template <typename Group>
FT_HOST_DEVICE bool join_window_by(Group g, initialization_scratch& s,
                                   initialization_window const& in,
                                   initialization_params const& params, float keep,
                                   joined_windows& sum, inertial_initialization& found) {
  window_equations<Group> equations(g, s, in, params, found);
  if (!equations.known()) { return false; }
  equations.add_to(sum, keep);
  return equations.solve(sum, found);
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
  return detail::join_window_by(single_group{}, scratch, in, params, keep, sum, found);
}

}  // namespace FT_ABI
}  // namespace ft
