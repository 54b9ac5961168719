// SPDX-License-Identifier: Apache-2.0
/// @file The pose that most of a camera's matches agree with, among poses from three of them each.
#pragma once

#include <cstdint>

#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Squared errors in eighths of the keypoint's variance, with room for that of a pose from three
/// points: four times the 95 % limit of two degrees of freedom.
inline constexpr int drawn_pose_limit = 24 * 8;

/// Matches of one camera with map points, and how well poses agree with them. Poses are of that
/// camera.
/// @tparam Limit of errors, in eighths of a variance; a match above it does not agree
template <typename Rig, int Limit = drawn_pose_limit>
struct seen_matches {
  static constexpr int limit = Limit;

  Rig const& rig;
  int camera;
  observation const* list;
  int n;

  FT_HOST_DEVICE auto const& model() const {
    if constexpr (Rig::rectified) {
      return rig.pair(camera).camera;
    } else {
      return rig.left;
    }
  }
  FT_HOST_DEVICE rigid<strict_double> of_camera(rigid<strict_double> const& T_bw) const {
    if constexpr (Rig::rectified) {
      return rig.to_camera(camera, T_bw);
    } else {
      return T_bw;
    }
  }
  FT_HOST_DEVICE rigid<strict_double> of_body(rigid<strict_double> const& T_cw) const {
    if constexpr (!Rig::rectified) {
      return T_cw;
    } else {
      // What turns derivatives turns the columns of a rotation.
      return rigid<strict_double>{rig.derivative_in_body(camera, T_cw.R.transposed()).transposed(),
                                  rig.to_body(camera, T_cw.t)}
          .orthonormalized();
    }
  }
  /// Squared error of match i in eighths of its variance, at most `limit`.
  FT_HOST_DEVICE int error(rigid<strict_double> const& T, int i) const {
    return error(T.template cast<strict_float>(), i);
  }
  FT_HOST_DEVICE int error(rigid<strict_float> const& T, int i) const { return error(T, list[i]); }
  FT_HOST_DEVICE int error(rigid<strict_float> const& T, observation const o) const {
    auto const p = T * o.point.template cast<strict_float>();
    auto const seen = model().template cast<strict_float>().project(p);
    strict_float const dx = seen.pixel.x - strict_float(o.u);
    strict_float const dy = seen.pixel.y - strict_float(o.v);
    strict_float const e = (dx * dx + dy * dy) * strict_float(8.0f * o.inv_sigma2);
    return seen.valid && e < strict_float(static_cast<float>(limit)) ? static_cast<int>(e.value)
                                                                     : limit;
  }
  /// Sum of the errors; a number that is not below `enough` as soon as it is known.
  FT_HOST_DEVICE int cost(rigid<strict_double> const& T_cw, int enough) const {
    auto const T = T_cw.template cast<strict_float>();
    int sum = 0;
    for (int i = 0; i < n && sum < enough; ++i) { sum += error(T, i); }
    return sum;
  }
};

/// Pose h: from three matches, the one of its solutions that a fourth match agrees with most.
/// @pre at least four matches
template <typename Rig, int Limit>
FT_HOST_DEVICE bool pose_of_three(seen_matches<Rig, Limit> const& in, counter_draws const& draws,
                                  int h, rigid<strict_double>& T) {
  int drawn[4];
  draws.distinct(in.n, static_cast<std::uint64_t>(h), drawn);
  auto const camera = in.model().template cast<strict_double>();
  vec3<strict_double> ray[3], point[3];
  for (int i = 0; i < 3; ++i) {
    observation const& o = in.list[drawn[i]];
    auto const seen = camera.unproject(
        {strict_double(static_cast<double>(o.u)), strict_double(static_cast<double>(o.v))});
    if (!seen.valid) { return false; }
    auto const length = scalar::sqrt(dot(seen.direction, seen.direction));
    ray[i] = scaled(seen.direction, strict_double(1) / length);
    point[i] = o.point.template cast<strict_double>();
  }
  observation const& fourth = in.list[drawn[3]];
  bool found = false;
  strict_double least = 0;
  three_point_solver(ray, point).for_each_pose([&](rigid<strict_double> const& T_cw) {
    auto const seen = camera.project(T_cw * fourth.point.template cast<strict_double>());
    strict_double const dx = seen.pixel.x - strict_double(static_cast<double>(fourth.u));
    strict_double const dy = seen.pixel.y - strict_double(static_cast<double>(fourth.v));
    strict_double const e = dx * dx + dy * dy;
    if (seen.valid && (!found || e < least)) {
      found = true;
      T = T_cw;
      least = e;
    }
  });
  return found;
}

/// Draws 256 poses and keeps the one with the least sum of truncated squared errors, the first of
/// equals. Called by all threads of a group. @pre at least four matches
/// @param to of the body, in memory that the group's threads share; written if there is one
/// @return whether there is one
template <typename Group, typename Rig, int Limit>
FT_HOST_DEVICE bool draw_pose(Group g, seen_matches<Rig, Limit> const& matches,
                              counter_draws const& draws, rigid<double>& to) {
  constexpr int hypotheses = 256;
  constexpr int none = 1 << 30;  // cost of a hypothesis that there is not
  auto T = rigid<strict_double>::identity(), best_T = T;
  int best = none, best_number = none;
  for (int h = g.rank(); h < hypotheses; h += g.size()) {
    if (!pose_of_three(matches, draws, h, T)) { continue; }
    int const cost = matches.cost(T, best);
    if (cost < best) {
      best = cost;
      best_number = h;
      best_T = T;
    }
  }
  int const least = g.reduce(best, min_op{});
  int const number = g.reduce(best == least ? best_number : none, min_op{});
  if (number == none) { return false; }
  if (best_number == number && best == least) {
    to = matches.of_body(best_T).template cast<double>();
  }
  g.sync();
  return true;
}

/// The sum of truncated squared errors of a pose of the body, by all threads of a group.
/// @param support gets the number of matches that agree with it
template <typename Group, typename Rig, int Limit>
FT_HOST_DEVICE int cost_of_pose(Group g, seen_matches<Rig, Limit> const& matches,
                                rigid<double> const& T_bw, int& support) {
  auto const T_cw = matches.of_camera(T_bw.template cast<strict_double>());
  int cost = 0, agree = 0;
  for (int i = g.rank(); i < matches.n; i += g.size()) {
    int const e = matches.error(T_cw, i);
    cost += e;
    agree += static_cast<int>(e < Limit);
  }
  support = g.reduce(agree, sum_op{});
  return g.reduce(cost, sum_op{});
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
