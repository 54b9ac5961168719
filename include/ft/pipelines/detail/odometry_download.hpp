// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry tells its caller: results, the map in host memory, refused parameters.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/pipelines/detail/odometry_memory.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Writes infinite variances without covariances.
inline void unknown_covariance(double (&out)[36]) {
  for (int i = 0; i < 36; ++i) {
    out[i] = i % 7 == 0 ? std::numeric_limits<double>::infinity() : 0.0;
  }
}

/// The variance of unit weight: how large the squared errors of inliers are beside those that the
/// information matrix assumes, one pixel of an octave. That assumption counts like so many numbers.
inline double variance_of(frame_facts const& facts) {
  constexpr double assumed = 20;
  double const misfit = static_cast<double>(facts.misfit) / frame_facts::misfit_one;
  return (misfit + assumed) / (std::max(facts.rows - 6, 0) + assumed);
}

/// By how much errors of the map's points add to the variance of a keypoint's: each point is what
/// some five keyframes saw. Of a camera at rest they are the same in each frame, and no motion has
/// them.
inline double variance_with_points(int inliers, int resting) {
  return inliers > 0 ? 1 + 0.2 * (inliers - std::min(resting, inliers)) / inliers : 1.0;
}

/// Inverts an information matrix. The covariance of one that is not positive definite is unknown.
/// @param upper its upper triangle by rows @param variance of unit weight
inline void invert_information(float const* upper, double variance, double (&out)[36]) {
  if (!invert_6(upper, out)) {
    unknown_covariance(out);
    return;
  }
  for (double& v : out) { v *= variance; }
}

inline image_light light_of(light_sums const& l) {
  if (l.image < 0) { return {}; }
  double const mean = static_cast<double>(l.sum) / light_sums::samples;
  double const squares = static_cast<double>(l.squares) / light_sums::samples;
  return {l.image, mean, std::sqrt(squares - mean * mean)};
}

inline tracking tracking_of(odometry_output const& o) {
  tracking t;
  t.T_world_camera = o.T_cw.cast<strict_double>().inverse().cast<double>();
  auto& at = t.T_world_camera.t;
  at = {at.x + 0.0, at.y + 0.0, at.z + 0.0};  // -0 becomes 0
  t.state = o.state;
  t.keyframe = o.keyframe != 0;
  t.inliers = o.inliers;
  t.keypoints = o.seen.keypoints;
  t.stereo_points = o.seen.with_depth;
  t.local_points = o.local_points;
  t.left_out = o.left_out;
  t.map_points = o.map_points;
  t.maps = o.maps;
  t.keyframes = o.keyframes;
  t.map_begun = o.begins_map != 0;
  t.agreed = o.agreed;
  t.distant_points = o.seen.distant;
  t.light = light_of(o.seen.light);
  t.map_id = o.state == tracking_state::initialising ? 0 : o.maps;
  t.evidence.facts = o.facts;
  t.evidence.ambiguous = o.seen.ambiguous;
  t.evidence.rows_apart = o.seen.with_depth > 0
                              ? static_cast<double>(o.seen.rows_apart) / seen_counts::row_one /
                                    static_cast<double>(o.seen.with_depth)
                              : 0;
  t.evidence.images = o.seen.changes.images;
  t.evidence.same = o.seen.changes.same;
  t.evidence.textured = o.seen.changes.textured;
  t.evidence.moved = o.seen.changes.moved;
  t.evidence.streaked = o.seen.changes.streaked;
  t.start = o.start.outcome;
  t.start_matches = o.start.matches;
  if (o.begins_first_map != 0) { return t; }
  if (o.inliers > 0) {
    double const points = variance_with_points(o.inliers, o.facts.resting);
    invert_information(o.information, points * variance_of(o.facts), t.covariance);
  } else {
    unknown_covariance(t.covariance);
  }
  return t;
}

/// A copy of `count` values in host memory.
template <typename Exec, typename T>
std::vector<T> downloaded(Exec const& exec, T const* from, std::size_t count) {
  buffer<T, staging_space<Exec>> const to(count);
  copy(exec, to.data(), from, count);
  exec.wait();
  return std::vector<T>(to.data(), to.data() + count);
}

template <typename Exec>
odometry_map download_odometry_map(Exec const& exec, odometry_map_view const& map, int b) {
  odometry_map out;
  auto const slots = static_cast<std::size_t>(map.records.slots);
  auto const first = map.records.at(b, 0);
  auto const points = map.points.slice(b);
  auto const column = [&](auto const* from) { return downloaded(exec, from, slots); };
  auto const position = column(array_of<field::position>(points));
  auto const normal = column(array_of<field::normal>(points));
  auto const nearest = column(array_of<field::min_distance>(points));
  auto const farthest = column(array_of<field::max_distance>(points));
  auto const number = column(map.records.number + first);
  auto const words = static_cast<std::size_t>(map.records.words);
  auto const seen_by = downloaded(exec, map.records.mask(b, 0), slots * words);
  for (std::size_t s = 0; s < slots; ++s) {
    if (number[s] == 0) { continue; }
    int observers = 0;
    for (std::size_t w = 0; w < words; ++w) { observers += popcount(seen_by[s * words + w]); }
    out.points.push_back({position[s], normal[s], nearest[s], farthest[s], static_cast<int>(s),
                          number[s], observers});
  }
  keyframes_view const& kf = map.keyframes;
  auto const positions = static_cast<std::size_t>(kf.positions);
  auto const T_cw = downloaded(exec, kf.T_cw + kf.at(b, 0), positions);
  auto const time_ns = downloaded(exec, kf.time_ns + kf.at(b, 0), positions);
  int const made = downloaded(exec, kf.made + b, 1)[0];
  int const count = downloaded(exec, kf.count + b, 1)[0];
  for (int n = made - count + 1; n <= made; ++n) {
    auto const p = static_cast<std::size_t>(kf.position(n));
    out.keyframes.push_back(
        {n, time_ns[p], T_cw[p].template cast<strict_double>().inverse().template cast<double>()});
  }
  return out;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
