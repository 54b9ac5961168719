// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose from a list of observations. Levenberg-Marquardt over the pose of the camera
/// with robust reprojection errors, mono and stereo. Source: specification section 11.
///
/// Products are not contracted and sums have a fixed order, so the pose has the same bits on every
/// executor, up to the trigonometric functions that a camera model calls.
#pragma once

#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/observations.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/group.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/damped_descent.hpp"
#include "ft/kernels/pose/normal_equations.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/pose/prepared_observations.hpp"
#include "ft/kernels/pose/reprojection.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct pose_scratch {
  ordered_sum_scratch<pose_terms, double> sums;
  ordered_sum_scratch<pose_terms, float, double> short_sums;
  damped_descent descent;
  rigid<strict_double> start;
  rigid<strict_double> best;  ///< the best pose of a round so far
  pose_sums best_sums;
  rigid<strict_double> T;  ///< where sums are needed; at the end of a round its result
  prepared_observations observations;
};

/// Optimises one pose by one group, of one thread or of sum_lanes: prepare() for every observation,
/// then solve().
///
/// Poses, points in the camera's frame and steps are in double: where few inliers are left, float
/// noise of the curvature is larger than the damping that determines the step. Errors and sums are
/// in double where precise() says so.
template <typename Group, typename Rig>
struct pose_solver {
  Group g;
  pose_scratch& s;
  Rig const& rig;
  pose_problem const& problem;
  pose_params const& params;
  pose_limits const& limits;

  /// Prepares observation i. Called by thread i modulo the group's size.
  /// @param o observation i of the problem
  FT_HOST_DEVICE void prepare(int i, observation const& o) const {
    s.observations.template keep<Rig>(i, o, problem);
  }

  FT_HOST_DEVICE void solve() const {
    // By the last thread, which seldom has an observation to wait for. Rows of floats are
    // orthonormal up to 1e-7 only, and a turn from the left leaves them so.
    if (g.rank() == g.size() - 1) {
      s.start = problem.start->template cast<real>().orthonormalized();
    }
    g.sync();
    int const n = problem.count;
    bool const enough = n >= 3 && params.rounds > 0;
    int const rounds = n < params.enough_observations ? 1 : params.rounds;
    bool changed = true;
    bool weighed = true;  // whether the last robust round weighed an error less
    FT_NO_UNROLL
    for (int round = 0; enough && round < rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      // The same observations and weights give the same pose again.
      if (!changed && (robust || !weighed)) { continue; }
      bool const weighs = run_round(robust);
      bool changes = false;
      FT_NO_UNROLL
      for (int i = g.rank(); i < n; i += g.size()) { changes = classify(i) || changes; }
      if (robust) {
        changed = g.any(changes);
        weighed = changed || g.any(weighs);
      }
    }
    write_result(enough);
  }

  /// The entry of the problem's `outlier`, for the thread of observation i.
  FT_HOST_DEVICE bool is_outlier(int i) const {
    return (s.observations.flags(i, problem) & prepared_observations::outlier) != 0;
  }

private:
  using real = strict_double;
  static constexpr double largest_chi2 = 1e30;
  /// Whether cameras are elsewhere than the frame of the pose, with all entries of a derivative.
  static constexpr bool displaced = Rig::rectified && !std::is_same_v<Rig, rectified_rig>;

  /// Finds the best pose for the observations that are included. Returns whether an error of this
  /// thread had less than its full weight, at any pose that was tried.
  FT_HOST_DEVICE bool run_round(bool robust) const {
    rigid<real> T = s.start;
    bool weighs = false;
    FT_NO_UNROLL
    for (bool first = true, running = true; running; first = false) {
      sum_terms_at(T, robust, first, weighs, [&](auto const& sums) { advance(sums, first); });
      running = s.descent.running;
      T = s.T;
    }
    return weighs;
  }

  /// Takes the sums of a trial and proposes the next one. Run by one thread.
  /// @param first whether the trial is the start
  FT_HOST_DEVICE void advance(pose_sums const& there, bool first) const {
    // Works on copies, so that scratch is loaded at once and not word by word between stores. Not
    // of the poses: registers are short.
    damped_descent next = s.descent;
    bool better = true;
    if (first) {
      next.begin(there, params);
    } else {
      better = next.judge(there.of[pose_terms - 1], params);
    }
    pose_sums const sums = better ? there : s.best_sums;
    if (better) {
      s.best_sums = sums;
      s.best = first ? s.start : s.T;
    }
    // The first round is the last one of few observations: it ends as the reference's does.
    bool const few = problem.count < params.enough_observations;
    s.T = next.propose(sums, s.best, params, few ? 0.0 : static_cast<double>(params.small_step));
    s.descent = next;
  }

  /// Whether sums are in double, as the reference's are: they decide where few observations are
  /// left, and without a small step, which ends a round earlier than the reference does.
  FT_HOST_DEVICE bool precise() const { return params.small_step == 0 || problem.count < 64; }

  /// Whether the third row is that of a disparity. Of rigs without a right column it is not used.
  FT_HOST_DEVICE bool by_disparity() const {
    if constexpr (Rig::rectified && !is_monocular_v<Rig>) { return limits.disparity_root > 0; }
    return false;
  }

  /// Sums gradient, curvature and cost at pose T over the observations that are included; then
  /// one thread runs then(sums).
  /// @param first whether T is the start, where unusable observations are found
  /// @param weighs set if an error of this thread has less than its full weight
  template <typename Then>
  FT_HOST_DEVICE void sum_terms_at(rigid<real> const& T, bool robust, bool first, bool& weighs,
                                   Then const& then) const {
    if (precise()) {
      ordered_sum<pose_terms>(
          g, s.sums, problem.count,
          [&](int i, auto& acc) { add_terms<real>(i, T, robust, first, weighs, acc); },
          [&] { then(s.sums.total); });
    } else {
      ordered_sum<pose_terms>(
          g, s.short_sums, problem.count,
          [&](int i, auto& acc) { add_terms<strict_float>(i, T, robust, first, weighs, acc); },
          [&] { then(s.short_sums.total); });
    }
  }

  /// Adds the terms of observation i. Its point is moved in double.
  template <typename Number, typename Sums>
  FT_HOST_DEVICE void add_terms(int i, rigid<real> const& T, bool robust, bool first, bool& weighs,
                                Sums& acc) const {
    using plain = plain_scalar_t<Number>;
    observation const o = s.observations.template get<Rig>(i, problem);
    if (!(o.inv_sigma2 > 0)) { return; }
    vec3<real> const in_body = T * o.point.template cast<real>();
    reprojection<Rig, Number, true> r(rig, in_body.template cast<Number>(), o);
    Number const root = static_cast<plain>(limits.disparity_root);
    if (by_disparity()) { r.take_disparity(root); }
    Number const chi2 = r.chi2(o);
    if (first && !(chi2 < Number(static_cast<plain>(largest_chi2)))) {
      s.observations.mark(i, problem,
                          s.observations.flags(i, problem) | prepared_observations::unusable);
      return;
    }
    Number const limit = static_cast<plain>((r.rows == 3 ? limits.stereo : limits.mono).robust);
    Number weight = static_cast<plain>(o.inv_sigma2);
    Number cost = chi2;
    if (robust && chi2 > limit) {  // Huber
      weighs = true;
      Number const product = scalar::sqrt(limit * chi2);
      cost = product + product - limit;
      weight = weight * (limit / product);
    }
    acc.of[pose_terms - 1] += cost.value;
    mat3<Number> P = r.derivative(rig, o);
    if (by_disparity()) { P = r.with_disparity(P, root); }
    vec3<Number> const W{weight, weight, r.rows == 3 ? weight : Number(0)};
    vec3<Number> const e{r.error[0], r.error[1], r.error[2]};
    if constexpr (is_monocular_v<Rig> || !Rig::rectified) {
      add_motion_terms(r.in_body, monocular_equations(P, W, e), acc.of);
    } else if constexpr (displaced) {
      add_motion_terms(r.in_body, displaced_equations(P, W, e), acc.of);
    } else {
      add_motion_terms(r.in_body, rectified_equations(P, W, e), acc.of);
    }
  }

  /// Flags observation i as inlier or outlier at s.T. Returns whether its flags changed.
  FT_HOST_DEVICE bool classify(int i) const {
    observation o = s.observations.template get<Rig>(i, problem);
    o.inv_sigma2 = ::fabsf(o.inv_sigma2);
    reprojection<Rig> r(rig, s.T, o);
    if (by_disparity()) { r.take_disparity(real(static_cast<double>(limits.disparity_root))); }
    // Written so that a NaN is too far.
    bool const far = !(static_cast<float>(r.chi2(o).value) <=
                       (r.rows == 3 ? limits.stereo : limits.mono).inlier);
    unsigned const before = s.observations.flags(i, problem);
    unsigned const after =
        (before & ~prepared_observations::outlier) | (far ? prepared_observations::outlier : 0);
    s.observations.mark(i, problem, after);
    return before != after;
  }

  FT_HOST_DEVICE bool is_start(rigid<real> const& T) const {
    bool same = T.t.x == s.start.t.x && T.t.y == s.start.t.y && T.t.z == s.start.t.z;
    for (int i = 0; i < 9; ++i) { same = same && T.R.m[i] == s.start.R.m[i]; }
    return same;
  }

  /// @param enough whether there were enough observations for a pose
  FT_HOST_DEVICE void write_result(bool enough) const {
    int good = 0;
    FT_NO_UNROLL
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      unsigned const flag =
          enough ? s.observations.flags(i, problem) & prepared_observations::outlier : 0;
      s.observations.set_flags(i, problem, flag);
      problem.outlier[i] = static_cast<unsigned char>(flag);
      good += static_cast<int>(flag == 0);
    }
    good = g.reduce(good, sum_op{});
    if (g.rank() == 0) {
      // Where nothing moves it, the pose is the start to the bit, and not made orthonormal.
      *problem.result = enough && !is_start(s.T) ? s.T.template cast<float>() : *problem.start;
      *problem.inliers = enough ? good : 0;
    }
    if (problem.information == nullptr) { return; }
    for (int i = g.rank(); i < information_terms; i += g.size()) {
      problem.information[i] = enough ? static_cast<float>(s.best_sums.of[6 + i]) : 0.0f;
    }
  }
};

/// One item: a problem.
template <typename Rig>
struct optimize_problem {
  using scratch = pose_scratch;
  Rig rig;
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, pose_problem const& problem) const {
    pose_solver<Group, Rig> const solver{g, s, rig, problem, params, limits};
    FT_NO_UNROLL
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      solver.prepare(i, problem.observations[i]);
    }
    solver.solve();
  }
};

}  // namespace detail

/// Pose of one camera, or of a rig, from a list of observations. Asynchronous on `exec`; allocates
/// nothing; one launch.
/// @param problem arrays in the executor's memory
template <typename Exec, typename Rig>
void optimize_pose(Exec const& exec, Rig const& rig, pose_problem const& problem,
                   pose_params const& params = {}) {
  for_each_item<per_block<sum_lanes>>(exec, 1, detail::optimize_problem<Rig>{rig, params}, problem);
}

}  // namespace FT_ABI
}  // namespace ft
