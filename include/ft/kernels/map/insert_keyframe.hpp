// SPDX-License-Identifier: Apache-2.0
/// @file Stage: makes keyframes of frames.
#pragma once

#include <cstddef>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/detail/describe_point.hpp"
#include "ft/kernels/map/detail/place_keyframe.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(keyframe_params const& p) {
  detail::require_range("near depth", p.near_depth, 1e-3f, 1e6f);
  detail::require_range("wanted near points", p.wanted_near_points, 0, 1 << 24);
  detail::require_range("frames before culling", p.cull_after, 1, 1 << 24);
  detail::require_range("share of culling", p.cull_share, 1, 1 << 24);
}

namespace detail {

/// Writes the keypoints of a new keyframe, and what its points learn from them. Item: a keypoint
/// number of a batch entry. After place_keyframe.
template <typename Rig>
struct record_keypoint {
  struct scratch {
    descriptor_distances distance;
  };
  using input = keyframe_input<Rig>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, input const& in,
                                 odometry_map_view const& map,
                                 keyframe_workspace const& work) const {
    frame_view const& frame = in.frame;
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const i = number % frame.capacity();
    if (in.order[b] == keyframe_order::none || i >= *frame.camera(b, c).count) { return; }
    int const slot = frame.holder[item];
    auto const claim = [&](int camera) {
      return work.claim[work.at(b, camera, slot, frame.cameras, map.records.slots)];
    };
    bool const holds = slot >= 0 && claim(c) == number;
    if (g.rank() == 0) { write_keypoint(in, map, b, number, holds ? slot : -1); }
    if (!holds) { return; }
    // Of several cameras the first one's keypoint describes the point.
    for (int before = 0; before < c; ++before) {
      if (claim(before) != unclaimed) { return; }
    }
    std::ptrdiff_t const at = map.records.at(b, slot);
    int const described = map.records.described[at];
    g.sync();
    if (described == 0 && g.rank() == 0) { place_point(in, map, b, number, slot); }
    add_descriptor(g, s.distance, map, at, described + 1, get<field::orb>(frame.camera(b, c), i));
    vec3<float> const normal = mean_direction(g, map, b, slot);
    if (g.rank() == 0) { array_of<field::normal>(map.points)[at] = normal; }
  }

private:
  /// @param slot that the keypoint observes, -1 = none
  FT_HOST_DEVICE static void write_keypoint(input const& in, odometry_map_view const& map, int b,
                                            int number, int slot) {
    int const c = number / in.frame.capacity();
    int const i = number % in.frame.capacity();
    keypoints_view const keypoints = in.frame.camera(b, c);
    keyframes_view const& to = map.keyframes;
    std::ptrdiff_t const at = to.at(b, to.position(to.made[b]), number);
    int const octave = get<field::octave>(keypoints, i);
    to.x[at] = in.geometry.column(get<field::x>(keypoints, i), octave);
    to.y[at] = in.geometry.row(get<field::y>(keypoints, i), octave);
    to.octave[at] = octave;
    std::ptrdiff_t const item = static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + number;
    to.aligned[at] = in.moves != nullptr && slot >= 0 && in.moves[item] >= 0 ? 1 : 0;
    float const right_x = right_column<Rig>(in.frame, b, c, i);
    to.right_x[at] = right_x < 0 ? -1.0f : in.geometry.column(right_x, octave);
    to.holder[at] = slot;
    to.holder_number[at] = slot >= 0 ? map.records.number[map.records.at(b, slot)] : 0;
  }

  /// Position and distances of a new point, from its first keypoint. Distances are those from the
  /// camera that sees it.
  FT_HOST_DEVICE static void place_point(input const& in, odometry_map_view const& map, int b,
                                         int number, int slot) {
    int const c = Rig::rectified ? number / in.frame.capacity() : 0;
    int const i = number - c * in.frame.capacity();
    map_points_view const points = map.points.slice(b);
    vec3<strict_double> const seen = widened(stereo_point(in, b, c, i));
    vec3<strict_double> in_body = seen;
    if constexpr (Rig::rectified) { in_body = in.rig.to_body(c, seen); }
    auto const T_cw = in.T_cw[b].template cast<strict_double>();
    strict_float const distance = static_cast<float>(scalar::sqrt(dot(seen, seen)).value);
    pyramid_geometry const& levels = in.geometry;
    int const octave = get<field::octave>(in.frame.camera(b, c), i);
    strict_float const most = distance * levels.scale[octave];
    get<field::position>(points, slot) = narrowed(T_cw.inverse() * in_body);
    get<field::max_distance>(points, slot) = most.value;
    get<field::min_distance>(points, slot) = (most / levels.scale[levels.levels - 1]).value;
  }
};

}  // namespace detail

/// Makes a keyframe of each frame whose `order` says so. Other batch entries are not touched.
///
/// 1. `begin_map` empties the map. Otherwise points that were in view in `cull_after` frames or
///    more and found in less than 1 / `cull_share` of them are removed.
/// 2. Keypoints that hold a point observe it: of several of a camera the one with the lowest
///    number. The right keypoint of a stereo match holds what the left one holds.
/// 3. Left keypoints with a stereo point and no map point become points: those that are near, and
///    more of the nearest until `wanted_near_points` stereo points are taken, counting those that
///    hold a map point (ties by number). Slots and numbers ascend with the number of the keypoint.
/// 4. The oldest keyframe leaves a full ring. If slots are still short, more of the oldest leave.
///    Points that no keyframe sees any more are removed. New points that find no slot are left out,
///    those with the highest keypoint numbers.
/// 5. A point that the keyframe sees gets its descriptor, the most typical of the last
///    point_descriptors, and its normal, the mean of the viewing directions. A new point can be
///    seen from the distances at which its keypoint's octave is one of the pyramid's.
/// 6. Neighbours: that of the new keyframe is the one that shares most points with it, the newest
/// of
///    equals. The new keyframe becomes the neighbour of those that share at least as many points
///    with it as with theirs, at the time that was found, or whose neighbour has left.
///
/// `frame.holder` has the result: keypoints of new points hold them, holders of removed points are
/// -1. Source: C. Campos and others, "ORB-SLAM3", 2021, for culling and the choice of descriptors.
/// Asynchronous on `exec`; allocates nothing; two launches.
/// @throws bad_argument for parameters out of range, or for a map made for other frames
template <typename Exec, typename Rig>
void insert_keyframe(Exec const& exec, keyframe_input<Rig> const& in, keyframe_params const& params,
                     odometry_map_view const& map, keyframe_result const& out,
                     keyframe_workspace const& work) {
  check(params);
  detail::require(map.keyframes.capacity == in.frame.capacity() &&
                      map.keyframes.cameras == in.frame.cameras &&
                      map.keyframes.batch == in.frame.batch,
                  "the map's keyframes have another shape than the frames");
  for_each_item<per_block<1024>>(exec, in.frame.batch, detail::place_keyframe<Rig>{}, in, params,
                                 map, out, work);
  for_each_item<per_warp>(exec, in.frame.batch * in.frame.numbers(), detail::record_keypoint<Rig>{},
                          in, map, work);
}

}  // namespace FT_ABI
}  // namespace ft
