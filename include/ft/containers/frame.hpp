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
/// It has one camera, the two of a fisheye pair, or those of a multi_rig. Keypoints of camera c of
/// batch entry b are batch entry image(b, c) of `keypoints`. Keypoint k of camera c has the number
/// `c * capacity + k`, which indexes `right_x`, `partner` and `holder`.
struct frame_view {
  keypoints_view keypoints;
  int keypoint_step = 2;  ///< images of a frame
  int camera_step = 1;    ///< images from a camera's to that of the next one
  int cameras = 1;
  int batch = 1;
  /// Batch entry `cameras * b + c`.
  feature_grid_view grids;
  /// [batch][cameras * capacity] column of the match in the right image, pixels; -1 = none. Null
  /// without right images.
  float const* right_x = nullptr;
  /// [batch][cameras * capacity] number of the stereo partner, -1 = none. May be null.
  int const* partner = nullptr;
  /// [batch][cameras * capacity] slot of the map point matched to a keypoint, -1 = none.
  int* holder = nullptr;

  FT_HOST_DEVICE int capacity() const { return keypoints.capacity; }
  FT_HOST_DEVICE int numbers() const { return cameras * keypoints.capacity; }
  FT_HOST_DEVICE int image(int b, int c) const { return keypoint_step * b + camera_step * c; }
  FT_HOST_DEVICE keypoints_view camera(int b, int c) const { return keypoints.slice(image(b, c)); }
  /// Only batch entry b.
  frame_view slice(int b) const {
    frame_view v = *this;
    auto const first = static_cast<std::ptrdiff_t>(b) * numbers();
    v.keypoints = keypoints.slice(image(b, 0));
    v.grids = grids.slice(cameras * b);
    v.batch = 1;
    if (right_x != nullptr) { v.right_x += first; }
    if (partner != nullptr) { v.partner += first; }
    if (holder != nullptr) { v.holder += first; }
    return v;
  }
  /// The frame as a batch of the independent searches of a rig; search s of batch entry b is entry
  /// `searches * b + s`.
  frame_view of_searches(int searches) const {
    frame_view v = *this;
    v.keypoint_step = keypoint_step / searches;
    v.cameras = cameras / searches;
    v.batch = batch * searches;
    return v;
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
