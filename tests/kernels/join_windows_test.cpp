// SPDX-License-Identifier: Apache-2.0
// Gravity and the accelerometer's bias from several windows of keyframes.
#include "ft/kernels/inertial/join_windows.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/moving_body.hpp"

namespace join_windows_test {

using namespace moving_body;

/// A robot on the floor: small swings, and a slow turn about the vertical.
body turning(double rate) {
  body b = swinging(0.3);
  b.attitude = [rate](double t) {
    return rotation_of({0, 0, rate * t}) *
           rotation_of({0.02 * std::sin(1.1 * t), 0.02 * std::sin(1.7 * t + 0.7), 0});
  };
  return b;
}

setting robot(unsigned seed, double rate, int keyframes) {
  setting s = noisy_moving(seed);
  s.of = turning(rate);
  s.keyframes = keyframes;
  return s;
}

constexpr int window_size = 8;
constexpr int step = 4;

ft::initialization_window window_of(recording const& r, int first) {
  auto const at = static_cast<std::size_t>(first);
  return {r.T_wc.data() + at, r.integrals.data() + at, window_size, mount()};
}

/// A window's own estimate, and that of all windows so far.
struct pair_of_estimates {
  ft::inertial_initialization own, joined;
};

pair_of_estimates last_of(recording const& r, ft::initialization_params const& p) {
  ft::joined_windows sum = ft::joined_windows::none();
  pair_of_estimates out{};
  for (int first = 0; first + window_size <= static_cast<int>(r.T_wc.size()); first += step) {
    out.own = out.joined = ft::initialize_window(window_of(r, first), p);
    EXPECT_TRUE(ft::join_window(window_of(r, first), p, 0.98f, sum, out.joined)) << first;
  }
  EXPECT_EQ(sum.count, (static_cast<int>(r.T_wc.size()) - window_size) / step + 1);
  return out;
}

TEST(JoinWindows, FindALevelBiasThatNoneOfThemShows) {
  constexpr int seeds = 10;
  constexpr int keyframes = 80;  // 20 s
  double own = 0;
  double joined = 0;
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    setting const s = robot(seed, 0.25, keyframes);
    recording const r = record(s);
    auto const found = last_of(r, {});
    own += norm(found.own.newest.ba - s.ba) / seeds;
    joined += norm(found.joined.newest.ba - s.ba) / seeds;
    EXPECT_LT(norm(found.joined.newest.ba - s.ba), 0.02) << "seed " << seed;
    EXPECT_LT(tilt(found.joined.gravity, r.gravity), 0.003) << "seed " << seed;
    EXPECT_LT(norm(found.joined.newest.v - r.velocities.back()), 0.05) << "seed " << seed;
    EXPECT_NEAR(norm(found.joined.gravity), 9.81, 1e-5);
  }
  EXPECT_GT(own, 2 * joined) << own << " and " << joined << " m/s^2";
}

// One window alone, with its prior, is solved as it was before.
TEST(JoinWindows, OneIsWhatItWas) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    recording const r = record(robot(seed, 0.8, window_size));
    auto const found = last_of(r, {});
    ASSERT_TRUE(found.own.succeeded());
    EXPECT_LT(norm(found.own.newest.ba - found.joined.newest.ba), 1e-6);
    EXPECT_LT(norm(found.own.gravity - found.joined.gravity), 1e-6);
    EXPECT_LT(norm(found.own.newest.v - found.joined.newest.v), 1e-6);
  }
}

TEST(JoinWindows, StayAsTheyWereWithoutASolution) {
  recording r = record(robot(1, 0.8, window_size));
  for (auto& integral : r.integrals) {
    integral.dT = 0;
    integral.JPa = integral.JVa = {};
  }
  ft::joined_windows sum = ft::joined_windows::none();
  ft::inertial_initialization found{};
  found.gravity = {0, 0, -9.81};
  EXPECT_FALSE(ft::join_window(window_of(r, 0), {}, 0.98f, sum, found));
  EXPECT_EQ(sum.count, 0);
  EXPECT_EQ(found.newest.ba.x, 0);
}

}  // namespace join_windows_test
