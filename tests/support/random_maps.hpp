// SPDX-License-Identifier: Apache-2.0
/// @file Random maps whose points, masks and keyframes agree with each other.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "tests/support/plain_map.hpp"

namespace test {

/// Writes a map into the arrays of batch entry b.
inline void write_map(plain_map const& m, ft::odometry_map_view const& v, int b) {
  auto const& r = v.records;
  auto const& k = v.keyframes;
  auto const points = v.points.slice(b);
  r.made[b] = m.points_made;
  r.alive[b] = m.alive();
  r.used[b] = 0;
  for (int s = 0; s < r.slots; ++s) {
    plain_point const& p = m.points[index(s)];
    r.number[r.at(b, s)] = p.number;
    r.visible[r.at(b, s)] = p.visible;
    r.found[r.at(b, s)] = p.found;
    r.described[r.at(b, s)] = static_cast<int>(p.recent.size());
    for (std::size_t i = 0; i < p.recent.size(); ++i) {
      r.recent[r.at(b, s) * ft::point_descriptors + static_cast<std::ptrdiff_t>(i)] = p.recent[i];
    }
    for (int w = 0; w < r.words; ++w) { r.mask(b, s)[w] = 0; }
    for (int const n : p.seen_by) {
      r.mask(b, s)[k.position(n) / 64] |= std::uint64_t{1} << (k.position(n) % 64);
    }
    points.position(s) = p.position;
    points.normal(s) = p.normal;
    points.min_distance(s) = p.least;
    points.max_distance(s) = p.most;
    points.orb(s) = p.orb;
    points.observations(s) = p.observations;
    if (p.number != 0) { r.used[b] = s + 1; }
  }
  k.made[b] = m.keyframes_made;
  k.count[b] = static_cast<int>(m.keyframes.size());
  for (auto const& [n, f] : m.keyframes) {
    std::ptrdiff_t const at = k.at(b, k.position(n));
    k.T_cw[at] = f.T_cw;
    k.time_ns[at] = f.time_ns;
    k.neighbour[at] = f.neighbour;
    k.shared[at] = f.shared;
    for (int c = 0; c < k.cameras; ++c) {
      auto const& keypoints = f.cameras[index(c)];
      k.keypoints[at * k.cameras + c] = static_cast<int>(keypoints.size());
      for (std::size_t i = 0; i < keypoints.size(); ++i) {
        std::ptrdiff_t const to = k.at(b, k.position(n), c * k.capacity + static_cast<int>(i));
        k.x[to] = keypoints[i].x;
        k.y[to] = keypoints[i].y;
        k.right_x[to] = keypoints[i].right_x;
        k.octave[to] = keypoints[i].octave;
        k.holder[to] = keypoints[i].holder;
        k.holder_number[to] = keypoints[i].holder_number;
        k.aligned[to] = keypoints[i].aligned ? 1 : 0;
      }
    }
  }
}

struct random_map_sizes {
  int slots, positions, cameras, keypoints;
  int keyframes;   ///< in use
  unsigned share;  ///< of slots that hold a point, percent
};

inline plain_keypoint random_keypoint(std::mt19937& random, int holder, int number) {
  std::uniform_real_distribution<float> pixel(0, 500);
  return {pixel(random),
          pixel(random),
          random() % 3 == 0 ? -1.0f : pixel(random),
          static_cast<int>(random() % 4),
          holder,
          number,
          random() % 3 == 0};
}

/// Adds a point at a slot, seen by some of the keyframes from `first` on.
inline void add_random_point(std::mt19937& random, plain_map& m, int slot, int first) {
  plain_point p;
  std::uniform_real_distribution<float> in(-5, 5);
  p.number = ++m.points_made;
  p.visible = p.found = 1;
  p.position = {in(random), in(random), 15 + in(random)};
  p.normal = {0.6f, 0, 0.8f};
  p.least = 1 + std::abs(in(random));
  p.most = 4 * p.least;
  p.recent = {ft::descriptor{{1, 2, 3, 4, 5, 6, 7, static_cast<std::uint32_t>(slot)}}};
  p.orb = p.recent[0];
  int const n = m.keyframes_made - first + 1;
  int const middle = first + static_cast<int>(random() % static_cast<unsigned>(n));
  for (auto& [number, f] : m.keyframes) {
    if (number < first || std::abs(number - middle) > 4 || random() % 3 == 0) { continue; }
    bool sees = false;
    for (auto& camera : f.cameras) {
      if (static_cast<int>(camera.size()) >= m.capacity || (sees && random() % 2 == 0)) {
        continue;
      }
      camera.push_back(random_keypoint(random, slot, p.number));
      sees = true;
    }
    if (sees) { p.seen_by.insert(number); }
  }
  p.observations = static_cast<int>(p.seen_by.size());
  if (!p.seen_by.empty()) { m.points[index(slot)] = p; }
}

/// Adds a keyframe that sees nothing yet but has keypoints that held removed points, or none.
inline void add_random_keyframe(std::mt19937& random, plain_map& m, int cameras) {
  plain_keyframe f;
  f.T_cw = random_motion(random, 0.2, 1);
  f.cameras.resize(index(cameras));
  for (auto& camera : f.cameras) {
    if (m.capacity > 4) { camera.push_back(random_keypoint(random, -1, 0)); }
    if (m.capacity > 4) {
      camera.push_back(random_keypoint(random, static_cast<int>(random() % m.points.size()), 1));
    }
  }
  m.keyframes[++m.keyframes_made] = f;
}

inline plain_map random_map(std::mt19937& random, random_map_sizes const& size) {
  plain_map m;
  m.positions = size.positions;
  m.capacity = size.keypoints;
  m.points.resize(index(size.slots));
  m.points_made = 1;  // a point that was removed
  m.keyframes_made = static_cast<int>(random() % 300);
  for (int i = 0; i < size.keyframes; ++i) { add_random_keyframe(random, m, size.cameras); }
  int const first = m.keyframes_made - size.keyframes + 1;
  for (int s = 0; s < size.slots && size.keyframes > 0; ++s) {
    if (random() % 100 < size.share) { add_random_point(random, m, s, first); }
  }
  for (auto& [n, f] : m.keyframes) {
    if (random() % 4 == 0) { continue; }
    f.neighbour = first - 1 + static_cast<int>(random() % index(size.keyframes + 1));
    f.shared = f.neighbour > 0 ? 3 : 0;
  }
  return m;
}

}  // namespace test
