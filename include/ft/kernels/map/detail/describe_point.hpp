// SPDX-License-Identifier: Apache-2.0
/// @file What follows from the keyframes that see a map point: its descriptor and its normal.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/map/point_masks.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Distances between the descriptors of a point.
using descriptor_distances = int[point_descriptors * point_descriptors];

/// Number of the most typical descriptor of a point: the one whose median distance to all
/// of them, itself included, is least; the oldest one of equals. The median of n distances is the
/// one at place (n - 1) / 2 of their ascending order.
/// @param distance workspace
/// @param first,end numbers of the descriptors, oldest first; the difference is 1 to
///   point_descriptors
template <typename Group>
FT_HOST_DEVICE int most_typical(Group g, descriptor_distances& distance, descriptor const* recent,
                                int first, int end) {
  int const n = end - first;
  for (int pair = g.rank(); pair < n * n; pair += g.size()) {
    distance[pair] = search_distance(recent[(first + pair / n) % point_descriptors],
                                     recent[(first + pair % n) % point_descriptors]);
  }
  g.sync();
  int best = (descriptor_scale::most + 1) *
             point_descriptors;  // a median and the number of its descriptor
  for (int pair = g.rank(); pair < n * n; pair += g.size()) {
    int const mine = distance[pair];
    int const row = pair / n * n;
    int place = 0;
    for (int other = row; other < row + n; ++other) {
      place +=
          static_cast<int>(distance[other] < mine || (distance[other] == mine && other < pair));
    }
    if (place == (n - 1) / 2) { best = min_of(best, mine * point_descriptors + pair / n); }
  }
  return first + g.reduce(best, min_op{}) % point_descriptors;
}

/// Gives a point one more descriptor.
/// @param end how many it then has had
template <typename Group>
FT_HOST_DEVICE void add_descriptor(Group g, descriptor_distances& distance,
                                   odometry_map_view const& map, std::ptrdiff_t at, int end,
                                   descriptor const& orb) {
  descriptor* const recent = map.records.recent + at * point_descriptors;
  if (g.rank() == 0) {
    recent[(end - 1) % point_descriptors] = orb;
    map.records.described[at] = end;
  }
  g.sync();
  int const typical = most_typical(g, distance, recent, max_of(0, end - point_descriptors), end);
  if (g.rank() == 0) { array_of<field::orb>(map.points)[at] = recent[typical % point_descriptors]; }
}

/// A vector divided by its length, or by 1e-12 if that is more.
FT_HOST_DEVICE inline vec3<strict_double> unit_vector(vec3<strict_double> v) {
  strict_double const n = max_of(scalar::sqrt(dot(v, v)), strict_double(1e-12));
  return {v.x / n, v.y / n, v.z / n};
}

FT_HOST_DEVICE inline vec3<strict_double> widened(vec3<float> v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}
FT_HOST_DEVICE inline vec3<float> narrowed(vec3<strict_double> v) {
  return {static_cast<float>(v.x.value), static_cast<float>(v.y.value),
          static_cast<float>(v.z.value)};
}

/// Mean viewing direction of a point over the keyframes that see it, oldest first.
template <typename Group>
FT_HOST_DEVICE vec3<float> mean_direction(Group g, odometry_map_view const& map, int b, int slot) {
  keyframes_view const& keyframes = map.keyframes;
  vec3<strict_double> const at = widened(get<field::position>(map.points.slice(b), slot));
  position_set const seen = position_set::of(map.records.mask(b, slot), map.records.words);
  int const last = keyframes.made[b];
  vec3<strict_double> sum{0.0, 0.0, 0.0};
  for (int first = keyframes.oldest(b); first <= last; first += g.size()) {
    int const p = keyframes.position(first + g.rank());
    bool const sees = first + g.rank() <= last && seen.has(p);
    vec3<strict_double> direction{0.0, 0.0, 0.0};
    if (sees) {
      auto const T = keyframes.T_cw[keyframes.at(b, p)].template cast<strict_double>();
      direction = unit_vector(at - T.centre());
    }
    for (unsigned rest = g.ballot(sees); rest != 0; rest &= rest - 1) {
      int const from = trailing_zeros(rest);
      sum = sum + vec3<strict_double>{g.shuffle(direction.x.value, from),
                                      g.shuffle(direction.y.value, from),
                                      g.shuffle(direction.z.value, from)};
    }
  }
  return narrowed(unit_vector(sum));
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
