// SPDX-License-Identifier: Apache-2.0
/// @file Tracks the frames of a sequence and collects what the report says of them.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "examples/sequence/odometry_input.hpp"
#include "examples/sequence/reader.hpp"
#include "examples/sequence/rectify.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/corrected_path.hpp"
#include "examples/track_sequence/options.hpp"
#include "examples/track_sequence/recording.hpp"
#include "examples/track_sequence/setup.hpp"
#include "examples/track_sequence/timed_odometry.hpp"

namespace app {

/// One run over a sequence.
class tracking_run {
public:
  /// @param a with a number of pairs to read ahead
  /// @param report gets records, poses, samples and counts; has the names of stages
  /// @throws seq::error for a recording that cannot be written
  tracking_run(arguments const& a, seq::sequence const& sequence, odometry_setup const& setup,
               timed_odometry& odometry, seq::run_report& report);

  /// Reads ahead on other threads and tracks. Ends after the last frame, at a signal, or at an
  /// image that cannot be read; report.stopped_at and stopped_by tell these apart.
  void track_all();

private:
  bool dropped(int i) const;
  void track(int i, seq::stereo_frame frame);
  std::optional<corrected_keyframes> corrected_now(ft::tracking const& found);
  void add_imu(std::int64_t to_ns);
  void add_record(int i, std::int64_t time_ns, frame_outcome const& outcome);
  void add_sample(int i, seq::image picture);
  void add_points(ft::rigid<double> const& T_wc);
  double arrival_ms(int i) const;

  arguments const& arguments_;
  seq::sequence const& sequence_;
  timed_odometry& odometry_;
  seq::odometry_masks masks_;
  seq::run_report& report_;
  double scale_factor_;
  int prefetch_;  ///< frames that the odometry gets early
  seq::lens_projection left_lens_;
  std::optional<recording> recording_;
  corrected_path path_;  ///< with --loops
  /// Of the last frame that was recorded.
  ft::rigid<double> T_world_odom_ = ft::rigid<double>::identity();
  std::vector<seen_keypoint> before_;  ///< keypoints of frame before_index_
  int before_index_ = -2;
  double busy_until_ms_ = 0;     ///< on the sequence's own clock, for --realtime
  std::size_t next_sample_ = 0;  ///< of the IMU
  int points_seen_ = 0;
  int points_step_ = 1;  ///< every so many-th new point is kept
};

}  // namespace app
