// SPDX-License-Identifier: Apache-2.0
// The prediction of track_sequence: a motion goes on by the time that passes, against products of
// the motion with itself, and as it is where stamps say no more than that.
#include "examples/track_sequence/motion_model.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <random>

namespace motion_model_test {

using app::motion_model;
using app::rigid_pose;

constexpr std::int64_t ms = 1'000'000;

/// A turn by `angle` radians about a random axis, and up to 2 m along each axis.
rigid_pose random_pose(std::mt19937& random, double angle) {
  std::uniform_real_distribution<double> unit(-1, 1);
  Eigen::Vector3d const axis(unit(random), unit(random), unit(random));
  Eigen::Matrix3d const R = Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
  rigid_pose T;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { T.R[static_cast<std::size_t>(3 * r + c)] = R(r, c); }
    T.t[static_cast<std::size_t>(r)] = 2 * unit(random);
  }
  return T;
}

double difference(rigid_pose const& a, rigid_pose const& b) {
  double largest = 0;
  for (std::size_t i = 0; i < 9; ++i) { largest = std::max(largest, std::abs(a.R[i] - b.R[i])); }
  for (std::size_t i = 0; i < 3; ++i) { largest = std::max(largest, std::abs(a.t[i] - b.t[i])); }
  return largest;
}

rigid_pose still() { return {}; }

void expect_same_bits(rigid_pose const& a, rigid_pose const& b) {
  EXPECT_EQ(a.R, b.R);
  EXPECT_EQ(a.t, b.t);
}

/// A model that saw a camera move from one random pose to another in 50 ms.
struct moving {
  explicit moving(unsigned seed, double angle = 0.1) {
    std::mt19937 random(seed);
    from = random_pose(random, 1);
    step = random_pose(random, angle);
    to = step * from;
    model.observe(from, to, 50 * ms);
  }
  rigid_pose from, step, to;
  motion_model model;
};

TEST(PartOfMotion, WholePartsAreProducts) {
  std::mt19937 random(1);
  for (double const angle : {0.0, 1e-12, 1e-7, 0.99e-4, 1.01e-4, 0.01, 0.5, 1.0}) {
    for (int i = 0; i < 50; ++i) {
      rigid_pose const T = random_pose(random, angle);
      EXPECT_LT(difference(app::part_of_motion(T, 0), still()), 1e-15);
      EXPECT_LT(difference(app::part_of_motion(T, 1), T), 1e-9) << angle;
      EXPECT_LT(difference(app::part_of_motion(T, 2), T * T), 1e-9) << angle;
      EXPECT_LT(difference(app::part_of_motion(T, 3), T * T * T), 1e-9) << angle;
    }
  }
}

TEST(PartOfMotion, PartsAddUp) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> share(0, 1);
  for (int i = 0; i < 200; ++i) {
    rigid_pose const T = random_pose(random, 3 * share(random));
    double const a = share(random);
    rigid_pose const whole = app::part_of_motion(T, a) * app::part_of_motion(T, 1 - a);
    EXPECT_LT(difference(whole, T), 1e-9);
  }
}

TEST(MotionModel, KnowsNoMotionAtFirst) {
  rigid_pose const T = moving(3).to;
  for (std::int64_t const interval : {0 * ms, 50 * ms, -50 * ms}) {
    expect_same_bits(motion_model().predict(T, interval), still() * T);
  }
}

TEST(MotionModel, EvenStampsKeepTheMotionBitForBit) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    moving const m(seed);
    rigid_pose motion = m.to * m.from.inverse();
    motion.orthonormalize();
    rigid_pose const next = motion * m.to;
    for (std::int64_t const interval : {50 * ms, 50 * ms + 100, 49 * ms, 51 * ms}) {
      expect_same_bits(m.model.predict(m.to, interval), next);
    }
    EXPECT_LT(difference(next, m.step * m.step * m.from), 1e-12);
  }
}

TEST(MotionModel, GoesOnByTheTimeThatPassed) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    moving const m(seed);
    EXPECT_LT(difference(m.model.predict(m.to, 100 * ms), m.step * m.step * m.to), 1e-9);
    EXPECT_LT(difference(m.model.predict(m.to, 150 * ms), m.step * m.step * m.step * m.to), 1e-9);
    rigid_pose const halved = m.model.predict(still(), 25 * ms);
    EXPECT_LT(difference(halved * halved, m.step), 1e-9);
  }
}

TEST(MotionModel, AFrameAfterAGapIsPredictedWithTheMotionOfOneFrame) {
  std::mt19937 random(5);
  rigid_pose const step = random_pose(random, 0.05);
  rigid_pose const from = random_pose(random, 1);
  rigid_pose const to = step * step * step * from;
  motion_model model;
  model.observe(from, to, 150 * ms);
  EXPECT_LT(difference(model.predict(to, 50 * ms), step * to), 1e-9);
}

TEST(MotionModel, ALongGapIsPredictedNoFurtherThanTheLimit) {
  moving const m(6, 0.02);
  rigid_pose five = m.to;
  for (int i = 0; i < 5; ++i) { five = m.step * five; }
  static_assert(motion_model::longest == 5, "the loop above");
  for (std::int64_t const interval :
       {250 * ms, 251 * ms, 3'600'000 * ms, std::numeric_limits<std::int64_t>::max()}) {
    EXPECT_LT(difference(m.model.predict(m.to, interval), five), 1e-9) << interval;
  }
}

TEST(MotionModel, StampsThatStandStillOrGoBackLeaveTheMotionAsItIs) {
  moving const m(7);
  rigid_pose const next = m.model.predict(m.to, 50 * ms);
  for (std::int64_t const interval : {0 * ms, -1 * ms, -50 * ms}) {
    expect_same_bits(m.model.predict(m.to, interval), next);
    motion_model unknown;
    unknown.observe(m.from, m.to, interval);
    expect_same_bits(unknown.predict(m.to, 200 * ms), next);
  }
}

TEST(MotionModel, RestsAndSlowsDown) {
  moving m(8, 0.02);
  m.model.slow_down();
  rigid_pose const slow = m.model.predict(still(), 50 * ms);
  EXPECT_LT(difference(slow * slow, m.step), 1e-9);
  m.model.rest();
  expect_same_bits(m.model.predict(m.to, 50 * ms), still() * m.to);
  EXPECT_LT(difference(m.model.predict(m.to, 500 * ms), m.to), 1e-15);
}

}  // namespace motion_model_test
