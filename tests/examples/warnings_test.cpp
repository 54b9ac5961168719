// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/warnings.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/support/sequence.hpp"

namespace warnings_test {

using seq_test::contains;

/// A run at 20 Hz with nothing to warn of.
seq::run_report good_run(int frames) {
  seq::run_report r;
  r.frames = r.tracked = frames;
  r.maps = 1;
  for (int i = 0; i < frames; ++i) {
    seq::frame_record f;
    f.index = i;
    f.time_ns = 1'000'000'000 + i * std::int64_t{50'000'000};
    f.tracked = true;
    f.keypoints = 1000;
    f.stereo_matches = 400;
    r.records.push_back(f);
  }
  return r;
}

void lose(seq::run_report& r, int begin, int end) {
  for (int i = begin; i < end; ++i) { r.records[static_cast<std::size_t>(i)].tracked = false; }
}

/// The one warning of a run; empty where there are none.
std::string only_warning(seq::run_report const& r) {
  auto const all = seq::warnings_of(r);
  EXPECT_LE(all.size(), 1u);
  return all.empty() ? std::string() : all.front();
}

TEST(WarningsOf, AGoodRunAndNoRunAtAll) {
  EXPECT_TRUE(seq::warnings_of(good_run(100)).empty());
  EXPECT_TRUE(seq::warnings_of({}).empty());
}

TEST(WarningsOf, WarningsOfFramesOnceEachWithTheirNumber) {
  seq::run_report r = good_run(10);
  for (std::size_t i = 3; i < 7; ++i) { r.records[i].warnings = {{"two_motions", "things move"}}; }
  EXPECT_EQ(only_warning(r), "two_motions in 4 of 10 frames, first in frame 3: things move");
  r.records[3].reason = "two_motions";  // told as a reason
  r.records[3].why = "why";
  EXPECT_EQ(only_warning(r), "two_motions in 1 of 10 frames, first in frame 3: why");
}

TEST(WarningsOf, FewStereoMatches) {
  seq::run_report r = good_run(10);
  for (auto& f : r.records) { f.stereo_matches = 99; }
  EXPECT_TRUE(contains(only_warning(r), "9.9 %"));
  for (auto& f : r.records) { f.stereo_matches = 100; }
  EXPECT_EQ(only_warning(r), "");
  // frames without keypoints, a covered camera, say nothing of the calibration
  for (auto& f : r.records) { f.keypoints = f.stereo_matches = 0; }
  EXPECT_EQ(only_warning(r), "");
}

TEST(WarningsOf, UnpairedImages) {
  seq::run_report r = good_run(10);
  r.unpaired_right = 3;
  EXPECT_TRUE(contains(only_warning(r), "0 of the left camera, 3 of the right one"));
}

TEST(WarningsOf, MoreThanOneMap) {
  seq::run_report r = good_run(10);
  r.maps = 3;
  EXPECT_TRUE(contains(only_warning(r), "3 maps"));
}

TEST(WarningsOf, LostForLong) {
  seq::run_report r = good_run(200);
  lose(r, 20, 40);  // a second, up to the frame that is found again
  EXPECT_EQ(only_warning(r), "");
  lose(r, 100, 124);
  EXPECT_TRUE(contains(only_warning(r), "lost for 1.2 s from frame 100 on"));
  lose(r, 151, 200);  // to the end: the last frame is 48 steps after the first one
  EXPECT_TRUE(contains(only_warning(r), "lost for 2.4 s from frame 151 on"));
}

TEST(WarningsOf, BegunLateIsNotLost) {
  seq::run_report r = good_run(200);
  lose(r, 0, 20);  // a second
  EXPECT_EQ(only_warning(r), "");
  lose(r, 0, 24);
  EXPECT_TRUE(contains(only_warning(r), "tracking began after 1.2 s, in frame 24"));
  lose(r, 100, 124);
  EXPECT_EQ(seq::warnings_of(r).size(), 2u) << "the loss after it is told, too";
  lose(r, 0, 200);
  EXPECT_TRUE(contains(seq::warnings_of(r).front(), "s from frame 0 on"));
}

TEST(WarningsOf, ReasonsAreCounted) {
  seq::run_report r = good_run(10);
  for (std::size_t i : {3u, 4u, 7u}) {
    r.records[i].reason = i == 4 ? "dark" : "few_matches";
    r.records[i].why = "words of frame " + std::to_string(i);
  }
  auto const all = seq::warnings_of(r);
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[0], "few_matches in 2 of 10 frames, first in frame 3: words of frame 3");
  EXPECT_EQ(all[1], "dark in 1 of 10 frames, first in frame 4: words of frame 4");
  EXPECT_EQ(seq::reasons_of(r), all);
  // One camera waits for motion, at first; it is a warning where it waits to the end.
  r = good_run(10);
  r.records[0].reason = "awaits_motion";
  EXPECT_EQ(only_warning(r), "");
  r.tracked = 0;
  EXPECT_TRUE(contains(only_warning(r), "awaits_motion in 1 of 10 frames"));
}

TEST(WarningsOf, CalibrationsThatLookWrong) {
  seq::run_report r = good_run(10);
  r.calibration = {"baseline_long: the baseline is 110 m"};
  EXPECT_EQ(only_warning(r), "calibration: baseline_long: the baseline is 110 m");
}

TEST(WarningsOf, TheImuIsToldOfOnceASentence) {
  seq::run_report r = good_run(10);
  std::string const rate = "samples of the IMU come at 50 Hz, rate_hz says 200";
  for (std::size_t i = 3; i < 10; ++i) {
    auto& said = r.records[i].imu_warnings;
    said.push_back("samples of the IMU left out: " + std::to_string(i) + " that are not finite");
    if (i == 5 || i == 7) { said.push_back(rate); }
    if (i == 8) { said.push_back("the newest sample of the IMU is 1.5e+04 s after its image"); }
    if (i == 9) { said.push_back("the newest sample of the IMU is 3 s after its image"); }
  }
  std::string const at_rate = rate + "; in 2 of 10 frames, first in frame 5";
  std::vector<std::string> wanted = {
      "samples of the IMU left out: 9 that are not finite; first in frame 3", at_rate,
      "the newest sample of the IMU is 1.5e+04 s after its image; in 2 of 10 frames, first in "
      "frame 8"};
  EXPECT_EQ(seq::warnings_of(r), wanted);
  // The recording's reader has told of the rate, but of nothing else.
  r.warnings = {"imu0/data.csv: samples come at 50 Hz, rate_hz says 200: the noise"};
  wanted.erase(wanted.begin() + 1);
  EXPECT_EQ(seq::warnings_of(r), wanted);
}

TEST(WarningsOf, ImpossibleSpeeds) {
  seq::run_report r = good_run(10);
  for (auto const& f : r.records) {
    seq::stamped_pose p;
    p.time_ns = f.time_ns;
    p.T_world_camera.translation().x() = 2.49 * f.index;  // a step of 50 ms
    r.estimate.push_back(p);
  }
  EXPECT_EQ(only_warning(r), "");
  r.estimate[4].T_world_camera.translation().x() += 0.1;
  EXPECT_TRUE(contains(only_warning(r), "moves at 51.8 m/s before pose 4, above 50 m/s"));
  r.metric = false;  // a speed of unknown scale is none
  EXPECT_EQ(only_warning(r), "");
}

TEST(WarningsOf, AStopGoesFirst) {
  seq::run_report r = good_run(10);
  r.stopped_at = 10;
  r.stopped_by = "SIGINT";
  r.maps = 2;
  auto const all = seq::warnings_of(r);
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[0], "stopped at frame 10: SIGINT");
}

}  // namespace warnings_test
