// SPDX-License-Identifier: Apache-2.0
/// @file A frame of an odometry as what is kept of it for loops.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/loops/keep_keyframe.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The last frame with the depths of its keypoints: of one camera those of the map.
template <typename Exec, typename Rig>
auto frame_with_points([[maybe_unused]] Exec const& exec,
                       odometry_stages<Exec, Rig> const& stages) {
  auto in = stages.as_keyframe();
  if constexpr (odometry_stages<Exec, Rig>::starts_from_motion) {
    auto const& seen = stages.beginning.points();  // the next keyframe writes it anew
    place_held_points(exec, in, stages.own.map.points, seen.depth, seen.point);
    in.depth = seen.depth;
    in.point = seen.point;
  }
  return in;
}

/// The same: of one camera all keypoints have depths that say nothing.
template <typename Exec, typename Rig>
auto frame_with_any_points([[maybe_unused]] Exec const& exec,
                           odometry_stages<Exec, Rig> const& stages) {
  auto in = stages.as_keyframe();
  if constexpr (odometry_stages<Exec, Rig>::starts_from_motion) {
    auto const& seen = stages.beginning.points();
    place_all_ahead(exec, in.frame.capacity(), seen.depth, seen.point);
    in.depth = seen.depth;
    in.point = seen.point;
  }
  return in;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
