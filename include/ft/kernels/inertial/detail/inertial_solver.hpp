// SPDX-License-Identifier: Apache-2.0
/// @file Gauss-Newton steps over a frame's state, and that of the frame before it.
#pragma once

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/inertial/detail/information.hpp"
#include "ft/kernels/inertial/detail/visual_residual.hpp"
#include "ft/kernels/inertial/inertial_problem.hpp"
#include "ft/kernels/pose/detail/damped_descent.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Sums of the observations: 6 of the gradient, 21 of the curvature's upper triangle by rows.
inline constexpr int visual_terms = 27;

struct inertial_scratch {
  ordered_sum_scratch<visual_terms, double> visual;
  information_scratch matrices;
  pose_mount mount;
  wide_state first;    ///< the last keyframe's or the last frame's
  wide_state frame;    ///< the frame's
  rigid<real64> T_cw;  ///< the frame's
  inertial_link link;
  real64 omega[81];
  real64 walk[6];  ///< information of the biases' change
  wide_state prior;
  real64 prior_H[225];
  inertial_rows rows;
  real64 weighted[inertial_rows::rows][inertial_rows::columns];  ///< omega times rows
  prior_residual at_prior;
  real64 prior_HJ[225];  ///< prior_H times the derivative of the prior's error
  real64 prior_He[15];
  real64 prior_weight;
};

/// The observations of one problem.
struct inertial_observations {
  observation const* items;
  float const* distance;  ///< or null
  unsigned char* outlier;
  int count;
  int const* number;
  float const* moves;  ///< or null

  /// Whether the keypoint of observation i was moved to its point's patch.
  FT_HOST_DEVICE bool is_aligned(int i) const { return moves != nullptr && moves[number[i]] >= 0; }
};

/// Linearises a problem at the states in scratch, and moves them. By one group, of one thread or
/// of sum_lanes. Parts that do not depend on each other are done by different warps.
template <typename Group, typename Rig>
struct inertial_solver {
  Group g;
  inertial_scratch& s;
  Rig const& rig;
  inertial_observations seen;
  bool both;              ///< whether the first state moves, too, and has a prior
  double step_tolerance;  ///< a step of which all components are below this is none

  /// Whether this thread's warp does job k of several at the same time.
  FT_HOST_DEVICE bool is_part(int k) const {
    return g.part_index() == (g.parts() > k ? g.parts() - 1 - k : 0);
  }
  /// Whether this thread does job k.
  FT_HOST_DEVICE bool is_thread(int k) const { return is_part(k) && g.part().rank() == 0; }

  /// What came of a step.
  enum class outcome : int {
    undetermined,  ///< none was made: the information does not determine the states
    moved,
    settled,  ///< moved by so little that more steps would change nothing
  };

  /// A Gauss-Newton step. Ends with a sync.
  /// @param robust whether observations have Huber weights
  /// @param chi2 [count] the squared weighted errors before the step, of those that take part
  FT_HOST_DEVICE outcome step(bool robust, float* chi2) const {
    linearize(robust, chi2);
    assemble_system();
    auto& system = s.matrices.system;
    system.eliminate_all(g, begin(), unknown::all, unknown::all + 1);
    if (system.positive == 0) { return outcome::undetermined; }
    return move_states() ? outcome::moved : outcome::settled;
  }

  /// Writes what the states' information leaves to the frame's state, without any robust weights.
  /// Ends with a sync.
  /// @param information [225], row-major
  FT_HOST_DEVICE void marginalize(double* information) const {
    linearize(false, nullptr);
    auto& a = s.matrices.system.a;
    constexpr int end = 2 * state_rows;
    for (int i = begin() + g.part_index(); i < end; i += g.parts()) {
      for (int j = i + g.part().rank(); j < end; j += g.part().size()) {
        real64 sum = walk_entry(i, j);
        if (j < unknown::all) { sum += entry(i, j, real64(1.0)); }
        a[i][j] = sum;
      }
    }
    g.sync();
    if (both) { eliminate_first_state(g, s.matrices); }
    pose_mount const& mount = s.mount;
    change_unknowns(g, s.matrices, state_rows, [&](int i, int j) { return mount.entry(i, j); });
    write_information(g, s.matrices, state_rows, information);
  }

private:
  /// Whether cameras are elsewhere than the frame of the pose, with all entries of a derivative.
  static constexpr bool displaced =
      Rig::rectified && !std::is_same_v<Rig, rectified_rig> && !is_monocular_v<Rig>;

  FT_HOST_DEVICE int begin() const { return both ? 0 : unknown::r2; }

  /// All sums and derivatives at the states. Ends with a sync.
  FT_HOST_DEVICE void linearize(bool robust, float* chi2) const {
    if (is_thread(0)) { s.link.write_rotation(s.first, s.frame, s.mount, s.rows); }
    if (is_thread(1)) { s.link.write_motion(s.first, s.frame, s.mount, s.rows); }
    if (both && is_part(2)) { weigh_prior(); }
    sum_observations(robust, chi2);
    constexpr int columns = inertial_rows::columns;
    for (int k = g.rank(); k < inertial_rows::rows * columns; k += g.size()) {
      int const i = k / columns;
      int const j = k - columns * i;
      if (j < begin()) { continue; }
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < 9; ++m) { sum += s.omega[9 * i + m] * s.rows.J[m][j]; }
      s.weighted[i][j] = sum;
    }
    for (int k = g.rank(); both && k < 225; k += g.size()) {
      int const i = k / 15;
      int const j = k - 15 * i;
      // A row of H times J is J^T times that row: H is symmetric.
      s.prior_HJ[k] = s.at_prior.transposed_times(j, s.prior_H + 15 * i, 1);
    }
    g.sync();
  }

  /// The prior's error, and its weight: Huber's with a limit of 5. By a warp.
  FT_HOST_DEVICE void weigh_prior() const {
    auto const part = g.part();
    if (part.rank() == 0) { s.at_prior.set(s.prior, s.first); }
    part.sync();
    for (int i = part.rank(); i < 15; i += part.size()) {
      real64 sum = 0.0;
      for (int m = 0; m < 15; ++m) { sum += s.prior_H[15 * i + m] * s.at_prior.error[m]; }
      s.prior_He[i] = sum;
    }
    part.sync();
    if (part.rank() == 0) {
      real64 c = 0.0;
      for (int m = 0; m < 15; ++m) { c += s.at_prior.error[m] * s.prior_He[m]; }
      s.prior_weight = c > real64(25.0) ? real64(5.0) / scalar::sqrt(c) : real64(1.0);
    }
  }

  FT_HOST_DEVICE void sum_observations(bool robust, float* chi2) const {
    // Roots of 95 % of 2 and of 3 degrees of freedom.
    real64 const limit_mono = static_cast<double>(2.44765186f);
    real64 const limit_stereo = static_cast<double>(2.79553223f);
    real64 const limit_aligned = scalar::sqrt(real64(aligned_robust));
    auto const add = [&](int i, sum_terms<visual_terms, double>& acc) {
      if (seen.outlier[i] != 0) { return; }
      observation const o = seen.items[i];
      visual_residual<Rig> const r(rig, s.T_cw, o);
      if (chi2 != nullptr) { chi2[i] = static_cast<float>(r.chi2.value); }
      if (!r.usable()) { return; }
      bool const tight = !robust && seen.is_aligned(i);
      real64 const times = tight ? static_cast<double>(aligned_at_last) : 1.0;
      real64 const square = r.chi2 * times;
      real64 weight = real64(static_cast<double>(o.inv_sigma2)) * times;
      real64 const limit = tight ? limit_aligned : r.rows == 3 ? limit_stereo : limit_mono;
      if ((robust || tight) && square > limit * limit) { weight *= limit / scalar::sqrt(square); }
      strict_vec3d const W{weight, weight, r.rows == 3 ? weight : real64(0.0)};
      strict_vec3d const e{r.error[0], r.error[1], r.error[2]};
      if constexpr (displaced) {
        add_motion_terms(r.in_pose, displaced_equations(r.P, W, e), acc.of);
      } else if constexpr (Rig::rectified && !is_monocular_v<Rig>) {
        add_motion_terms(r.in_pose, rectified_equations(r.P, W, e), acc.of);
      } else {
        add_motion_terms(r.in_pose, monocular_equations(r.P, W, e), acc.of);
      }
    };
    ordered_sum<visual_terms>(g, s.visual, seen.count, add);
  }

  /// Entry (i, j), i <= j, of the information of the unknowns; column unknown::all is the gradient.
  FT_HOST_DEVICE real64 entry(int i, int j, real64 prior_weight) const {
    real64 sum = 0.0;
    FT_UNROLL
    for (int m = 0; m < 9; ++m) { sum += s.rows.J[m][i] * s.weighted[m][j]; }
    constexpr int r2 = unknown::r2;
    bool const gradient = j == unknown::all;
    if (i < r2 && (gradient || j < r2)) {
      real64 const* const from = gradient ? s.prior_He : s.prior_HJ + j;
      int const stride = gradient ? 1 : 15;
      sum += prior_weight * s.at_prior.transposed_times(i, from, stride);
    } else if (i >= r2 && i < r2 + 6 && (gradient || j < r2 + 6)) {
      int const row = i - r2;
      int const at = gradient ? row : 6 + row * 6 - row * (row - 1) / 2 + (j - i);
      sum += s.visual.total.of[at];
    }
    return sum;
  }
  /// Entry (i, j), i <= j, of the biases' walk; the frame's biases follow the unknowns.
  FT_HOST_DEVICE real64 walk_entry(int i, int j) const {
    int const k = i - unknown::g1;
    if (i >= unknown::all) { return i == j ? s.walk[i - unknown::all] : real64(0.0); }
    if (k < 0 || k >= 6) { return 0.0; }
    return i == j ? s.walk[k] : (j == unknown::all + k ? -s.walk[k] : real64(0.0));
  }

  FT_HOST_DEVICE void assemble_system() const {
    auto& system = s.matrices.system;
    if (g.rank() == 0) { system.begin(); }
    for (int i = begin() + g.part_index(); i < unknown::all; i += g.parts()) {
      for (int j = i + g.part().rank(); j <= unknown::all; j += g.part().size()) {
        real64 const sum = entry(i, j, s.prior_weight);
        system.a[i][j] = j == unknown::all ? -sum : sum;
      }
    }
    g.sync();
  }

  /// @return whether any component of the step, rad, m, m/s, rad/s or m/s^2, counts
  FT_HOST_DEVICE bool move_states() const {
    bool counts = false;
    auto const solution = [&](int k) {
      strict_vec3d const d = s.matrices.system.solution(k, unknown::all);
      auto const small = [this](real64 v) { return scalar::abs(v) < real64(step_tolerance); };
      counts = counts || !(small(d.x) && small(d.y) && small(d.z));
      return d;
    };
    if (is_thread(0)) {
      strict_vec3d const turn = solution(unknown::r2);
      strict_vec3d const shift = solution(unknown::t2);
      wide_state& x = s.frame;
      x.p = x.p + x.R * s.mount.shift_of_body(turn, shift);
      x.R = x.R * rotation_exp(s.mount.turn_of_body(turn));
      x.v = x.v + solution(unknown::v2);
      s.T_cw = s.mount.pose_of(x);
    }
    if (is_thread(1)) {
      wide_state& x = s.first;
      if (both) {
        x.p = x.p + x.R * solution(unknown::t1);
        x.R = x.R * rotation_exp(solution(unknown::r1));
        x.v = x.v + solution(unknown::v1);
        x.bg = x.bg + solution(unknown::g1);
        x.ba = x.ba + solution(unknown::a1);
      }
      s.frame.bg = x.bg;
      s.frame.ba = x.ba;
    }
    return g.any(counts);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
