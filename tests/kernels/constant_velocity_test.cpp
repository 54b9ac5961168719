// SPDX-License-Identifier: Apache-2.0
// Prediction with constant velocity against closed formulas in long double, and its rules.
#include "ft/kernels/motion/constant_velocity.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"

namespace constant_velocity_test {

using wide = long double;
using motion = ft::rigid<double>;
constexpr std::int64_t ms = 1'000'000;

/// exp of a twist by the closed formulas of Rodrigues.
motion exp_of(ft::vec3<wide> w, ft::vec3<wide> u) {
  wide const angle = std::sqrt(w.x * w.x + w.y * w.y + w.z * w.z);
  bool const small = angle < 1e-4L;
  wide const s2 = angle * angle;
  wide const a = small ? 1 - s2 / 6 : std::sin(angle) / angle;
  wide const b = small ? 0.5L - s2 / 24 : 2 * std::pow(std::sin(angle / 2) / angle, 2.0L);
  wide const c = small ? 1.0L / 6 - s2 / 120 : (angle - std::sin(angle)) / (s2 * angle);
  wide const W[9] = {0, -w.z, w.y, w.z, 0, -w.x, -w.y, w.x, 0};
  wide WW[9];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      WW[3 * i + j] = W[3 * i] * W[j] + W[3 * i + 1] * W[3 + j] + W[3 * i + 2] * W[6 + j];
    }
  }
  motion T;
  wide t[3];
  wide const v[3] = {u.x, u.y, u.z};
  for (int i = 0; i < 3; ++i) {
    t[i] = 0;
    for (int j = 0; j < 3; ++j) {
      wide const one = i == j ? 1 : 0;
      T.R.m[3 * i + j] = static_cast<double>(one + a * W[3 * i + j] + b * WW[3 * i + j]);
      t[i] += (one + b * W[3 * i + j] + c * WW[3 * i + j]) * v[j];
    }
  }
  T.t = {static_cast<double>(t[0]), static_cast<double>(t[1]), static_cast<double>(t[2])};
  return T;
}

struct screw {
  ft::vec3<wide> w, u;
  motion part(wide s) const {
    return exp_of({s * w.x, s * w.y, s * w.z}, {s * u.x, s * u.y, s * u.z});
  }
};

screw random_screw(std::mt19937& random, wide angle) {
  std::uniform_real_distribution<double> unit(-1, 1);
  ft::vec3<wide> const a{unit(random), unit(random), unit(random)};
  wide const n = std::sqrt(a.x * a.x + a.y * a.y + a.z * a.z);
  return {{angle * a.x / n, angle * a.y / n, angle * a.z / n},
          {unit(random), unit(random), unit(random)}};
}

double difference(motion const& a, motion const& b) {
  double most = 0;
  for (int i = 0; i < 9; ++i) { most = std::max(most, std::abs(a.R.m[i] - b.R.m[i])); }
  return std::max(
      {most, std::abs(a.t.x - b.t.x), std::abs(a.t.y - b.t.y), std::abs(a.t.z - b.t.z)});
}

void expect_same_bits(motion const& a, motion const& b) {
  EXPECT_EQ(std::memcmp(&a, &b, sizeof a), 0);
}

motion part(motion const& T, double share) {
  return ft::detail::part_of_motion(T.cast<ft::strict_double>(), share).cast<double>();
}

motion times(motion const& a, motion const& b) {
  return (a.cast<ft::strict_double>() * b.cast<ft::strict_double>()).cast<double>();
}

TEST(PartOfMotion, EqualsTheClosedFormula) {
  std::mt19937 random(1);
  for (double const angle :
       {0.0, 1e-12, 1e-7, 1e-3, 0.01, 0.1, 0.24, 0.26, 0.49, 0.51, 1.0, 2.0, 3.0, 3.1}) {
    for (int i = 0; i < 100; ++i) {
      screw const s = random_screw(random, angle);
      motion const T = s.part(1);
      // The motion itself is rounded to double, which a turn close to half a turn magnifies.
      double const most = angle < 1.5 ? 2e-14 : 2e-13;
      for (double const share : {0.0, 0.3, 0.5, 1.0, 2.0, 4.7}) {
        EXPECT_LT(difference(part(T, share), s.part(share)), most) << angle << " " << share;
      }
    }
  }
}

TEST(PartOfMotion, OfARestIsARest) {
  expect_same_bits(part(motion::identity(), 0.7), motion::identity());
}

TEST(ConstantVelocity, RepeatsTheMotionOfEvenStampsBitForBit) {
  std::mt19937 random(2);
  motion const step = random_screw(random, 0.1).part(1);
  motion const from = random_screw(random, 1).part(1);
  motion const to = times(step, from);
  ft::constant_velocity v = ft::constant_velocity::at_rest();
  v.observe(from, to, 50 * ms);
  motion const next = times(v.motion, to);
  EXPECT_LT(difference(next, times(step, to)), 1e-14);
  for (std::int64_t const interval : {50 * ms, 48 * ms, 52 * ms, 0 * ms, -10 * ms}) {
    expect_same_bits(v.predict(to, interval), next);
  }
}

TEST(ConstantVelocity, FollowsTheTimeThatPassedUpToALimit) {
  std::mt19937 random(3);
  screw const s = random_screw(random, 0.2);
  motion const from = random_screw(random, 1).part(1);
  motion const to = times(s.part(1), from);
  ft::constant_velocity v = ft::constant_velocity::at_rest();
  v.observe(from, to, 50 * ms);
  EXPECT_LT(difference(v.predict(to, 25 * ms), times(s.part(0.5L), to)), 1e-13);
  EXPECT_LT(difference(v.predict(to, 100 * ms), times(s.part(2), to)), 1e-13);
  motion const five = times(s.part(5), to);
  for (std::int64_t const interval :
       {250 * ms, 3'600'000 * ms, std::numeric_limits<std::int64_t>::max()}) {
    EXPECT_LT(difference(v.predict(to, interval), five), 1e-13) << interval;
  }
}

TEST(ConstantVelocity, RestsAndSlowsDown) {
  std::mt19937 random(4);
  screw const s = random_screw(random, 0.3);
  ft::constant_velocity v = ft::constant_velocity::at_rest();
  expect_same_bits(v.predict(s.part(1), 50 * ms), s.part(1));
  v.observe(motion::identity(), s.part(1), 50 * ms);
  ft::motion_params p;
  p.memory = 0.5;
  v.slow_down(0, p);
  EXPECT_LT(difference(v.motion, s.part(1)), 1e-14);
  v.slow_down(125 * ms, p);
  EXPECT_LT(difference(v.motion, s.part(0.75L)), 1e-14);
  v.slow_down(250 * ms, p);
  EXPECT_LT(difference(v.motion, s.part(0.375L)), 1e-14);
  v.slow_down(std::numeric_limits<std::int64_t>::max(), p);
  EXPECT_LT(difference(v.motion, motion::identity()), 1e-14);
  v.rest();
  expect_same_bits(v.predict(s.part(1), 90 * ms), s.part(1));
}

struct predict_each {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, motion const* steps,
                                 std::int64_t const* intervals, motion* out) const {
    ft::constant_velocity v = ft::constant_velocity::at_rest();
    v.observe(motion::identity(), steps[i], 50 * 1'000'000);
    out[i] = v.predict(steps[i], intervals[i]);
    v.slow_down(intervals[i]);
    out[i] = v.predict(out[i], intervals[i]);
  }
};

template <typename Backend>
class constant_velocity_stage : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(constant_velocity_stage, test::backends);

TYPED_TEST(constant_velocity_stage, gives_the_bits_of_a_plain_call) {
  TypeParam backend;
  auto const& exec = backend.exec;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> angle(0, 3);
  std::vector<motion> steps;
  std::vector<std::int64_t> intervals;
  for (int i = 0; i < 500; ++i) {
    steps.push_back(random_screw(random, angle(random)).part(1));
    intervals.push_back(static_cast<std::int64_t>(random() % 300u) * ms);
  }
  std::vector<motion> plain(steps.size());
  for (int i = 0; i < static_cast<int>(steps.size()); ++i) {
    ft::no_scratch none;
    predict_each{}(ft::single_group{}, none, i, steps.data(), intervals.data(), plain.data());
  }
  auto const d_steps = test::to_exec(exec, steps);
  auto const d_intervals = test::to_exec(exec, intervals);
  auto const d_out = test::to_exec(exec, plain);
  ft::for_each_item<ft::per_thread>(exec, static_cast<int>(steps.size()), predict_each{},
                                    static_cast<motion const*>(d_steps.data()),
                                    static_cast<std::int64_t const*>(d_intervals.data()),
                                    d_out.data());
  auto const out = test::from_exec(exec, d_out.data(), steps.size());
  EXPECT_EQ(std::memcmp(out.data(), plain.data(), out.size() * sizeof(motion)), 0);
}

}  // namespace constant_velocity_test
