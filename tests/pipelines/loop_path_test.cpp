// SPDX-License-Identifier: Apache-2.0
// The path of a camera and its loops: what fits it, what agrees, what a correction does, and that
// thinning changes nothing but the number of keyframes.
#include "ft/pipelines/detail/loop_path.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/pipelines/detail/loop_correction.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/random.hpp"

namespace loop_path_test {

using ft::detail::loop_path;
using ft::detail::path_loop;
using ft::detail::with_scale;
using ft::detail::without_scale;
using test::at;
constexpr double turn_of_lap = 6.283185307179586;

/// The true pose of keyframe i of n on a circle of 2 m, camera to world.
test::motion truth(int i, int n) {
  double const a = turn_of_lap * i / n;
  return test::turn({0, 1, 0}, a, {2 - 2 * std::cos(a), 0.0, 2 * std::sin(a)});
}

float const certain[21] = {1e6f, 0, 0, 0, 0,    0, 1e6f, 0,    0, 0,   0,
                           1e6f, 0, 0, 0, 1e6f, 0, 0,    1e6f, 0, 1e6f};

/// A lap whose motions are each off by a little of the same, so that its end is not at its start.
loop_path drifting_lap(int n, double drift) {
  loop_path path;
  path.reserve(200, 2);
  test::motion T = truth(0, n);
  for (int i = 0; i < n; ++i) {
    ft::detail::path_keyframe k;
    if (i > 0) {
      test::motion step = truth(i - 1, n).inverse() * truth(i, n);
      step.t.y += drift;  // on a circle it adds up
      T = T * step;
      k.step = std::sqrt(ft::dot(step.t, step.t));
    }
    k.row = i;
    k.map = k.part = 1;
    k.time_ns = i * 1000;
    k.T_odom_camera = T.orthonormalized();
    k.T_world_camera = with_scale(k.T_odom_camera);
    ft::detail::edge_information(certain, 1, k.information);
    path.keyframes.push_back(k);
  }
  return path;
}
path_loop true_loop(int from, int to, int n) {
  path_loop l;
  l.from = from;
  l.to = to;
  l.T_from_to = with_scale((truth(from, n).inverse() * truth(to, n)).orthonormalized());
  ft::detail::edge_information(certain, 1, l.information);
  return l;
}
double error(loop_path const& path, int i, int n) {
  auto const d = path.at(i).T_world_camera.t - truth(i, n).t;
  return std::sqrt(ft::dot(d, d));
}

TEST(LoopPath, ALoopSpreadsTheDriftOverTheLap) {
  constexpr int n = 60;
  loop_path path = drifting_lap(n, 0.002);
  double const before = error(path, n - 1, n);
  ASSERT_GT(before, 0.01);
  path.loops.push_back(true_loop(0, n - 1, n));
  ft::detail::optimize(ft::host_exec(), path);
  EXPECT_LT(error(path, n - 1, n), before / 10);
  EXPECT_EQ(error(path, 0, n), 0);
  // What the odometry tracked stays, and the correction takes the newest keyframe to its place.
  auto const T = path.T_world_odom() * with_scale(path.keyframes.back().T_odom_camera);
  EXPECT_NEAR(T.t.x, path.keyframes.back().T_world_camera.t.x, 1e-9);
  EXPECT_NEAR(T.t.z, path.keyframes.back().T_world_camera.t.z, 1e-9);
}

/// A lap of one camera whose unit grows by the same share in each step.
loop_path growing_lap(int n, double share) {
  loop_path path = drifting_lap(n, 0);
  path.scaled = true;
  double unit = 1;
  for (int i = 1; i < n; ++i) {
    test::motion step = truth(i - 1, n).inverse() * truth(i, n);
    step.t = ft::scaled(step.t, 1 / unit);
    unit *= 1 + share;
    auto& k = path.keyframes[at(i)];
    k.T_odom_camera = (path.at(i - 1).T_odom_camera * step).orthonormalized();
    k.T_world_camera = with_scale(k.T_odom_camera);
  }
  return path;
}
/// Of two keyframes of that lap.
path_loop true_scaled_loop(int from, int to, int n, double share) {
  path_loop l = true_loop(from, to, n);
  l.T_from_to.scale = std::pow(1 + share, to - from);
  l.T_from_to.t = ft::scaled(l.T_from_to.t, std::pow(1 + share, -from));
  l.scale_information = 1e6;
  return l;
}

TEST(LoopPath, ALoopSpreadsTheDriftOfTheScaleOverTheLap) {
  constexpr int n = 60;
  constexpr double share = 0.004;  // a quarter in all
  loop_path path = growing_lap(n, share);
  double const before = error(path, n - 1, n);
  ASSERT_GT(before, 0.3);
  EXPECT_TRUE(path.fits(true_scaled_loop(0, n - 1, n, share), {}, 0));
  path.loops.push_back(true_scaled_loop(0, n - 1, n, share));
  ft::detail::optimize(ft::host_exec(), path);
  double worst = 0;
  for (int i = 0; i < n; ++i) {
    worst = std::fmax(worst, error(path, i, n));
    EXPECT_NEAR(path.at(i).T_world_camera.scale, std::pow(1 + share, i), 0.01) << i;
  }
  EXPECT_LT(worst, before / 20);
  EXPECT_EQ(path.at(0).T_world_camera.scale, 1);
  auto const T = path.T_world_odom();
  EXPECT_NEAR(T.scale, path.keyframes.back().T_world_camera.scale, 1e-12);
  auto const p = T * path.keyframes.back().T_odom_camera.t;
  EXPECT_NEAR(p.x, path.keyframes.back().T_world_camera.t.x, 1e-9);
}

TEST(LoopPath, AScaleMustBeOneThatMayHaveDrifted) {
  constexpr int n = 60;
  loop_path path = growing_lap(n, 0);
  path_loop l = true_loop(0, n - 1, n);
  ft::loop_params params;
  for (double const scale : {1.0, 1.6, 1 / 1.6, 1.7, 1 / 1.7}) {
    l.T_from_to.scale = scale;
    EXPECT_EQ(path.fits(l, params, 0), std::abs(std::log(scale)) < 0.5) << scale;
  }
  // A scale that has not drifted explains no other place.
  l = true_loop(0, n - 1, n);
  l.T_from_to.t.x += 1;  // 8 % of the way
  EXPECT_FALSE(path.fits(l, params, 0));
  path_loop other = l = true_scaled_loop(0, n - 1, n, 0);
  EXPECT_TRUE(path.agree(l, other));
  other.T_from_to.scale = 1.02;  // 20 deviations, of which 8 times the variance leaves 7
  EXPECT_FALSE(path.agree(l, other));
}

TEST(LoopPath, KnownGravityKeepsEachKeyframesAnglesAgainstIt) {
  constexpr int n = 60;
  for (bool const known : {false, true}) {
    SCOPED_TRACE(known);
    loop_path path = drifting_lap(n, 0.002);
    loop_path const before = path;
    path.loops.push_back(true_loop(0, n - 1, n));
    if (known) { path.gravity = {0, 9.8, 0}; }
    ft::detail::optimize(ft::host_exec(), path);
    double tilt = 0;
    for (int i = 0; i < n; ++i) {
      for (int column = 0; column < 3; ++column) {  // what the camera sees of the world's y axis
        tilt = std::fmax(tilt, std::abs(path.at(i).T_world_camera.R.m[3 + column] -
                                        before.at(i).T_world_camera.R.m[3 + column]));
      }
    }
    if (known) {
      EXPECT_LT(tilt, 1e-9);
    } else {
      EXPECT_GT(tilt, 1e-5);
    }
    EXPECT_LT(error(path, n - 1, n), error(before, n - 1, n) / 10);
  }
}

TEST(LoopPath, FitsWhatTheOdometryMayHaveDrifted) {
  constexpr int n = 60;
  loop_path path = drifting_lap(n, 0.002);  // 2 % of its way at most
  ft::loop_params params;
  EXPECT_TRUE(path.fits(true_loop(0, n - 1, n), params, 0));
  params.max_drift = 0.001f;
  EXPECT_FALSE(path.fits(true_loop(0, n - 1, n), params, 0));
  params = {};
  path_loop wrong = true_loop(0, n - 1, n);
  wrong.T_from_to.t.x += 1;  // 8 % of the way
  EXPECT_FALSE(path.fits(wrong, params, 0));
  EXPECT_TRUE(path.fits(wrong, params, 0.5));  // 5 % of the way are 0.6 m
  path_loop turned = true_loop(0, n - 1, n);
  turned.T_from_to = turned.T_from_to * with_scale(test::turn({0, 1, 0}, 0.5, {0, 0, 0}));
  EXPECT_FALSE(path.fits(turned, params, 0));
  path.keyframes.back().part = 2;  // whose place is guessed
  EXPECT_FALSE(path.fits(true_loop(0, n - 1, n), params, 0));
}

TEST(LoopPath, LoopsAgreeWithinTheirUncertainty) {
  constexpr int n = 60;
  loop_path const path = drifting_lap(n, 0);
  path_loop const a = true_loop(0, n - 1, n);
  EXPECT_TRUE(path.agree(a, true_loop(1, n - 1, n)));
  for (double const off : {0.01, 0.02}) {  // 1 / certain is 1 mm, 8 times the variance 13 mm
    path_loop b = true_loop(1, n - 1, n);
    b.T_from_to.t.x += off;
    EXPECT_EQ(path.agree(a, b), off < 0.0134) << off;
  }
}

TEST(LoopPath, LoopsToTwoPlacesThatLookTheSameContradictEachOther) {
  constexpr int n = 60, opposite = n / 2;
  loop_path path = drifting_lap(n, 0);
  ft::loop_params const params;
  path_loop const a = true_loop(0, n - 1, n);
  EXPECT_FALSE(path.contradict(a, true_loop(opposite, n - 1, n), params, 0.1));
  path_loop drifted = true_loop(opposite, n - 1, n);
  drifted.T_from_to.t.x += 1;  // less than half of the 4 m between the keyframes
  EXPECT_FALSE(path.contradict(a, drifted, params, 0.1));
  path_loop twin = a;  // 4 m away, 6 m along the path
  twin.from = opposite;
  EXPECT_TRUE(path.contradict(a, twin, params, 0.1));
  EXPECT_TRUE(path.contradict(twin, a, params, 0.1));
  ft::loop_params any_turn;
  any_turn.max_turn = 4;  // its place alone counts
  EXPECT_TRUE(path.contradict(a, twin, any_turn, 0.1));
  EXPECT_FALSE(path.contradict(a, twin, any_turn, 4)) << "as far as a loop may correct anyway";
  path_loop near = a;  // half a turn about a point near the camera
  near.from = 1;
  path.keyframes[1].T_world_camera =
      with_scale(truth(0, n) * test::turn({0, 1, 0}, turn_of_lap / 2, {0, 0, 0}));
  EXPECT_TRUE(path.contradict(a, near, params, 4));
  path.keyframes[opposite].part = 2;
  EXPECT_FALSE(path.contradict(a, twin, params, 0.1)) << "where that part is is a guess";
}

TEST(LoopPath, LoopsWhoseScaleHasDriftedInBetweenDoNotContradictEachOther) {
  constexpr int n = 60, late = n - 5;
  constexpr double share = 0.008;  // half in all, e^0.44 between the two keyframes
  loop_path path = growing_lap(n, share);
  ft::loop_params const params;
  path_loop const a = true_scaled_loop(0, n - 1, n, share);
  path_loop const b = true_scaled_loop(late, n - 1, n, share);
  auto const placed = [&](path_loop const& l) {
    return path.at(l.from).T_world_camera * l.T_from_to;
  };
  auto const off = placed(a).t - placed(b).t;
  double const drift = static_cast<double>(params.max_drift) * path.way(0, late);
  ASSERT_GT(std::sqrt(ft::dot(off, off)), drift) << "what the drift of the scale explains";
  EXPECT_FALSE(path.contradict(a, b, params, 0));
  EXPECT_FALSE(path.contradict(b, a, params, 0));
  ft::loop_params exact = params;
  exact.max_scale_drift = 0.4f;
  EXPECT_TRUE(path.contradict(a, b, exact, 0)) << "more than a scale drifts";
  path_loop same_scale = a;  // which explains nothing
  same_scale.T_from_to.scale = b.T_from_to.scale;
  EXPECT_TRUE(path.contradict(same_scale, b, params, 0));
}

/// A lap whose second half is another map, that begins at a wrong place.
loop_path broken_lap(int n) {
  loop_path path = drifting_lap(n, 0);
  test::motion const wrong = test::turn({0.1, 1, 0.2}, 0.4, {0.7, -0.2, 0.3});
  for (int i = n / 2; i < n; ++i) {
    auto& k = path.keyframes[at(i)];
    k.map = k.part = 2;
    k.T_odom_camera = (wrong * k.T_odom_camera).orthonormalized();
    k.T_world_camera = with_scale(k.T_odom_camera);
  }
  return path;
}

TEST(LoopPath, TwoKeyframesThatAgreeJoinTwoMaps) {
  constexpr int n = 60;
  loop_path path = broken_lap(n);
  ASSERT_GT(error(path, n - 1, n), 0.5);
  EXPECT_EQ(path.newest(100), n / 2);
  EXPECT_EQ(path.join(true_loop(1, n - 3, n)), 0);
  EXPECT_EQ(path.join(true_loop(2, n - 3, n)), 0);  // of the same keyframe
  path_loop off = true_loop(0, n - 2, n);
  off.T_from_to.t.x += 0.3;
  EXPECT_EQ(path.join(off), 0);
  EXPECT_GT(error(path, n - 1, n), 0.5);
  EXPECT_EQ(path.join(true_loop(1, n - 1, n)), 2);
  ft::detail::optimize(ft::host_exec(), path);
  for (int i = 0; i < n; ++i) {
    EXPECT_EQ(path.at(i).part, 1) << i;
    EXPECT_LT(error(path, i, n), 1e-6) << i;
  }
  EXPECT_EQ(path.newest(100), n);
  // From now on such a loop is one of the same part, which must fit it.
  EXPECT_TRUE(path.fits(true_loop(3, n - 5, n), {}, 0));
  EXPECT_EQ(path.at(n - 1).map, 2);
}

TEST(LoopPath, MapsOfOneCameraAreJoinedWhateverTheirUnits) {
  constexpr int n = 60;
  constexpr double unit = 0.37;  // of the second map
  loop_path path = broken_lap(n);
  path.scaled = true;
  for (int i = n / 2; i < n; ++i) {
    auto& k = path.keyframes[at(i)];
    k.T_odom_camera.t = ft::scaled(k.T_odom_camera.t, 1 / unit);
    k.T_world_camera = with_scale(k.T_odom_camera);
    k.step /= unit;
  }
  double const way = path.way(0, n / 2 - 1);  // half a circle
  EXPECT_NEAR(path.way(n / 2, n - 1), way / unit, 1e-6);
  auto const loop = [&](int from, int to, double of_unit) {
    path_loop l = true_loop(from, to, n);
    l.T_from_to.scale = of_unit;
    l.scale_information = 1e6;
    return l;
  };
  EXPECT_EQ(path.join(loop(1, n - 3, 200 * unit)) + path.join(loop(1, n - 2, 200 * unit)), 0)
      << "nothing is so much deeper";
  EXPECT_EQ(path.join(loop(1, n - 3, unit)), 0);
  EXPECT_EQ(path.join(loop(0, n - 2, 1.1 * unit)), 0) << "another scale";
  EXPECT_EQ(path.join(loop(1, n - 1, unit)), 2);
  ft::detail::optimize(ft::host_exec(), path);
  for (int i = 0; i < n; ++i) {
    EXPECT_EQ(path.at(i).part, 1) << i;
    EXPECT_LT(error(path, i, n), 1e-6) << i;
    EXPECT_NEAR(path.at(i).T_world_camera.scale, i < n / 2 ? 1 : unit, 1e-9) << i;
  }
  EXPECT_NEAR(path.way(n / 2, n - 1), way, 1e-6);  // by which later loops are judged
}

TEST(LoopPath, MapsThatNothingJoinsKeepTheirPlaces) {
  constexpr int n = 60;
  loop_path path = broken_lap(n);
  double const before = error(path, n - 1, n);
  path.loops.push_back(true_loop(0, n / 2 - 1, n));
  ft::detail::optimize(ft::host_exec(), path);
  EXPECT_NEAR(error(path, n - 1, n), before, 1e-9);
}

TEST(LoopPath, ThinnedOutItsLoopsStayWhereTheyWere) {
  constexpr int n = 100;
  loop_path path = drifting_lap(n, 0);
  for (int i = 0; i < 10; ++i) { path.loops.push_back(true_loop(3 * i, 99 - i, n)); }
  path_loop const between = true_loop(40, 41, n);
  path.loops.push_back(between);
  std::vector<int> freed;
  path.thin([&](int row) { freed.push_back(row); });
  EXPECT_EQ(path.size(), 100 - 37);
  EXPECT_EQ(path.at(20).steps, 2);
  EXPECT_EQ(path.at(0).steps, 1);
  EXPECT_EQ(path.at(60).steps, 1);
  EXPECT_EQ(freed.size(), at(37));
  EXPECT_EQ(path.loops.size(), at(10));  // the last one joined what is one keyframe now
  for (int i = 0; i < path.size(); ++i) { EXPECT_EQ(path.at(i).row, i < 38 ? 2 * i : i + 37); }
  for (path_loop const& l : path.loops) {
    ASSERT_LT(l.to, path.size());
    auto const T = with_scale(path.at(l.from).T_odom_camera) * l.T_from_to;
    auto const d = T.t - path.at(l.to).T_odom_camera.t;
    EXPECT_LT(std::sqrt(ft::dot(d, d)), 1e-9);
  }
  ft::detail::optimize(ft::host_exec(), path);
  EXPECT_LT(std::abs(path.at(20).T_world_camera.t.x - path.at(20).T_odom_camera.t.x), 1e-6);
}

/// How far the loops are from the path in the world, at most.
double misfit(loop_path const& path) {
  double most = 0;
  for (path_loop const& l : path.loops) {
    auto const T = path.at(l.from).T_world_camera * l.T_from_to;
    auto const d = T.t - path.at(l.to).T_world_camera.t;
    double const scales = std::abs(std::log(T.scale / path.at(l.to).T_world_camera.scale));
    most = std::max({most, std::sqrt(ft::dot(d, d)), scales});
  }
  return most;
}
/// A path whose odometry drifts is right in the world; thinned out, its loops are as right as
/// before.
void expect_no_drift_when_thinned(loop_path path) {
  ft::detail::optimize(ft::host_exec(), path);
  double const before = misfit(path);
  for (int round = 0; round < 5; ++round) {
    path.thin([](int) {});
  }
  EXPECT_LT(path.size(), 45);
  EXPECT_GE(path.loops.size(), at(4));
  EXPECT_LT(misfit(path), before + 1e-9);
}

// The keyframe beside which a camera was found may be none of those that stay.
TEST(LoopPath, WhatFollowsIsTiedToTheSamePlaceAfterItWasThinned) {
  constexpr int n = 64;
  for (int const beside : {0, 20, 21, 40, n - 1}) {
    loop_path path = drifting_lap(n, 0);
    path.beside = beside;
    auto const place = path.at(beside).time_ns;
    path.thin([](int) {});
    ASSERT_LT(path.size(), n);
    ASSERT_GE(path.beside, 0);
    EXPECT_LE(path.at(path.beside).time_ns, place);
    EXPECT_GE(path.at(path.beside).time_ns, place - 1000) << "the one before it, at most";
    ft::detail::path_keyframe k;
    k.map = 2;
    k.T_world_camera = with_scale(truth(beside, n));
    auto const from = static_cast<std::size_t>(path.beside);
    path.tie(50, k);
    path.keyframes.push_back(k);
    EXPECT_EQ(path.beside, -1);
    EXPECT_EQ(k.part, 1);
    path_loop const& l = path.loops.back();
    EXPECT_EQ(l.to, path.size() - 1);
    auto const off = (path.keyframes[from].T_world_camera * l.T_from_to).t - k.T_world_camera.t;
    EXPECT_LT(std::sqrt(ft::dot(off, off)), 1e-9);
  }
}

TEST(LoopPath, ThinnedOutOftenItsLoopsHaveNoDrift) {
  constexpr int n = 100;
  loop_path path = drifting_lap(n, 0.01);
  for (int i = 0; i < 10; ++i) { path.loops.push_back(true_loop(3 * i, 99 - i, n)); }
  expect_no_drift_when_thinned(path);
}

TEST(LoopPath, ThinnedOutOftenItsLoopsKeepTheirUnits) {
  constexpr int n = 100;
  loop_path path = growing_lap(n, 0.005);
  for (int i = 0; i < 10; ++i) { path.loops.push_back(true_scaled_loop(3 * i, 99 - i, n, 0.005)); }
  expect_no_drift_when_thinned(path);
}

TEST(LoopPath, NoLoopIsRefusedHoweverOftenItIsThinned) {
  loop_path path = drifting_lap(100, 0);
  path.reserve(200, 2);
  std::size_t const room = path.loops.capacity();
  for (int round = 0; round < 30; ++round) {
    for (int i = 10; i < path.size(); ++i) {
      for (int k = 0; k < 2; ++k) {
        path_loop l = true_loop(0, 1, 100);
        l.from = (i + 3 * k) % 10;
        l.to = i;
        path.loops.push_back(l);
      }
    }
    ASSERT_LE(path.loops.size(), room) << round;
    int freed = 0;
    path.thin([&](int) { ++freed; });
    EXPECT_GT(freed, 0);
    while (path.size() < 100) {
      auto const k = path.keyframes.back();
      path.keyframes.push_back(k);
    }
  }
}

/// Else later laps would be tied to others of laps before, and errors would add up.
TEST(LoopPath, KeyframesThatSeeAPlaceAgainLeaveFirst) {
  constexpr int lap = 30;
  loop_path path = drifting_lap(lap, 0);
  path.reserve(200, 2);
  int next = lap;  ///< row
  for (int round = 0; round < 30; ++round) {
    while (path.size() < 100) {
      auto k = path.keyframes.back();
      k.row = next++;
      k.again = false;
      path.keyframes.push_back(k);
      if (k.row % 4 == 3) { continue; }  // not found, but between two that are
      path_loop l = true_loop(0, 1, lap);
      l.from = k.row % lap;
      l.to = path.size() - 1;
      path.add(l);
    }
    path.thin([&](int row) { EXPECT_GE(row, lap); });
    ASSERT_LE(path.size(), 100 * 7 / 8) << round;
    for (int i = 0; i < lap; ++i) { EXPECT_EQ(path.at(i).row, i); }
  }
}

TEST(LoopPath, AMapBetweenOthersThatSeeAPlaceAgainIsNew) {
  loop_path path = drifting_lap(60, 0);
  for (int i = 0; i < path.size(); ++i) {
    auto& k = path.keyframes[at(i)];
    bool const between = i == 20 || i == 21;
    k.map = between ? 2 : (i < 20 ? 1 : 3);
    k.again = !between;
  }
  std::vector<int> freed;
  path.thin([&](int row) { freed.push_back(row); });
  EXPECT_GT(freed.size(), at(15));
  EXPECT_EQ(std::count(freed.begin(), freed.end(), 21), 0);
}

TEST(LoopPath, ThinnedOutAMapsFirstKeyframeTakesNoStepOfAnotherMap) {
  loop_path path = drifting_lap(60, 0);
  for (int i = 12; i < path.size(); ++i) {
    auto& k = path.keyframes[static_cast<std::size_t>(i)];
    k.map = k.part = 2;
    if (i == 12) { k.step = 0; }
  }
  std::vector<int> freed;
  path.thin([&](int row) { freed.push_back(row); });
  ASSERT_EQ(std::count(freed.begin(), freed.end(), 11), 1) << "the last of the first map";
  for (int i = 1; i < path.size(); ++i) {
    if (path.at(i).map == path.at(i - 1).map) { continue; }
    EXPECT_EQ(path.at(i).row, 12);
    EXPECT_EQ(path.at(i).step, 0);
    return;
  }
  FAIL() << "one map is left";
}

TEST(LoopPath, MapsOfOneKeyframeEachLeaveFromTheOldestOn) {
  loop_path path = drifting_lap(40, 0);
  for (int i = 0; i < 40; ++i) { path.keyframes[at(i)].map = path.keyframes[at(i)].part = i + 1; }
  path.keyframes[1].map = path.keyframes[1].part = 1;  // of all but the first two
  path.loops = {true_loop(3, 30, 40), true_loop(25, 31, 40)};
  std::vector<int> freed;
  path.thin([&](int row) { freed.push_back(row); });
  ASSERT_EQ(freed.size(), at(20));
  EXPECT_EQ(freed.back(), 19);
  ASSERT_EQ(path.size(), 20);
  EXPECT_EQ(path.at(0).row, 20);
  ASSERT_EQ(path.loops.size(), at(1));
  EXPECT_EQ(path.loops[0].from, 5);
  EXPECT_EQ(path.loops[0].to, 11);
}

TEST(LoopPath, WhatIsNotFiniteIsNotKnown) {
  float of_pose[21] = {1, 2, 3};
  of_pose[7] = std::nanf("");
  double to[21];
  ft::detail::edge_information(of_pose, 1, to);
  for (int i = 0; i < 21; ++i) { EXPECT_TRUE(to[i] == 0 || to[i] == 100) << i; }
}

TEST(LoopPath, InformationIsThatOfTheEdgesError) {
  float of_pose[21];
  for (int i = 0; i < 21; ++i) { of_pose[i] = static_cast<float>(i + 1); }
  double to[21];
  ft::detail::edge_information(of_pose, 2, to);
  // Rotation first: entry (3, 3) of the pose is the first of the edge, (0, 0) is (3, 3) there.
  EXPECT_NEAR(to[0], 2 * 16 * (1 + 1e-5) + 100, 1e-9);
  EXPECT_NEAR(to[15], 2 * 4 * 1 * (1 + 1e-5) + 100, 1e-9);
  EXPECT_NEAR(to[3], 2 * 2 * 4, 1e-9);  // x with the turn about x: (0, 3)
}

}  // namespace loop_path_test
