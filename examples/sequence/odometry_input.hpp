// SPDX-License-Identifier: Apache-2.0
/// @file From a recording to what an odometry of ft takes:
///
///     auto const recording = seq::sequence::open(folder);
///     ft::any_odometry odometry = ft::make_odometry({}, seq::odometry_rig(recording),
///                                                   seq::odometry_settings(recording));
///     for (int i = 0; i < recording.size(); ++i) {
///       seq::stereo_frame const frame = recording.load(i);
///       ft::tracking const t = odometry.track(seq::odometry_images(frame), frame.time_ns);
///     }
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <vector>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/types.hpp"
#include "ft/any_odometry.hpp"

namespace seq {

/// The rig of the frames that load() returns. Its body is the left camera. Depths of all lengths
/// are taken: rig_description::min_depth, max_depth.
ft::rig_description odometry_rig(sequence const& recording);

/// Image size, number of keypoints, pyramid and thresholds: those of a settings file, else 1200
/// keypoints, 2000 of wide images. With an IMU if it was read (open_options::read_imu); with a mask
/// of the images' size if frames have masks.
/// @param features keypoints of an image; 0 = these
ft::odometry_params odometry_settings(sequence const& recording, int features = 0);

/// Place and noise of the recording's IMU. Its samples are handed on by odometry_sample().
/// @pre recording.imu() has a value
ft::imu_params odometry_imu(sequence const& recording);
ft::imu_measurement odometry_sample(imu_sample const& sample);

/// The images of a frame, which outlives them; of a rig those that cameras miss are null. Masks of
/// a frame are not in it: odometry_masks.
ft::any_images odometry_images(stereo_frame const& frame);

/// Gives an odometry of odometry_settings() the masks of frames (open_options::masks), each one
/// once while frames share it.
class odometry_masks {
public:
  explicit odometry_masks(sequence const& recording) : mixed_(recording.mixed()) {}
  /// Before the frame's track() or prefetch(). Does nothing for a recording without masks.
  void set(ft::any_odometry& odometry, stereo_frame const& frame);

private:
  bool mixed_;  ///< image 2 c is that of camera c
  std::vector<std::shared_ptr<image const>> set_;
};

ft::rigid<double> odometry_pose(Eigen::Isometry3d const& T);
/// @param T camera to world
stamped_pose stamped(std::int64_t time_ns, ft::rigid<double> const& T);

}  // namespace seq
