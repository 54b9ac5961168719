// SPDX-License-Identifier: Apache-2.0
/// @file What follows from the keyframes that see a map point: its descriptor and its normal.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/map/point_masks.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Number of the most typical descriptor of a point: the one whose median Hamming distance to all
/// of them, itself included, is least; the oldest one of equals. The median of n distances is the
/// one at place (n - 1) / 2 of their ascending order.
/// @param first,end numbers of the descriptors, oldest first; the difference is 1 to
///   point_descriptors
FT_HOST_DEVICE inline int most_typical(descriptor const* recent, int first, int end) {
  int best = first;
  int least = 257;
  for (int i = first; i < end; ++i) {
    int sorted[point_descriptors];
    int n = 0;
    for (int j = first; j < end; ++j) {
      int const d = hamming(recent[i % point_descriptors], recent[j % point_descriptors]);
      int at = n++;
      for (; at > 0 && sorted[at - 1] > d; --at) { sorted[at] = sorted[at - 1]; }
      sorted[at] = d;
    }
    int const median = sorted[(n - 1) / 2];
    if (median < least) {
      least = median;
      best = i;
    }
  }
  return best;
}

/// Gives a point one more descriptor.
FT_HOST_DEVICE inline void add_descriptor(odometry_map_view const& map, int b, int slot,
                                          descriptor const& orb) {
  std::ptrdiff_t const at = map.records.at(b, slot);
  descriptor* const recent = map.records.recent + at * point_descriptors;
  int const end = map.records.described[at] + 1;
  recent[(end - 1) % point_descriptors] = orb;
  map.records.described[at] = end;
  int const typical = most_typical(recent, max_of(0, end - point_descriptors), end);
  get<field::orb>(map.points.slice(b), slot) = recent[typical % point_descriptors];
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
FT_HOST_DEVICE inline vec3<float> mean_direction(odometry_map_view const& map, int b, int slot) {
  keyframes_view const& keyframes = map.keyframes;
  vec3<strict_double> const at = widened(get<field::position>(map.points.slice(b), slot));
  vec3<strict_double> sum{0.0, 0.0, 0.0};
  each_observer(keyframes, b, map.records.mask(b, slot), [&](int p) {
    auto const T = keyframes.T_cw[keyframes.at(b, p)].template cast<strict_double>();
    sum = sum + unit_vector(at - T.centre());
  });
  return narrowed(unit_vector(sum));
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
