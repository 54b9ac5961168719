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
  EXPECT_NE(page.find("Known from frame 5; 50 poses optimised with it, 5 frames"),
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
