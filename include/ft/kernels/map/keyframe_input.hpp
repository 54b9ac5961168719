// SPDX-License-Identifier: Apache-2.0
/// @file Inputs, results and workspace of insert_keyframe, and what its steps share.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Whether a frame becomes a keyframe.
enum class keyframe_order : int {
  none = 0,
  add = 1,
  begin_map = 2,  ///< empties the map first
};

/// Keypoints of camera c up to this depth are near, metres: `near_depth` baselines of its own pair.
template <typename Rig>
FT_HOST_DEVICE float near_limit(Rig const& rig, int c, float near_depth) {
  if constexpr (Rig::rectified) {
    return (rig.pair(c).baseline_length() * near_depth).value;
  } else {
    static_cast<void>(c);
    return (rig.baseline_length() * near_depth).value;
  }
}

/// The frames that may become keyframes. `frame.holder` is read and written.
template <typename Rig>
struct keyframe_input {
  Rig rig;
  frame_view frame;
  keyframe_order const* order = nullptr;  ///< [batch]
  rigid<double> const* T_cw =
      nullptr;  ///< [batch] world to left camera, or to a multi_rig's body, metres
  std::int64_t const* time_ns = nullptr;  ///< [batch]
  /// [batch][capacity] of left keypoints, of a multi_rig [batch][cameras * capacity], metres; a
  /// keypoint without a positive finite depth has no stereo point
  float const* depth = nullptr;
  /// [batch][capacity] in the left camera's frame, metres; not read for a rectified pair.
  vec3<float> const* point = nullptr;
  pyramid_geometry geometry;
  /// [batch][cameras * capacity] as in frames_in_map; null: no keypoint was moved
  float const* moves = nullptr;
};

struct keyframe_params {
  float near_depth = 0;          ///< as in near_limit(): keypoints up to there become points
  int wanted_near_points = 100;  ///< stereo points that a camera gives a keyframe at least, near or
                                 ///< not
  int cull_after = 10;           ///< frames in view after which a point has to have proved itself
  int cull_share = 4;            ///< a point found in less than 1 / cull_share of them is removed
};

/// What became of the frames' keypoints. Written for batch entries that insert a keyframe.
struct keyframe_result {
  int* held = nullptr;      ///< [batch] left keypoints that hold a point, old or new
  int* left_out = nullptr;  ///< [batch] points for which there was no free slot
};

struct keyframe_workspace {
  int* claim = nullptr;  ///< [batch][cameras][slots] lowest keypoint that holds the point; defined
                         ///< for points that a keypoint holds
  unsigned char* claimed = nullptr;  ///< [batch][slots] 1 = a keypoint holds the point
  unsigned* free_rows = nullptr;     ///< [batch][rows of 32 slots] a bit for each free slot
  int* free_slots = nullptr;         ///< [batch][numbers] slots for new points, ascending
  int* new_points = nullptr;         ///< [batch][numbers] keypoints to become points, ascending

  /// Index into `claim`. @param slots of the map
  FT_HOST_DEVICE static std::ptrdiff_t at(int b, int c, int slot, int cameras, int slots) {
    return (static_cast<std::ptrdiff_t>(b) * cameras + c) * slots + slot;
  }
};

/// Places the arrays into an arena. @param capacity keypoints of an image
inline void carve(carver& c, keyframe_workspace& v, int slots, int capacity, int cameras,
                  int batch) {
  c.place({batch, cameras, slots}, v.claim);
  c.place({batch, slots}, v.claimed);
  c.place({batch, ceil_div(slots, 32)}, v.free_rows);
  c.place({batch, cameras, capacity}, v.free_slots, v.new_points);
}

namespace detail {

inline constexpr int unclaimed = std::numeric_limits<int>::max();

/// Column of the match of camera c's keypoint i in the right image, at its octave; -1 = none.
template <typename Rig>
FT_HOST_DEVICE float right_column(frame_view const& frame, int b, int c, int i) {
  if (!Rig::rectified || frame.right_x == nullptr) { return -1.0f; }
  return frame.right_x[static_cast<std::ptrdiff_t>(b) * frame.numbers() + c * frame.capacity() + i];
}

/// The stereo point of a left keypoint, in its camera's frame.
template <typename Rig>
FT_HOST_DEVICE vec3<float> stereo_point(keyframe_input<Rig> const& in, int b, int c, int i) {
  if constexpr (is_monocular_v<Rig>) {
    static_cast<void>(c);
    return in.point[static_cast<std::ptrdiff_t>(b) * in.frame.capacity() + i];
  } else if constexpr (Rig::rectified) {
    keypoints_view const keypoints = in.frame.camera(b, c);
    int const octave = get<field::octave>(keypoints, i);
    strict_float const x = in.geometry.column(get<field::x>(keypoints, i), octave);
    strict_float const y = in.geometry.row(get<field::y>(keypoints, i), octave);
    auto ray = in.rig.pair(c).camera.template cast<strict_float>().unproject({x, y}).direction;
    if constexpr (is_mixed_v<Rig>) { ray = {ray.x / ray.z, ray.y / ray.z, 1.0f}; }
    float const z = in.geometry.depth(
        in.depth[static_cast<std::ptrdiff_t>(b) * in.frame.numbers() + c * in.frame.capacity() + i],
        octave);
    return {(ray.x * z).value, (ray.y * z).value, z};
  } else {
    static_cast<void>(c);
    return in.point[static_cast<std::ptrdiff_t>(b) * in.frame.capacity() + i];
  }
}

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
