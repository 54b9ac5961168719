// SPDX-License-Identifier: Apache-2.0
/// @file The keyframes of an odometry: a ring of poses and keypoints with the points that they
/// hold.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Most positions of a keyframe ring.
inline constexpr int max_keyframes = 256;

/// Keyframes in executor memory, a ring of `positions` for each batch entry.
///
/// Keyframes are numbered from 1, each newer one by 1 more, also across maps; the keyframe with
/// number n is at position (n - 1) % positions. Those in use are the newest `count`. The oldest
/// leaves first. Keypoint k of camera c has the number c * capacity + k, as in a frame_view.
///
/// A keypoint's observation counts only while the slot `holder` has the number `holder_number`;
/// later the slot belongs to another point.
struct keyframes_view {
  int positions = 0;
  int cameras = 1;   ///< whose keypoints are searched: Rig::cameras
  int capacity = 0;  ///< keypoints of an image
  int batch = 0;
  int* made = nullptr;              ///< [batch] number of the newest keyframe, 0 = none yet
  int* count = nullptr;             ///< [batch] keyframes in use
  rigid<double>* T_cw = nullptr;    ///< [batch][positions] world to left camera, metres
  std::int64_t* time_ns = nullptr;  ///< [batch][positions]
  /// [batch][positions] number of the keyframe that shares most points with this one, 0 = none.
  /// Known since one of the two was inserted; see insert_keyframe.
  int* neighbour = nullptr;
  int* shared = nullptr;         ///< [batch][positions] number of these points, at that time
  int* keypoints = nullptr;      ///< [batch][positions][cameras]
  float* x = nullptr;            ///< [batch][positions][numbers] pixels
  float* y = nullptr;            ///< [batch][positions][numbers] pixels
  float* right_x = nullptr;      ///< [batch][positions][numbers] -1 = none
  int* octave = nullptr;         ///< [batch][positions][numbers]
  int* holder = nullptr;         ///< [batch][positions][numbers] slot, -1 = none
  int* holder_number = nullptr;  ///< [batch][positions][numbers] of the point, 0 = none

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch}, made, count);
    each({batch, positions}, T_cw, time_ns, neighbour, shared);
    each({batch, positions, cameras}, keypoints);
    each({batch, positions, numbers()}, x, y, right_x, octave, holder, holder_number);
  }
  FT_HOST_DEVICE int numbers() const { return cameras * capacity; }
  /// Position of a keyframe. @pre number >= 1
  FT_HOST_DEVICE int position(int number) const { return (number - 1) % positions; }
  /// Number of the oldest keyframe in use; made + 1 if there is none.
  FT_HOST_DEVICE int oldest(int b) const { return made[b] - count[b] + 1; }
  /// Whether a keyframe with this number is in use.
  FT_HOST_DEVICE bool holds(int b, int number) const {
    return number >= oldest(b) && number <= made[b];
  }
  /// Index of a position.
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int p) const {
    return static_cast<std::ptrdiff_t>(b) * positions + p;
  }
  /// Index of a keypoint.
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int p, int keypoint) const {
    return at(b, p) * numbers() + keypoint;
  }
};
static_assert(std::is_trivially_copyable<keyframes_view>::value, "passed to kernels");

struct keyframes_capacity {
  int positions = 128;  ///< 2 to max_keyframes
  int cameras = 1;      ///< 1 to 16
  int keypoints = 0;    ///< of an image
};

/// Places the arrays into an arena.
/// @throws bad_argument for a size out of range
inline void carve(carver& c, keyframes_view& v, keyframes_capacity const& size, int batch) {
  detail::require_range("keyframes", size.positions, 2, max_keyframes);
  detail::require_range("cameras of a keyframe", size.cameras, 1, 16);
  detail::require_range("keypoints of a keyframe", size.keypoints, 1, 1 << 24);
  v.positions = size.positions;
  v.cameras = size.cameras;
  v.capacity = size.keypoints;
  v.batch = batch;
  detail::place_columns(c, v);
}

/// Forgets all keyframes. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, keyframes_view const& v) {
  fill_bytes(exec, v.made, 0, static_cast<std::size_t>(v.batch) * sizeof(int));
  fill_bytes(exec, v.count, 0, static_cast<std::size_t>(v.batch) * sizeof(int));
}

}  // namespace FT_ABI
}  // namespace ft
