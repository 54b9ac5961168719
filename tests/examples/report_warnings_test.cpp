// SPDX-License-Identifier: Apache-2.0
// Warnings of frames in report.html: where in the run they are drawn.
#include <gtest/gtest.h>

#include <cstddef>
#include <string>
#include <vector>

#include "examples/sequence/report.hpp"
#include "tests/support/report_markup.hpp"
#include "tests/support/report_runs.hpp"
#include "tests/support/sequence.hpp"

namespace report_test {

using seq_test::contains;

/// As many frames as the charts are units wide, one more: frame i is drawn at 62 + i.
constexpr int frames_drawn = 925;

seq::run_report tracked_run() {
  seq::run_report r = filled(frames_drawn, false);
  for (auto& f : r.records) { f.tracked = true; }
  return r;
}

void warn(seq::run_report& r, std::string const& name, int begin, int end) {
  for (int i = begin; i < end; ++i) {
    r.records[static_cast<std::size_t>(i)].warnings.emplace_back(name, "said");
  }
}

/// The drawing that has this label; empty where there is none.
std::string drawing(std::string const& page, std::string const& label) {
  std::size_t const at = page.find("aria-label=\"" + label + '"');
  return at == std::string::npos ? std::string() : page.substr(at, page.find("</svg>", at) - at);
}

/// The data of all paths of a class, in their order.
std::vector<std::string> paths(std::string const& svg, std::string const& style) {
  std::string const head = "<path class=\"" + style + "\" d=\"";
  std::vector<std::string> all;
  for (std::size_t at = svg.find(head); at != std::string::npos; at = svg.find(head, at + 1)) {
    std::size_t const begin = at + head.size();
    all.push_back(svg.substr(begin, svg.find('"', begin) - begin));
  }
  return all;
}

TEST_F(report, warnings_are_drawn_where_they_happened) {
  seq::run_report r = tracked_run();
  warn(r, "two_motions", 100, 150);
  warn(r, "two_motions", 300, 301);
  warn(r, "dark", 900, frames_drawn);
  for (std::size_t i : {0U, 1U, 2U}) { r.records[i].imu_warnings = {"said"}; }
  std::string const page = html(r);
  EXPECT_EQ(markup_fault(page), "");
  std::string const svg = drawing(page, "Warnings per frame");
  // One strip a name, by the first frame; the axis ends with the first and the last frame.
  EXPECT_EQ(paths(svg, "warned"), (std::vector<std::string>{
                                      "M62 24H64.5V32H62Z",
                                      "M161.5 54H211.5V62H161.5ZM361.5 54H362.5V62H361.5Z",
                                      "M961.5 84H986V92H961.5Z",
                                  }));
  for (char const* label : {"imu: 3 of 925 frames, first in frame 0",
                            "two_motions: 51 of 925 frames, first in frame 100",
                            "dark: 25 of 925 frames, first in frame 900"}) {
    EXPECT_TRUE(contains(svg, label)) << label;
  }
  EXPECT_EQ(count(svg, "class=\"track\""), 3);
  EXPECT_TRUE(contains(page, "viewBox=\"0 0 1000 138\""));
}

// Frames 100 to 149 are lost and have a warning: both marks have the same ends.
TEST_F(report, warnings_and_counts_have_one_axis) {
  seq::run_report r = tracked_run();
  warn(r, "blurred", 100, 150);
  for (std::size_t i = 100; i < 150; ++i) { r.records[i].tracked = false; }
  std::string const page = html(r);
  auto const lost = paths(drawing(page, "Keypoints and inliers per frame"), "lost");
  ASSERT_EQ(lost.size(), 1U);
  EXPECT_EQ(lost[0], "M161.5 14H211.5V238H161.5Z");
  EXPECT_EQ(paths(drawing(page, "Warnings per frame"), "warned"),
            std::vector<std::string>{"M161.5 24H211.5V32H161.5Z"});
}

TEST_F(report, maps_have_borders_where_they_begin) {
  seq::run_report r = tracked_run();
  warn(r, "new_map", 400, 401);
  EXPECT_FALSE(contains(html(r), "a map begins"));
  r.records[0].map_begun = r.records[400].map_begun = true;
  std::string const page = html(r);
  EXPECT_EQ(markup_fault(page), "");
  EXPECT_EQ(paths(drawing(page, "Warnings per frame"), "level"),
            std::vector<std::string>{"M62 6V36M461.5 6V36"});
  EXPECT_EQ(paths(drawing(page, "Keypoints and inliers per frame"), "level"),
            std::vector<std::string>{"M62 14V238M461.5 14V238"});
  EXPECT_TRUE(contains(page, "a map begins"));
}

TEST_F(report, no_strip_without_warnings) {
  EXPECT_FALSE(contains(html(tracked_run()), "Warnings per frame"));
  EXPECT_FALSE(contains(html({}), "Warnings per frame"));
  seq::run_report one = filled(1, false);
  warn(one, "dark", 0, 1);
  EXPECT_EQ(paths(drawing(html(one), "Warnings per frame"), "warned"),
            std::vector<std::string>{"M62 24H986V32H62Z"});
}

// Every second of very many frames: marks that touch are one.
TEST_F(report, strips_of_long_runs_are_short) {
  seq::run_report r = filled(20 * frames_drawn, false);
  for (int i = 0; i < 20 * frames_drawn; i += 2) { warn(r, "<dark> & \"b\"", i, i + 1); }
  for (auto& f : r.records) { f.map_begun = true; }
  std::string const page = html(r);
  EXPECT_EQ(markup_fault(page), "");
  auto const marks = paths(drawing(page, "Warnings per frame"), "warned");
  ASSERT_EQ(marks.size(), 1U);
  EXPECT_LE(count(marks[0], "M"), 2);
  EXPECT_LE(count(paths(drawing(page, "Warnings per frame"), "level").at(0), "M"), 930);
}

}  // namespace report_test
