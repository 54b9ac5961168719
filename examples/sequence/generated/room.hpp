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
  texture skin;
};

/// Walls, floor, ceiling, boxes and panels, without their textures; the nearer ones come first.
std::vector<surface> furnish(std::uint64_t seed);

/// Metres.
double distance(surface const& s, Eigen::Vector3d const& point);

}  // namespace seq::generated
