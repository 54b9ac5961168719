// SPDX-License-Identifier: Apache-2.0
/// @file What track_sequence --record writes, against the sequence and the other outputs of the
/// run. python/tests/test_view.py reads it as the viewer does.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/end_to_end/track_support.hpp"

namespace {

using namespace app_test;

/// A frame has its pose, image and keypoints.
void expect_frame(json const& frame, seq::stamped_pose const& pose, seq::image const& left,
                  std::string const& folder) {
  EXPECT_EQ(frame.at("time_ns"), pose.time_ns);
  EXPECT_TRUE(frame.at("tracked").get<bool>());
  auto const T = frame.at("T_world_camera").get<std::vector<double>>();
  ASSERT_EQ(T.size(), 12u);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) {
      EXPECT_NEAR(T[static_cast<std::size_t>(4 * r + c)], pose.T_world_camera(r, c), 1e-6);
    }
  }
  EXPECT_EQ(seq::read_image(folder + "/" + frame.at("image").get<std::string>()).pixels,
            left.pixels);
  std::size_t const n = frame.at("counts").at("keypoints").get<std::size_t>();
  std::size_t with_depth = 0;
  for (char const* name : {"x", "y", "depth", "point", "matched"}) {
    ASSERT_EQ(frame.at(name).size(), n) << name;
  }
  for (std::size_t i = 0; i < n; ++i) {
    with_depth += static_cast<std::size_t>(frame.at("depth")[i].get<double>() > 0);
    EXPECT_GE(frame.at("x")[i].get<double>(), 0);
    EXPECT_LT(frame.at("x")[i].get<double>(), width);
  }
  EXPECT_EQ(frame.at("counts").at("with depth"), with_depth);
}

TEST(Recording, HasTheFramesOfTheRun) {
  temp_folder const folder;
  std::string const record = folder.path("record");
  ASSERT_TRUE(
      succeeded(track(generated(few), folder.path("out"), {"--timing", "--record", record})));
  strings const lines = lines_of(read_file(record + "/recording.jsonl"));
  ASSERT_EQ(lines.size(), 1u + few);
  auto const sequence = seq::sequence::open(generated(few));
  json const header = json::parse(lines[0]);
  EXPECT_EQ(header.at("ft_recording"), 1);
  EXPECT_EQ(header.at("width"), width);
  EXPECT_EQ(header.at("height"), height);
  EXPECT_EQ(header.at("camera").size(), 4u);
  EXPECT_EQ(header.at("camera")[0], sequence.rig().left.fx);
  EXPECT_EQ(header.at("stages").back(), "total");
  EXPECT_EQ(header.at("truth").at("time_ns").size(), sequence.ground_truth().size());
  EXPECT_EQ(header.at("truth").at("T_world_camera").size(), sequence.ground_truth().size());
  auto const poses = seq::read_tum(folder.path("out/trajectory.txt"));
  ASSERT_EQ(poses.size(), static_cast<std::size_t>(few));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    json const frame = json::parse(lines[i + 1]);
    EXPECT_EQ(frame.at("frame"), i);
    EXPECT_EQ(frame.at("keyframe").get<bool>() || i > 0, true);  // the first one is
    EXPECT_EQ(frame.at("stage_ms").size(), header.at("stages").size());
    expect_frame(frame, poses[i], sequence.load(static_cast<int>(i)).left, record);
  }
}

TEST(Recording, OfAFisheyePairHasItsLens) {
  temp_folder const folder;
  std::string const sequence =
      generated(few, {"--rig", "fisheye", "--width", "320", "--height", "320"});
  std::string const record = folder.path("record");
  ASSERT_TRUE(
      succeeded(track(sequence, folder.path("out"), {"--frames", "2", "--record", record})));
  strings const lines = lines_of(read_file(record + "/recording.jsonl"));
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_EQ(json::parse(lines[0]).at("camera").size(), 8u);
  EXPECT_EQ(json::parse(lines[0]).at("model"), "KannalaBrandt");
  EXPECT_EQ(json::parse(lines[0]).at("stages"), json({"total"}));
}

TEST(Recording, ThatCannotBeWrittenIsSaid) {
  temp_folder const folder;
  EXPECT_TRUE(complained_of(
      track(generated(few), folder.path("out"), {"--record", "/dev/null/record"}), "--record"));
}

}  // namespace
