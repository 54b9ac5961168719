// SPDX-License-Identifier: Apache-2.0
// What a path knows of the motion between two of its keyframes, and which loops tell more.
#include <gtest/gtest.h>

#include <cmath>

#include "ft/pipelines/detail/loop_path.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/random.hpp"

namespace loop_bounds_test {

using ft::detail::loop_path;
using ft::detail::path_loop;
using ft::detail::with_scale;
using test::at;

constexpr double step = 0.1;  ///< metres from a keyframe to the next

/// A camera that goes to the right, and then back.
loop_path to_and_fro(int n) {
  loop_path path;
  path.reserve(n, 2);
  for (int i = 0; i < n; ++i) {
    ft::detail::path_keyframe k;
    k.row = i;
    k.map = k.part = 1;
    k.step = i > 0 ? step : 0;
    k.T_odom_camera.t = {step * (i < n / 2 ? i : n - 1 - i), 0, 0};
    k.T_world_camera = with_scale(k.T_odom_camera);
    path.keyframes.push_back(k);
  }
  return path;
}
/// @param sigma of each of its coordinates, metres
path_loop loop_between(int from, int to, double sigma) {
  path_loop l;
  l.from = from;
  l.to = to;
  for (int i = 0, k = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { l.information[k++] = i == j ? 1 / (sigma * sigma) : 0; }
  }
  return l;
}

TEST(LoopBounds, ALoopTellsMoreThanTheOdometryOnALongWayOnly) {
  constexpr int n = 100;
  loop_path path = to_and_fro(n);
  ft::loop_params const params;
  double const sigma = 0.05;  // 0.245 m with eight times its covariance, in all directions
  EXPECT_FALSE(path.tells(loop_between(n - 1 - 48, n - 1, sigma), params)) << "4.8 m, 0.24 m";
  EXPECT_TRUE(path.tells(loop_between(n - 1 - 50, n - 1, sigma), params)) << "5 m, 0.25 m";
  EXPECT_FALSE(path.tells(loop_between(n - 1 - 50, n - 1, 2 * sigma), params));
  EXPECT_TRUE(path.tells(loop_between(n - 1 - 10, n - 1, 0.01), params));
  ft::loop_params drifts = params;
  drifts.max_drift = 0.06f;
  EXPECT_TRUE(path.tells(loop_between(n - 1 - 48, n - 1, sigma), drifts));
  path_loop unknown = loop_between(0, n - 1, sigma);
  unknown.information[0] = std::nan("");
  EXPECT_FALSE(path.tells(unknown, params));
}

TEST(LoopBounds, OfAnotherMapAnyLoopTellsMore) {
  constexpr int n = 20;
  loop_path path = to_and_fro(n);
  path_loop const l = loop_between(5, n - 1, 1);
  EXPECT_FALSE(path.tells(l, {}));
  path.keyframes[at(n - 1)].map = 2;
  EXPECT_TRUE(path.tells(l, {}));
  path.keyframes[at(n - 1)].map = 1;
  path.keyframes[5].loaded = true;
  EXPECT_TRUE(path.tells(l, {}));
}

TEST(LoopBounds, AScaleThatDriftsIsCorrectedByWhatTellsLess) {
  constexpr int n = 20;
  loop_path path = to_and_fro(n);
  path_loop const l = loop_between(9, n - 1, 0.1);  // 1 m of way, 0.49 m
  path.scaled = true;
  EXPECT_TRUE(path.tells(l, {}));
  path.keyframes[at(n - 1)].T_world_camera.scale = 2;  // 1.1 m of way, 0.98 m
  EXPECT_FALSE(path.tells(l, {}));
}

TEST(LoopBounds, ViewsFromElsewhereAreNotAlike) {
  constexpr double far = 3;  // metres of what is seen, by its information
  for (double const apart : {0.0, 0.5, 1.19, 1.21, 3.0}) {
    path_loop l = loop_between(0, 1, 0.01);
    for (int const turn : {15, 18, 20}) { l.information[turn] *= 4 * far * far; }  // of a half
    l.T_from_to = with_scale(test::turn({0.3, 1, 0.2}, 0.3, {0.6 * apart, 0, 0.8 * apart}));
    EXPECT_EQ(loop_path::is_alike(l), apart < 1.2) << apart;
    l.T_from_to.t = ft::scaled(l.T_from_to.t, 2.0);  // in units of the other one
    l.T_from_to.scale = 2;
    EXPECT_EQ(loop_path::is_alike(l), apart < 1.2) << apart;
  }
}

TEST(LoopBounds, PointsThatAFittingLoopPutsTogetherAreWithinTheBound) {
  constexpr int n = 100;
  loop_path const path = to_and_fro(n);
  ft::loop_params const params;
  test::generator random(3);
  int fit = 0, allowed_else = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    int const from = random.below(40);
    path_loop l = loop_between(from, n - 1, 0.01);
    auto const off =
        test::turn({random.real(-1, 1), 1, random.real(-1, 1)}, random.real(-0.3f, 0.3f),
                   {random.real(-1, 1), random.real(-0.2f, 0.2f), random.real(-1, 1)});
    l.T_from_to =
        path.at(from).T_world_camera.inverse() * path.at(n - 1).T_world_camera * with_scale(off);
    ft::loop_bound const bound = path.bound(from, n - 1, params, 0.1);
    ft::vec3<double> const row{random.real(-2, 2), random.real(-1, 1), random.real(2, 6)};
    auto const seen = l.T_from_to.inverse() * row;
    if (seen.z < 1) { continue; }
    bool const allows = bound.allows(row.cast<float>(), seen.cast<float>());
    if (path.fits(l, params, 0.1)) {
      ++fit;
      EXPECT_TRUE(allows) << trial;
    } else {
      allowed_else += static_cast<int>(allows);
    }
  }
  EXPECT_GT(fit, 200);
  EXPECT_LT(allowed_else, 1500) << "nearly all points are allowed";
}

}  // namespace loop_bounds_test
