// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/hiding.hpp"

#include <cmath>
#include <utility>

#include "examples/sequence/detail/random.hpp"

namespace seq::generated {
namespace {

using detail::random_stream;

/// Pixels, the edges included.
struct box {
  double left, top, right, bottom;
};

/// A rectangle that faces the camera and covers a part of its image.
void add_cover(std::vector<surface>& to, camera_intrinsics const& c, box const& pixels,
               double depth) {
  auto const x = [&](double u) { return depth * (u - c.cx) / c.fx; };
  auto const y = [&](double v) { return depth * (v - c.cy) / c.fy; };
  surface s;
  s.origin = Eigen::Vector3d(x(pixels.left), y(pixels.bottom), depth);
  s.along = Eigen::Vector3d::UnitX();
  s.up = -Eigen::Vector3d::UnitY();
  s.normal = -Eigen::Vector3d::UnitZ();
  s.width = x(pixels.right) - x(pixels.left);
  s.height = y(pixels.bottom) - y(pixels.top);
  s.texels_per_m = 500 / depth;  // about a texel a pixel of the rig's own size
  to.push_back(std::move(s));
}

/// The middle of the image. @param wide, high shares of its sides
box middle(camera_intrinsics const& c, double wide, double high) {
  return {0.5 * (1 - wide) * c.width, 0.5 * (1 - high) * c.height, 0.5 * (1 + wide) * c.width,
          0.5 * (1 + high) * c.height};
}

}  // namespace

hiding_surfaces hide(std::uint64_t seed, hiding_things const& things, camera_intrinsics const& c,
                     double duration_s) {
  constexpr double ahead = 2;  // metres
  random_stream random(seed);
  hiding_surfaces out;
  if (things.bonnet > 0) {
    // wider than the left image, so that it fills the right one, too
    add_cover(
        out.fixed, c,
        {-0.5 * c.width, (1 - 0.01 * things.bonnet) * c.height, 1.5 * c.width, 1.5 * c.height},
        0.6);
  }
  if (things.dirt > 0) {
    constexpr int columns = 6;
    constexpr int rows = 4;
    double const w = c.width / static_cast<double>(columns);
    double const h = c.height / static_cast<double>(rows);
    double const side = std::sqrt(0.01 * things.dirt);
    for (int i = 0; i < columns * rows; ++i) {
      double const u = (i % columns + random.uniform(0, 1 - side)) * w;
      double const v = (i / columns + random.uniform(0, 1 - side)) * h;
      add_cover(out.fixed, c, {u, v, u + side * w, v + side * h}, 0.5);
    }
  }
  if (things.companion > 0) {
    double const side = std::sqrt(0.01 * things.companion);
    add_cover(out.companion, c, middle(c, side, side), ahead);
  }
  if (things.crossing > 0) {
    box band = middle(c, 2, 0.01 * things.crossing);
    band.right += things.crossing_speed * duration_s / ahead * c.fx;
    add_cover(out.crossing, c, band, ahead);
  }
  return out;
}

void place(hiding_surfaces const& surfaces, hiding_things const& things, double t,
           Eigen::Isometry3d const& T_world_start, Eigen::Isometry3d const& T_world_left,
           Eigen::Isometry3d const& T_left_camera, std::vector<placed_surfaces>& to) {
  Eigen::Isometry3d const T_camera_left = T_left_camera.inverse();
  if (!surfaces.fixed.empty()) { to.push_back({&surfaces.fixed, T_camera_left}); }
  Eigen::Isometry3d T_world_along = T_world_start;
  T_world_along.translation() = T_world_left.translation();
  Eigen::Isometry3d const T_camera_along = T_camera_left * T_world_left.inverse() * T_world_along;
  if (!surfaces.companion.empty()) { to.push_back({&surfaces.companion, T_camera_along}); }
  if (!surfaces.crossing.empty()) {
    Eigen::Translation3d const gone(-things.crossing_speed * t, 0, 0);
    to.push_back({&surfaces.crossing, T_camera_along * gone});
  }
}

}  // namespace seq::generated
