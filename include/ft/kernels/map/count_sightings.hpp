// SPDX-License-Identifier: Apache-2.0
/// @file Stage: counts in how many frames map points were in view, and in how many they were found.
#pragma once

#include "ft/containers/frame.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/search/frustum.hpp"

namespace ft {
inline namespace FT_ABI {

/// What count_sightings counts of a frame.
enum class sightings : int {
  none = 0,        ///< nothing: the frame was not tracked
  all = 1,         ///< points in view, and points found
  found_only = 2,  ///< points found: the camera was recovered, and what is in view is a guess's
};

/// Inputs of count_sightings, apart from the frame and the map.
struct sightings_input {
  sightings const* kind = nullptr;   ///< [batch]
  visibility const* seen = nullptr;  ///< [cameras][batch][local.capacity] of the local map's search
  local_map_view local;
  point_stamps stamps;  ///< points matched from the last frame; `seen` may not be null
};

/// Counts for each map point the frames that had it in view, which are those that matched it from
/// the last frame or that see it in the local map, and the frames with a keypoint that holds it.
/// Asynchronous on `exec`; allocates nothing; one launch.
template <typename Exec>
void count_sightings(Exec const& exec, frame_view const& frame, sightings_input const& in,
                     odometry_map_view const& map);

}  // namespace FT_ABI
}  // namespace ft
