// SPDX-License-Identifier: Apache-2.0
/// @file Stage: states of frames from their map points and their IMU.
#pragma once

#include <cstddef>

#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/inertial/detail/inertial_solver.hpp"
#include "ft/kernels/inertial/detail/information.hpp"
#include "ft/kernels/inertial/detail/visual_residual.hpp"
#include "ft/kernels/inertial/inertial_problem.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// What the optimisation of a state and its marginalisation have in common.

namespace detail {

/// Numbers that a structure of nothing else begins with, for checks that threads share.
template <typename T>
struct leading_numbers {
  T const* first;
  int count;

  template <typename Group>
  FT_HOST_DEVICE bool finite(Group g) const {
    bool good = true;
    for (int k = g.rank(); k < count; k += g.size()) { good = good && scalar::is_finite(first[k]); }
    return good;
  }
};

/// A problem and its working memory.
template <typename Rig>
struct inertial_pose_item {
  using scratch = inertial_scratch;
  Rig rig;
  imu_mount mount;
  inertial_pose_params params;

protected:
  FT_HOST_DEVICE static inertial_observations observations_of(int b, inertial_poses const& in) {
    auto const at = static_cast<std::ptrdiff_t>(b) * in.capacity;
    return {in.observations + at,
            in.distance == nullptr ? nullptr : in.distance + at,
            in.outlier + at,
            clamp(in.count[b], 0, in.capacity),
            in.number == nullptr ? nullptr : in.number + at,
            in.moves == nullptr ? nullptr : in.moves + static_cast<std::ptrdiff_t>(b) * in.numbers};
  }
  /// The integral whose walk counts.
  FT_HOST_DEVICE preintegrated const& walk_of(int b, inertial_poses const& in, bool both) const {
    bool const slip = params.reference_quirks && both && in.since_keyframe != nullptr;
    return slip ? in.since_keyframe[b] : in.integral[b];
  }
  FT_HOST_DEVICE static leading_numbers<float> numbers(preintegrated const& v) {
    static_assert(offsetof(preintegrated, steps) == 160 * sizeof(float), "160 floats");
    return {&v.dT, 160};
  }
  FT_HOST_DEVICE static leading_numbers<float> numbers(stored_inertial_state const& v) {
    static_assert(sizeof(stored_inertial_state) == 16 * sizeof(float), "16 floats");
    return {&v.q_cw.x, 16};
  }
  FT_HOST_DEVICE static leading_numbers<double> numbers(inertial_prior const& v) {
    static_assert(offsetof(inertial_prior, known) == 246 * sizeof(double), "246 doubles");
    return {&v.state.R.m[0], 246};
  }

  /// Fills scratch, but for the states, which are written before. Ends with a sync.
  template <typename Group, typename Solver>
  FT_HOST_DEVICE void load_terms(Group g, scratch& s, int b, inertial_poses const& in,
                                 Solver const& solver) const {
    preintegrated const& integral = in.integral[b];
    if (solver.is_thread(0)) { s.mount = pose_mount::of(mount); }
    if (solver.is_thread(1)) {
      s.link =
          inertial_link::of(integral, in.gravity == nullptr ? standard_gravity() : in.gravity[b]);
    }
    if (solver.is_thread(2)) {
      s.prior_weight = 1.0;
      if (solver.both) { s.prior = cast_state<real64>(in.prior[b].state); }
    }
    for (int k = g.rank(); solver.both && k < 225; k += g.size()) {
      s.prior_H[k] = in.prior[b].information[k];
    }
    preintegrated const& walked = walk_of(b, in, solver.both);
    for (int k = g.rank(); k < 6; k += g.size()) {
      s.walk[k] = scalar::reciprocal(real64(static_cast<double>(walked.walk[k])));
    }
    s.rows.clear(g);
    information_of(g, s.matrices, integral, params.reference_quirks, s.omega);
  }

  /// Writes what the states in scratch leave to the next frame. Ends with a sync.
  /// @return whether all of it is finite
  template <typename Group, typename Solver>
  FT_HOST_DEVICE bool write_prior(Group g, scratch const& s, inertial_prior& next,
                                  Solver const& solver) const {
    solver.marginalize(next.information);
    if (g.rank() == 0) {
      next.state = cast_state<double>(s.frame);
      next.known = 1;
    }
    g.sync();
    return !g.any(!numbers(next).finite(g));
  }
};

inline void require_finite_pose(rigid<float> const& T) {
  for (float const v : T.R.m) { require_finite("imu mount rotation", v); }
  require_finite("imu mount x", T.t.x);
  require_finite("imu mount y", T.t.y);
  require_finite("imu mount z", T.t.z);
}
/// @throws bad_argument
inline void require_inertial_poses(inertial_poses const& in, imu_mount const& mount) {
  require(in.problems >= 0 && in.capacity >= 0, "a number of problems or a capacity < 0");
  require_finite_pose(mount.T_bc);
  require_finite_pose(mount.T_cb);
}

/// Item: a problem.
template <typename Rig>
struct optimize_inertial_pose : inertial_pose_item<Rig> {
  using item = inertial_pose_item<Rig>;
  using typename item::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, inertial_poses const& in) const {
    bool const both = in.from_last_frame[b] != 0;
    inertial_observations const seen = item::observations_of(b, in);
    for (int i = g.rank(); !this->params.outliers_given && i < seen.count; i += g.size()) {
      seen.outlier[i] = 0;
    }
    inertial_solver<Group, Rig> const solver{g,    s,    this->rig,
                                             seen, both, this->params.step_tolerance};
    inertial_pose_status const refused = inspect(g, b, in, both);
    if (refused != inertial_pose_status::optimised) {
      if (g.rank() == 0) { refuse(b, in, refused); }
      return;
    }
    load_states(s, b, in, solver);
    this->load_terms(g, s, b, in, solver);
    auto const at = static_cast<std::ptrdiff_t>(b) * in.capacity;
    run(g, s, in.chi2 + at * inertial_rounds, in.capacity, solver, in.result[b]);
    bool finite = write_states(g, s, in.result[b]);
    if (this->params.marginalizes) {
      finite = this->write_prior(g, s, in.next_prior[b], solver) && finite;
    }
    if (!finite && g.rank() == 0) { refuse(b, in, inertial_pose_status::not_finite); }
  }

private:
  /// Why a problem is refused; `optimised` if it is not.
  template <typename Group>
  FT_HOST_DEVICE inertial_pose_status inspect(Group g, int b, inertial_poses const& in,
                                              bool both) const {
    preintegrated const& integral = in.integral[b];
    bool const steps = usable(integral.status) && integral.steps > 0;
    preintegrated const& walked = this->walk_of(b, in, both);
    bool const walk_steps = usable(walked.status) && walked.steps > 0;
    bool const known = !both || (in.prior != nullptr && in.prior[b].known != 0);
    bool good = item::numbers(integral).finite(g) && item::numbers(in.first[b]).finite(g) &&
                item::numbers(in.start[b]).finite(g);
    if (both && in.prior != nullptr) { good = good && item::numbers(in.prior[b]).finite(g); }
    for (int k = g.rank(); k < 6; k += g.size()) {
      good = good && walked.walk[k] > 0 && scalar::is_finite(1.0f / walked.walk[k]);
    }
    good = !g.any(!good);
    if (!steps || !walk_steps) { return inertial_pose_status::no_integral; }
    if (!known) { return inertial_pose_status::no_prior; }
    if (!good || !(integral.dT > 0)) { return inertial_pose_status::not_finite; }
    return inertial_pose_status::optimised;
  }
  FT_HOST_DEVICE static void refuse(int b, inertial_poses const& in, inertial_pose_status status) {
    inertial_pose_result& result = in.result[b];
    result.stored = in.start[b];
    result.status = status;
    result.tracked = 0;
    result.inliers = 0;
    result.rounds = 0;
    in.next_prior[b].known = 0;
  }

  template <typename Solver>
  FT_HOST_DEVICE void load_states(scratch& s, int b, inertial_poses const& in,
                                  Solver const& solver) const {
    if (solver.is_thread(0)) {
      s.frame = cast_state<real64>(body_state(in.start[b], this->mount));
      s.T_cw = pose_mount::of(this->mount).pose_of(s.frame);
    }
    if (solver.is_thread(1)) { s.first = cast_state<real64>(body_state(in.first[b], this->mount)); }
  }

  /// The states after the last round. Ends with a sync.
  /// @return whether what is stored is finite
  template <typename Group>
  FT_HOST_DEVICE bool write_states(Group g, scratch const& s, inertial_pose_result& result) const {
    if (g.rank() == 0) {
      result.first = cast_state<double>(s.first);
      result.stored = stored_state(cast_state<float>(s.frame), this->mount);
    }
    g.sync();
    return !g.any(!item::numbers(result.stored).finite(g));
  }

  /// All rounds, and the recovery of outliers.
  /// @param chi2 [inertial_rounds][capacity]
  template <typename Group, typename Solver>
  FT_HOST_DEVICE void run(Group g, scratch& s, float* chi2, int capacity, Solver const& solver,
                          inertial_pose_result& result) const {
    constexpr int steps = 10;
    constexpr int enough_terms = 10;
    constexpr int few_inliers = 30;
    int const count = solver.seen.count;
    int const others = solver.both ? 4 : 3;  // terms that are no observations
    bool early = false;
    int rounds = 0;
    int inliers = 0;
    FT_NO_UNROLL
    for (bool more = true; more && this->params.first_round + rounds < inertial_rounds; ++rounds) {
      int const round = this->params.first_round + rounds;
      float* const judged = chi2 + static_cast<std::ptrdiff_t>(rounds) * capacity;
      auto last = Solver::outcome::moved;
      FT_NO_UNROLL
      for (int step = 0; last == Solver::outcome::moved && step < steps; ++step) {
        last = solver.step(round + 1 < inertial_rounds, judged);
      }
      early = early || last == Solver::outcome::undetermined;
      inliers = classify(g, s, round, judged, solver);
      if (g.rank() == 0) { result.round_state[rounds] = cast_state<double>(s.frame); }
      more = count + others >= enough_terms;
    }
    int tracked = inliers;
    if (inliers < few_inliers) { tracked = recover(g, s, solver); }
    if (g.rank() == 0) {
      result.status = early ? inertial_pose_status::ended_early : inertial_pose_status::optimised;
      result.tracked = tracked;
      result.inliers = inliers;
      result.rounds = rounds;
    }
  }

  /// Flags the observations after a round. Returns the number of inliers, to all threads.
  template <typename Group, typename Solver>
  FT_HOST_DEVICE int classify(Group g, scratch& s, int round, float* chi2,
                              Solver const& solver) const {
    constexpr float mono[inertial_rounds] = {12.0f, 7.5f, 5.991f, 5.991f};
    constexpr float stereo[inertial_rounds] = {15.6f, 9.8f, 7.815f, 7.815f};
    float const mono_limit = solver.both ? mono[inertial_rounds - 1] : mono[round];
    auto const& seen = solver.seen;
    int good = 0;
    FT_NO_UNROLL
    for (int i = g.rank(); i < seen.count; i += g.size()) {
      visual_residual<Rig> const r(this->rig, s.T_cw, seen.items[i]);
      // Those that took part keep the error before the last step.
      if (seen.outlier[i] != 0) { chi2[i] = static_cast<float>(r.chi2.value); }
      bool const is_mono = r.rows == 2;
      strict_float limit = is_mono ? mono_limit : stereo[round];
      if (is_mono && is_close(seen, i, r.in_pose)) { limit *= strict_float(1.5f); }
      // Written so that a NaN is an outlier.
      bool const inlier = chi2[i] <= limit.value && (!is_mono || r.z > real64(0.0));
      seen.outlier[i] = inlier ? 0 : 1;
      good += static_cast<int>(inlier);
    }
    return g.reduce(good, sum_op{});
  }

  FT_HOST_DEVICE static bool is_close(inertial_observations const& seen, int i, strict_vec3d p) {
    constexpr float limit = 10;  // metres
    if (seen.distance != nullptr) { return seen.distance[i] < limit; }
    return dot(p, p) < real64(static_cast<double>(limit * limit));
  }

  /// Takes outliers that are not far off in again. Returns the number of observations that are not.
  template <typename Group, typename Solver>
  FT_HOST_DEVICE int recover(Group g, scratch& s, Solver const& solver) const {
    auto const& seen = solver.seen;
    int good = 0;
    FT_NO_UNROLL
    for (int i = g.rank(); i < seen.count; i += g.size()) {
      visual_residual<Rig> const r(this->rig, s.T_cw, seen.items[i]);
      bool const near = static_cast<float>(r.chi2.value) < (r.rows == 2 ? 18.0f : 24.0f);
      if (near) { seen.outlier[i] = 0; }
      good += static_cast<int>(near);
    }
    return g.reduce(good, sum_op{});
  }
};

}  // namespace detail

/// States of frames from the map points that their keypoints hold, the integral of their IMU, and
/// either the last keyframe, which is fixed, or the last frame with its prior; and, unless
/// inertial_pose_params::marginalizes is false, the prior for the frame that follows. Up to four
/// rounds of ten Gauss-Newton steps with robust weights, after each of which outliers are told from
/// inliers. A round ends before its tenth step where a step is below
/// inertial_pose_params::step_tolerance in all components. Host and device give the same bits.
///
/// Asynchronous on `exec`; allocates nothing; one launch with a block for each problem, which do
/// not depend on each other. Source: Forster et al., "On-manifold preintegration for real-time
/// visual-inertial odometry", T-RO 2017; Campos et al., "ORB-SLAM3", T-RO 2021.
/// @param rig rectified_rig (also for one camera: observations without a right column), stereo_rig
///   or multi_rig, in which T_cw is the pose of the rig's body
/// @param mount of the IMU to the frame of T_cw
/// @param in arrays in the executor's memory
/// @throws bad_argument for a negative number of problems, a mount that is not finite, a tolerance
///   that is negative or NaN, or a first round that does not exist
template <typename Exec, typename Rig>
void optimize_inertial_poses(Exec const& exec, Rig const& rig, imu_mount const& mount,
                             inertial_poses const& in, inertial_pose_params const& params = {}) {
  detail::require_inertial_poses(in, mount);
  detail::require(params.step_tolerance >= 0, "step_tolerance must not be negative");
  detail::require_range("first_round", params.first_round, 0, inertial_rounds - 1);
  for_each_item<per_block<sum_lanes>>(
      exec, in.problems, detail::optimize_inertial_pose<Rig>{{rig, mount, params}}, in);
}

// Stage: what the optimised states of frames leave to the next frames.

namespace detail {

/// Item: a problem.
template <typename Rig>
struct marginalize_inertial_pose : inertial_pose_item<Rig> {
  using item = inertial_pose_item<Rig>;
  using typename item::scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, inertial_poses const& in) const {
    inertial_pose_result const& result = in.result[b];
    inertial_prior& next = in.next_prior[b];
    if (result.rounds == 0) {  // refused
      if (g.rank() == 0) { next.known = 0; }
      return;
    }
    inertial_solver<Group, Rig> const solver{
        g, s, this->rig, item::observations_of(b, in), in.from_last_frame[b] != 0, 0.0};
    if (solver.is_thread(0)) {
      s.frame = cast_state<real64>(result.round_state[result.rounds - 1]);
      s.T_cw = pose_mount::of(this->mount).pose_of(s.frame);
    }
    if (solver.is_thread(1)) { s.first = cast_state<real64>(result.first); }
    this->load_terms(g, s, b, in, solver);
    bool const finite = this->write_prior(g, s, next, solver);
    if (!finite && g.rank() == 0) { next.known = 0; }
  }
};

}  // namespace detail

/// Writes `in.next_prior` of problems that optimize_inertial_poses() has solved without it
/// (inertial_pose_params::marginalizes = false), with the same bits; of refused ones, and of those
/// whose prior is not finite, it is not known. Inputs and results are those of that call.
/// Asynchronous on `exec`; allocates nothing; one launch with a block for each problem.
/// @throws bad_argument for a negative number of problems, or a mount that is not finite
template <typename Exec, typename Rig>
void marginalize_inertial_poses(Exec const& exec, Rig const& rig, imu_mount const& mount,
                                inertial_poses const& in, inertial_pose_params const& params = {}) {
  detail::require_inertial_poses(in, mount);
  for_each_item<per_block<sum_lanes>>(
      exec, in.problems, detail::marginalize_inertial_pose<Rig>{{rig, mount, params}}, in);
}

}  // namespace FT_ABI
}  // namespace ft
