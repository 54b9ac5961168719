// SPDX-License-Identifier: Apache-2.0
// times.csv and what a terminal shows.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <limits>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "examples/sequence/report.hpp"
#include "tests/support/report_markup.hpp"
#include "tests/support/report_runs.hpp"

namespace report_test {

TEST_F(report, csv_has_a_row_for_each_frame) {
  seq::run_report r = filled(3, false);
  r.records[1].stage_ms = {1.5, nan_value};  // one unusable, one missing
  r.records[0].images_to_pose_ms = 5;
  r.records[1].reason = "dark";
  r.records[1].map_id = 2;
  r.records[1].map_begun = true;
  r.records[1].warnings = {{"dark", "nearly black"}, {"two_motions", "things move"}};
  r.records[1].imu_warnings = {"samples come too late"};
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[0],
            "index,time_s,tracked,keyframe,keypoints,stereo_matches,inliers,local_points,fast_ms,"
            "match_ms,"
            "total_ms,images_to_pose_ms,reason,map_id,map_begun,warnings");
  EXPECT_EQ(
      lines[1],
      "0,1403636579.763555584,1,1,1000,600,200,800,1.000000,2.000000,4.000000,5.000000,,0,0,");
  EXPECT_EQ(
      lines[2],
      "1,1403636579.813555584,1,0,1000,600,201,800,1.500000,,,,dark,2,1,dark two_motions imu");
  for (auto const& line : lines) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 15) << line;
  }
}

TEST_F(report, csv_has_the_covariances_that_are_known) {
  seq::run_report r = filled(2, false);
  for (int i = 0; i < 21; ++i) { r.records[0].covariance.push_back(0.5 + 1e-7 * i); }
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_NE(lines[0].find(",covariance_00,covariance_01,"), std::string::npos);
  EXPECT_NE(lines[0].find(",covariance_05,covariance_11,"), std::string::npos);
  EXPECT_NE(lines[0].find(",covariance_45,covariance_55,images_to_pose_ms,"), std::string::npos);
  EXPECT_NE(lines[1].find(",0.5,0.5000001,"), std::string::npos);
  EXPECT_NE(lines[1].find(",0.5000019,0.500002,"), std::string::npos);
  EXPECT_NE(lines[2].find(std::string(21, ',')), std::string::npos);
  for (auto const& line : lines) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), 15 + 21) << line;
  }
}

TEST_F(report, csv_quotes_names_and_keeps_signs) {
  seq::run_report r;
  r.stages = {"a,\"b\""};
  r.records.resize(1);
  r.records[0].time_ns = -1'500'000'000;
  seq::write_times_csv(file("times.csv"), r);
  auto const lines = split(read_text(file("times.csv")), '\n');
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_NE(lines[0].find(",\"a,\"\"b\"\"_ms\""), std::string::npos);
  EXPECT_EQ(lines[1].rfind("0,-1.500000000,0,0,", 0), 0U);
}

TEST_F(report, summary_table_is_aligned) {
  std::ostringstream out;
  out.precision(3);
  seq::print_summary(out, filled(20, true));
  std::string const text = out.str();
  std::vector<std::size_t> widths;
  for (std::string const& line : split(text, '\n')) {
    for (char const* start : {"  stage", "  fast ", "  match ", "  total "}) {
      if (line.rfind(start, 0) == 0) { widths.push_back(line.size()); }
    }
  }
  ASSERT_EQ(widths.size(), 4U);
  for (std::size_t const w : widths) { EXPECT_EQ(w, widths[0]); }
  EXPECT_NE(text.find("0.0500 m"), std::string::npos);
  EXPECT_NE(text.find("400.000"), std::string::npos);
  EXPECT_EQ(text.find("n/a"), std::string::npos);
  EXPECT_EQ(out.precision(), 3);  // the stream is left as it was
}

TEST_F(report, summary_says_where_there_is_no_value) {
  std::ostringstream out;
  seq::print_summary(out, {});
  EXPECT_NE(out.str().find("ATE RMSE          n/a (no ground truth)"), std::string::npos);
  EXPECT_NE(out.str().find("throughput        n/a"), std::string::npos);
  EXPECT_EQ(out.str().find("nan"), std::string::npos);
}

TEST_F(report, progress_prints_a_line_every_ten_percent) {
  std::ostringstream out;
  seq::progress p(out, false, "track", 300);
  for (int i = 1; i <= 300; ++i) { p.step(i, i == 30 ? "note" : ""); }
  p.finish();
  auto const lines = split(out.str(), '\n');
  ASSERT_EQ(lines.size(), 10U);
  EXPECT_EQ(lines[0].rfind("track  30/300  10 %", 0), 0U);
  EXPECT_NE(lines[0].find("  note"), std::string::npos);
  EXPECT_EQ(lines[9].rfind("track  300/300  100 %", 0), 0U);
  EXPECT_EQ(lines[9].find("ETA"), std::string::npos);
  EXPECT_EQ(out.str().find('\r'), std::string::npos);
}

TEST_F(report, progress_takes_odd_totals) {
  for (int const total : {0, -1, 1, 3, std::numeric_limits<int>::max()}) {
    std::ostringstream out;
    seq::progress p(out, false, "x", total);
    p.step(0);
    p.step(1);
    p.step(5);
    p.finish();
    EXPECT_EQ(out.str().find("nan"), std::string::npos) << total;
    EXPECT_LE(split(out.str(), '\n').size(), 3U) << total;
  }
}

TEST_F(report, progress_redraws_seldom_on_a_terminal) {
  std::ostringstream out;
  seq::progress p(out, true, "track", 1000);
  for (int i = 1; i <= 1000; ++i) { p.step(i); }
  // well under a second passes here: the first, the last, and at most ten a second between
  int const early = count(out.str(), "\r");
  EXPECT_GE(early, 2);
  EXPECT_LE(early, 12);
  EXPECT_EQ(out.str().find('\n'), std::string::npos);
  EXPECT_NE(out.str().find("1000/1000  100 %"), std::string::npos);
  p.finish();
  p.finish();
  EXPECT_EQ(count(out.str(), "\n"), 1);

  std::ostringstream slow;
  seq::progress q(slow, true, "track", 10);
  q.step(1);
  std::this_thread::sleep_for(std::chrono::milliseconds(120));
  q.step(2);
  EXPECT_EQ(count(slow.str(), "\r"), 2);
  EXPECT_NE(slow.str().find("ETA"), std::string::npos);
}

}  // namespace report_test
