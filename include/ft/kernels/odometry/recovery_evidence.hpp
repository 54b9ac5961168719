// SPDX-License-Identifier: Apache-2.0
/// @file Whether the matches of a lost camera are more than a wrong pose would find.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline constexpr int evidence_one = 1 << 16;  ///< fixed point: 1, or one bit

/// Logarithm to base 2 in 1 / 65536, rounded down. @param v 1 to 2^32 - 1
FT_HOST_DEVICE inline std::int64_t log2_fixed(std::uint64_t v) {
  int const whole = highest_bit(v);
  std::uint64_t x = v << (31 - whole);  // 1 to 2, in 2^-31
  std::int64_t log = whole;
  for (int digit = 0; digit < 16; ++digit) {
    x = x * x >> 31;
    bool const is_one = x >> 32 != 0;
    log = 2 * log + static_cast<int>(is_one);
    if (is_one) { x >>= 1; }
  }
  return log;
}

/// How unlikely it is that of n points, each of which is matched with chance p, as many as k are
/// matched: n KL(k / n || p) in bits, whose power of two bounds the tail of the binomial
/// distribution. In integers, so that all executors have the same. Source: H. Chernoff, "A measure
/// of asymptotic efficiency for tests of a hypothesis based on the sum of observations", 1952.
/// @param p in 1 / 65536 @return in 1 / 65536 bits; 0 if k is no more than is expected
FT_HOST_DEVICE inline std::int64_t binomial_evidence(int k, int n, int p) {
  if (n < 1) { return 0; }
  k = min_of(k, n);
  p = clamp(p, 1, evidence_one - 1);
  if (static_cast<std::int64_t>(k) * evidence_one <= static_cast<std::int64_t>(n) * p) { return 0; }
  auto const log = [](int v) { return log2_fixed(static_cast<std::uint64_t>(v)); };
  // The logarithm of (part / n) / (chance / 65536), for each of the part.
  auto const sum = [&](int part, int chance) {
    if (part == 0) { return std::int64_t{0}; }
    return part * (log(part) - log(n) - log(chance) + std::int64_t{16} * evidence_one);
  };
  return max_of(sum(k, p) + sum(n - k, evidence_one - p), std::int64_t{0});
}

/// A match by chance has at least this chance, in 1 / 65536: a pose has six degrees of freedom to
/// please some of the points.
inline constexpr int least_chance = evidence_one / 1000;

/// Points that were searched for a lost camera, and the keypoints that they may be matched to.
struct searched_evidence {
  int points = 0;              ///< that project into an image with the pose, once per camera
  std::int64_t by_chance = 0;  ///< of these, as many as a wrong pose would match, in 1 / 65536

  /// The evidence of so many inliers, in 1 / 65536 bits.
  FT_HOST_DEVICE std::int64_t bits(int inliers) const {
    if (points < 1) { return 0; }
    std::int64_t const p = min_of(by_chance / points, std::int64_t{evidence_one});
    return binomial_evidence(inliers, points, max_of(static_cast<int>(p), least_chance));
  }
};

/// Half side of the square around a point whose keypoints are counted, pixels at its octave.
inline constexpr float evidence_radius = 24.0f;

/// The chance that a keypoint of the square is where an inlier would be: the area in which a match
/// is an inlier, a circle for 95 % of two degrees of freedom, as a share of the square's. In
/// 1 / 65536.
FT_HOST_DEVICE inline int inlier_share(pyramid_geometry const& geometry, int octave, int level) {
  constexpr float circle = 3.14159265f * 5.991f;
  constexpr float square = 4 * evidence_radius * evidence_radius;
  strict_float const share = strict_float(circle / square * evidence_one) *
                             geometry.sigma2[octave] * geometry.inv_sigma2[level];
  return static_cast<int>(share.value);
}

/// Adds what one visible point has around it: its keypoints are shared by the threads of a group,
/// which all call. The sums of the group are to be added up.
/// @param v the point's window in an image; slot -1 = it is not visible there
template <typename Group>
FT_HOST_DEVICE void weigh_point(Group g, search_window v, descriptor const& orb,
                                frame_view const& frame, int image, int grid,
                                local_search_params const& params, pyramid_geometry const& geometry,
                                searched_evidence& sum) {
  if (v.slot < 0) { return; }
  sum.points += static_cast<int>(g.rank() == 0);
  keypoints_view const kp = frame.keypoints.slice(image);
  v.radius = (strict_float(evidence_radius) * geometry.scale[v.max_level]).value;
  visit_cells(g, v, frame.grids.slice(grid), [&](int k) {
    if (k < 0 || !inside(v, kp, k) || hamming(kp.orb(k), orb) > params.max_hamming) { return; }
    sum.by_chance += inlier_share(geometry, kp.octave(k), v.max_level);
  });
}

/// Counts of all points of a list that a camera sees from its pose. All threads of a group call.
/// @param in with the pose that is judged; its `slots` and `slot_count` are the list. Stamps are
/// not
///   used; `seen` is null
/// @param capacity of the list
template <typename Group, typename Rig>
FT_HOST_DEVICE searched_evidence weigh_points(Group g, int b, local_search<Rig> const& in,
                                              int capacity, frame_view const& frame,
                                              map_points_view const& map) {
  using windows = local_map_windows<Rig, false>;
  search_windows_view shape;
  shape.capacity = capacity;
  shape.batch = frame.batch * Rig::searches;
  searched_evidence mine;
  map_points_view const points = map.slice(b);
  for (int s = 0; s < Rig::searches; ++s) {
    for (int i = g.rank(); i < in.slot_count[b]; i += g.size()) {
      window_pair const pair = windows::find(in, map, b * Rig::searches + s, i, shape, false);
      for (int c = 0; c < windows::cameras; ++c) {
        search_window const w = pair.camera(c);
        int const camera = s * windows::cameras + c;
        if (w.slot < 0) { continue; }
        weigh_point(single_group{}, w, get<field::orb>(points, w.slot), frame,
                    frame.image(b, camera), frame.cameras * b + camera, in.params, in.geometry,
                    mine);
      }
    }
  }
  return {g.reduce(mine.points, sum_op{}), g.reduce(mine.by_chance, sum_op{})};
}

/// @param bits in 1 / 65536
FT_HOST_DEVICE inline bool is_enough(std::int64_t bits, tracking_rules const& rules) {
  return bits >= static_cast<std::int64_t>(rules.min_evidence) * evidence_one;
}

/// Item: a batch entry. Writes the evidence of its inliers, in 1 / 65536 bits.
struct weigh_recovery {
  using scratch = no_scratch;

  template <typename Group, typename Rig>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, local_search<Rig> const& in,
                                 int capacity, frame_view const& frame, map_points_view const& map,
                                 int const* inliers, std::int64_t* bits) const {
    searched_evidence const of = weigh_points(g, b, in, capacity, frame, map);
    if (g.rank() == 0) { bits[b] = of.bits(inliers[b]); }
  }
};

}  // namespace detail

/// The evidence of the inliers of frames, each at its pose `in.T_cw`, among the points of the list
/// `in.slots`. Asynchronous on `exec`; allocates nothing; one launch.
/// @param capacity of the lists @param inliers [batch] @param bits [batch] output, 1 / 65536 bits
template <typename Exec, typename Rig>
void weigh_recoveries(Exec const& exec, local_search<Rig> const& in, int capacity,
                      frame_view const& frame, map_points_view const& map, int const* inliers,
                      std::int64_t* bits) {
  local_search<Rig> search = in;
  search.seen = nullptr;
  for_each_item<per_block<256>>(exec, frame.batch, detail::weigh_recovery{}, search, capacity,
                                frame, map, inliers, bits);
}

}  // namespace FT_ABI
}  // namespace ft
