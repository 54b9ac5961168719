// SPDX-License-Identifier: Apache-2.0
// Selection of an IMU's samples: cases by hand at times that doubles hold exactly, signals that
// change linearly, whose means are known, faults, queues that are emptied bit by bit.
#include "ft/kernels/inertial/select_samples.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace select_samples_test {

using ft::integration_status;
using test::at;

constexpr double tick = 1.0 / 256;  // between samples
constexpr double early = tick / 8;  // in place of the reference's 1 ms, which no double is

ft::selection_params params() {
  ft::selection_params p;
  p.early_s = early;
  p.longest_gap_s = HUGE_VAL;
  return p;
}

/// A sample whose signals are 0 to 5 more than a multiple of its time.
ft::imu_sample ramp(double t) {
  auto const f = [&](int k) { return static_cast<float>(8 * t) + static_cast<float>(k); };
  return {t, {f(0), f(1), f(2)}, {f(3), f(4), f(5)}};
}
/// Samples at these ticks.
std::vector<ft::imu_sample> samples_at(std::vector<double> const& ticks) {
  std::vector<ft::imu_sample> out;
  for (double const t : ticks) { out.push_back(ramp(t * tick)); }
  return out;
}
std::vector<ft::imu_sample> samples_from(int first, int last) {
  std::vector<ft::imu_sample> out;
  for (int t = first; t <= last; ++t) { out.push_back(ramp(t * tick)); }
  return out;
}

struct selection {
  ft::imu_selection chosen;
  std::vector<ft::imu_step> steps;
};
constexpr int most_steps = 64;

/// Selects between two images, given in ticks.
selection select(std::vector<ft::imu_sample> const& queue, double from, double to,
                 ft::selection_params const& p = params()) {
  selection out;
  out.steps.resize(most_steps);
  out.chosen = ft::select_samples({queue.data(), static_cast<int>(queue.size())},
                                  {from * tick, to * tick, 0, 0}, p, out.steps.data(), most_steps);
  out.steps.resize(at(out.chosen.steps));
  return out;
}

void expect_counts(selection const& s, int dropped, int taken, int removed,
                   integration_status status) {
  EXPECT_EQ(s.chosen.dropped, dropped);
  EXPECT_EQ(s.chosen.taken, taken);
  EXPECT_EQ(s.chosen.removed, removed);
  EXPECT_EQ(s.chosen.status, status);
  EXPECT_EQ(s.chosen.steps, usable(status) ? taken - 1 : 0);
}
/// The steps of a ramp are its values in the middle of each.
void expect_middles(selection const& s, double from, double to, std::vector<double> const& inner) {
  std::vector<double> ends{from};
  ends.insert(ends.end(), inner.begin(), inner.end());
  ends.push_back(to);
  ASSERT_EQ(s.steps.size() + 1, ends.size());
  for (std::size_t i = 0; i < s.steps.size(); ++i) {
    ft::imu_sample const want = ramp((ends[i] + ends[i + 1]) / 2 * tick);
    EXPECT_NEAR(s.steps[i].accel.x, want.accel.x, 2e-6f);
    EXPECT_NEAR(s.steps[i].accel.z, want.accel.z, 2e-6f);
    EXPECT_NEAR(s.steps[i].gyro.y, want.gyro.y, 2e-6f);
    EXPECT_EQ(s.steps[i].dt, static_cast<float>((ends[i + 1] - ends[i]) * tick));
  }
}

TEST(SelectSamples, TakesThoseBetweenTwoImages) {
  // Aligned with the images; the last one stays for the next interval.
  auto s = select(samples_from(0, 20), 4, 9);
  expect_counts(s, 4, 6, 9, integration_status::integrated);
  expect_middles(s, 4, 9, {5, 6, 7, 8});
  // Images between samples: both ends are cut off.
  s = select(samples_from(0, 20), 3.5, 8.25);
  expect_counts(s, 4, 6, 9, integration_status::integrated);
  expect_middles(s, 3.5, 8.25, {5, 6, 7, 8});
  EXPECT_TRUE(s.chosen.marks_frame());
}

TEST(SelectSamples, CountsASampleThatIsALittleEarlyWithTheImage) {
  std::vector<double> const first{0, 3, 3.875, 4, 5, 6, 7};
  // Exactly as early as allowed: taken. Anything earlier: dropped.
  expect_counts(select(samples_at(first), 4, 6), 2, 4, 5, integration_status::integrated);
  expect_counts(select(samples_at({3.87, 4.5, 5, 6}), 4, 6), 1, 3, 3,
                integration_status::integrated);
  // The same at the end: the sample closes this interval, and opens the next one.
  expect_counts(select(samples_at({4, 5, 5.875, 6, 7}), 4, 6), 0, 3, 2,
                integration_status::integrated);
  expect_counts(select(samples_at({4, 5, 5.87, 6, 7}), 4, 6), 0, 4, 3,
                integration_status::integrated);
  // A first sample before the image is cut off behind it.
  auto const s = select(samples_at({3.875, 5, 6, 7}), 4, 7);
  expect_middles(s, 4, 7, {5, 6});
}

TEST(SelectSamples, ExtrapolatesWhereTheQueueEndsEarly) {
  auto const s = select(samples_from(0, 6), 4, 8);
  expect_counts(s, 4, 3, 7, integration_status::integrated);
  expect_middles(s, 4, 8, {5});
  // So does a queue that begins late.
  auto const late = select(samples_from(6, 12), 4, 8);
  expect_counts(late, 0, 3, 2, integration_status::integrated);
  expect_middles(late, 4, 8, {7});
}

TEST(SelectSamples, TakesTheFirstOfTwoForAWholeInterval) {
  auto const s = select(samples_at({4.25, 5.5, 6}), 4, 5);
  expect_counts(s, 0, 2, 1, integration_status::integrated);
  ASSERT_EQ(s.steps.size(), 1u);
  ft::imu_sample const first = ramp(4.25 * tick);
  EXPECT_EQ(std::memcmp(&s.steps[0].accel, &first.accel, sizeof first.accel), 0);
  EXPECT_EQ(std::memcmp(&s.steps[0].gyro, &first.gyro, sizeof first.gyro), 0);
  EXPECT_EQ(s.steps[0].dt, static_cast<float>(tick));
}

TEST(SelectSamples, SaysWhyThereIsNoStep) {
  expect_counts(select({}, 4, 8), 0, 0, 0, integration_status::no_samples);
  EXPECT_TRUE(select({}, 4, 8).chosen.marks_frame());
  // One sample in time is removed, one that is late stays. The frame can be tried again.
  expect_counts(select(samples_at({1, 5}), 4, 8), 1, 1, 2, integration_status::one_sample);
  expect_counts(select(samples_at({1, 9, 10}), 4, 8), 1, 1, 1, integration_status::one_sample);
  EXPECT_FALSE(select(samples_at({5}), 4, 8).chosen.marks_frame());
  // All too old.
  expect_counts(select(samples_from(0, 3), 4, 8), 4, 0, 4, integration_status::no_steps);
  EXPECT_TRUE(select(samples_from(0, 3), 4, 8).chosen.marks_frame());
}

TEST(SelectSamples, RefusesImagesWithoutTimeBetweenThem) {
  auto const queue = samples_from(0, 20);
  expect_counts(select(queue, 8, 8), 0, 0, 0, integration_status::unordered);
  expect_counts(select(queue, 9, 8), 0, 0, 0, integration_status::unordered);
  double const nan = std::numeric_limits<double>::quiet_NaN();
  expect_counts(select(queue, nan, 8), 0, 0, 0, integration_status::not_finite);
  expect_counts(select(queue, 4, HUGE_VAL), 0, 0, 0, integration_status::not_finite);
}

TEST(SelectSamples, RefusesStampsThatDoNotAscend) {
  expect_counts(select(samples_at({4, 5, 7, 6, 8, 9}), 4, 8), 0, 5, 4,
                integration_status::unordered);
  // A stamp from the future ends the walk. It goes as soon as an older sample follows it.
  expect_counts(select(samples_at({4, 5, 99}), 4, 8), 0, 3, 2, integration_status::integrated);
  expect_counts(select(samples_at({99, 7, 8, 9}), 7, 9), 0, 1, 1, integration_status::unordered);
  // Twice the same time at an end of several steps: nothing to interpolate between.
  expect_counts(select(samples_at({4, 4, 5, 6}), 4, 6), 0, 4, 3, integration_status::unordered);
  expect_counts(select(samples_at({4, 5, 6.5, 6.5}), 4, 7), 0, 4, 4, integration_status::unordered);
}

TEST(SelectSamples, AllowsARepeatedStampInside) {
  auto const s = select(samples_at({4, 5, 5, 6, 7}), 4, 7);
  expect_counts(s, 0, 5, 4, integration_status::repeated);
  expect_middles(s, 4, 7, {5, 5, 6});
  EXPECT_EQ(s.steps[1].dt, 0.0f);
  // Nothing is interpolated between the only two.
  auto const two = select(samples_at({5, 5}), 4, 7);
  expect_counts(two, 0, 2, 2, integration_status::repeated);
  EXPECT_EQ(two.steps[0].dt, static_cast<float>(3 * tick));
}

TEST(SelectSamples, RefusesNumbersThatAreNone) {
  float const nan = std::numeric_limits<float>::quiet_NaN();
  for (int k = 0; k < 6; ++k) {
    auto const spoil = [&](ft::imu_sample& s, float by) {
      float* const values[] = {&s.accel.x, &s.accel.y, &s.accel.z, &s.gyro.x, &s.gyro.y, &s.gyro.z};
      *values[k] = by;
    };
    auto queue = samples_from(4, 12);
    spoil(queue[2], k % 2 == 0 ? nan : HUGE_VALF);
    expect_counts(select(queue, 4, 8), 0, 5, 4, integration_status::not_finite);
    // A spoilt sample that would open the next interval is removed, too.
    queue = samples_from(4, 12);
    spoil(queue[4], nan);
    expect_counts(select(queue, 4, 8), 0, 5, 5, integration_status::not_finite);
    // One that is dropped does no harm.
    queue = samples_from(0, 12);
    spoil(queue[1], nan);
    expect_counts(select(queue, 4, 8), 4, 5, 8, integration_status::integrated);
  }
  auto queue = samples_from(4, 12);
  for (double const time : {std::numeric_limits<double>::quiet_NaN(), HUGE_VAL, -HUGE_VAL}) {
    queue[2].time_s = time;
    expect_counts(select(queue, 4, 8), 0, 5, 4, integration_status::not_finite);
  }
}

TEST(SelectSamples, RefusesLongGaps) {
  auto p = params();
  p.longest_gap_s = 3 * tick;
  expect_counts(select(samples_at({4, 5, 8, 9}), 4, 9, p), 0, 4, 3, integration_status::integrated);
  expect_counts(select(samples_at({4, 5, 8.5, 9}), 4, 9, p), 0, 4, 3, integration_status::gap);
  expect_counts(select(samples_at({7, 8, 9}), 4, 9, p), 0, 3, 2, integration_status::integrated);
  expect_counts(select(samples_at({7.5, 8, 9}), 4, 9, p), 0, 3, 2, integration_status::gap);
  expect_counts(select(samples_at({4, 5, 6}), 4, 9, p), 0, 3, 3, integration_status::integrated);
  expect_counts(select(samples_at({4, 5, 5.5}), 4, 9, p), 0, 3, 3, integration_status::gap);
  p.longest_gap_s = std::numeric_limits<double>::quiet_NaN();  // no limit that anything keeps
  expect_counts(select(samples_from(4, 9), 4, 9, p), 0, 6, 5, integration_status::gap);
  EXPECT_EQ(ft::selection_params{}.longest_gap_s, 0.1);
}

TEST(SelectSamples, RefusesRatesThatTheNoiseIsNotFor) {
  auto p = params();
  auto const status_at = [&](float rate) {
    p.rate_hz = rate;
    return select(samples_from(0, 30), 4, 20, p).chosen.status;  // 256 Hz
  };
  EXPECT_EQ(status_at(0), integration_status::integrated);
  EXPECT_EQ(status_at(256), integration_status::integrated);
  EXPECT_EQ(status_at(86), integration_status::integrated);
  EXPECT_EQ(status_at(85), integration_status::wrong_rate);
  EXPECT_EQ(status_at(767), integration_status::integrated);
  EXPECT_EQ(status_at(769), integration_status::wrong_rate);
  // Lost samples are no other rate.
  p.rate_hz = 256;
  EXPECT_EQ(select(samples_at({4, 9, 15, 16, 20}), 4, 20, p).chosen.status,
            integration_status::integrated);
}

TEST(SelectSamples, WritesNoMoreStepsThanThereIsMemoryFor) {
  auto const queue = samples_from(0, 40);
  for (int const capacity : {10, 9, 0}) {
    std::vector<ft::imu_step> steps(11, {{7, 7, 7}, {7, 7, 7}, 7});
    auto const chosen = ft::select_samples({queue.data(), 41}, {4 * tick, 14 * tick, 0, 0},
                                           params(), steps.data(), capacity);
    bool const fits = capacity == 10;
    EXPECT_EQ(chosen.status, fits ? integration_status::integrated : integration_status::too_many);
    EXPECT_EQ(chosen.steps, fits ? 10 : 0);
    EXPECT_EQ(chosen.removed, 14);
    EXPECT_EQ(steps[at(capacity)].dt, 7.0f);
  }
}

TEST(SelectSamples, GoesThroughAQueueWithoutLosingTime) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(0, 1);
  for (int round = 0; round < test::effort(50); ++round) {
    std::vector<ft::imu_sample> queue;
    for (double t = -2; t < 300; t += 0.5 + u(random)) { queue.push_back(ramp(t * tick)); }
    double from = 0;
    double total = 0;
    while (from < 250) {
      double const to = from + 4 + 10 * u(random);
      auto const s = select(queue, from, to);
      ASSERT_EQ(s.chosen.status, integration_status::integrated);
      double sum = 0;
      for (auto const& step : s.steps) {
        // The mean of a ramp over a step is its value in the middle.
        double const middle = from * tick + sum + static_cast<double>(step.dt) / 2;
        EXPECT_NEAR(static_cast<double>(step.accel.x), 8 * middle, 1e-5);
        EXPECT_NEAR(static_cast<double>(step.gyro.z), 8 * middle + 5, 1e-5);
        sum += static_cast<double>(step.dt);
      }
      EXPECT_NEAR(sum, (to - from) * tick, 1e-8);
      total += sum;
      auto const rest = queue.begin() + s.chosen.removed;
      ASSERT_GE(rest->time_s, to * tick - early);
      queue.erase(queue.begin(), rest);
      from = to;
    }
    EXPECT_NEAR(total, from * tick, 1e-6);
  }
}

template <typename Backend>
class SelectManySamples : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(SelectManySamples, test::backends);

TYPED_TEST(SelectManySamples, IsTheSelectionOfEach) {
  TypeParam backend;
  std::mt19937 random(2);
  std::uniform_real_distribution<double> u(0, 1);
  std::vector<ft::imu_sample> samples;
  std::vector<ft::imu_interval> intervals;
  for (int i = 0; i < 700; ++i) {
    int const count = static_cast<int>(random() % 30u);
    intervals.push_back({3 * tick * u(random), (3 + 20 * u(random)) * tick,
                         static_cast<int>(samples.size()), count});
    double t = -3 * u(random);
    for (int k = 0; k < count; ++k) {
      t += random() % 40u == 0 ? -0.5 : 1.5 * u(random);
      samples.push_back(ramp(t * tick));
      samples.back().accel.y = static_cast<float>(u(random));
      if (random() % 200u == 0) { samples.back().gyro.x = HUGE_VALF; }
    }
  }
  auto p = params();
  p.longest_gap_s = 6 * tick;
  p.rate_hz = 256;
  constexpr int capacity = 20;
  auto const n = intervals.size();
  std::vector<ft::imu_selection> want(n);
  std::vector<ft::imu_step> want_steps(n * capacity, ft::imu_step{});
  for (std::size_t i = 0; i < n; ++i) {
    want[i] = ft::select_samples({samples.data() + intervals[i].first, intervals[i].count},
                                 intervals[i], p, want_steps.data() + i * capacity, capacity);
  }
  for (auto const s :
       {integration_status::integrated, integration_status::no_samples,
        integration_status::one_sample, integration_status::unordered,
        integration_status::not_finite, integration_status::gap, integration_status::too_many}) {
    EXPECT_TRUE(std::any_of(want.begin(), want.end(), [&](auto const& w) { return w.status == s; }))
        << static_cast<int>(s);
  }
  auto const d_samples = test::to_exec(backend.exec, samples);
  auto const d_intervals = test::to_exec(backend.exec, intervals);
  auto const d_chosen = test::to_exec(backend.exec, std::vector<ft::imu_selection>(n));
  auto const d_steps = test::to_exec(backend.exec, std::vector<ft::imu_step>(n * capacity));
  ft::select_samples(backend.exec, d_samples.data(), d_intervals.data(), p,
                     {static_cast<int>(n), capacity, d_chosen.data(), d_steps.data()});
  auto const chosen = test::from_exec(backend.exec, d_chosen.data(), n);
  auto const steps = test::from_exec(backend.exec, d_steps.data(), n * capacity);
  EXPECT_EQ(std::memcmp(chosen.data(), want.data(), n * sizeof want[0]), 0);
  EXPECT_EQ(std::memcmp(steps.data(), want_steps.data(), steps.size() * sizeof steps[0]), 0);
}

}  // namespace select_samples_test
