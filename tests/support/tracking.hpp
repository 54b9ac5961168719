// SPDX-License-Identifier: Apache-2.0
/// @file Copies of what a tracker found, and textures for what it looks at.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"

namespace test {

/// Grey level between the texels of a square texture that repeats. @param s,t texels, 0 or more
inline std::uint8_t texture_at(std::vector<std::uint8_t> const& texture, int side, double s,
                               double t) {
  int const x = static_cast<int>(s);
  int const y = static_cast<int>(t);
  double const fx = s - x;
  double const fy = t - y;
  auto const texel = [&](int i, int j) {
    return static_cast<double>(
        texture[static_cast<std::size_t>(j % side) * static_cast<std::size_t>(side) +
                static_cast<std::size_t>(i % side)]);
  };
  return static_cast<std::uint8_t>(
      std::lround((1 - fx) * (1 - fy) * texel(x, y) + fx * (1 - fy) * texel(x + 1, y) +
                  (1 - fx) * fy * texel(x, y + 1) + fx * fy * texel(x + 1, y + 1)));
}

/// A copy of a tracker's result, one batch entry.
struct snapshot {
  std::vector<int> keypoints;  ///< of each camera that is searched
  int matches = 0, inliers = 0;
  ft::pose T_cw{};
  std::vector<float> x, y, depth;
  std::vector<ft::vec3<float>> point;
  std::vector<int> octave, holder, partner;
  std::vector<unsigned char> in_view;
};

/// @param local_points how many entries of in_view to copy
template <typename Tracker>
snapshot take(Tracker const& tracker, int b, int local_points) {
  auto const& r = tracker.result();
  auto const row = [&](auto const* data, int length, int count) {
    auto const* const first = data + static_cast<std::ptrdiff_t>(b) * length;
    return std::vector<std::decay_t<decltype(*data)>>(first, first + count);
  };
  int const numbers = r.cameras * r.capacity;
  snapshot s;
  s.keypoints = row(r.keypoints, r.cameras, r.cameras);
  s.matches = r.matches[b];
  s.inliers = r.inliers[b];
  s.T_cw = r.T_cw[b];
  s.x = row(r.x, numbers, numbers);
  s.y = row(r.y, numbers, numbers);
  s.octave = row(r.octave, numbers, numbers);
  s.holder = row(r.holder, numbers, numbers);
  s.partner = row(r.partner, numbers, numbers);
  s.depth = row(r.depth, r.capacity, r.capacity);
  s.point = row(r.point, r.capacity, r.capacity);
  s.in_view = row(r.in_view, r.local_points, local_points);
  return s;
}

template <typename T>
bool same_bits(std::vector<T> const& a, std::vector<T> const& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

inline void expect_same(snapshot const& a, snapshot const& b) {
  EXPECT_EQ(a.keypoints, b.keypoints);
  EXPECT_EQ(a.matches, b.matches);
  EXPECT_EQ(a.inliers, b.inliers);
  EXPECT_EQ(std::memcmp(&a.T_cw, &b.T_cw, sizeof(ft::pose)), 0) << "poses differ";
  EXPECT_TRUE(same_bits(a.x, b.x) && same_bits(a.y, b.y) && same_bits(a.octave, b.octave))
      << "keypoints differ";
  EXPECT_TRUE(same_bits(a.depth, b.depth) && same_bits(a.point, b.point)) << "depths differ";
  EXPECT_EQ(a.partner, b.partner);
  EXPECT_EQ(a.holder, b.holder);
  EXPECT_EQ(a.in_view, b.in_view);
}

}  // namespace test
