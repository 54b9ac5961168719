// SPDX-License-Identifier: Apache-2.0
/// @file An odometry, and what the program measures of it.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/types.hpp"
#include "examples/track_sequence/stage_sums.hpp"
#include "ft/any_odometry.hpp"
#include "ft/pipelines/explain.hpp"

namespace app {

/// One left keypoint of the last processed frame, for drawing.
struct seen_keypoint {
  float x, y;
  int octave;
  float depth;   ///< metres, -1 = none
  int point;     ///< map point held, -1 = none
  bool matched;  ///< matched to a map point from before this frame
};

struct frame_outcome {
  ft::tracking found;
  bool tracked = false;                    ///< has a pose that is no guess
  std::vector<std::string> imu_warnings;   ///< what is likely wrong with its samples
  std::optional<ft::imu_explanation> imu;  ///< whether it is used; nothing without one
  std::vector<double> stage_ms;  ///< one per stage_names(), of measure_stages, else the last alone
  double images_to_pose_ms = 0;  ///< from handing the images over to having the pose
  std::string reason;            ///< why it is not tracked, or to be doubted; empty = neither
  std::string why;               ///< the same as a sentence
  std::vector<std::pair<std::string, std::string>> warnings;  ///< names and sentences
};

/// Frames of one camera, or of one pair.
class timed_odometry {
public:
  timed_odometry(ft::any_odometry odometry, ft::rig_description const& rig);

  /// @param time_ns one that stands still or goes back is taken for one at the usual distance
  frame_outcome track(ft::any_images const& images, std::int64_t time_ns);
  void prefetch(ft::any_images const& images);
  void forget_prefetched();
  frame_outcome track_prefetched(std::int64_t time_ns);

  std::vector<std::string> const& stage_names() const { return sums_.names(); }  ///< last: "total"
  std::vector<seen_keypoint> keypoints() const;  ///< of the last frame
  /// Writes the points of the map as PLY. @param T_file_odom maps them to the file's world
  /// @param scale that they are multiplied by first
  void write_map(std::ostream& to, ft::pose const& T_file_odom, float scale) const;
  ft::any_odometry& odometry() { return odometry_; }

private:
  std::int64_t later_than_before(std::int64_t time_ns);
  template <typename Track>
  frame_outcome timed(Track const& track);

  ft::any_odometry odometry_;
  stage_sums sums_;
  std::int64_t time_ns_ = 0;      ///< of the last frame
  std::int64_t interval_ns_ = 1;  ///< time from the preceding frame to it
  double prefetch_ms_ = 0;        ///< in prefetch(), since the last frame
  std::deque<double> handed_ms_;  ///< when the prefetched frames were given
  int frames_ = 0;
};

}  // namespace app
