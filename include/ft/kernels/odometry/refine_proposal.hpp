// SPDX-License-Identifier: Apache-2.0
/// @file Stage: a proposed pose from all matches that agree with it, and how wide to search around
/// it.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/odometry/match_without_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/pnp/draw_pose.hpp"
#include "ft/kernels/pose/detail/reprojection.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a camera.
template <typename Rig>
struct refine_proposal {
  struct scratch {
    pose_scratch pose;
    double covariance[36];
    bool known;  ///< whether there is one
  };
  tracking_rules rules;
  pose_params params;
  pose_limits limits = pose_limits::of(params);

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, windowless_search<Rig> const& in,
                                 odometry_state_view const& state,
                                 windowless_workspace const& work) const {
    pose_proposal& out = work.proposals[b];
    bool const wanted = out.support >= rules.min_support;
    g.sync();
    if (!wanted) { return; }
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
    observation* const list = work.matches + first;
    proposal_refinement& to = work.refined[b];
    if (g.rank() == 0) { to.start = out.T_cw.template cast<float>(); }
    int const n = keep_agreeing(g, {in.rig, out.camera, list, out.matches}, out.T_cw, list);
    g.sync();
    optimize(g, s,
             {list, n, &to.start, &to.T_cw, work.outlier + first, &to.inliers, to.information},
             in.rig);
    g.sync();
    auto const T_cw = to.T_cw.template cast<strict_double>().orthonormalized();
    seen_matches<Rig> const matches{in.rig, out.camera, list, n};
    int support = 0, drawn_support = 0;
    int const cost = cost_of_pose(g, matches, T_cw.template cast<double>(), support);
    bool const better = cost <= cost_of_pose(g, matches, out.T_cw, drawn_support);
    // Matches that have left count as if none agreed.
    constexpr int limit = seen_matches<Rig>::limit;
    bool const gains = better && cost + limit * (out.matches - n) + least_gain < out.first_cost;
    if (g.rank() == 0) { s.known = better && invert_6(to.information, s.covariance); }
    g.sync();
    float const factor =
        s.known ? search_factor(g, s, in, T_cw.template cast<strict_float>(), out.camera,
                                anchors::of(in, state.tracks[b], b), in.map.points.slice(b))
                : rules.matched_search;
    if (g.rank() != 0) { return; }
    if (gains) { out.adopted = 1; }
    out.search_factor = min_of(factor, rules.matched_search);
    if (better) {
      out.T_cw = T_cw.template cast<double>();
      out.support = support;
    }
  }

private:
  /// Of two poses that are both right, errors differ by a chi-square of six degrees of freedom:
  /// this much, in eighths, once in a thousand times.
  static constexpr int least_gain = 8 * 23;

  /// Moves the matches that agree with a pose of the body to the front, in their order.
  /// @return their number
  template <typename Group>
  FT_HOST_DEVICE static int keep_agreeing(Group g, seen_matches<Rig> const& matches,
                                          rigid<double> const& T_bw, observation* list) {
    auto const T_cw = matches.of_camera(T_bw.template cast<strict_double>());
    int n = 0;
    for (int base = 0; base < matches.n; base += g.size()) {
      int const i = base + g.rank();
      bool const agrees = i < matches.n && matches.error(T_cw, i) < seen_matches<Rig>::limit;
      observation const o = agrees ? list[i] : observation{};
      int here = 0;
      int const place = n + g.exclusive_count(agrees, here);  // all have read theirs
      if (agrees) { list[place] = o; }
      n += here;
      g.sync();
    }
    return n;
  }

  template <typename Group>
  FT_HOST_DEVICE void optimize(Group g, scratch& s, pose_problem const& problem,
                               Rig const& rig) const {
    pose_solver<Group, Rig> const solver{g, s.pose, rig, problem, params, limits};
    FT_NO_UNROLL
    for (int i = g.rank(); i < problem.count; i += g.size()) {
      solver.prepare(i, problem.observations[i]);
    }
    solver.solve();
  }

  /// The factor on search radii that has room for three standard deviations of where the pose
  /// expects the anchors that it sees, in the mean over these.
  template <typename Group>
  FT_HOST_DEVICE static float search_factor(Group g, scratch const& s,
                                            windowless_search<Rig> const& in,
                                            rigid<strict_float> const& T_cw, int camera,
                                            anchors const& from, map_points_view const& points) {
    std::int64_t sum = 0;
    int seen = 0;
    for (int i = g.rank(); i < in.frame.capacity(); i += g.size()) {
      int const slot = from.slot(camera * in.frame.capacity() + i);
      if (slot < 0) { continue; }
      observation o{};
      o.point = points.position(slot);
      o.right_u = -1.0f;
      o.camera = camera;
      reprojection<Rig, strict_float, true> const r(in.rig, T_cw, o);
      // Measured at the origin, so the error is where it is expected, negated.
      bool const there = r.valid && r.in_camera.z > 0.0f &&
                         is_in(-r.error[0], in.geometry.width[0]) &&
                         is_in(-r.error[1], in.geometry.height[0]);
      if (!there) { continue; }
      ++seen;
      sum += variance_of(s, r.in_body, r.derivative(in.rig, o));
    }
    sum = g.reduce(sum, sum_op{});
    seen = g.reduce(seen, sum_op{});
    constexpr float least_radius = 2.5f;  // pixels, of windows of the local map
    strict_float const variance = strict_float(static_cast<float>(sum)) /
                                  strict_float(static_cast<float>(variance_one * max_of(seen, 1)));
    strict_float const wider = strict_float(9.0f / (least_radius * least_radius)) * variance;
    return scalar::sqrt(strict_float(1.0f) + wider).value;
  }
  FT_HOST_DEVICE static bool is_in(strict_float v, int length) {
    return v >= 0.0f && v < strict_float(static_cast<float>(length));
  }

  static constexpr int variance_one = 1024;
  static constexpr int most_variance = 64;  ///< pixels^2

  /// Variance of a pixel, the sum of both directions' halved, in 1 / variance_one: so that all
  /// executors have the same sum.
  /// @param p the point in the frame of the pose @param P d pixel / d point
  FT_HOST_DEVICE static int variance_of(scratch const& s, vec3<strict_float> p,
                                        mat3<strict_float> const& P) {
    strict_float sum = 0.0f;
    for (int row = 0; row < 2; ++row) {
      // A small twist (w, t) moves the point by w x p + t.
      vec3<strict_float> const by_t{P.m[3 * row], P.m[3 * row + 1], P.m[3 * row + 2]};
      vec3<strict_float> const by_w = cross(p, by_t);
      strict_float const d[6] = {by_w.x, by_w.y, by_w.z, by_t.x, by_t.y, by_t.z};
      for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < 6; ++j) {
          sum = sum + d[i] * strict_float(static_cast<float>(s.covariance[6 * i + j])) * d[j];
        }
      }
    }
    float const variance = 0.5f * sum.value;  // exact
    return variance < most_variance ? static_cast<int>(variance_one * max_of(variance, 0.0f))
                                    : variance_one * most_variance;
  }
};

}  // namespace detail

/// Improves proposals of propose_poses(), each by all of the frame's matches that agree with it: a
/// pose from three matches sees points several pixels off, and so wide a search finds a wrong
/// keypoint for every second one. The search around it is as wide as its covariance asks for, with
/// an error of one pixel a match. If the optimised pose agrees worse, the proposal stays, with
/// `rules.matched_search`. A proposal that was not adopted is now, if the pose of the search from
/// the last frame, were it right, would agree so much worse with the matches once in a thousand
/// times. Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec, typename Rig>
void refine_proposals(Exec const& exec, windowless_search<Rig> const& in,
                      tracking_rules const& rules, odometry_state_view const& state,
                      windowless_workspace const& work, pose_params const& params = {}) {
  for_each_item<per_block<sum_lanes>>(exec, in.frame.batch,
                                      detail::refine_proposal<Rig>{rules, params}, in, state, work);
}

}  // namespace FT_ABI
}  // namespace ft
