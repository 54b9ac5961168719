// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose from a list of observations. Levenberg-Marquardt over the pose of the camera
/// with robust reprojection errors, mono and stereo. Source: specification section 11.
///
/// Products are not contracted and sums have a fixed order, so the pose has the same bits on every
/// executor, up to the trigonometric functions that a camera model calls.
#pragma once

#include <type_traits>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/detail/damped_descent.hpp"
#include "ft/kernels/pose/detail/reprojection.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Of a descent in `Number`.
template <typename Number>
struct descent_scratch {
  ordered_sum_scratch<pose_terms, plain_scalar_t<Number>> sums;
  damped_descent<Number> descent;
  rigid<Number> best;           ///< the best pose of a round so far
  pose_sums<Number> best_sums;  ///< there
  rigid<Number> T;              ///< where sums are needed
  bool better;                  ///< whether the last sums are those of the best pose
};

struct pose_scratch {
  descent_scratch<strict_double> precise;
  descent_scratch<strict_float> brief;
  rigid<strict_double> start;
  rigid<strict_double> T;  ///< result of a round
  bool moved;              ///< whether that is not the start
  prepared_observations observations;
};

/// Optimises one pose by one group, of one thread or of sum_lanes: prepare() for every observation,
/// then solve().
///
/// A round is computed in double where the reference's result is wanted, or where few observations
/// are left: there the curvature has a lower rank, and the damping, 1e-9 of its largest entry,
/// which determines the rest of a step, is smaller than the noise of floats. Other rounds are
/// computed in float, which is faster on a device.
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
  /// @param aligned whether its keypoint was moved to its point's patch
  FT_HOST_DEVICE void prepare(int i, observation const& o, bool aligned = false) const {
    s.observations.template keep<Rig>(i, o, problem, aligned);
  }

  FT_HOST_DEVICE void solve() const {
    // By the last thread, which seldom has an observation to wait for. Rows of floats are
    // orthonormal up to 1e-7 only, and a turn from the left leaves them so.
    if (g.rank() == g.size() - 1) {
      s.start = problem.exact_start != nullptr
                    ? problem.exact_start->template cast<real>()
                    : problem.start->template cast<real>().orthonormalized();
    }
    g.sync();
    int const n = problem.count;
    bool const enough = n >= 3 && params.rounds > 0;
    int const rounds = n < params.enough_observations ? 1 : params.rounds;
    int included = n;
    bool precise = true;
    bool changed = true;
    bool weighed = true;  // whether weights of the last round may differ
    FT_NO_UNROLL
    for (int round = 0; enough && round < rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      // The same observations and weights give the same pose again.
      if (!changed && (robust || !weighed)) { continue; }
      precise = params.small_step == 0 || included < enough_for_float;
      bool const weighs = precise ? run_round(s.precise, robust) : run_round(s.brief, robust);
      bool changes = false;
      int inliers = 0;
      FT_NO_UNROLL
      for (int i = g.rank(); i < n; i += g.size()) {
        changes = classify(i) || changes;
        inliers += is_outlier(i) ? 0 : 1;
      }
      if (robust) {
        // Both in one sum. Threads need not say more than that there are enough.
        constexpr int one_change = 1 << 20;
        static_assert(sum_lanes * enough_for_float < one_change);
        int const few = min_of(inliers, enough_for_float);
        int const both = g.reduce(few + (changes ? one_change : 0), sum_op{});
        changed = both >= one_change;
        included = both % one_change;
        weighed = changed || problem.aligned || g.any(weighs);
      }
    }
    write_result(enough, precise);
  }

  /// The entry of the problem's `outlier`, for the thread of observation i.
  FT_HOST_DEVICE bool is_outlier(int i) const {
    return (s.observations.flags(i, problem) & prepared_observations::outlier) != 0;
  }

private:
  using real = strict_double;
  static constexpr double largest_chi2 = 1e30;
  static constexpr int enough_for_float = 64;  ///< observations
  /// Whether cameras are elsewhere than the frame of the pose, with all entries of a derivative.
  static constexpr bool displaced = Rig::rectified && !std::is_same_v<Rig, rectified_rig>;

  /// Finds the best pose for the observations that are included. Returns whether an error of this
  /// thread had less than its full weight, at any pose that was tried.
  template <typename Number>
  FT_HOST_DEVICE bool run_round(descent_scratch<Number>& d, bool robust) const {
    rigid<Number> T = s.start.template cast<Number>();
    bool weighs = false;
    FT_NO_UNROLL
    for (bool first = true, running = true; running; first = false) {
      ordered_sum<pose_terms>(
          g, d.sums, problem.count,
          [&](int i, auto& acc) { add_terms(i, T, robust, first, weighs, acc); },
          [&] { advance(d, T, first); });
      if (d.better) {  // copied by threads that seldom have an observation
        for (int k = g.size() - 1 - g.rank(); k < pose_terms; k += g.size()) {
          d.best_sums.of[k] = d.sums.total.of[k];
        }
      }
      running = d.descent.running;
      T = d.T;
    }
    return weighs;
  }

  /// Takes the sums of a trial and proposes the next one. Run by one thread.
  /// @param T the trial @param first whether it is the start
  template <typename Number>
  FT_HOST_DEVICE void advance(descent_scratch<Number>& d, rigid<Number> const& T,
                              bool first) const {
    // Works on a copy, so that scratch is loaded at once and not word by word between stores.
    damped_descent<Number> next = d.descent;
    d.better = true;
    if (first) {
      next.begin(d.sums.total, params);
    } else {
      d.better = next.judge(d.sums.total.of[pose_terms - 1], params);
    }
    if (d.better) { d.best = T; }
    // The first round is the last one of few observations: it ends as the reference's does.
    bool const few = problem.count < params.enough_observations;
    d.T = next.propose(d.better ? d.sums.total : d.best_sums, d.best, params,
                       few ? 0.0f : params.small_step);
    d.descent = next;
    if (next.running) { return; }
    s.T = d.T.template cast<real>();
    s.moved = !same(d.T, s.start.template cast<Number>());
  }

  FT_HOST_DEVICE bool is_aligned(int i) const {
    return (s.observations.flags(i, problem) & prepared_observations::aligned) != 0;
  }

  /// Whether the third row is that of a disparity. Of rigs without a right column it is not used.
  FT_HOST_DEVICE bool by_disparity() const {
    if constexpr (Rig::rectified && !is_monocular_v<Rig>) { return limits.disparity_root > 0; }
    return false;
  }

  /// Adds the terms of observation i.
  /// @param first whether T is the start, where unusable observations are found
  /// @param weighs set if an error of this thread has less than its full weight
  template <typename Number, typename Sums>
  FT_HOST_DEVICE void add_terms(int i, rigid<Number> const& T, bool robust, bool first,
                                bool& weighs, Sums& acc) const {
    using plain = plain_scalar_t<Number>;
    observation const o = s.observations.template get<Rig>(i, problem);
    if (!(o.inv_sigma2 > 0)) { return; }
    reprojection<Rig, Number, true> r(rig, T, o);
    Number const root = static_cast<plain>(limits.disparity_root);
    if (by_disparity()) { r.take_disparity(root); }
    Number chi2 = r.chi2(o);
    if (first && !(chi2 < Number(static_cast<plain>(largest_chi2)))) {
      s.observations.mark(i, problem,
                          s.observations.flags(i, problem) | prepared_observations::unusable);
      return;
    }
    bool const tight = !robust && is_aligned(i);
    Number const limit = static_cast<plain>(
        tight ? aligned_robust : (r.rows == 3 ? limits.stereo : limits.mono).robust);
    Number weight = static_cast<plain>(o.inv_sigma2);
    if (tight) {
      chi2 = chi2 * Number(static_cast<plain>(aligned_at_last));
      weight = weight * Number(static_cast<plain>(aligned_at_last));
    }
    Number cost = chi2;
    if ((robust || tight) && chi2 > limit) {  // Huber
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

  template <typename Number>
  FT_HOST_DEVICE static bool same(rigid<Number> const& A, rigid<Number> const& B) {
    bool equal = A.t.x == B.t.x && A.t.y == B.t.y && A.t.z == B.t.z;
    for (int i = 0; i < 9; ++i) { equal = equal && A.R.m[i] == B.R.m[i]; }
    return equal;
  }

  /// @param enough whether there were enough observations for a pose
  /// @param precise whether the last round was
  FT_HOST_DEVICE void write_result(bool enough, bool precise) const {
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
      bool const moved = enough && s.moved;
      *problem.result = moved ? s.T.template cast<float>() : *problem.start;
      if (problem.exact_result != nullptr) {
        *problem.exact_result = (moved ? s.T : s.start).template cast<double>();
      }
      *problem.inliers = enough ? good : 0;
    }
    if (problem.information == nullptr) { return; }
    for (int i = g.rank(); i < information_terms; i += g.size()) {
      float const entry =
          precise ? static_cast<float>(s.precise.best_sums.of[6 + i]) : s.brief.best_sums.of[6 + i];
      problem.information[i] = enough ? entry : 0.0f;
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
