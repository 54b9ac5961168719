// SPDX-License-Identifier: Apache-2.0
/// @file A map in ordinary containers, to compare the map stages with plain loops.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace test {

/// The same layout in an executor's memory and in that of the host.
template <typename Exec, typename View>
struct mirrored {
  View device;
  View host;

  /// @param layout void(carver&, View&)
  template <typename Layout>
  explicit mirrored(Layout const& layout)
      : device_memory_([&](ft::carver& c) { layout(c, device); }),
        host_memory_([&](ft::carver& c) { layout(c, host); }) {}
  void push(Exec const& exec) {
    ft::copy_bytes(exec, device_memory_.data(), host_memory_.data(), host_memory_.bytes());
    exec.wait();
  }
  void pull(Exec const& exec) {
    ft::copy_bytes(exec, host_memory_.data(), device_memory_.data(), host_memory_.bytes());
    exec.wait();
  }
  /// Takes the host's copy of another one of the same layout.
  template <typename Other>
  void take(mirrored<Other, View> const& other) {
    std::memcpy(host_memory_.data(), other.bytes(), host_memory_.bytes());
  }
  std::byte const* bytes() const { return host_memory_.data(); }

private:
  ft::arena<Exec::space> device_memory_;
  ft::arena<ft::memory_space::host> host_memory_;
};

struct plain_point {
  int number = 0;
  int visible = 0, found = 0;
  ft::vec3<float> position{NAN, NAN, NAN};
  ft::vec3<float> normal{0, 0, 0};
  float least = 0, most = 0;
  ft::descriptor orb{};
  int observations = 0;
  std::vector<ft::descriptor> recent;  ///< oldest first
  std::set<int> seen_by;               ///< numbers of keyframes
};

struct plain_keypoint {
  float x, y, right_x;
  int octave, holder, holder_number;
  bool aligned = false;
};

struct plain_keyframe {
  ft::rigid<double> T_cw;
  std::int64_t time_ns = 0;
  int neighbour = 0, shared = 0;
  std::vector<std::vector<plain_keypoint>> cameras;
};

struct plain_map {
  int points_made = 0;
  int keyframes_made = 0;
  int positions = 0;
  int capacity = 0;
  std::vector<plain_point> points;
  std::map<int, plain_keyframe> keyframes;  ///< by number

  int alive() const {
    int n = 0;
    for (auto const& p : points) { n += static_cast<int>(p.number != 0); }
    return n;
  }
};

inline std::size_t index(std::ptrdiff_t i) { return static_cast<std::size_t>(i); }

inline plain_point read_point(ft::odometry_map_view const& v, int b, int slot) {
  plain_point p;
  auto const& r = v.records;
  auto const points = v.points.slice(b);
  p.number = r.number[r.at(b, slot)];
  p.visible = r.visible[r.at(b, slot)];
  p.found = r.found[r.at(b, slot)];
  p.position = points.position(slot);
  p.normal = points.normal(slot);
  p.least = points.min_distance(slot);
  p.most = points.max_distance(slot);
  p.orb = points.orb(slot);
  p.observations = points.observations(slot);
  int const end = r.described[r.at(b, slot)];
  for (int i = std::max(0, end - ft::point_descriptors); i < end; ++i) {
    p.recent.push_back(r.recent[r.at(b, slot) * ft::point_descriptors + i % ft::point_descriptors]);
  }
  for (int n = v.keyframes.oldest(b); n <= v.keyframes.made[b]; ++n) {
    int const at = v.keyframes.position(n);
    if ((r.mask(b, slot)[at / 64] >> (at % 64) & 1) != 0) { p.seen_by.insert(n); }
  }
  EXPECT_EQ(r.observers(b, slot), static_cast<int>(p.seen_by.size())) << "of slot " << slot;
  return p;
}

inline plain_map read_map(ft::odometry_map_view const& v, int b) {
  plain_map m;
  auto const& k = v.keyframes;
  m.points_made = v.records.made[b];
  m.keyframes_made = k.made[b];
  m.positions = k.positions;
  m.capacity = k.capacity;
  for (int s = 0; s < v.records.slots; ++s) { m.points.push_back(read_point(v, b, s)); }
  EXPECT_EQ(v.records.alive[b], m.alive());
  for (int s = v.records.used[b]; s < v.records.slots; ++s) {
    EXPECT_EQ(m.points[index(s)].number, 0) << "past the slots in use";
  }
  for (int n = k.oldest(b); n <= k.made[b]; ++n) {
    plain_keyframe f;
    std::ptrdiff_t const at = k.at(b, k.position(n));
    f.T_cw = k.T_cw[at];
    f.time_ns = k.time_ns[at];
    f.neighbour = k.neighbour[at];
    f.shared = k.shared[at];
    for (int c = 0; c < k.cameras; ++c) {
      f.cameras.emplace_back();
      for (int i = 0; i < k.keypoints[at * k.cameras + c]; ++i) {
        std::ptrdiff_t const to = k.at(b, k.position(n), c * k.capacity + i);
        f.cameras.back().push_back({k.x[to], k.y[to], k.right_x[to], k.octave[to], k.holder[to],
                                    k.holder_number[to], k.aligned[to] != 0});
      }
    }
    m.keyframes[n] = f;
  }
  return m;
}

/// Whether the parts of a map agree with each other.
inline void expect_consistent(plain_map const& m) {
  std::set<int> numbers;
  std::map<int, std::set<int>> seen_by;  // keyframes by slot
  for (auto const& [n, f] : m.keyframes) {
    for (auto const& camera : f.cameras) {
      std::set<int> once;
      for (auto const& p : camera) {
        EXPECT_EQ(p.holder < 0, p.holder_number == 0);
        if (p.holder < 0 || m.points[index(p.holder)].number != p.holder_number) { continue; }
        EXPECT_TRUE(once.insert(p.holder).second) << "a point twice in a camera";
        seen_by[p.holder].insert(n);
      }
    }
  }
  for (std::size_t s = 0; s < m.points.size(); ++s) {
    auto const& p = m.points[s];
    EXPECT_EQ(p.seen_by, seen_by[static_cast<int>(s)]) << "slot " << s;
    EXPECT_EQ(p.observations, static_cast<int>(p.seen_by.size())) << "slot " << s;
    EXPECT_EQ(p.number != 0, !p.seen_by.empty()) << "slot " << s;
    EXPECT_EQ(p.number == 0, std::isnan(p.position.x)) << "slot " << s;
    if (p.number == 0) { continue; }
    EXPECT_TRUE(numbers.insert(p.number).second) << "number " << p.number << " twice";
    EXPECT_LE(p.number, m.points_made);
    EXPECT_FALSE(p.recent.empty());
  }
}

inline bool same_words(ft::descriptor const& a, ft::descriptor const& b) {
  return ft::hamming(a, b) == 0;
}

inline void expect_near(ft::vec3<float> a, ft::vec3<float> b, float tolerance) {
  float const size = 1 + std::abs(b.x) + std::abs(b.y) + std::abs(b.z);
  EXPECT_NEAR(a.x, b.x, tolerance * size);
  EXPECT_NEAR(a.y, b.y, tolerance * size);
  EXPECT_NEAR(a.z, b.z, tolerance * size);
}

/// @param tolerance of floats, relative; 0 = the same bits
inline void expect_same_point(plain_point const& a, plain_point const& b, float tolerance) {
  EXPECT_EQ(a.number, b.number);
  EXPECT_EQ(a.seen_by, b.seen_by);
  if (a.number == 0 || b.number == 0) { return; }
  EXPECT_EQ(a.visible, b.visible);
  EXPECT_EQ(a.found, b.found);
  EXPECT_EQ(a.observations, b.observations);
  expect_near(a.position, b.position, tolerance);
  expect_near(a.normal, b.normal, tolerance);
  EXPECT_NEAR(a.least, b.least, tolerance * b.least);
  EXPECT_NEAR(a.most, b.most, tolerance * b.most);
  EXPECT_TRUE(same_words(a.orb, b.orb));
  ASSERT_EQ(a.recent.size(), b.recent.size());
  for (std::size_t i = 0; i < a.recent.size(); ++i) {
    EXPECT_TRUE(same_words(a.recent[i], b.recent[i])) << "descriptor " << i;
  }
}

inline void expect_same_keyframe(plain_keyframe const& a, plain_keyframe const& b,
                                 double tolerance) {
  for (int i = 0; i < 9; ++i) { EXPECT_NEAR(a.T_cw.R.m[i], b.T_cw.R.m[i], tolerance); }
  EXPECT_NEAR(a.T_cw.t.x, b.T_cw.t.x, tolerance);
  EXPECT_NEAR(a.T_cw.t.y, b.T_cw.t.y, tolerance);
  EXPECT_NEAR(a.T_cw.t.z, b.T_cw.t.z, tolerance);
  EXPECT_EQ(a.time_ns, b.time_ns);
  EXPECT_EQ(a.neighbour, b.neighbour);
  EXPECT_EQ(a.shared, b.shared);
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  for (std::size_t c = 0; c < a.cameras.size(); ++c) {
    ASSERT_EQ(a.cameras[c].size(), b.cameras[c].size());
    for (std::size_t i = 0; i < a.cameras[c].size(); ++i) {
      auto const& p = a.cameras[c][i];
      auto const& q = b.cameras[c][i];
      EXPECT_NEAR(p.x, q.x, 100 * tolerance);
      EXPECT_NEAR(p.y, q.y, 100 * tolerance);
      EXPECT_NEAR(p.right_x, q.right_x, 100 * tolerance);
      EXPECT_EQ(p.octave, q.octave);
      EXPECT_EQ(p.holder, q.holder) << "camera " << c << ", keypoint " << i;
      EXPECT_EQ(p.holder_number, q.holder_number);
      EXPECT_EQ(p.aligned, q.aligned);
    }
  }
}

inline void expect_same_map(plain_map const& a, plain_map const& b, float tolerance) {
  EXPECT_EQ(a.points_made, b.points_made);
  EXPECT_EQ(a.keyframes_made, b.keyframes_made);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t s = 0; s < a.points.size(); ++s) {
    SCOPED_TRACE("slot " + std::to_string(s));
    expect_same_point(a.points[s], b.points[s], tolerance);
  }
  ASSERT_EQ(a.keyframes.size(), b.keyframes.size());
  for (auto const& [n, f] : a.keyframes) {
    SCOPED_TRACE("keyframe " + std::to_string(n));
    ASSERT_EQ(b.keyframes.count(n), 1u);
    expect_same_keyframe(f, b.keyframes.at(n), static_cast<double>(tolerance));
  }
}

/// A small motion: rotation about the axes in turn.
inline ft::rigid<double> random_motion(std::mt19937& random, double angle, double length) {
  std::uniform_real_distribution<double> in(-1, 1);
  ft::rigid<double> T = ft::rigid<double>::identity();
  for (int axis = 0; axis < 3; ++axis) {
    double const a = angle * in(random);
    ft::mat3<double> R = ft::mat3<double>::identity();
    int const i = (axis + 1) % 3;
    int const j = (axis + 2) % 3;
    R.m[4 * i] = R.m[4 * j] = std::cos(a);
    R.m[3 * i + j] = -std::sin(a);
    R.m[3 * j + i] = std::sin(a);
    T.R = T.R * R;
  }
  T.t = {length * in(random), length * in(random), length * in(random)};
  return T;
}

}  // namespace test
