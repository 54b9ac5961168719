// SPDX-License-Identifier: Apache-2.0
/// @file The map of an odometry in executor memory: points, their records, and keyframes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// What an odometry keeps of its map points besides what searches read: numbers, sightings,
// descriptors, and the keyframes that see a point.

/// Descriptors that are kept of a point.
inline constexpr int point_descriptors = 8;

/// Records of map points by slot, in executor memory. Slot s of batch entry b is at
/// `b * slots + s`. A free slot has number 0, an empty mask, a NaN position and no observations.
///
/// A mask has a bit for each position of the keyframe ring: bit p % 64 of word p / 64. It is set
/// while a keypoint of the keyframe at position p holds the point.
struct point_records_view {
  int slots = 0;
  int words = 0;  ///< of a mask
  int batch = 0;
  int* number = nullptr;             ///< [batch][slots] unique in this batch entry; 0 = free slot
  int* visible = nullptr;            ///< [batch][slots] frames that had the point in view
  int* found = nullptr;              ///< [batch][slots] frames that matched it
  int* found_frame = nullptr;        ///< [batch][slots] number of the last one of these
  int* described = nullptr;          ///< [batch][slots] descriptors that were ever given to it
  descriptor* recent = nullptr;      ///< [batch][slots][point_descriptors] the newest ones;
                                     ///< descriptor i is at i % point_descriptors
  std::uint64_t* seen_by = nullptr;  ///< [batch][slots][words]
  int* made = nullptr;               ///< [batch] number of the newest point
  int* alive = nullptr;              ///< [batch] slots that are not free
  int* used = nullptr;               ///< [batch] all slots from here on are free

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, slots}, number, visible, found, found_frame, described);
    each({batch, slots, point_descriptors}, recent);
    each({batch, slots, words}, seen_by);
    each({batch}, made, alive, used);
  }
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int slot) const {
    return static_cast<std::ptrdiff_t>(b) * slots + slot;
  }
  FT_HOST_DEVICE std::uint64_t* mask(int b, int slot) const {
    return seen_by + at(b, slot) * words;
  }
  /// Whether a slot of batch entry b is one of the map's and holds a point.
  FT_HOST_DEVICE bool holds_point(int b, int slot) const {
    return slot >= 0 && slot < slots && number[at(b, slot)] != 0;
  }
  /// Number of keyframes that see a point.
  FT_HOST_DEVICE int observers(int b, int slot) const {
    int n = 0;
    for (int w = 0; w < words; ++w) { n += popcount(mask(b, slot)[w]); }
    return n;
  }
};
static_assert(std::is_trivially_copyable<point_records_view>::value, "passed to kernels");

/// Places the arrays into an arena.
/// @param positions of the keyframe ring
inline void carve(carver& c, point_records_view& v, int slots, int positions, int batch) {
  v.slots = slots;
  v.words = (positions + 63) / 64;
  v.batch = batch;
  detail::place_columns(c, v);
}

/// Makes all slots free. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, point_records_view const& v) {
  detail::fill_columns(exec, v, 0);
}

/// The map of each batch entry. `points.count` is not used: see point_records_view::alive.
struct odometry_map_view {
  map_points_view points;
  point_records_view records;
  keyframes_view keyframes;

  template <typename Visit>
  void columns(Visit&& each) {
    points.columns(each);
    records.columns(each);
    keyframes.columns(each);
  }
};
static_assert(std::is_trivially_copyable<odometry_map_view>::value, "passed to kernels");

struct odometry_map_capacity {
  int slots = 1 << 14;  ///< map points at a time, 1 to 2^24
  keyframes_capacity keyframes;
};

/// Places the arrays into an arena. clear() comes before the first use.
/// @throws bad_argument for a size out of range
inline void carve(carver& c, odometry_map_view& v, odometry_map_capacity const& size, int batch) {
  detail::require_range("slots of a map", size.slots, 1, 1 << 24);
  carve(c, v.points, size.slots, batch);
  carve(c, v.records, size.slots, size.keyframes.positions, batch);
  carve(c, v.keyframes, size.keyframes, batch);
}

/// Makes all maps empty. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, odometry_map_view const& v) {
  std::size_t const n =
      static_cast<std::size_t>(v.points.batch) * static_cast<std::size_t>(v.points.capacity);
  fill(exec, v.points, 0);
  fill_bytes(exec, array_of<field::position>(v.points), 0xff, n * sizeof(vec3<float>));
  clear(exec, v.records);
  clear(exec, v.keyframes);
}

}  // namespace FT_ABI
}  // namespace ft
