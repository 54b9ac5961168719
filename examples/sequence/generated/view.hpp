// SPDX-License-Identifier: Apache-2.0
/// @file The cameras of a generated sequence: a ray and a share of light for every pixel.
#pragma once

#include <Eigen/Geometry>

#include <array>
#include <optional>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq::generated {

constexpr double fisheye_fade = 1.42;   ///< rad: darkening starts
constexpr double fisheye_limit = 1.50;  ///< rad: black from here

/// Distance from the image's centre, in focal lengths, of a ray at an angle to the axis, rad.
/// @param k the four coefficients
double kannala_brandt(std::vector<double> const& k, double angle);

/// A point on the ray of a pixel; nothing outside the lens' range.
std::optional<Eigen::Vector3d> unproject(camera_intrinsics const& c, double u, double v);

constexpr int tile_side = 16;  ///< pixels

/// Rays of a block of pixels lie between four planes through the camera.
struct tile {
  int x0 = 0, x1 = 0, y0 = 0, y1 = 0;  ///< pixels, end excluded
  bool any = false;
  std::array<Eigen::Vector3f, 4> outward;
};

struct view {
  camera_intrinsics camera;
  Eigen::Isometry3d T_left_this = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Vector3f> rays;  ///< any length; zero outside the lens' range
  std::vector<float> light;           ///< factor by vignetting; 0 outside the lens' range
  std::vector<tile> tiles;
};

view make_view(camera_intrinsics const& camera, Eigen::Isometry3d const& T_left_this,
               bool vignetting);

}  // namespace seq::generated
