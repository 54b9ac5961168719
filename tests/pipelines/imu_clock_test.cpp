// SPDX-License-Identifier: Apache-2.0
// The offset of an IMU's clock, from how a camera and the IMU turn: it is found within a
// millisecond where the rate of turning changes, and not claimed to be known where it does not.
// Likewise the rotation between both, within a tenth of a degree, where they turn about two axes.
#include "ft/pipelines/detail/imu_clock.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>
#include <utility>

namespace imu_clock_test {

using ft::detail::imu_clock;
using ft::detail::real64;
using strict_vec3d = ft::vec3<real64>;

/// A motion, as rates about three axes at a time, rad/s.
using motion = ft::vec3<double> (*)(double);

ft::vec3<double> hand(double t) {
  return {0.6 * std::sin(2.1 * t) + 0.2 * std::sin(5.3 * t + 1), 0.5 * std::sin(1.3 * t + 2),
          0.3 * std::sin(3.7 * t)};
}
ft::vec3<double> steady(double) { return {0.3, -0.2, 0.1}; }
ft::vec3<double> rest(double) { return {0, 0, 0}; }
/// The same again every 0.1 s: any multiple of that may be the offset.
/// About one axis, as a vehicle turns.
ft::vec3<double> yaw(double t) { return {0, 0.4 * std::sin(2 * t) + 0.1, 0}; }
ft::vec3<double> shaking(double t) { return {0.5 * std::sin(20 * 3.14159265358979 * t), 0, 0}; }

struct setting {
  motion turn = hand;
  double offset_s = 0;
  double lead_s = 0;    ///< samples come so long before their frame
  double middle_s = 0;  ///< what is said of the offset
  double attitude_noise = 3e-4;
  double attitude_drift = 0;  ///< of a frame: a map's error goes on to the next one
  int frames = 240;
  double spike_s = -1;                   ///< a sample of 34 rad/s
  int new_map = -1;                      ///< frame from which the world is another one
  ft::vec3<double> mounted = {0, 0, 0};  ///< rotation vector from the IMU to where it should be
  bool swapped = false;                  ///< its x and y
  bool mirrored = false;                 ///< its z
};

imu_clock run(setting const& s, unsigned seed) {
  constexpr std::int64_t fine_ns = 500'000;
  std::mt19937 random(seed);
  std::normal_distribution<double> noise;
  auto const noisy = [&](double sigma) {
    return strict_vec3d{sigma * noise(random), sigma * noise(random), sigma * noise(random)};
  };
  imu_clock clock;
  clock.reserve(200, std::llround(1e9 * s.middle_s));
  auto R = ft::mat3<real64>::identity();
  auto map = R;
  std::int64_t sample_ns = 0;
  auto const offset_ns = static_cast<std::int64_t>(std::llround(1e9 * s.offset_s));
  auto const lead_ns = static_cast<std::int64_t>(std::llround(1e9 * s.lead_s));
  for (std::int64_t t = 0; t <= s.frames * 50'000'000LL; t += fine_ns) {
    auto const rate = s.turn(static_cast<double>(t) * 1e-9 + 0.25e-3);
    strict_vec3d const step{rate.x * 5e-4, rate.y * 5e-4, rate.z * 5e-4};
    if (t % 50'000'000 == 0) {
      for (; sample_ns <= t + lead_ns - offset_ns; sample_ns += 5'000'000) {  // images' clock
        auto w = s.turn(static_cast<double>(sample_ns) * 1e-9);
        if (std::abs(static_cast<double>(sample_ns) * 1e-9 - s.spike_s) < 1e-6) { w.y = 34; }
        auto const in_imu =
            ft::detail::rotation_exp(s.mounted.cast<real64>()).transposed() * w.cast<real64>();
        w = in_imu.cast<double>();
        if (s.swapped) { std::swap(w.x, w.y); }
        if (s.mirrored) { w.z = -w.z; }
        auto const n = noisy(2.4e-3);
        clock.add(sample_ns + offset_ns, {static_cast<float>(w.x + 0.02 + n.x.value),
                                          static_cast<float>(w.y - 0.01 + n.y.value),
                                          static_cast<float>(w.z + 0.03 + n.z.value)});
      }
      map = map * ft::detail::rotation_exp(noisy(s.attitude_drift));
      auto const seen = map * R * ft::detail::rotation_exp(noisy(s.attitude_noise));
      clock.add_attitude(t, seen.template cast<double>(), t / 50'000'000 != s.new_map);
      if (t / 50'000'000 + 1 == s.new_map) {
        R = R * ft::detail::rotation_exp(strict_vec3d{1.0, -0.5, 0.3});
      }
    }
    R = R * ft::detail::rotation_exp(step);
  }
  return clock;
}
ft::imu_clock_offset found(setting const& s, unsigned seed = 1) { return run(s, seed).estimate(); }
ft::imu_misalignment misalignment(setting const& s, unsigned seed = 1) {
  return run(s, seed).misalignment();
}
double apart(ft::vec3<double> a, ft::vec3<double> b) { return std::sqrt(dot(a - b, a - b)); }

TEST(ImuClock, IsFoundWithinAMillisecond) {
  for (double const offset : {-0.1, -0.05, -0.02, -0.005, 0.0, 0.002, 0.01, 0.03, 0.05, 0.1}) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      setting s;
      s.offset_s = offset;
      auto const c = found(s, seed);
      EXPECT_TRUE(c.known) << offset;
      EXPECT_NEAR(c.offset_s, offset, 1e-3) << seed;
      EXPECT_LT(std::abs(c.offset_s - offset), 4 * c.sigma_s + 1e-4) << seed;
    }
  }
}

TEST(ImuClock, IsThatOfSamplesThatComeEarlyAndOfAnOffsetFarAway) {
  setting s;
  s.offset_s = 2.02;
  s.middle_s = 2;
  s.lead_s = 0.08;
  auto const c = found(s);
  EXPECT_TRUE(c.known);
  EXPECT_NEAR(c.offset_s, 2.02, 1e-3);
}

TEST(ImuClock, IsNotKnownWithoutAChangingTurn) {
  for (motion const turn : {steady, rest, shaking}) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      setting s;
      s.turn = turn;
      s.offset_s = 0.01;
      EXPECT_FALSE(found(s, seed).known);
    }
  }
  setting s;
  s.frames = 20;
  EXPECT_FALSE(found(s).known) << "too few turns";
  s.frames = 0;
  EXPECT_EQ(found(s).sigma_s, 0);
}

// Images with more noise tell it less well, and the estimate says so.
TEST(ImuClock, SaysHowCertainItIs) {
  setting s;
  double before = 0;
  for (double const noise : {1e-4, 1e-3, 1e-2}) {
    s.attitude_noise = noise;
    auto const c = found(s);
    EXPECT_GT(c.sigma_s, 2 * before) << noise;
    before = c.sigma_s;
  }
  EXPECT_FALSE(found(s).known);
}

// Where images err on their own, turns that overlap do not share much: most of them tell more.
TEST(ImuClock, IsAsCertainAsImagesThatErrOnTheirOwnMakeIt) {
  for (double const noise : {3e-4, 1e-3}) {
    double off = 0, told = 0, turn_off = 0, turn_told = 0;
    for (unsigned seed = 1; seed <= 20; ++seed) {
      setting s;
      s.offset_s = s.middle_s = 0.012;  // in use: the rotation is found at it
      s.attitude_noise = noise;
      auto const clock = run(s, seed);
      auto const c = clock.estimate();
      auto const m = clock.misalignment();
      off += (c.offset_s - s.offset_s) * (c.offset_s - s.offset_s);
      told += c.sigma_s * c.sigma_s;
      turn_off += dot(m.turn, m.turn);
      turn_told += m.sigma * m.sigma;
    }
    EXPECT_LT(std::sqrt(told / off), 3) << noise;
    EXPECT_GT(std::sqrt(told / off), 1) << noise;
    EXPECT_LT(std::sqrt(turn_told / turn_off), 3) << noise;
    EXPECT_GT(std::sqrt(turn_told / turn_off), 1) << noise;
  }
}

// Turns that overlap share what the map has drifted between: not each of them tells more.
TEST(ImuClock, IsAsUncertainAsADriftingMapMakesIt) {
  for (int const frames : {60, 120, 240}) {
    double squares = 0;
    constexpr int runs = 40;
    for (unsigned seed = 1; seed <= runs; ++seed) {
      setting s;
      s.offset_s = 0.005;
      s.attitude_noise = 1e-4;
      s.attitude_drift = 1e-3;
      s.frames = frames;
      auto const c = found(s, seed);
      ASSERT_GT(c.sigma_s, 0) << seed;
      double const off = (c.offset_s - s.offset_s) / c.sigma_s;
      EXPECT_LT(std::abs(off), 4) << seed << " of " << frames << " frames";
      squares += off * off;
    }
    EXPECT_LT(std::sqrt(squares / runs), 1.5) << frames;
    EXPECT_GT(std::sqrt(squares / runs), 0.5) << frames;
  }
}

TEST(ImuClock, ASpikeOrANewMapDoNotMoveIt) {
  setting s;
  s.offset_s = 0.02;
  s.spike_s = 8;
  EXPECT_NEAR(found(s).offset_s, 0.02, 1e-3);
  s.spike_s = -1;
  s.new_map = 100;
  EXPECT_NEAR(found(s).offset_s, 0.02, 1e-3);
}

TEST(ImuClock, InUseIsAsUncertainAsItIsKnownToBeWrong) {
  using ft::detail::sigma_of_clock;
  EXPECT_EQ(sigma_of_clock({}, 0.05), 0.01) << "no estimate";
  EXPECT_EQ(sigma_of_clock({false, 0.05, 0.03}, 0.05), 0.01) << "no better one";
  EXPECT_EQ(sigma_of_clock({false, 0.05, 0.002}, 0.05), 0.002);
  EXPECT_EQ(sigma_of_clock({true, 0.05, 0.001}, 0), 0.05) << "found, and not applied";
  EXPECT_EQ(sigma_of_clock({true, -0.004, 0.001}, 0), 0.004);
}

constexpr double degree = 3.14159265358979 / 180;

TEST(ImuMisalignment, IsFoundWithinATenthOfADegree) {
  for (ft::vec3<double> const mounted :
       {ft::vec3<double>{0, 0, 0}, {0.01, 0, 0}, {0, -0.05, 0.02}, {0.1, 0.1, -0.1}, {0, 0, 0.4}}) {
    for (unsigned seed = 1; seed <= 3; ++seed) {
      setting s;
      s.mounted = mounted;
      auto const m = misalignment(s, seed);
      EXPECT_TRUE(m.known) << seed;
      EXPECT_LT(apart(m.turn, mounted), 0.1 * degree) << seed;
      EXPECT_LT(apart(m.turn, mounted), 4 * m.sigma) << seed;
    }
  }
}

/// Angle between two rotations, rad: near half a turn vectors of one rotation point either way.
double between(ft::vec3<double> a, ft::vec3<double> b) {
  auto const R = ft::detail::rotation_exp(a.cast<real64>()).transposed() *
                 ft::detail::rotation_exp(b.cast<real64>());
  double const chord = std::sqrt(std::fmax(0, 3 - (R.m[0] + R.m[4] + R.m[8]).value));
  return 2 * std::asin(std::fmin(1, chord / 2));
}

TEST(ImuMisalignment, IsNotKnownWithoutTurnsAboutTwoAxes) {
  for (motion const turn : {steady, rest, shaking, yaw}) {
    for (unsigned seed = 1; seed <= 10; ++seed) {
      setting s;
      s.turn = turn;
      s.mounted = {0, 0, 0.05};
      auto const m = misalignment(s, seed);
      EXPECT_FALSE(m.known) << seed;
      EXPECT_TRUE(m.sigma == 0 || between(m.turn, s.mounted) < 4 * m.sigma) << seed;
    }
  }
  setting s;
  s.frames = 20;
  EXPECT_FALSE(misalignment(s).known) << "too few turns";
  s = {};
  s.mounted = {0, 1.5, 0};
  EXPECT_LT(apart(misalignment(s).turn, s.mounted), 0.1 * degree) << "nearly a right angle";
  EXPECT_EQ(imu_clock().misalignment().sigma, 0);
}

TEST(ImuMisalignment, IsFoundNearHalfATurn) {
  for (ft::vec3<double> const axis : {ft::vec3<double>{1, 0, 0},
                                      {0, -1, 0},
                                      {0, 0, 1},
                                      {1, 1, 0},
                                      {-1, 0, 1},
                                      {1, 1, 1},
                                      {0.3, -0.8, 0.5}}) {
    for (double const angle : {120.0, 150.0, 170.0, 179.0, 180.0}) {
      setting s;
      s.mounted = ft::scaled(axis, angle * degree / std::sqrt(dot(axis, axis)));
      auto const m = misalignment(s, 2);
      EXPECT_TRUE(m.known) << angle;
      EXPECT_LT(between(m.turn, s.mounted), 0.1 * degree) << angle;
      EXPECT_LT(between(m.turn, s.mounted), 4 * m.sigma) << angle;
      EXPECT_NEAR(std::sqrt(dot(m.turn, m.turn)), angle * degree, 0.1 * degree) << angle;
    }
  }
}

// Axes that are swapped are a rotation if one of them is turned round, and else none.
TEST(ImuMisalignment, OfSwappedAxesIsARotationOrNone) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    setting s;
    s.swapped = true;
    EXPECT_EQ(misalignment(s, seed).sigma, 0) << "swapped alone";
    s.mirrored = true;
    auto const m = misalignment(s, seed);
    EXPECT_TRUE(m.known);
    double const each = 180 * degree / std::sqrt(2.0);
    EXPECT_LT(between(m.turn, {each, each, 0}), 0.1 * degree);
    s.swapped = false;
    EXPECT_EQ(misalignment(s, seed).sigma, 0) << "mirrored alone";
  }
}

TEST(ImuMisalignment, SaysHowCertainItIs) {
  for (ft::vec3<double> const mounted : {ft::vec3<double>{0.02, -0.01, 0.03}, {1.2, -1.2, 1.2}}) {
    for (int const frames : {60, 120, 240}) {
      double squares = 0;
      constexpr int runs = 40;
      for (unsigned seed = 1; seed <= runs; ++seed) {
        setting s;
        s.mounted = mounted;
        s.attitude_noise = 1e-4;
        s.attitude_drift = 1e-3;
        s.frames = frames;
        auto const m = misalignment(s, seed);
        ASSERT_GT(m.sigma, 0) << seed;
        double const off = between(m.turn, s.mounted) / m.sigma;
        EXPECT_LT(off, 4) << seed << " of " << frames << " frames";
        squares += off * off;
      }
      EXPECT_LT(std::sqrt(squares / runs), 1.5) << frames;
      EXPECT_GT(std::sqrt(squares / runs), 0.4) << frames;
    }
  }
}

// The clock's offset that is in use counts; with another one the estimate begins anew.
TEST(ImuMisalignment, IsAtTheOffsetInUse) {
  setting s;
  s.offset_s = 0.03;
  s.mounted = {0, 0.05, 0};
  auto const wrong = misalignment(s);
  s.middle_s = 0.03;
  auto const right = misalignment(s);
  EXPECT_GT(wrong.sigma, 3 * right.sigma);
  EXPECT_LT(apart(right.turn, s.mounted), 0.1 * degree);
  auto clock = run(s, 1);
  clock.use(30'000'000, ft::mat3<double>::identity());
  EXPECT_TRUE(clock.misalignment().known);
  clock.use(20'000'000, ft::mat3<double>::identity());
  EXPECT_EQ(clock.misalignment().sigma, 0);
}

// With the samples turned the clock's estimate begins anew.
TEST(ImuMisalignment, ATurnThatIsInUseTakesItFromTheClock) {
  setting s;
  auto clock = run(s, 1);
  EXPECT_TRUE(clock.estimate().known);
  clock.use(0, ft::mat3<double>::identity());
  EXPECT_TRUE(clock.estimate().known);
  clock.use(0, ft::detail::rotation_exp(strict_vec3d{0.1, 0.0, 0.0}).cast<double>());
  EXPECT_EQ(clock.estimate().sigma_s, 0);
}

}  // namespace imu_clock_test
