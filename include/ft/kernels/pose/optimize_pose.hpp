// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose from a list of observations. Levenberg-Marquardt over the camera's pose with
/// robust reprojection errors, mono and stereo. Source: specification section 11.
///
/// With products kept apart and sums in a fixed order: the same pose, to the last bit, on every
/// executor (up to the camera model's own use of trigonometric functions).
#pragma once

#include "ft/containers/observations.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/core/group.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/pose/damped_descent.hpp"
#include "ft/kernels/pose/normal_equations.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/pose/reprojection.hpp"

namespace ft {
inline namespace FT_ABI {

/// Optimises one pose. Groups of one thread or of sum_lanes.
///
/// The points are carried into the camera's frame at the start in double, once; the motion from
/// there is sought in float, whose errors are those of the residual's own float 1 / z. Who is an
/// outlier is decided in double, at the pose of the motion found.
template <typename Rig>
struct optimize_pose {
  static constexpr int terms = detail::pose_terms;
  /// So many observations are kept in block scratch, others are looked up each time.
  static constexpr int scratch_size = 1024;
  struct scratch {
    ordered_sum_scratch<terms> sums;
    sum_terms<terms> best;  ///< sums at the best motion so far
    detail::damped_descent descent;
    alignas(16) rigid<strict_double> T;  ///< what the last round found; at first the start
    /// What sums need of an observation, in pieces that are loaded at once.
    struct alignas(16) {
      vec3<float> point;  ///< in the camera's frame at the start
      float weight;       ///< 0 = does not count in this round
    } place[scratch_size];
    struct alignas(16) {
      float u, v, third;  ///< column in the right image, or 1 = seen by the right camera
      unsigned flags;
    } pixel[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                 pose_params const& params) const {
    if (g.rank() == 0) { s.T = problem.start->template cast<strict_double>(); }
    g.sync();
    FT_NO_UNROLL
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      prepare(s, i, rig, problem, problem.observations[i]);
    }
    solve(g, s, rig, problem, params);
  }

  /// Takes in observation i, once s.T is the start: in the thread that will look at it, which is i
  /// modulo the group's size. @param o observation i of the problem
  FT_HOST_DEVICE static void prepare(scratch& s, int i, Rig const& rig, pose_problem const& problem,
                                     observation const& o) {
    reprojection<Rig> const r(rig, s.T, o);
    bool const usable = r.chi2(o) < largest_chi2;
    if (i < scratch_size) {
      s.place[i] = {narrowed(r.in_body), usable ? o.inv_sigma2 : 0.0f};
      s.pixel[i] = {o.u, o.v, Rig::rectified ? o.right_u : static_cast<float>(o.right_camera), 0};
    }
    set_flags(s, i, problem, usable ? 0 : unusable);
  }

  /// Optimises once all observations are prepared.
  template <typename Group>
  FT_HOST_DEVICE static void solve(Group g, scratch& s, Rig const& rig, pose_problem const& problem,
                                   pose_params const& params) {
    int const n = problem.count;
    bool const enough = n >= 3 && params.rounds > 0;
    int const rounds = n < params.enough_observations ? 1 : params.rounds;
    bool changed = true;
    FT_NO_UNROLL
    for (int round = 0; enough && round < rounds; ++round) {
      bool const robust = round + 1 < params.rounds;
      // The same observations and the same kernel give the same pose again.
      if (!changed && robust) { continue; }
      run_round(g, s, rig, problem, params, robust);
      bool changes = false;
      FT_NO_UNROLL
      for (int i = g.rank(); i < n; i += g.size()) {
        changes = classify(s, i, rig, problem, params) || changes;
      }
      if (robust) { changed = g.any(changes); }
    }
    int good = 0;
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      unsigned const flag = enough ? flags(s, i, problem) & outlier : 0;
      set_flags(s, i, problem, flag);
      problem.outlier[i] = static_cast<unsigned char>(flag);
      good += static_cast<int>(flag == 0);
    }
    good = g.reduce(good, sum_op{});
    if (g.rank() == 0) {
      *problem.result = enough ? s.T.template cast<float>() : *problem.start;
      *problem.inliers = enough ? good : 0;
    }
  }

  /// What the problem's `outlier` says, for the thread of observation i.
  FT_HOST_DEVICE static bool is_outlier(scratch const& s, int i, pose_problem const& problem) {
    return (flags(s, i, problem) & outlier) != 0;
  }

private:
  static constexpr unsigned outlier = 1;
  /// Without a number at the start, or with one that the sums in float cannot hold: out of all
  /// sums, which one of them would spoil.
  static constexpr unsigned unusable = 2;
  static constexpr double largest_chi2 = 1e30;

  FT_HOST_DEVICE static unsigned flags(scratch const& s, int i, pose_problem const& problem) {
    return i < scratch_size ? s.pixel[i].flags : problem.outlier[i];
  }
  FT_HOST_DEVICE static void set_flags(scratch& s, int i, pose_problem const& problem,
                                       unsigned flags) {
    if (i < scratch_size) {
      s.pixel[i].flags = flags;
    } else {
      problem.outlier[i] = static_cast<unsigned char>(flags);
    }
  }
  FT_HOST_DEVICE static vec3<float> narrowed(vec3<strict_double> p) {
    return {static_cast<float>(p.x.value), static_cast<float>(p.y.value),
            static_cast<float>(p.z.value)};
  }

  /// Observation i with its point in the camera's frame at the start; of weight 0 where it does not
  /// count.
  FT_HOST_DEVICE static observation prepared(scratch const& s, int i, pose_problem const& problem) {
    if (i < scratch_size) {
      auto const place = s.place[i];
      auto const pixel = s.pixel[i];
      return {place.point, pixel.u,      pixel.v,
              pixel.third, place.weight, Rig::rectified ? 0 : static_cast<int>(pixel.third)};
    }
    observation o = problem.observations[i];
    auto const start = problem.start->template cast<strict_double>();
    o.point = narrowed(start * vec3<strict_double>{static_cast<double>(o.point.x),
                                                   static_cast<double>(o.point.y),
                                                   static_cast<double>(o.point.z)});
    if (problem.outlier[i] != 0) { o.inv_sigma2 = 0; }
    return o;
  }

  /// Whether observation i is an outlier at s.T, for its flag and the next round. True if that is
  /// new.
  FT_HOST_DEVICE static bool classify(scratch& s, int i, Rig const& rig,
                                      pose_problem const& problem, pose_params const& params) {
    observation const o = problem.observations[i];
    reprojection<Rig> const r(rig, s.T, o);
    // Written so that a NaN is too far.
    bool const far = !(r.chi2(o) <= (r.rows == 3 ? params.chi2_stereo : params.chi2_mono));
    unsigned const before = flags(s, i, problem);
    unsigned const after = (before & unusable) | (far ? outlier : 0);
    set_flags(s, i, problem, after);
    if (i < scratch_size) { s.place[i].weight = after != 0 ? 0.0f : o.inv_sigma2; }
    return before != after;
  }

  /// Gradient, curvature and cost after motion D, over the observations that count; then `then()`.
  template <typename Group, typename Then>
  FT_HOST_DEVICE static void linearize(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       rigid<strict_float> const& D, bool robust,
                                       Then const& then) {
    using real = strict_float;
    real const limit_mono = static_cast<float>(params.chi2_mono);
    real const limit_stereo = static_cast<float>(params.chi2_stereo);
    auto const add = [&](int i, sum_terms<terms>& acc) {
      observation const o = prepared(s, i, problem);
      if (!(o.inv_sigma2 > 0)) { return; }
      reprojection<Rig, real, true> const r(rig, D, o);
      real const chi2 = r.chi2(o);
      real const limit = r.rows == 3 ? limit_stereo : limit_mono;
      real weight = o.inv_sigma2;
      real cost = chi2;
      if (robust && chi2 > limit) {  // Huber
        real const product = scalar::sqrt(limit * chi2);
        cost = real(2.0f) * product - limit;
        weight = weight * (limit / product);
      }
      acc.of[terms - 1] += cost.value;
      real P[3][3];
      r.derivative(rig, o, P);
      // A row that is not there has no weight.
      vec3<real> const weights{weight, weight, r.rows == 3 ? weight : real(0.0f)};
      detail::add_motion_terms(r.in_body, P, weights, {r.error[0], r.error[1], r.error[2]},
                               Rig::rectified, acc.of);
    };
    ordered_sum<terms>(g, s.sums, problem.count, add, then);
  }

  /// Finds the best pose for the observations that count.
  template <typename Group>
  FT_HOST_DEVICE static void run_round(Group g, scratch& s, Rig const& rig,
                                       pose_problem const& problem, pose_params const& params,
                                       bool robust) {
    auto D = rigid<strict_float>::identity();
    FT_NO_UNROLL
    for (bool first = true, running = true; running; first = false) {
      linearize(g, s, rig, problem, params, D, robust, [&] {
        // On copies: loads from scratch at once, not one after another between stores.
        detail::damped_descent next = s.descent;
        sum_terms<terms> sums = s.sums.total;
        bool better = true;
        if (first) {
          next.begin(sums, params);
        } else {
          better = next.judge(sums, params);
        }
        if (better) {
          s.best = sums;
        } else {
          sums = s.best;
        }
        next.propose(sums, params);
        s.descent = next;
        if (!next.running) {
          s.T =
              next.D.template cast<strict_double>() * problem.start->template cast<strict_double>();
        }
      });
      running = s.descent.running;
      D = s.descent.trial;
    }
  }
};

}  // namespace FT_ABI
}  // namespace ft
