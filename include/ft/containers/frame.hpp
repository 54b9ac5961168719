// SPDX-License-Identifier: Apache-2.0
/// @file The current frame, the input of searches and pose optimisation.
#pragma once

#include <cstddef>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// The current frame: its keypoints, their stereo matches and the map points matched to them.
///
/// It has one camera, or the two of a fisheye pair. Keypoints of camera c of batch entry b are
/// batch entry `keypoint_step * b + c` of `keypoints`. Keypoint k of camera c has the number `c *
/// capacity + k`, which indexes `partner` and `holder`.
struct frame_view {
  keypoints_view keypoints;
  int keypoint_step = 2;
  int cameras = 1;
  int batch = 1;
  /// Batch entry `cameras * b + c`.
  feature_grid_view grids;
  /// [batch][capacity] column of the match in the right image, pixels; -1 = none. May be null.
  float const* right_x = nullptr;
  /// [batch][cameras * capacity] number of the stereo partner, -1 = none. May be null.
  int const* partner = nullptr;
  /// [batch][cameras * capacity] slot of the map point matched to a keypoint, -1 = none.
  int* holder = nullptr;

  FT_HOST_DEVICE int capacity() const { return keypoints.capacity; }
  FT_HOST_DEVICE int numbers() const { return cameras * keypoints.capacity; }
  FT_HOST_DEVICE keypoints_view camera(int b, int c) const {
    return keypoints.slice(keypoint_step * b + c);
  }
};

/// The last frame in which each map point was matched. The search from the last frame writes it,
/// and the search in the local map skips the points of the current frame.
struct point_stamps {
  /// [batch] number of the current frame.
  int const* frame = nullptr;
  /// [batch][map slots] number of the last frame that matched a point. May be null.
  int* seen = nullptr;

  /// Whether a slot of batch entry b was matched in the current frame.
  /// @param slots capacity of the map
  FT_HOST_DEVICE bool stamped(int b, int slots, int slot) const {
    return seen != nullptr && seen[static_cast<std::ptrdiff_t>(b) * slots + slot] == frame[b];
  }
};

}  // namespace FT_ABI
}  // namespace ft
