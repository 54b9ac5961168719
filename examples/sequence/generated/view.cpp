// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/generated/view.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace seq::generated {
namespace {

void fill_pixels(view& out, bool vignetting) {
  camera_intrinsics const& camera = out.camera;
  int const w = camera.width;
  int const h = camera.height;
  double const corner = std::hypot(0.5 * w, 0.5 * h);
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      auto const ray = unproject(camera, x, y);
      if (!ray) { continue; }
      auto const i =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(w) + static_cast<std::size_t>(x);
      out.rays[i] = ray->cast<float>();
      double light = 1;
      if (vignetting) {
        double const r = std::hypot(x - camera.cx, y - camera.cy) / corner;
        light = 1 - 0.2 * r * r;
      }
      if (camera.model == lens::kannala_brandt) {
        double const angle = std::atan2(ray->head<2>().norm(), ray->z());
        double const f =
            std::clamp((fisheye_limit - angle) / (fisheye_limit - fisheye_fade), 0.0, 1.0);
        light *= f * f * (3 - 2 * f);
      }
      out.light[i] = static_cast<float>(light);
    }
  }
}

// @param t its pixels are set
void bound_rays(tile& t, view const& out) {
  int const w = out.camera.width;
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();
  auto const each = [&](auto const& use) {
    for (int v = t.y0; v < t.y1; ++v) {
      for (int u = t.x0; u < t.x1; ++u) {
        auto const& ray = out.rays[static_cast<std::size_t>(v) * static_cast<std::size_t>(w) +
                                   static_cast<std::size_t>(u)];
        if (ray.squaredNorm() > 0) { use(Eigen::Vector3d(ray.cast<double>().normalized())); }
      }
    }
  };
  each([&](Eigen::Vector3d const& ray) {
    axis += ray;
    t.any = true;
  });
  if (t.any) {
    axis.normalize();
    Eigen::Vector3d const right = axis.unitOrthogonal();
    Eigen::Vector3d const down = axis.cross(right);
    std::array<double, 4> limit = {1e9, -1e9, 1e9, -1e9};
    each([&](Eigen::Vector3d const& ray) {
      double const a = ray.dot(axis);
      limit[0] = std::min(limit[0], ray.dot(right) / a);
      limit[1] = std::max(limit[1], ray.dot(right) / a);
      limit[2] = std::min(limit[2], ray.dot(down) / a);
      limit[3] = std::max(limit[3], ray.dot(down) / a);
    });
    // half a pixel more on each side, for the samples between pixels
    double const slack = std::max({limit[1] - limit[0], limit[3] - limit[2], 1e-3}) / 8;
    t.outward[0] = ((limit[0] - slack) * axis - right).cast<float>();
    t.outward[1] = (right - (limit[1] + slack) * axis).cast<float>();
    t.outward[2] = ((limit[2] - slack) * axis - down).cast<float>();
    t.outward[3] = (down - (limit[3] + slack) * axis).cast<float>();
  }
}

}  // namespace

double kannala_brandt(std::vector<double> const& k, double angle) {
  double const a2 = angle * angle;
  return angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3]))));
}

std::optional<Eigen::Vector3d> unproject(camera_intrinsics const& c, double u, double v) {
  double const x = (u - c.cx) / c.fx;
  double const y = (v - c.cy) / c.fy;
  if (c.model == lens::pinhole) { return Eigen::Vector3d(x, y, 1); }
  double const radius = std::hypot(x, y);
  if (radius < 1e-12) { return Eigen::Vector3d(0, 0, 1); }
  double angle = std::min(radius, fisheye_limit);
  for (int i = 0; i < 20; ++i) {
    double const a2 = angle * angle;
    auto const& k = c.distortion;
    double const slope = 1 + a2 * (3 * k[0] + a2 * (5 * k[1] + a2 * (7 * k[2] + a2 * 9 * k[3])));
    double const step = (kannala_brandt(k, angle) - radius) / slope;
    angle -= step;
    if (std::abs(step) < 1e-14) { break; }
  }
  if (!(angle < fisheye_limit)) { return std::nullopt; }
  double const side = std::sin(angle) / radius;
  return Eigen::Vector3d(side * x, side * y, std::cos(angle));
}

view make_view(camera_intrinsics const& camera, Eigen::Isometry3d const& T_left_this,
               bool vignetting) {
  view out;
  out.camera = camera;
  out.T_left_this = T_left_this;
  int const w = camera.width;
  int const h = camera.height;
  auto const count = static_cast<std::size_t>(w) * static_cast<std::size_t>(h);
  out.rays.assign(count, Eigen::Vector3f::Zero());
  out.light.assign(count, 0.0f);
  fill_pixels(out, vignetting);
  for (int y = 0; y < h; y += tile_side) {
    for (int x = 0; x < w; x += tile_side) {
      tile t;
      t.x0 = x;
      t.x1 = std::min(x + tile_side, w);
      t.y0 = y;
      t.y1 = std::min(y + tile_side, h);
      bound_rays(t, out);
      out.tiles.push_back(t);
    }
  }
  return out;
}

}  // namespace seq::generated
