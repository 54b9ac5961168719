// SPDX-License-Identifier: Apache-2.0
/// @file Stage: makes keyframes of frames.
#pragma once

#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/detail/place_keyframe.hpp"
#include "ft/kernels/map/detail/record_keyframe.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
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
