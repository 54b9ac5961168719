// SPDX-License-Identifier: Apache-2.0
// The IMU in the outputs of a run.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "examples/sequence/report.hpp"

namespace report_inertial_test {

/// Known from frame 5 on; frames 20 to 24 are not found.
seq::run_report run_of(int frames) {
  seq::run_report r;
  r.with_imu = true;
  r.stages = {"total"};
  r.frames = frames;
  for (int i = 0; i < frames; ++i) {
    seq::frame_record record;
    record.index = i;
    record.time_ns = std::int64_t{50'000'000} * i;
    record.tracked = i < 20 || i >= 25;
    record.stage_ms = {1.0};
    if (i >= 5) {
      record.imu = seq::imu_record{record.tracked,
                                   {0.5, 0.01 * i, -1},
                                   {0.001, -0.002, 0.003},
                                   {0.01, 0.02, -0.03},
                                   {0, 9.81, 0}};
    }
    r.records.push_back(record);
  }
  return r;
}

class report_inertial : public ::testing::Test {
protected:
  std::string written(void (*write)(std::string const&, seq::run_report const&),
                      seq::run_report const& r) const {
    std::string const path =
        (std::filesystem::path(::testing::TempDir()) / "ft_report_inertial").string() +
        ::testing::UnitTest::GetInstance()->current_test_info()->name();
    write(path, r);
    std::ifstream in(path, std::ios::binary);
    std::string text{std::istreambuf_iterator<char>(in), {}};
    in.close();
    std::filesystem::remove(path);
    return text;
  }
};

TEST_F(report_inertial, the_summary_has_what_the_imu_did) {
  auto const j = nlohmann::json::parse(written(seq::write_summary_json, run_of(40)));
  EXPECT_EQ(j["imu"]["known_from"], 5);
  EXPECT_EQ(j["imu"]["optimized"], 30);
  EXPECT_EQ(j["imu"]["bridged"], 5);
  EXPECT_DOUBLE_EQ(j["imu"]["velocity"][1], 0.39);
  EXPECT_DOUBLE_EQ(j["imu"]["gyro_bias"][2], 0.003);
  EXPECT_DOUBLE_EQ(j["imu"]["accel_bias"][0], 0.01);
  EXPECT_DOUBLE_EQ(j["imu"]["gravity"][1], 9.81);
  auto const early = nlohmann::json::parse(written(seq::write_summary_json, run_of(4)));
  EXPECT_TRUE(early["imu"]["known_from"].is_null());
  EXPECT_FALSE(early["imu"].contains("velocity"));
  seq::run_report without = run_of(10);
  without.with_imu = false;
  EXPECT_TRUE(nlohmann::json::parse(written(seq::write_summary_json, without))["imu"].is_null());
}

TEST_F(report_inertial, the_table_has_a_column_for_each_value) {
  std::istringstream in(written(seq::write_times_csv, run_of(7)));
  std::string head;
  std::getline(in, head);
  EXPECT_NE(head.find("total_ms,imu_optimized,velocity_x"), std::string::npos);
  auto const columns = [](std::string const& line) {
    return std::count(line.begin(), line.end(), ',');
  };
  std::string line;
  int rows = 0;
  for (; std::getline(in, line); ++rows) { EXPECT_EQ(columns(line), columns(head)) << line; }
  EXPECT_EQ(rows, 7);
  EXPECT_NE(written(seq::write_times_csv, run_of(7)).find(",1,0.500000,0.060000,-1.000000,0.001"),
            std::string::npos);
}

TEST_F(report_inertial, the_page_draws_velocity_and_biases) {
  std::string const page = written(seq::write_html, run_of(60));
  EXPECT_NE(page.find("Gravity and biases: known from frame 5, 50 poses optimised with it, 5 "),
            std::string::npos);
  for (char const* title : {"Velocity in the world", "Bias of the gyroscope", "Bias of the acc"}) {
    EXPECT_NE(page.find(title), std::string::npos) << title;
  }
  EXPECT_EQ(page.find("nan"), std::string::npos);
  EXPECT_NE(written(seq::write_html, run_of(3)).find("never known"), std::string::npos);
  seq::run_report without = run_of(10);
  without.with_imu = false;
  EXPECT_EQ(written(seq::write_html, without).find("gyroscope"), std::string::npos);
}

// Frames 0 to 4 wait for keyframes, 20 to 24 have no samples.
seq::run_report with_states(int frames) {
  seq::run_report r = run_of(frames);
  for (auto& f : r.records) {
    f.imu_state = f.index < 5 ? "initialising" : f.tracked ? "used" : "known";
    if (f.imu_state == "used") { continue; }
    f.imu_reason = f.index < 5 ? "few_keyframes" : "no_samples";
    f.imu_why = f.index < 5 ? "8 keyframes are <asked> for" : "there are none";
  }
  return r;
}

TEST_F(report_inertial, all_outputs_have_the_state_and_its_reason) {
  seq::run_report r = with_states(40);
  r.records[30].imu_clock_offset_s = -0.0125;
  r.records[31].imu_turn = Eigen::Vector3d(0.01, -0.02, 0.5);
  std::ostringstream out;
  seq::print_summary(out, r);
  std::string const page = written(seq::write_html, r);
  for (char const* said : {"used in 30 of 40 frames, first in frame 5\n",
                           "known (no_samples) in 5 of 40 frames, first in frame 20: there are"}) {
    EXPECT_NE(out.str().find(std::string("  IMU state         ") + said), std::string::npos)
        << out.str();
  }
  EXPECT_NE(page.find("<li>initialising (few_keyframes) in 5 of 40 frames, first in frame 0: 8 "
                      "keyframes are &lt;asked&gt; for</li>"),
            std::string::npos);
  EXPECT_EQ(
      nlohmann::json::parse(written(seq::write_summary_json, r))["imu"]["states"],
      (nlohmann::json{
          {"initialising", {{"few_keyframes", 5}}}, {"used", 30}, {"known", {{"no_samples", 5}}}}));
  std::string const table = written(seq::write_times_csv, r);
  EXPECT_NE(table.find(",imu_state,imu_reason,imu_clock_offset_s,imu_turn_x,imu_turn_y,imu_turn_z,"
                       "images_to_pose_ms"),
            std::string::npos);
  EXPECT_NE(table.find(",initialising,few_keyframes,"), std::string::npos);
  EXPECT_NE(table.find(",used,,-0.012500,,,,"), std::string::npos);
  EXPECT_NE(table.find(",used,,,,,,"), std::string::npos);
  EXPECT_NE(table.find(",used,,,0.010000,-0.020000,0.500000,"), std::string::npos);
}

TEST_F(report_inertial, an_imu_that_was_never_known_has_a_reason) {
  seq::run_report const r = with_states(4);
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("  IMU               never known; at the end initialising: 8 keyframes"),
            std::string::npos)
      << out.str();
  EXPECT_NE(written(seq::write_html, r).find("never known; at the end initialising: 8 keyframes"),
            std::string::npos);
  // Known before: the end says why it is no longer used.
  std::ostringstream later;
  seq::print_summary(later, with_states(23));
  EXPECT_NE(later.str().find("frames without a match bridged; at the end known: there are none"),
            std::string::npos)
      << later.str();
}

TEST_F(report_inertial, the_printed_summary_has_the_biases) {
  std::ostringstream out;
  seq::print_summary(out, run_of(40));
  EXPECT_NE(out.str().find("gyro bias         0.00100 -0.00200 0.00300 rad/s"), std::string::npos)
      << out.str();
  std::ostringstream early;
  seq::print_summary(early, run_of(4));
  EXPECT_NE(early.str().find("never known"), std::string::npos);
}

}  // namespace report_inertial_test
