// SPDX-License-Identifier: Apache-2.0
/// @file Copies of a tracker's results, and textures for its images.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/memory.hpp"

namespace test {

/// Grey level between the texels of a square texture that repeats. @param s,t texels, 0 or more
inline std::uint8_t texture_at(std::vector<std::uint8_t> const& texture, int side, double s,
                               double t) {
  int const x = static_cast<int>(s);
  int const y = static_cast<int>(t);
  double const fx = s - x;
  double const fy = t - y;
  auto const wrapped = [&](int i) {
    return static_cast<std::size_t>(i) % static_cast<std::size_t>(side);
  };
  auto const next = [&](std::size_t i) {
    return i + 1 == static_cast<std::size_t>(side) ? 0 : i + 1;
  };
  std::size_t const column = wrapped(x), right = next(column), line = wrapped(y);
  std::uint8_t const* const above = texture.data() + line * static_cast<std::size_t>(side);
  std::uint8_t const* const below = texture.data() + next(line) * static_cast<std::size_t>(side);
  double const grey = (1 - fx) * (1 - fy) * above[column] + fx * (1 - fy) * above[right] +
                      (1 - fx) * fy * below[column] + fx * fy * below[right];
  int const whole = static_cast<int>(grey);
  return static_cast<std::uint8_t>(grey - whole < 0.5 ? whole : whole + 1);
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

/// @param local_points number of entries of in_view to copy
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
  int const with_depth = r.depth_cameras * r.capacity;
  s.depth = row(r.depth, with_depth, with_depth);
  s.point = row(r.point, with_depth, with_depth);
  s.in_view = row(r.in_view, r.local_points, local_points);
  return s;
}

/// All inputs of a frame of a tracker, given with every call. These include the state after the
/// last frame, which the tracker otherwise keeps by itself. One call at a time: wait between two.
template <typename Tracker>
struct frame_inputs {
  Tracker& tracker;
  std::vector<ft::pose> predicted;  ///< [batch]
  std::vector<ft::pose> last_pose;  ///< [batch]
  std::vector<int> last_holder;     ///< [batch][cameras * capacity]
  std::vector<int> local_slots;     ///< [batch][local_points]
  std::vector<int> local_count;     ///< [batch]

  explicit frame_inputs(Tracker& t)
      : tracker(t),
        predicted(size(t.batch()), ft::pose::identity()),
        last_pose(predicted),
        last_holder(size(t.batch() * numbers()), -1),
        local_slots(size(t.batch() * t.params().local_points)),
        local_count(size(t.batch())) {}

  int numbers() const { return Tracker::cameras * tracker.capacity(); }

  /// The result has the predicted pose.
  template <typename Exec>
  void extract(Exec const& exec) {
    set_last(exec, predicted);
    tracker.extract(exec);
  }
  template <typename Exec>
  void track(Exec const& exec) {
    set_last(exec, last_pose);
    auto const all = inputs();
    tracker.track(exec, all.data());
  }
  template <typename Exec>
  void track_motion(Exec const& exec) {
    set_last(exec, last_pose);
    tracker.track_motion(exec, predicted.data());
  }
  template <typename Exec>
  void track_local(Exec const& exec) {
    auto const all = slots();
    tracker.track_local(exec, all.data());
  }
  template <typename Exec>
  void relocalize(Exec const& exec, ft::local_search_params const& search = {}) {
    auto const all = inputs();
    tracker.relocalize(exec, all.data(), search);
  }

private:
  static std::size_t size(int n) { return static_cast<std::size_t>(n); }
  template <typename Exec>
  void set_last(Exec const& exec, std::vector<ft::pose> const& poses) {
    for (int b = 0; b < tracker.batch(); ++b) {
      tracker.set_last(
          exec, b, poses[size(b)],
          {last_holder.data() + static_cast<std::ptrdiff_t>(b) * numbers(), numbers()});
    }
  }
  std::vector<ft::slot_list> slots() const {
    std::vector<ft::slot_list> all;
    for (int b = 0; b < tracker.batch(); ++b) {
      all.emplace_back(
          local_slots.data() + static_cast<std::ptrdiff_t>(b) * tracker.params().local_points,
          local_count[size(b)]);
    }
    return all;
  }
  std::vector<ft::frame_input> inputs() const {
    auto const all_slots = slots();
    std::vector<ft::frame_input> all;
    for (int b = 0; b < tracker.batch(); ++b) {
      all.push_back({predicted[size(b)], all_slots[size(b)]});
    }
    return all;
  }
};

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
