// SPDX-License-Identifier: Apache-2.0
/// @file The current frame as searches and pose optimisation see it.
#pragma once

#include <cstddef>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// The current frame as the searches see it. One camera, or two of a fisheye pair: keypoints of
/// camera c of batch entry b are batch entry `keypoint_step * b + c` of `keypoints`. Keypoint k of
/// camera c has number c * capacity + k in the arrays below, which have `cameras * capacity`
/// entries per batch entry.
struct frame_view {
  keypoints_view keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  int batch = 1;
  feature_grid_view grids;  ///< batch entry cameras * b + c
  float const* right_x =
      nullptr;  ///< [batch][capacity] column in the right image, -1 = none; or null
  int const* partner = nullptr;  ///< number of the stereo partner, -1 = none; or null
  int* holder = nullptr;         ///< slot of the map point that a keypoint holds, -1 = none

  FT_HOST_DEVICE int capacity() const { return keypoints.capacity; }
  FT_HOST_DEVICE int numbers() const { return cameras * keypoints.capacity; }
  FT_HOST_DEVICE keypoints_view camera(int b, int c) const {
    return keypoints.slice(keypoint_step * b + c);
  }
};

/// Which map points were seen in which frame: written after a search, so that the next leaves them
/// out.
struct point_stamps {
  int const* frame = nullptr;  ///< [batch] number of this frame
  int* seen = nullptr;  ///< [batch][map slots] number of the frame that held a point last, or null

  /// Whether a slot of batch entry b was seen in this frame. @param slots of a map
  FT_HOST_DEVICE bool stamped(int b, int slots, int slot) const {
    return seen != nullptr && seen[static_cast<std::ptrdiff_t>(b) * slots + slot] == frame[b];
  }
};

}  // namespace FT_ABI
}  // namespace ft
