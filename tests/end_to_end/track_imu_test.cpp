// SPDX-License-Identifier: Apache-2.0
/// @file track_sequence with an IMU whose samples, or whose calibration, are wrong: it says so once
/// and the path stays right.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <functional>
#include <string>

#include "tests/end_to_end/track_support.hpp"

namespace {

using namespace app_test;

constexpr int walk_frames = 60;

/// Each sample as fields: time, gyro, accel. @param spoil of a sample's number and fields; false
/// leaves the sample out
void spoil_samples(spoilt_sequence const& s, std::function<bool(int, strings&)> const& spoil) {
  strings const lines = lines_of(read_file(s.path("imu0/data.csv")));
  std::ofstream out(s.path("imu0/data.csv"));
  out << lines[0] << "\n";
  for (std::size_t i = 1; i < lines.size(); ++i) {
    strings fields = split(lines[i], ',');
    ASSERT_EQ(fields.size(), 7u);
    if (!spoil(static_cast<int>(i) - 1, fields)) { continue; }
    for (std::size_t k = 0; k < 7; ++k) { out << (k > 0 ? "," : "") << fields[k]; }
    out << "\n";
  }
}

/// The warnings about the IMU, after a run that tracked all frames well.
strings imu_warnings_of(spoilt_sequence const& s) {
  outcome const o = track(s.path(), s.out(), {"--threads", "0"});
  EXPECT_TRUE(succeeded(o));
  results const r = read_results(s.out(), walk_frames);
  EXPECT_EQ(r.number("tracked"), walk_frames);
  EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.01);
  std::string const page = read_file(s.out() + "/report.html");
  strings found;
  for (auto const& w : r.summary.at("warnings")) {
    auto const text = w.get<std::string>();
    if (!contains(text, "IMU") && !contains(text, "imu0")) { continue; }
    found.push_back(text);
    EXPECT_TRUE(contains(o.out, "warning: " + text));
    EXPECT_TRUE(contains(page, "<li>" + text.substr(0, 30)));
  }
  return found;
}

TEST(TrackImu, EachFrameHasItsStateAndWhetherItBeginsAMap) {
  spoilt_sequence const s(walk_frames);
  ASSERT_TRUE(succeeded(track(s.path(), s.out(), {"--threads", "0"})));
  results const r = read_results(s.out(), walk_frames);
  int used = 0;
  for (std::size_t i = 0; i < r.times.size(); ++i) {
    EXPECT_EQ(r.times[i].at("map_begun"), i == 0 ? "1" : "0") << i;
    std::string const state = r.times[i].at("imu_state");
    EXPECT_EQ(state == "used", r.times[i].at("imu_optimized") == "1") << i;
    EXPECT_EQ(state == "used", r.times[i].at("imu_reason").empty()) << i;
    used += static_cast<int>(state == "used");
  }
  auto const& states = r.summary.at("imu").at("states");
  EXPECT_EQ(states.value("used", 0), used);
  EXPECT_TRUE(states.at("initialising").at("few_keyframes").is_number());
}

TEST(TrackImu, AGoodOneIsNotTalkedAbout) {
  EXPECT_EQ(imu_warnings_of(spoilt_sequence(walk_frames)), strings{});
}

TEST(TrackImu, AWrongRateIsSaidOnce) {
  spoilt_sequence const s(walk_frames);
  s.set_line("imu0/sensor.yaml", "rate_hz:", "rate_hz: 100");
  strings const said = imu_warnings_of(s);
  ASSERT_EQ(said.size(), 1u);
  EXPECT_TRUE(contains(said[0], "come at 200 Hz, rate_hz says 100"));
}

// The recording as a whole has the right rate, so that its reader has nothing to say.
TEST(TrackImu, SamplesThatGetFewerAreNamed) {
  spoilt_sequence const s(walk_frames);
  spoil_samples(s, [](int i, strings&) { return i < 400 || i % 4 == 0; });
  strings const said = imu_warnings_of(s);
  ASSERT_EQ(said.size(), 1u);
  EXPECT_TRUE(contains(said[0], "samples of the IMU come at 50 Hz, rate_hz says 200; in "));
  EXPECT_TRUE(contains(said[0], " of 60 frames, first in frame 5")) << said[0];
}

TEST(TrackImu, ASpikeIsLeftOutAndCounted) {
  for (char const* const value : {"1e7", "-1e7"}) {
    for (std::size_t const field : {1u, 5u}) {  // rad/s, m/s^2
      spoilt_sequence const s(walk_frames);
      spoil_samples(s, [&](int i, strings& fields) {
        if (i == 300) { fields[field] = value; }
        return true;
      });
      strings const said = imu_warnings_of(s);
      ASSERT_EQ(said.size(), 1u);
      EXPECT_TRUE(contains(said[0], "left out: 1 that are not finite or reach the sensor's range"));
      EXPECT_TRUE(contains(said[0], "; first in frame 29"));  // samples come 80 ms ahead
    }
  }
}

TEST(TrackImu, AnotherClockIsNamed) {
  spoilt_sequence const s(walk_frames);
  spoil_samples(s, [](int, strings& fields) {
    fields[0] = std::to_string(std::stoll(fields[0]) + std::int64_t{20'000'000'000});
    return true;
  });
  strings const said = imu_warnings_of(s);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_TRUE(contains(said[0], "IMU and images have no time in common: the former begins 17."));
  EXPECT_TRUE(contains(said[1], "newest sample of the IMU is 20"));
}

}  // namespace
