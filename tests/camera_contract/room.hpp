// SPDX-License-Identifier: Apache-2.0
/// @file A room to look at. Part of tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/kernels/upload.hpp"
#include "ft/types/poses.hpp"
#include "tests/camera_contract/questions.hpp"
#include "tests/camera_contract/scenes.hpp"

namespace camera_contract {
inline namespace FT_ABI {

using image = std::vector<std::uint8_t>;

/// Rectangles of all sizes and some noise; the same for the same seed.
inline image texture(int side, unsigned seed) {
  std::mt19937 random(seed);
  image t(at(side * side), 90);
  auto const draw = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  for (int i = 0; i < 150; ++i) {
    int const w = 2 + draw(side / (2 + i % 40));
    int const h = 2 + draw(side / (2 + i % 40));
    int const x0 = draw(side);
    int const y0 = draw(side);
    int const grey = draw(256);
    for (int y = y0; y < std::min(side, y0 + h); ++y) {
      for (int x = x0; x < std::min(side, x0 + w); ++x) {
        t[at(y * side + x)] = static_cast<std::uint8_t>(grey);
      }
    }
  }
  for (auto& v : t) { v = static_cast<std::uint8_t>(std::clamp(v + draw(9) - 4, 0, 255)); }
  return t;
}

/// A box around the origin of the world with a texture on each wall.
class room {
public:
  room() {
    for (unsigned w = 0; w < 6; ++w) { walls_.push_back(texture(side, 70 + w)); }
  }
  /// From a place inside to the wall, in lengths of `d`. @param wall its number
  static double distance(vector from, vector d, int& wall) {
    double const origin[3] = {from.x, from.y, from.z};
    double const towards[3] = {d.x, d.y, d.z};
    double nearest = 1e9;
    for (int a = 0; a < 3; ++a) {
      if (std::abs(towards[a]) < 1e-12) { continue; }
      double const t = ((towards[a] > 0 ? high[a] : low[a]) - origin[a]) / towards[a];
      if (t < nearest) {
        nearest = t;
        wall = 2 * a + static_cast<int>(towards[a] > 0);
      }
    }
    return nearest;
  }
  /// @param rays one per pixel, in the camera's frame; length 0 = none, painted grey
  image render(std::vector<vector> const& rays, motion const& T_cw) const {
    motion const T_wc = T_cw.inverse();
    image out(rays.size(), 90);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      vector const d = T_wc.R * rays[i];
      if (!(length(d) > 0)) { continue; }
      int wall = 0;
      vector const hit = T_wc.t + scaled(d, distance(T_wc.t, d, wall));
      double const p[3] = {hit.x, hit.y, hit.z};
      double const s = (p[(wall / 2 + 1) % 3] + 20) * texels;
      double const t = (p[(wall / 2 + 2) % 3] + 20) * texels;
      int const x = static_cast<int>(s);
      int const y = static_cast<int>(t);
      auto const texel = [&](int u, int v) {
        return static_cast<double>(walls_[at(wall)][at(v % side * side + u % side)]);
      };
      double const fx = s - x;
      double const fy = t - y;
      out[i] = static_cast<std::uint8_t>(
          (1 - fx) * (1 - fy) * texel(x, y) + fx * (1 - fy) * texel(x + 1, y) +
          (1 - fx) * fy * texel(x, y + 1) + fx * fy * texel(x + 1, y + 1) + 0.5);
    }
    return out;
  }

private:
  static constexpr int side = 400;
  static constexpr double texels = 50;  // per metre
  static constexpr double low[3] = {-3, -1.5, -2};
  static constexpr double high[3] = {3, 1.5, 6};
  std::vector<image> walls_;
};

/// Two stereo frames of the room.
struct walk {
  ft::pose T_cw[2];  ///< true
  image left[2], right[2];
};

inline walk make_walk(double_camera const& camera) {
  std::vector<vector> rays;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      auto const r = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      rays.push_back(r.valid ? r.direction : vector{0, 0, 0});
    }
  }
  room const box;
  walk w;
  w.T_cw[0] = turn({0, 1, 0}, 0.2, {0.1, 0.05, 0.2}).cast<float>();
  w.T_cw[1] =
      (turn({0.4, 1, 0}, 0.014, {0.02, -0.01, -0.05}) * w.T_cw[0].cast<double>()).cast<float>();
  for (int f = 0; f < 2; ++f) {
    auto const T_cw = w.T_cw[f].cast<double>();
    w.left[f] = box.render(rays, T_cw);
    w.right[f] = box.render(rays, rig_motion().cast<double>() * T_cw);
  }
  return w;
}

/// A frame of a tracker as the host reads it; left keypoints.
struct tracked {
  int keypoints = 0, inliers = 0;
  ft::pose T_cw{};
  std::vector<float> x, y, depth;
  std::vector<int> octave, partner;
  std::vector<ft::vec3<float>> point;
  std::vector<ft::descriptor> orb;
};

/// Triangulated points of a frame against the walls that its pixels' rays meet.
inline void check_depths(double_camera const& camera, tracked const& frame, ft::pose const& T_cw) {
  auto const T_wc = T_cw.cast<double>().inverse();
  auto const T_rl = rig_motion().cast<double>();
  vector const right_centre = T_rl.centre();
  std::vector<double> errors;  // as what a pixel off in one image does, times so many
  for (std::size_t i = 0; i < at(frame.keypoints); ++i) {
    auto const r = camera.unproject({frame.x[i], frame.y[i]});
    if (!(frame.depth[i] > 0) || !r.valid) { continue; }
    int wall = 0;
    double const along = room::distance(T_wc.t, T_wc.R * r.direction, wall);
    vector const p = scaled(r.direction, along);
    auto const& got = frame.point[i];
    double const off = length(vector{got.x, got.y, got.z} - p) / length(p);
    errors.push_back(off * camera.focal() * std::sin(angle_between(p, p - right_centre)));
  }
  ASSERT_GE(errors.size(), 100u) << "stereo matches of " << frame.keypoints << " keypoints";
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  EXPECT_LT(errors[errors.size() / 2], 2) << "median error of triangulated points, in pixels";
}

/// Map points of a frame: slot i is left keypoint i.
inline std::vector<ft::point_update> map_of(tracked const& frame, ft::pose const& T_cw,
                                            ft::pyramid_geometry const& geometry) {
  ft::pose const T_wc = T_cw.inverse();
  std::vector<ft::point_update> points;
  for (int i = 0; i < frame.keypoints; ++i) {
    if (!(frame.depth[at(i)] > 0)) { continue; }
    ft::vec3<float> const p = T_wc * frame.point[at(i)];
    ft::vec3<float> const d = p - T_wc.t;
    float const distance = std::sqrt(ft::dot(d, d));
    float const farthest = distance * geometry.scale[frame.octave[at(i)]];
    points.push_back({i,
                      1,
                      p,
                      {d.x / distance, d.y / distance, d.z / distance},
                      farthest / geometry.scale[geometry.levels - 1],
                      farthest,
                      frame.orb[at(i)]});
  }
  return points;
}

inline void check_pose(double_camera const& camera, tracked const& frame, ft::pose const& want) {
  // Keypoints lie on whole pixels of their level; 3 pixels at 3 metres is far more than 40 leave.
  double const radians = 3 / camera.focal();
  auto const off = frame.T_cw.cast<double>() * want.cast<double>().inverse();
  vector const axis{off.R.m[7] - off.R.m[5], off.R.m[2] - off.R.m[6], off.R.m[3] - off.R.m[1]};
  EXPECT_LT(length(axis) / 2, radians) << "rotation, radians";
  EXPECT_LT(length(off.t), 3 * radians) << "translation, metres";
  EXPECT_GE(frame.inliers, 40) << "map points found";
}

}  // namespace FT_ABI
}  // namespace camera_contract
