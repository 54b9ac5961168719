// SPDX-License-Identifier: Apache-2.0
/// @file The keyframes of an odometry: a ring of poses and keypoints with the points that they
/// hold.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/containers/keypoints.hpp"
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
  /// [batch][positions][numbers] 1 = the keypoint is where its point's patch is: it was moved
  /// there, or the patch is its own
  unsigned char* aligned = nullptr;

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch}, made, count);
    each({batch, positions}, T_cw, time_ns, neighbour, shared);
    each({batch, positions, cameras}, keypoints);
    each({batch, positions, numbers()}, x, y, right_x, octave, holder, holder_number, aligned);
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

// What keyframes keep of their keypoints for later triangulation.

/// Cells of an image in which rays are sorted, about as many as lines are long in pixels of them.
inline constexpr int ray_columns = 32;
inline constexpr int ray_rows = 24;
inline constexpr int ray_cells = ray_columns * ray_rows;

/// Where the rays of a cell are: within `reach` of `middle`, with what each may be off from an
/// epipolar plane. So a plane with the unit normal n has none of them if |n middle| > reach.
struct ray_cell {
  vec3<float> middle;
  float reach;  ///< below 0: there are none
};

/// Rays and descriptors of the keypoints of a keyframes_view with one camera, in executor memory,
/// indexed as there.
struct keyframe_rays_view {
  int* number = nullptr;       ///< [batch][positions] of the keyframe that they belong to, 0 = none
  vec3<float>* ray = nullptr;  ///< [batch][positions][capacity] unit length, camera frame; 0 = none
  descriptor* orb = nullptr;   ///< [batch][positions][capacity]
  ray_cell* cell = nullptr;    ///< [batch][positions][ray_cells]
  int* first = nullptr;        ///< [batch][positions][ray_cells + 1] of a cell in `in_cell`
  int* in_cell = nullptr;  ///< [batch][positions][capacity] keypoints cell by cell, in any order
};
static_assert(std::is_trivially_copyable<keyframe_rays_view>::value, "passed to kernels");

/// Places the arrays into an arena. clear() comes before the first use.
inline void carve(carver& c, keyframe_rays_view& v, keyframes_capacity const& size, int batch) {
  auto const positions = size.positions;
  c.place({batch, positions}, v.number);
  c.place({batch, positions, size.keypoints}, v.ray, v.orb);
  c.place({batch, positions, ray_cells}, v.cell);
  c.place({batch, positions, ray_cells + 1}, v.first);
  c.place({batch, positions, size.keypoints}, v.in_cell);
}

/// No keyframe of batch entry b has rays. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void forget_rays(Exec const& exec, keyframe_rays_view const& v, int positions, int b) {
  fill_bytes(exec, v.number + static_cast<std::ptrdiff_t>(b) * positions, 0,
             static_cast<std::size_t>(positions) * sizeof(int));
}

}  // namespace FT_ABI
}  // namespace ft
