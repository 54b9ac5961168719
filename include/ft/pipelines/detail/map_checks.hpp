// SPDX-License-Identifier: Apache-2.0
/// @file Refuses a map whose numbers stages would follow out of bounds or into nonsense. Its arrays
/// are in host memory, of batch entry 0.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "ft/containers/map_points.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Most of what is counted from frame to frame: as much again is left before an int overflows.
inline constexpr int most_counted = 1 << 30;
/// Coordinates and distances; their squares are finite floats.
inline constexpr float farthest_saved = 1e15f;
inline constexpr float farthest_pixel = 1e6f;

/// @throws error naming the number and its limits; NaN has none
template <typename T>
void require_saved(char const* name, T value, T low, T high) {
  if (value >= low && value <= high) { return; }
  throw error(std::string("ft: the map file has ") + name + " " + number_text(value) +
              ", must be in [" + number_text(low) + ", " + number_text(high) + "]");
}

/// The numbers that say what of the arrays is in use.
inline void check_saved_counts(odometry_map_view const& map) {
  point_records_view const& r = map.records;
  keyframes_view const& k = map.keyframes;
  require_saved("points made", *r.made, 0, most_counted);
  require_saved("slots in use", *r.used, 0, r.slots);
  require_saved("points alive", *r.alive, 0, *r.used);
  require_saved("keyframes made", *k.made, 0, most_counted);
  require_saved("keyframes in use", *k.count, std::min(*k.made, 1), std::min(*k.made, k.positions));
  for (int n = k.oldest(0); n <= *k.made; ++n) {
    for (int c = 0; c < k.cameras; ++c) {
      require_saved("keypoints", k.keypoints[k.position(n) * k.cameras + c], 0, k.capacity);
    }
  }
}

/// Keyframes in use.
inline position_set saved_positions(keyframes_view const& k) {
  position_set used;
  used.assign(k, k.oldest(0), *k.made);
  return used;
}

/// What is not in use has no number of its own, so that a file has nothing but the map.
inline void clear_unused(odometry_map_view const& map) {
  point_records_view const& r = map.records;
  keyframes_view const& k = map.keyframes;
  for (int slot = 0; slot < r.slots; ++slot) {
    if (r.number[slot] != 0) { continue; }
    free_slot(map, 0, slot);
    map.points.normal(slot) = {0, 0, 0};
    map.points.min_distance(slot) = map.points.max_distance(slot) = 0;
    map.points.orb(slot) = {};
    std::fill_n(r.recent + static_cast<std::ptrdiff_t>(slot) * point_descriptors, point_descriptors,
                descriptor{});
  }
  position_set const used = saved_positions(k);
  for (int p = 0; p < k.positions; ++p) {
    if (!used.has(p)) {
      k.T_cw[p] = rigid<double>::identity();
      k.time_ns[p] = 0;
      k.neighbour[p] = k.shared[p] = 0;
      std::fill_n(k.keypoints + p * k.cameras, k.cameras, 0);
    }
    for (int c = 0; c < k.cameras; ++c) {
      int const n = k.keypoints[p * k.cameras + c];
      std::ptrdiff_t const first = k.at(0, p, c * k.capacity + n);
      for (float* const column : {k.x, k.y, k.right_x}) {
        std::fill_n(column + first, k.capacity - n, -1.0f);
      }
      std::fill_n(k.octave + first, k.capacity - n, 0);
      std::fill_n(k.holder + first, k.capacity - n, -1);
      std::fill_n(k.holder_number + first, k.capacity - n, 0);
      std::fill_n(k.aligned + first, k.capacity - n, static_cast<unsigned char>(0));
    }
  }
}

inline void check_saved_point(odometry_map_view const& map, int slot, position_set const& used) {
  point_records_view const& r = map.records;
  vec3<float> const at = map.points.position(slot);
  vec3<float> const n = map.points.normal(slot);
  for (float const v : {at.x, at.y, at.z}) {
    require_saved("a point's coordinate", v, -farthest_saved, farthest_saved);
  }
  for (float const v : {n.x, n.y, n.z}) {
    require_saved("an entry of a normal", v, -1.001f, 1.001f);
  }
  float const most = map.points.max_distance(slot);
  require_saved("a point's max_distance", most, 1e-15f, farthest_saved);
  require_saved("a point's min_distance", map.points.min_distance(slot), 1e-16f, most);
  position_set const seen = position_set::of(r.mask(0, slot), r.words);
  if (!used.contains(seen)) {
    throw error("ft: the map file has a point in slot " + std::to_string(slot) +
                " that is seen by a keyframe which it does not have");
  }
  require_saved("keyframes that see a point", seen.count(), 1, used.count());
  require_saved("a point's observations", map.points.observations(slot), seen.count(),
                seen.count());
  require_saved("a point's number", r.number[slot], 1, *r.made);
  require_saved("frames that had a point in view", r.visible[slot], 0, most_counted);
  require_saved("frames that found a point", r.found[slot], 0, most_counted);
  require_saved("descriptors given to a point", r.described[slot], 1, most_counted);
}

inline void check_saved_points(odometry_map_view const& map) {
  point_records_view const& r = map.records;
  position_set const used = saved_positions(map.keyframes);
  int alive = 0;
  for (int slot = 0; slot < r.slots; ++slot) {
    if (r.number[slot] == 0) { continue; }
    if (slot >= *r.used) {
      throw error("ft: the map file has a point in slot " + std::to_string(slot) +
                  ", must be below the " + std::to_string(*r.used) + " slots in use");
    }
    check_saved_point(map, slot, used);
    ++alive;
  }
  require_saved("points alive", *r.alive, alive, alive);
}

inline void check_saved_pose(rigid<double> const& T) {
  for (double const v : T.R.m) { require_saved("an entry of a rotation", v, -1.001, 1.001); }
  auto const limit = static_cast<double>(farthest_saved);
  for (double const v : {T.t.x, T.t.y, T.t.z}) {
    require_saved("a keyframe's coordinate", v, -limit, limit);
  }
  mat3<double> const RRt = T.R * T.R.transposed();
  for (int i = 0; i < 9; ++i) {
    double const wanted = i % 4 == 0 ? 1 : 0;
    require_saved("an entry of a rotation times its transpose", RRt.m[i], wanted - 1e-3,
                  wanted + 1e-3);
  }
  auto const& m = T.R.m;
  vec3<double> const x{m[0], m[1], m[2]};
  vec3<double> const y{m[3], m[4], m[5]};
  require_saved("a determinant of a rotation", dot(cross(x, y), {m[6], m[7], m[8]}), 0.9, 1.1);
}

/// @param levels of the pyramid
inline void check_saved_keypoint(odometry_map_view const& map, std::ptrdiff_t at, int levels) {
  keyframes_view const& k = map.keyframes;
  require_saved("a keypoint's x", k.x[at], -farthest_pixel, farthest_pixel);
  require_saved("a keypoint's y", k.y[at], -farthest_pixel, farthest_pixel);
  require_saved("a keypoint's right x", k.right_x[at], -farthest_pixel, farthest_pixel);
  require_saved("an octave", k.octave[at], 0, levels - 1);
  require_saved("a keypoint's slot", k.holder[at], -1, map.records.slots - 1);
  require_saved("the number of a keypoint's point", k.holder_number[at], 0, *map.records.made);
  require_saved("whether a keypoint is aligned", static_cast<int>(k.aligned[at]), 0, 1);
}

inline void check_saved_keyframes(odometry_map_view const& map, int levels) {
  keyframes_view const& k = map.keyframes;
  for (int n = k.oldest(0); n <= *k.made; ++n) {
    int const p = k.position(n);
    check_saved_pose(k.T_cw[p]);
    require_saved("a keyframe's neighbour", k.neighbour[p], 0, *k.made);
    require_saved("points shared with a neighbour", k.shared[p], 0, k.numbers());
    for (int c = 0; c < k.cameras; ++c) {
      for (int i = 0; i < k.keypoints[p * k.cameras + c]; ++i) {
        check_saved_keypoint(map, k.at(0, p, c * k.capacity + i), levels);
      }
    }
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
