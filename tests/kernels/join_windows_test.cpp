// SPDX-License-Identifier: Apache-2.0
// Gravity and the accelerometer's bias from several windows of keyframes.
#include "ft/kernels/inertial/join_windows.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
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

/// A window's own estimate, and that of all windows so far.
struct pair_of_estimates {
  ft::inertial_initialization own, joined;
};

/// The functions for one thread.
struct plain_calls {
  FT_HOST_DEVICE ft::inertial_initialization initialize(ft::initialization_window const& w) const {
    return ft::initialize_window(w, {});
  }
  FT_HOST_DEVICE bool join(ft::initialization_window const& w, ft::joined_windows& sum,
                           ft::inertial_initialization& found) const {
    return ft::join_window(w, {}, 0.98f, sum, found);
  }
};
/// Those that a stage calls.
template <typename Group>
struct calls_by {
  Group g;
  ft::detail::initialization_scratch& s;
  FT_HOST_DEVICE ft::inertial_initialization initialize(ft::initialization_window const& w) const {
    ft::detail::initialize_window_by(g, s, w, {}, nullptr, s.found);
    return s.found;
  }
  FT_HOST_DEVICE bool join(ft::initialization_window const& w, ft::joined_windows& sum,
                           ft::inertial_initialization& found) const {
    g.sync();
    if (g.rank() == 0) { s.found = found; }
    g.sync();
    bool const joined = ft::detail::join_window_by(g, s, w, {}, ft::detail::without_bias_prior({}),
                                                   0.98f, sum, s.found);
    found = s.found;
    g.sync();
    return joined;
  }
};

/// Joins the windows of `count` keyframes.
template <typename Calls>
FT_HOST_DEVICE pair_of_estimates join_all(Calls const& calls, motion const* poses,
                                          ft::preintegrated const* integrals, int count,
                                          ft::imu_mount const& mounted, ft::joined_windows& sum,
                                          int& failures) {
  pair_of_estimates out{};
  failures = 0;
  for (int first = 0; first + window_size <= count; first += step) {
    ft::initialization_window const window{poses + first, integrals + first, window_size, mounted};
    out.own = out.joined = calls.initialize(window);
    failures += calls.join(window, sum, out.joined) ? 0 : 1;
  }
  return out;
}

pair_of_estimates last_of(recording const& r) {
  ft::joined_windows sum{};
  int failures = 0;
  auto const count = static_cast<int>(r.T_wc.size());
  auto const out =
      join_all(plain_calls{}, r.T_wc.data(), r.integrals.data(), count, mount(), sum, failures);
  EXPECT_EQ(failures, 0);
  EXPECT_EQ(sum.count, (count - window_size) / step + 1);
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
    auto const found = last_of(r);
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
    auto const found = last_of(r);
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
  EXPECT_FALSE(ft::join_window(r.window(), {}, 0.98f, sum, found));
  EXPECT_EQ(sum.count, 0);
  EXPECT_EQ(found.newest.ba.x, 0);
}

/// Item: a recording, joined by a group.
struct join_each {
  using scratch = ft::detail::initialization_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, motion const* poses,
                                 ft::preintegrated const* integrals, int count,
                                 ft::imu_mount const& mounted, ft::joined_windows* sums,
                                 pair_of_estimates* found, int* failures) const {
    auto const at = static_cast<std::ptrdiff_t>(b) * count;
    int failed = 0;
    auto const mine = join_all(calls_by<Group>{g, s}, poses + at, integrals + at, count, mounted,
                               sums[b], failed);
    if (g.rank() == g.size() - 1) {  // all threads have it
      found[b] = mine;
      failures[b] = failed;
    }
  }
};

template <typename Backend>
class join_windows_stage : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(join_windows_stage, test::backends);

TYPED_TEST(join_windows_stage, gives_the_bits_of_a_plain_call) {
  TypeParam backend;
  auto const& exec = backend.exec;
  constexpr int batch = 6;
  constexpr int count = 24;
  std::vector<motion> poses;
  std::vector<ft::preintegrated> integrals;
  std::vector<recording> recordings;
  for (unsigned seed = 1; seed <= batch; ++seed) {
    recordings.push_back(record(robot(seed, 0.2 * seed, count)));
    auto const& r = recordings.back();
    poses.insert(poses.end(), r.T_wc.begin(), r.T_wc.end());
    integrals.insert(integrals.end(), r.integrals.begin(), r.integrals.end());
    integrals.push_back({});  // as many as poses
  }
  auto const d_poses = test::to_exec(exec, poses);
  auto const d_integrals = test::to_exec(exec, integrals);
  auto const d_sums = test::to_exec(exec, std::vector<ft::joined_windows>(batch));
  auto const d_found = test::to_exec(exec, std::vector<pair_of_estimates>(batch));
  auto const d_failures = test::to_exec(exec, std::vector<int>(batch, 7));
  ft::for_each_item<ft::per_block<32>>(exec, batch, join_each{}, d_poses.data(), d_integrals.data(),
                                       count, mount(), d_sums.data(), d_found.data(),
                                       d_failures.data());
  auto const sums = test::from_exec(exec, d_sums.data(), batch);
  auto const found = test::from_exec(exec, d_found.data(), batch);
  auto const failures = test::from_exec(exec, d_failures.data(), batch);
  for (std::size_t b = 0; b < batch; ++b) {
    ft::joined_windows sum{};
    int failed = 0;
    auto const plain = join_all(plain_calls{}, recordings[b].T_wc.data(),
                                recordings[b].integrals.data(), count, mount(), sum, failed);
    EXPECT_EQ(failures[b], failed);
    EXPECT_EQ(sums[b].count, sum.count);
    EXPECT_TRUE(std::equal(sum.A, sum.A + 36, sums[b].A)) << b;
    EXPECT_TRUE(std::equal(sum.b, sum.b + 6, sums[b].b)) << b;
    auto const same = [](vec x, vec y) { return x.x == y.x && x.y == y.y && x.z == y.z; };
    EXPECT_TRUE(same(found[b].joined.gravity, plain.joined.gravity)) << b;
    EXPECT_TRUE(same(found[b].joined.newest.ba, plain.joined.newest.ba)) << b;
    EXPECT_TRUE(same(found[b].joined.newest.v, plain.joined.newest.v)) << b;
  }
}

}  // namespace join_windows_test
