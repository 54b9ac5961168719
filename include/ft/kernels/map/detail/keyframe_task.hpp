// SPDX-License-Identifier: Apache-2.0
/// @file What the steps of place_keyframe share.
#pragma once

#include <cstddef>
#include <limits>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr int unclaimed = std::numeric_limits<int>::max();

/// The new keyframe of a batch entry.
template <typename Rig>
struct keyframe_task {
  using rig_type = Rig;
  /// Cameras whose keypoints may have a depth.
  static constexpr int depth_cameras = Rig::rectified ? Rig::cameras : 1;

  keyframe_input<Rig> const& in;
  keyframe_params const& params;
  odometry_map_view const& map;
  keyframe_workspace const& work;
  int b;
  int made;   ///< number of the newest keyframe before this one
  int count;  ///< keyframes before this one
  int used;   ///< slots that may be in use

  FT_HOST_DEVICE int position() const { return map.keyframes.position(made + 1); }
  /// Index of the first keypoint of all cameras.
  FT_HOST_DEVICE std::ptrdiff_t first() const {
    return static_cast<std::ptrdiff_t>(b) * in.frame.numbers();
  }
  /// Depths of camera c's keypoints.
  FT_HOST_DEVICE float const* depth(int c) const {
    return in.depth + (static_cast<std::ptrdiff_t>(b) * depth_cameras + c) * in.frame.capacity();
  }
  FT_HOST_DEVICE int* holders() const { return in.frame.holder + first(); }
  FT_HOST_DEVICE int const* partners() const {
    if (in.frame.partner == nullptr) { return nullptr; }
    return in.frame.partner + first();
  }
  FT_HOST_DEVICE int keypoints(int c) const { return *in.frame.camera(b, c).count; }
  FT_HOST_DEVICE int& claim(int c, int slot) const {
    return work.claim[work.at(b, c, slot, in.frame.cameras, map.records.slots)];
  }
  /// Whether a keypoint of this frame holds the point.
  FT_HOST_DEVICE unsigned char& claimed(int slot) const {
    return work.claimed[map.records.at(b, slot)];
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
