// SPDX-License-Identifier: Apache-2.0
/// @file The map of an odometry in executor memory: points, their records, and keyframes.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/keyframes.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/point_records.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// The map of each batch entry. `points.count` is not used: see point_records_view::alive.
struct odometry_map_view {
  map_points_view points;
  point_records_view records;
  keyframes_view keyframes;
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
