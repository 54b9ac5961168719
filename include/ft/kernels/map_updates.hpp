// SPDX-License-Identifier: Apache-2.0
/// @file Stage: writes map points from the host into the map.
#pragma once

#include <cmath>
#include <string>

#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// One map point from the host.
struct point_update {
  int slot;
  int observations;
  vec3<float> position;  ///< world, metres
  vec3<float> normal;
  float min_distance, max_distance;  ///< metres
  descriptor orb;

  /// @throws bad_argument for a NaN in any of the lengths
  void check() const {
    bool const number =
        !(std::isnan(position.x) || std::isnan(position.y) || std::isnan(position.z) ||
          std::isnan(normal.x) || std::isnan(normal.y) || std::isnan(normal.z) ||
          std::isnan(min_distance) || std::isnan(max_distance));
    if (!number) {
      throw bad_argument("ft: the map point for slot " + std::to_string(slot) +
                         " has a NaN in its position, normal or distances");
    }
  }
};

/// Writes the points of an update into the map.
struct apply_updates {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, point_update const* updates,
                                 map_points_view const& map) const {
    point_update const u = updates[item];
    map.position(u.slot) = u.position;
    map.normal(u.slot) = u.normal;
    map.min_distance(u.slot) = u.min_distance;
    map.max_distance(u.slot) = u.max_distance;
    map.orb(u.slot) = u.orb;
    map.observations(u.slot) = u.observations;
  }
};

}  // namespace FT_ABI
}  // namespace ft
