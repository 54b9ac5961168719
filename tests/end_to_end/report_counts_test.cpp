// SPDX-License-Identifier: Apache-2.0
/// @file What track_sequence says of a frame: the same number in its table and in its report.
#include <gtest/gtest.h>

#include <map>
#include <string>

#include "examples/sequence/report_palette.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/end_to_end/track_support.hpp"
#include "tests/support/sequence.hpp"

namespace {

using namespace app_test;

/// Inliers of the frames that are drawn, from the pictures' captions.
std::map<int, int> inliers_of_pictures(std::string const& html) {
  std::map<int, int> all;
  std::string const opening = "<b>Frame ";
  for (std::size_t at = html.find(opening); at != std::string::npos;
       at = html.find(opening, at + 1)) {
    std::string const caption = html.substr(at, html.find("</figcaption>", at) - at);
    std::size_t const end = caption.rfind(" inliers");
    std::size_t const begin = caption.rfind(' ', end - 1);
    if (end == std::string::npos || begin == std::string::npos) {
      ADD_FAILURE() << caption;
      continue;
    }
    std::string digits;
    for (char const c : caption.substr(begin, end - begin)) {
      if (c >= '0' && c <= '9') { digits += c; }  // thousands are set apart
    }
    all[std::stoi(caption.substr(opening.size()))] = std::stoi(digits);
  }
  return all;
}

/// @return keyframes among the frames that are drawn
int expect_equal_counts(std::string const& out, int pairs) {
  results const r = read_results(out, pairs);
  auto const drawn = inliers_of_pictures(read_file(out + "/report.html"));
  EXPECT_FALSE(drawn.empty());
  int keyframes = 0;
  for (auto const& [frame, inliers] : drawn) {
    auto const& row = r.times.at(static_cast<std::size_t>(frame));
    EXPECT_EQ(row.at("index"), std::to_string(frame));
    EXPECT_EQ(row.at("inliers"), std::to_string(inliers)) << "frame " << frame;
    keyframes += static_cast<int>(row.at("keyframe") == "1");
  }
  // there was no map to match
  EXPECT_EQ(r.times.at(0).at("keyframe"), "1");
  EXPECT_EQ(r.times.at(0).at("inliers"), "0");
  return keyframes;
}

// Every frame is drawn, the first one makes the map.
TEST(ReportCounts, PointsOfTheFrameItselfAreNoInliers) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"))));
  EXPECT_GE(expect_equal_counts(folder.path("out"), few), 1);
}

// A car: every frame is a keyframe, with hundreds of new points.
TEST(ReportCounts, PointsOfAKeyframeAreNoInliers) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  temp_folder const folder;
  ASSERT_TRUE(
      succeeded(track(shared + "/data/kitti_0926_stereo", folder.path("out"), {"--frames", "6"})));
  EXPECT_EQ(expect_equal_counts(folder.path("out"), 6), 6);
}

// The last stage is the whole frame, which is drawn as a line.
TEST(ReportCounts, EveryStageHasAColour) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--timing"})));
  results const r = read_results(folder.path("out"), few);
  EXPECT_LE(r.summary.at("stages").size() - 1, seq::detail::stage_palette.size());
  EXPECT_GE(r.summary.at("stages").size() - 1, 15u);
}

}  // namespace
