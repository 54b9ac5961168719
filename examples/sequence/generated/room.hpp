// SPDX-License-Identifier: Apache-2.0
/// @file The surfaces of the room that a generated sequence is seen in.
#pragma once

#include <Eigen/Core>

#include <cstdint>
#include <vector>

#include "examples/sequence/generated/texture.hpp"

namespace seq::generated {

/// A rectangle seen from its front: origin + s * along + t * up, 0 <= s <= width, 0 <= t <= height.
struct surface {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d along = Eigen::Vector3d::UnitX();
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitY();
  double width = 0;
  double height = 0;
  double texels_per_m = 0;
  double brightness = 1;
  int paint = -1;  ///< surfaces with the same number look the same; -1 = unlike any other
  texture skin;
};

/// Walls, floor, ceiling, boxes and panels, without their textures; the nearer ones come first.
std::vector<surface> furnish(std::uint64_t seed);

/// The same of a corridor along x, 5 m wide and 3 m high, from -5 m to length_m.
/// @param repeat_m after which it looks the same, 0 = never; not its end
std::vector<surface> build_corridor(std::uint64_t seed, double length_m, double repeat_m);

/// Metres.
double distance(surface const& s, Eigen::Vector3d const& point);

}  // namespace seq::generated
