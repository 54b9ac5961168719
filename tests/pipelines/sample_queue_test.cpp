// SPDX-License-Identifier: Apache-2.0
// Samples of an IMU that wait for their frame: which are left out, how many are kept, how often
// they come, and times up to the ends of what a number of ns can be.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "ft/pipelines/imu_warnings.hpp"
#include "ft/pipelines/odometry.hpp"

namespace sample_queue_test {

using queue = ft::detail::sample_queue;
constexpr std::int64_t least = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t most = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t ms = 1'000'000;

ft::imu_measurement at(std::int64_t time_ns) { return {time_ns, {0, 0, 9.81f}, {0, 0, 0}}; }

ft::imu_tracking described(queue& q, std::int64_t time_ns = 0) {
  ft::imu_tracking t;
  q.describe(time_ns, t);
  return t;
}

/// Times of what is taken, s.
std::vector<double> taken(queue& q, std::int64_t base_ns, std::int64_t to_ns, int room = 100) {
  std::vector<ft::imu_sample> to(static_cast<std::size_t>(room));
  int const n = q.take(base_ns, to_ns, nullptr, room, to.data());
  std::vector<double> times;
  for (int i = 0; i < n && i < room; ++i) {
    times.push_back(to[static_cast<std::size_t>(i)].time_s);
  }
  return times;
}

void expect_times(std::vector<double> const& got, std::vector<double> const& want) {
  ASSERT_EQ(got.size(), want.size());
  for (std::size_t i = 0; i < want.size(); ++i) { EXPECT_DOUBLE_EQ(got[i], want[i]) << i; }
}

TEST(SampleQueue, LeavesOutDoubledAndSwappedSamplesAndCountsThem) {
  queue q;
  q.set_limits({});
  for (std::int64_t const t : {0, 5, 5, 15, 10, 20}) { q.add(at(t * ms)); }
  EXPECT_EQ(described(q).left_out.disordered, 2);
  EXPECT_EQ(described(q).left_out.out_of_range, 0);
  expect_times(taken(q, 0, 20 * ms), {0, 0.005, 0.015, 0.02});
  EXPECT_EQ(q.size(), 1u);  // the last one opens the next interval
  q.clear();
  EXPECT_EQ(described(q).left_out.disordered, 0);
  q.add(at(0));
  EXPECT_EQ(q.size(), 1u);
}

TEST(SampleQueue, LeavesOutWhatNoSensorMeasures) {
  queue q;
  ft::imu_params p;
  p.max_accel = 100;
  p.max_gyro = 10;
  q.set_limits(p);
  float const nan = std::numeric_limits<float>::quiet_NaN();
  float const inf = std::numeric_limits<float>::infinity();
  std::int64_t time = 0;
  int bad = 0;
  for (float const v : {nan, inf, -inf, 1e7f, 100.0f, -100.0f}) {
    for (int axis = 0; axis < 6; ++axis) {
      auto m = at(time += ms);
      float* const numbers[] = {&m.accel.x, &m.accel.y, &m.accel.z,
                                &m.gyro.x,  &m.gyro.y,  &m.gyro.z};
      *numbers[axis] = v;
      q.add(m);
      ++bad;
    }
  }
  EXPECT_EQ(described(q).left_out.out_of_range, bad);
  EXPECT_EQ(q.size(), 0u);
  auto m = at(0);  // what is left out has no time
  m.accel.x = 99;
  m.gyro.y = -9.9f;
  q.add(m);
  EXPECT_EQ(q.size(), 1u);
  // By default 16 g and 2000 degrees/s.
  EXPECT_NEAR(static_cast<double>(ft::imu_params{}.max_accel), 16 * 9.80665, 1e-4);
  EXPECT_NEAR(static_cast<double>(ft::imu_params{}.max_gyro), 2000 * 3.14159265 / 180, 1e-4);
}

TEST(SampleQueue, HoldsNoMoreThanItMay) {
  queue q;
  ft::imu_params p;
  p.waiting = 10;
  q.set_limits(p);
  for (int i = 0; i < 1000; ++i) {
    q.add(at(i * ms));
    EXPECT_LE(q.size(), 10u);
  }
  EXPECT_EQ(described(q).left_out.crowded_out, 990);
  expect_times(taken(q, 990 * ms, 992 * ms), {0, 0.001, 0.002});
  expect_times(taken(q, 990 * ms, 998 * ms, 2), {0.002, 0.003});
  EXPECT_EQ(q.size(), 2u);
}

TEST(SampleQueue, OneWrongTimeOrAClockThatIsSetBackDoesNotEndIt) {
  queue q;
  q.set_limits({});
  q.add(at(0));
  q.add(at(most));  // a bit error
  for (int i = 1; i < 40; ++i) { q.add(at(5 * i * ms)); }
  EXPECT_EQ(described(q).left_out.disordered, queue::enough_behind - 1);
  EXPECT_EQ(q.size(), 1u + 39u - (queue::enough_behind - 1));
  EXPECT_NEAR(described(q).newest_s, 0.195, 1e-12);
  // Doubled ones alone show nothing.
  for (int i = 0; i < 100; ++i) { q.add(at(5 * ms)); }
  EXPECT_NEAR(described(q).newest_s, 0.195, 1e-12);
}

/// Sample i of a sensor with noise, 200 Hz.
ft::imu_measurement noisy(int i) {
  auto const noise = [i](int k) { return 1e-3f * static_cast<float>((7919 * i + 31 * k) % 101); };
  return {5 * i * ms, {noise(0), noise(1), 9.8f + noise(2)}, {0.1f + noise(3), noise(4), noise(5)}};
}
/// The values of sample i at the time of sample k.
ft::imu_measurement repeated(int i, int k) {
  auto m = noisy(i);
  m.time_ns = 5 * k * ms;
  return m;
}

TEST(SampleQueue, LeavesOutWhatASensorThatIsStuckRepeats) {
  queue q;
  q.set_limits({});
  int k = 0;
  for (; k < 100; ++k) { q.add(noisy(k)); }
  for (; k < 120; ++k) { q.add(repeated(99, k)); }
  EXPECT_EQ(described(q).left_out.frozen, 20);
  EXPECT_EQ(q.size(), 100u);
  EXPECT_DOUBLE_EQ(taken(q, 0, 119 * 5 * ms, 200).back(), 0.495);  // the first of them
  for (; k < 150; ++k) { q.add(noisy(k)); }
  EXPECT_EQ(described(q).left_out.frozen, 20);
  for (; k < 160; ++k) { q.add(repeated(149, k)); }  // and again, at once
  EXPECT_EQ(described(q).left_out.frozen, 30);
  // Some of the first repetitions have been taken before it is known.
  for (; k < 260; ++k) { q.add(noisy(k)); }
  q.add(repeated(259, k++));
  EXPECT_DOUBLE_EQ(taken(q, 0, 5 * k * ms, 400).back(), 1.3);
  for (; k < 270; ++k) { q.add(repeated(259, k)); }
  EXPECT_EQ(described(q).left_out.frozen, 39);
  EXPECT_EQ(q.size(), 0u);
  q.clear();
  EXPECT_EQ(described(q).left_out.frozen, 0);
}

TEST(SampleQueue, KeepsRepetitionsThatTellNothing) {
  queue q;
  q.set_limits({});
  int k = 0;
  for (; k < 200; ++k) { q.add(repeated(1, k)); }  // a simulator without noise
  for (; k < 260; ++k) { q.add(noisy(k)); }        // too few to know that there is noise
  for (; k < 300; ++k) { q.add(repeated(1, k)); }
  for (; k < 500; ++k) { q.add(repeated(k / 2, k)); }  // a driver at twice the sensor's rate
  for (; k < 520; ++k) { q.add(repeated(2, k)); }
  for (; k < 620; ++k) { q.add(noisy(k)); }
  for (int i = 0; i < 2; ++i) { q.add(repeated(619, k++)); }  // chance
  for (; k < 680; ++k) { q.add(noisy(k)); }
  for (; k < 690; ++k) { q.add(repeated(679, k)); }  // what happened by chance may happen again
  EXPECT_EQ(described(q).left_out.frozen, 0);
  EXPECT_EQ(q.size(), 690u);
}

TEST(SampleQueue, LeavesOutSingleRatesThatNoBodyHas) {
  queue q;
  q.set_limits({});
  auto const with = [](int k, float rate) {
    auto m = noisy(k);
    m.gyro.y = rate;
    return m;
  };
  for (int k = 0; k < 40; ++k) { q.add(k == 10 ? with(k, 30) : noisy(k)); }
  EXPECT_EQ(described(q).left_out.spikes, 1);
  EXPECT_EQ(q.size(), 39u);
  // The newest one waits for the next, and is not taken before.
  q.add(with(40, -8));
  auto const times = taken(q, 0, 200 * ms);
  EXPECT_EQ(times.size(), 39u);
  EXPECT_DOUBLE_EQ(times.back(), 0.195);
  // The next one is there, too: it was none.
  q.add(with(41, -8));
  expect_times(taken(q, 0, 205 * ms), {0.2, 0.205});
  EXPECT_EQ(described(q).left_out.spikes, 1);
  for (int k = 42; k < 60; ++k) { q.add(with(k, -8)); }
  q.add(with(60, 0));
  EXPECT_DOUBLE_EQ(taken(q, 0, 300 * ms).back(), 0.295);
  q.add(with(61, -8));
  EXPECT_EQ(described(q).left_out.spikes, 2);
  expect_times(taken(q, 0, 305 * ms), {0.305});
  // Several near one another are a vibration.
  for (int k = 62; k < 80; ++k) { q.add(with(k, k % 2 == 0 ? 0.0f : -8.0f)); }
  EXPECT_EQ(described(q).left_out.spikes, 3);
}

ft::imu_measurement turning(std::int64_t time_ns, float rate) {
  auto m = at(time_ns);
  m.gyro.y = rate;
  return m;
}
/// Samples at rest, 200 Hz, until 195 ms.
void rest(queue& q) {
  q.set_limits({});
  for (int k = 0; k < 40; ++k) { q.add(turning(5 * k * ms, 0)); }
}

TEST(SampleQueue, KeepsTheNewestSampleUntilTheNextTellsWhetherItIsASpike) {
  queue q;
  rest(q);
  q.add(turning(200 * ms, -8));
  EXPECT_DOUBLE_EQ(taken(q, 0, 200 * ms + 1).back(), 0.195);
  EXPECT_EQ(q.size(), 1u);
  EXPECT_TRUE(taken(q, 0, 203 * ms).empty());
  for (int k = 41; k < 44; ++k) { q.add(turning(5 * k * ms, -8)); }
  expect_times(taken(q, 0, 210 * ms), {0.2, 0.205, 0.21});
  EXPECT_EQ(described(q).left_out.spikes, 0);
}

TEST(SampleQueue, TakesNoFastChangeForASpike) {
  queue q;
  rest(q);
  std::int64_t time = 195 * ms;
  for (float const rate : {6.0f, 12.0f, 12.0f, 6.0f, 0.0f}) {
    q.add(turning(time += 5 * ms, rate));
  }
  EXPECT_EQ(described(q).left_out.spikes, 0);
  EXPECT_EQ(q.size(), 45u);
}

TEST(SampleQueue, ComparesNoRatesOverAGap) {
  for (bool const before : {false, true}) {
    queue q;
    rest(q);
    q.add(turning((before ? 2195 : 200) * ms, 8));
    q.add(turning((before ? 2200 : 3200) * ms, 0));
    EXPECT_EQ(described(q).left_out.spikes, 0) << before;
    EXPECT_EQ(q.size(), 42u) << before;
  }
  // The clock is set back after what may have been a spike.
  queue q;
  rest(q);
  q.add(turning(200 * ms, 8));
  for (int k = 0; k < queue::enough_behind; ++k) { q.add(turning((100 + k) * ms, 0)); }
  EXPECT_EQ(described(q).left_out.spikes, 0);
  EXPECT_DOUBLE_EQ(taken(q, 0, 300 * ms).back(), 0.115);
}

TEST(SampleQueue, MeasuresHowOftenSamplesCome) {
  queue q;
  q.set_limits({});
  EXPECT_EQ(described(q).rate_hz, 0);
  for (int i = 0; i < 5; ++i) { q.add(at(20 * i * ms)); }
  EXPECT_EQ(described(q).rate_hz, 0);  // too few
  for (int i = 5; i < 200; ++i) {
    if (i % 10 != 0) { q.add(at(20 * i * ms)); }  // with gaps
  }
  EXPECT_NEAR(described(q).rate_hz, 50, 1e-9);
  for (int i = 2000; i < 2100; ++i) { q.add(at(5 * i * ms)); }
  EXPECT_NEAR(described(q).rate_hz, 200, 1e-9);
}

TEST(SampleQueue, TimesMayBeAny) {
  queue q;
  q.set_limits({});
  for (std::int64_t const t :
       {least, least + 1, std::int64_t{-1}, std::int64_t{0}, most - 1, most}) {
    q.add(at(t));
  }
  EXPECT_EQ(described(q).left_out.disordered, 0);
  EXPECT_GT(described(q, least).newest_s, 9.2e9);
  expect_times(taken(q, most, least), {1e-9 * static_cast<double>(least)});
  auto const all = taken(q, least, most);
  ASSERT_EQ(all.size(), 6u);
  EXPECT_EQ(all[0], 0);
  EXPECT_EQ(all[5], 1e-9 * static_cast<double>(most));
  using ft::detail::saturated_difference;
  EXPECT_EQ(saturated_difference(least, most), least);
  EXPECT_EQ(saturated_difference(most, least), most);
  EXPECT_EQ(saturated_difference(-1, most), least);
  EXPECT_EQ(saturated_difference(-2, most), least);
  EXPECT_EQ(saturated_difference(-1, least), most);
  EXPECT_EQ(saturated_difference(0, least), most);
  EXPECT_EQ(saturated_difference(least, least), 0);
  EXPECT_EQ(saturated_difference(most, 1), most - 1);
  EXPECT_EQ(saturated_difference(least + 5, 5), least);
}

bool says(std::vector<std::string> const& all, std::string const& words) {
  for (auto const& one : all) {
    if (one.find(words) != std::string::npos) { return true; }
  }
  return false;
}

TEST(ImuWarnings, NameWhatWasFoundAndWhatWasExpected) {
  ft::imu_params p;
  ft::imu_tracking t;
  t.samples = ft::integration_status::integrated;
  t.rate_hz = 201;
  EXPECT_TRUE(ft::imu_warnings(t, p).empty());
  t.rate_hz = 50;
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "come at 50 Hz, rate_hz says 200"));
  t.rate_hz = 400;
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "come at 400 Hz, rate_hz says 200"));
  p.selection.rate_hz = 400;
  EXPECT_TRUE(ft::imu_warnings(t, p).empty());
  t.left_out = {3, 4, 5, 6, 7};
  auto const all = ft::imu_warnings(t, p);
  EXPECT_EQ(all.size(), 5u);
  EXPECT_TRUE(says(all, "left out: 6 that repeat the one before"));
  EXPECT_TRUE(says(all, "left out: 7 whose rate of turning"));
  EXPECT_TRUE(says(all, "left out: 3"));
  EXPECT_TRUE(says(all, "left out: 4"));
  EXPECT_TRUE(says(all, "156.9 m/s^2 and 34.91 rad/s"));
  EXPECT_TRUE(says(all, "left out: 5 of more than 65536"));
  t.left_out = {};
  t.newest_s = 12.5;
  EXPECT_TRUE(ft::imu_warnings(t, p).empty());  // samples may come early
  t.samples = ft::integration_status::one_sample;
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "12.5 s after its image"));
  t.newest_s = -3;
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "3 s before its image"));
  t = {};
  t.samples = ft::integration_status::integrated;
  t.clock = {true, 0.0201, 2e-4};
  EXPECT_TRUE(
      says(ft::imu_warnings(t, p), "20 ms ahead of that of the images, time_offset_s says 0"));
  t.clock.offset_s = -0.03;
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "30 ms behind that of the images"));
  p.time_offset_s = t.time_offset_s = -0.0285;
  EXPECT_TRUE(ft::imu_warnings(t, p).empty());  // as near as it is known
  p.time_offset_s = t.time_offset_s = 0;
  t.clock.known = false;
  EXPECT_TRUE(ft::imu_warnings(t, p).empty());
  t.time_offset_s = 0.012;  // taken into use before it is known within a millisecond
  EXPECT_TRUE(says(ft::imu_warnings(t, p), "12 ms ahead of that of the images"));
}

}  // namespace sample_queue_test
