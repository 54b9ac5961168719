// SPDX-License-Identifier: Apache-2.0
// The keyframe adjustment of track_sequence: exact sightings lead back to the truth, useless ones
// do no harm.
#include "examples/track_sequence/local_adjustment.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <vector>

namespace local_adjustment_test {

using vector = std::array<double, 3>;

app::odometry_options rig(bool fisheye) {
  app::odometry_options o;
  o.fisheye = fisheye;
  o.fx = o.fy = 435;
  o.cx = 376;
  o.cy = 240;
  o.baseline = 0.11;
  o.left = {190, 191, 254, 256, 0.003, 0.001, -0.002, 0.0003};
  o.right = {190.4, 190.1, 252, 255, 0.002, 0.001, -0.001, 0.0002};
  o.T_right_left.R = {std::cos(0.02),  0, std::sin(0.02), 0, 1, 0,
                      -std::sin(0.02), 0, std::cos(0.02)};
  o.T_right_left.t = {-0.101, 0.001, 0.002};
  return o;
}

/// Pixel of a point in the left camera's frame, written out from the models' equations.
std::array<double, 2> pixel(app::odometry_options const& o, int camera, vector x) {
  if (!o.fisheye) {
    return camera == 0 ? std::array<double, 2>{o.fx * x[0] / x[2] + o.cx, o.fy * x[1] / x[2] + o.cy}
                       : std::array<double, 2>{o.fx * o.baseline / x[2], 0};
  }
  if (camera == 1) { x = o.T_right_left * x; }
  auto const& k = camera == 0 ? o.left : o.right;
  double const radius = std::hypot(x[0], x[1]);
  double const a = std::atan2(radius, x[2]);
  double const r = a + k[4] * std::pow(a, 3) + k[5] * std::pow(a, 5) + k[6] * std::pow(a, 7) +
                   k[7] * std::pow(a, 9);
  return {k[0] * r * x[0] / radius + k[2], k[1] * r * x[1] / radius + k[3]};
}

/// 100 points seen by 4 views without error.
app::adjustment exact_scene(app::odometry_options const& o, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  app::adjustment a;
  a.fixed = 1;
  for (int v = 0; v < 4; ++v) {
    app::rigid_pose T;
    T.t = {-0.1 * v, 0.02 * v, 0.05 * v};
    a.views.push_back(T);
  }
  for (int p = 0; p < 100; ++p) {
    a.points.push_back({2 * unit(random), 2 * unit(random), 3 + unit(random)});
    for (int v = 0; v < 4; ++v) {
      for (int c = 0; c < 2; ++c) {
        auto const at = static_cast<std::size_t>(v);
        auto const seen = pixel(o, c, a.views[at] * a.points.back());
        a.sightings.push_back({v, p, c, seen[0], seen[1], 1});
      }
    }
  }
  return a;
}

void disturb(app::adjustment& a, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  for (auto& p : a.points) {
    for (double& x : p) { x += 0.05 * unit(random); }
  }
  for (std::size_t v = 1; v < a.views.size(); ++v) {
    app::rigid_pose turn;
    turn.R = {1, 0.01, 0, -0.01, 1, 0, 0, 0, 1};
    turn.orthonormalize();
    a.views[v] = turn * a.views[v];
    for (double& x : a.views[v].t) { x += 0.02 * unit(random); }
  }
}

double largest_difference(app::adjustment const& a, app::adjustment const& b) {
  double worst = 0;
  for (std::size_t v = 0; v < a.views.size(); ++v) {
    for (std::size_t k = 0; k < 3; ++k) {
      worst = std::max(worst, std::abs(a.views[v].t[k] - b.views[v].t[k]));
    }
  }
  for (std::size_t p = 0; p < a.points.size(); ++p) {
    for (std::size_t k = 0; k < 3; ++k) {
      worst = std::max(worst, std::abs(a.points[p][k] - b.points[p][k]));
    }
  }
  return worst;
}

TEST(LocalAdjustment, ExactSightingsLeadBackToTheTruth) {
  for (bool const fisheye : {true, false}) {
    auto const o = rig(fisheye);
    std::mt19937 random(1);
    auto const truth = exact_scene(o, random);
    auto a = truth;
    disturb(a, random);
    ASSERT_GT(largest_difference(a, truth), 0.04);
    auto const errors = app::adjust(o, a, 20);
    EXPECT_LT(largest_difference(a, truth), 1e-9) << (fisheye ? "fisheye" : "rectified");
    ASSERT_EQ(errors.size(), a.sightings.size());
    for (double const e : errors) { EXPECT_LT(std::abs(e), 1e-12); }
  }
}

TEST(LocalAdjustment, FixedViewsStay) {
  auto const o = rig(true);
  std::mt19937 random(2);
  auto a = exact_scene(o, random);
  disturb(a, random);
  a.fixed = 3;
  auto const before = a;
  app::adjust(o, a, 5);
  for (std::size_t v = 0; v < 3; ++v) {
    EXPECT_EQ(a.views[v].R, before.views[v].R);
    EXPECT_EQ(a.views[v].t, before.views[v].t);
  }
  EXPECT_NE(a.views[3].t, before.views[3].t);
}

TEST(LocalAdjustment, AWildSightingHasBoundedInfluence) {
  for (bool const fisheye : {true, false}) {
    auto const o = rig(fisheye);
    std::mt19937 random(3);
    auto const truth = exact_scene(o, random);
    auto const shift = [&](double pixels) {  // of the views
      auto a = truth;
      a.sightings[8].u += pixels;
      auto const errors = app::adjust(o, a, 30);
      EXPECT_GT(errors[8], 0.25 * pixels * pixels);
      double moved = 0;
      for (std::size_t v = 1; v < a.views.size(); ++v) {
        for (std::size_t k = 0; k < 3; ++k) {
          moved = std::max(moved, std::abs(a.views[v].t[k] - truth.views[v].t[k]));
        }
      }
      return moved;
    };
    double const near = shift(40);
    EXPECT_GT(near, 0);
    EXPECT_LT(shift(4000), 1.5 * near) << (fisheye ? "fisheye" : "rectified");
  }
}

TEST(LocalAdjustment, SightingsWithoutANumberOrAnImageAreReported) {
  auto const o = rig(false);
  std::mt19937 random(4);
  auto a = exact_scene(o, random);
  a.sightings[0].u = std::numeric_limits<double>::quiet_NaN();
  a.points[5] = {0, 0, -2};  // behind the camera
  auto const errors = app::adjust(o, a, 5);
  EXPECT_LT(errors[0], 0);
  for (auto const& view : a.views) {
    for (double const x : view.t) { EXPECT_TRUE(std::isfinite(x)); }
  }
}

}  // namespace local_adjustment_test
