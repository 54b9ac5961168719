// SPDX-License-Identifier: Apache-2.0
/// @file Scenes for the stages, with a pair of the described cameras. Part of
/// tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "tests/camera_contract/questions.hpp"

namespace camera_contract {
inline namespace FT_ABI {

/// One of 512 descriptors, any two of them 128 bits apart or all 256.
inline ft::descriptor code(int number) {
  ft::descriptor d{};
  for (unsigned bit = 0; bit < 256; ++bit) {
    auto const n = static_cast<unsigned>(number);
    unsigned const set = (static_cast<unsigned>(ft::popcount(n & bit & 255u)) ^ n >> 8) & 1u;
    d.words[bit / 32] |= set << (bit % 32);
  }
  return d;
}

/// A keypoint of a scene: where a point is seen by one camera.
struct mark {
  int point;
  ft::vec2<double> pixel;
};

/// Points in front of a pair of cameras, and where they are seen: from the model's projection in
/// double alone. Poses and points are rounded to float before anything is computed from them.
struct scene {
  ft::pose T_cw;                          ///< true
  ft::pose T_rl;                          ///< left to right camera
  std::vector<ft::vec3<float>> points;    ///< world
  std::vector<vector> in_left, in_right;  ///< the points in the cameras' frames
  std::vector<mark> left, right;          ///< keypoints: left ones in order, right ones reversed
  double margin = 0;                      ///< no keypoint is this near to the image's rim, pixels
};

inline ft::pose rig_motion() {
  return turn({0.1, 1, 0.2}, 0.03, {-0.3, 0.004, 0.002}).cast<float>();
}

/// @param seen points that the left camera sees, at most 84 degrees off its axis
/// @param unseen points behind both cameras
inline scene make_scene(double_camera const& camera, int seen, int unseen, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  scene s;
  s.T_cw = turn({0.3, -0.7, 0.2}, 0.8, {0.5, -0.2, 1.1}).cast<float>();
  s.T_rl = rig_motion();
  s.margin = 2 + std::max(camera.width, camera.height) / 64.0;
  auto const T_cw = s.T_cw.cast<double>();
  auto const T_wc = T_cw.inverse();
  auto const add = [&](vector p) {
    vector const w = T_wc * p;
    s.points.push_back({static_cast<float>(w.x), static_cast<float>(w.y), static_cast<float>(w.z)});
    auto const& r = s.points.back();
    s.in_left.push_back(T_cw * vector{r.x, r.y, r.z});
    s.in_right.push_back(s.T_rl.cast<double>() * s.in_left.back());
  };
  for (int i = 0; static_cast<int>(s.points.size()) < seen && i < 100 * seen; ++i) {
    ft::vec2<double> const pixel{s.margin + 1 + unit(random) * (camera.width - 2 * s.margin - 2),
                                 s.margin + 1 + unit(random) * (camera.height - 2 * s.margin - 2)};
    auto const r = camera.unproject(pixel);
    double const distance = 1.5 + 4 * unit(random);
    if (!r.valid || !(r.direction.z > 0.1 * length(r.direction))) { continue; }
    add(scaled(r.direction, distance / length(r.direction)));
  }
  EXPECT_EQ(static_cast<int>(s.points.size()), seen) << "too few pixels have a ray ahead";
  for (int i = 0; i < unseen; ++i) {
    vector d = random_direction(random);
    d.z = -std::abs(d.z) - 0.3 * length(d);
    add(scaled(d, (1.5 + 4 * unit(random)) / length(d)));
  }
  for (int i = 0; i < static_cast<int>(s.points.size()); ++i) {
    auto const l = camera.project(s.in_left[at(i)]);
    auto const r = camera.project(s.in_right[at(i)]);
    if (i >= seen) { continue; }
    EXPECT_TRUE(l.valid && camera.in_image(l.pixel, s.margin));
    s.left.push_back({i, l.pixel});
    if (r.valid && camera.in_image(r.pixel, s.margin)) {
      s.right.insert(s.right.begin(), {i, r.pixel});
    }
  }
  EXPECT_GE(static_cast<int>(s.right.size()), seen / 3) << "the cameras see too little in common";
  return s;
}

inline ft::pyramid_geometry scene_geometry(int width, int height) {
  return ft::pyramid_geometry::make(width, height, 8, 1.2f);
}

/// A scene in an executor's memory: point i is in slot i, keypoints hold what `holder` says.
template <typename Exec>
struct stage_frame {
  static constexpr ft::memory_space space = Exec::space;
  int capacity;
  ft::pyramid_geometry geometry;
  ft::map_points<space> map;
  ft::keypoints<space> keypoints;
  ft::feature_grid<space> grids;
  ft::buffer<int, space> holder;
  ft::frame_view view;

  stage_frame(Exec const& exec, scene const& s, int width, int height,
              std::vector<int> const& holders = {})
      : capacity(static_cast<int>(s.points.size())),
        geometry(scene_geometry(width, height)),
        map(capacity),
        keypoints(capacity, 2),
        grids(ft::grid_geometry::over(0, 0, static_cast<float>(width), static_cast<float>(height)),
              capacity, 2),
        holder(to_exec(exec, holders.empty() ? std::vector<int>(at(2 * capacity), -1) : holders)) {
    auto const T_wc = s.T_cw.cast<double>().inverse();
    ft::map_points<ft::memory_space::host> const points(capacity);
    ft::keypoints<ft::memory_space::host> const marks(capacity, 2);
    auto const p = points.view();
    *p.count = capacity;
    for (int i = 0; i < capacity; ++i) {
      auto const& w = s.points[at(i)];
      vector const from = vector{w.x, w.y, w.z} - T_wc.t;
      double const distance = length(from);
      p.position(i) = w;
      p.normal(i) = {static_cast<float>(from.x / distance), static_cast<float>(from.y / distance),
                     static_cast<float>(from.z / distance)};
      p.min_distance(i) = 0.1f;
      p.max_distance(i) = 100.0f;
      p.orb(i) = code(i);
      p.observations(i) = 1;
    }
    for (int c = 0; c < 2; ++c) {
      auto const& seen = c == 0 ? s.left : s.right;
      auto const k = marks.view().slice(c);
      *k.count = static_cast<int>(seen.size());
      for (int i = 0; i < capacity; ++i) {
        bool const there = i < *k.count;
        mark const m = there ? seen[at(i)] : mark{0, {0, 0}};
        k.x(i) = static_cast<float>(m.pixel.x);
        k.y(i) = static_cast<float>(m.pixel.y);
        k.angle(i) = 0;
        k.response(i) = 1;
        k.octave(i) = 0;
        k.orb(i) = there ? code(m.point) : ft::descriptor{};
      }
    }
    ft::copy(exec, map.view(), points.view());
    ft::copy(exec, keypoints.view(), marks.view());
    ft::build_grid<ft::nearest_cell>(exec, keypoints.view(), 0, 1, 2, grids.view());
    exec.wait();
    view.keypoints = keypoints.view();
    view.keypoint_step = 2;
    view.cameras = 2;
    view.grids = grids.view();
    view.holder = holder.data();
  }
  std::vector<int> holders(Exec const& exec) const {
    return from_exec(exec, static_cast<int const*>(holder.data()), at(2 * capacity));
  }
};

/// Slot held by each keypoint where every keypoint holds its own point: [2 * capacity].
inline std::vector<int> own_points(scene const& s) {
  std::size_t const capacity = s.points.size();
  std::vector<int> holders(2 * capacity, -1);
  for (std::size_t i = 0; i < s.left.size(); ++i) { holders[i] = s.left[i].point; }
  for (std::size_t i = 0; i < s.right.size(); ++i) { holders[capacity + i] = s.right[i].point; }
  return holders;
}

/// Whether a camera has the point in view, from the projection in double.
enum class expected { seen, unseen, doubtful };
inline expected in_view(double_camera const& camera, vector p) {
  auto const here = camera.project(p);
  double const size = length(p);
  if (std::abs(p.z) < 1e-4 * size) { return expected::doubtful; }
  if (p.z < 0) { return expected::unseen; }
  for (vector const step : {vector{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}) {
    for (double const h : {-1e-4 * size, 1e-4 * size}) {
      if (camera.project(p + scaled(step, h)).valid != here.valid) { return expected::doubtful; }
    }
  }
  if (!here.valid || !camera.in_image(here.pixel, -0.02)) { return expected::unseen; }
  return camera.in_image(here.pixel, 0.02) ? expected::seen : expected::doubtful;
}

/// What each window and camera should find: [2 * count].
inline std::vector<expected> expected_views(double_camera const& camera, scene const& s) {
  std::vector<expected> all;
  for (vector const& p : s.in_left) { all.push_back(in_view(camera, p)); }
  for (vector const& p : s.in_right) { all.push_back(in_view(camera, p)); }
  return all;
}

/// Puts half of a scene's points elsewhere, all around the cameras.
inline void scatter(scene& s, unsigned seed) {
  std::mt19937 random(seed);
  auto const T_wc = s.T_cw.cast<double>().inverse();
  for (std::size_t i = 0; i < s.points.size(); i += 2) {
    vector const d = random_direction(random);
    vector const w = T_wc * scaled(d, 3 / length(d));
    s.points[i] = {static_cast<float>(w.x), static_cast<float>(w.y), static_cast<float>(w.z)};
    s.in_left[i] = s.T_cw.cast<double>() * vector{s.points[i].x, s.points[i].y, s.points[i].z};
    s.in_right[i] = s.T_rl.cast<double>() * s.in_left[i];
  }
}

/// Parallax of a point seen by both cameras, radians.
inline double parallax(scene const& s, int i) {
  vector const r = s.T_rl.cast<double>().R.transposed() * s.in_right[at(i)];
  return angle_between(s.in_left[at(i)], r);
}

/// Largest difference of entries.
inline double difference(ft::pose const& a, ft::pose const& b) {
  double worst = std::max({std::abs(static_cast<double>(a.t.x) - b.t.x),
                           std::abs(static_cast<double>(a.t.y) - b.t.y),
                           std::abs(static_cast<double>(a.t.z) - b.t.z)});
  for (int i = 0; i < 9; ++i) {
    double const entry = std::abs(static_cast<double>(a.R.m[i]) - b.R.m[i]);
    worst = entry <= worst ? worst : entry;  // also a NaN
  }
  return worst;
}

}  // namespace FT_ABI
}  // namespace camera_contract
