// SPDX-License-Identifier: Apache-2.0
/// @file Opens a stereo sequence on disk: EuRoC (ASL) or KITTI odometry layout (image_0 and
/// image_1, or without them the colour images image_2 and image_3).
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

/// ORB settings found in an ORB-SLAM3 settings file; absent fields stay empty.
struct orb_settings {
  std::optional<int> features;
  std::optional<int> levels;
  std::optional<double> scale_factor;
  std::optional<int> ini_threshold;
  std::optional<int> min_threshold;
  std::optional<double> depth_threshold;  ///< Stereo.ThDepth, in baselines
};

/// Samples of an IMU and what has to be known about them.
struct imu_recording {
  imu_calibration calibration;
  /// Maps points of the left camera of loaded frames into the IMU's frame, metres.
  Eigen::Isometry3d T_imu_left = Eigen::Isometry3d::Identity();
  std::vector<imu_sample> samples;  ///< sorted by time, none twice
};

/// Reads the data.csv of an EuRoC IMU: time stamp in ns, angular rate in rad/s, specific force in
/// m/s^2; further columns are ignored. @throws seq::error naming file and line: not seven finite
/// numbers, time stamps that do not increase; or without any sample
std::vector<imu_sample> read_imu_samples(std::string const& path);

struct open_options {
  /// Calibration file to use instead of the folder's own: sensor.yaml's parent `mav0`, a KITTI
  /// calib.txt, or an ORB-SLAM3 settings file (PinHole, Rectified, KannalaBrandt8). Empty = the
  /// folder's.
  std::string calibration;
  /// Keeps fisheye (Kannala-Brandt) pairs as they are; otherwise every pair is rectified on load.
  bool keep_fisheye = true;
  /// Reads at most this many frames; 0 = all.
  int max_frames = 0;
  /// Reads the IMU's samples, EuRoC layout, from mav0/imu0. Without it no file of the IMU is
  /// opened.
  bool read_imu = false;
};

/// The sequence has no calibration of its own and none was named.
struct missing_calibration : error {
  using error::error;
};

/// Images that were left out because the other camera has none of the same time.
struct unpaired_images {
  int left = 0;
  int right = 0;
};

/// An opened sequence; frames are loaded one at a time. Movable. Several threads may call the
/// functions of one object that are const.
class sequence {
public:
  /// @throws seq::error: no such folder, no layout recognised, no images, unreadable or absurd
  ///   calibration (focal length not positive, NaN, zero baseline, sizes that differ from the
  ///   images'), fewer than one stereo pair with equal time stamps, an IMU's file that is damaged;
  ///   missing_calibration
  static sequence open(std::string const& directory, open_options const& options = {});

  sequence(sequence&&) noexcept;
  sequence& operator=(sequence&&) noexcept;
  ~sequence();

  std::string const& name() const;    ///< the folder's name
  std::string const& layout() const;  ///< "euroc" or "kitti"
  /// The rig of the frames that load() returns: rectified pinholes, or the fisheye pair.
  stereo_rig const& rig() const;
  bool fisheye() const;
  bool has_body_frame() const;  ///< rig().T_body_left was given; otherwise it is the identity
  unpaired_images unpaired() const;
  orb_settings const& settings() const;  ///< empty unless an ORB-SLAM3 settings file was given
  int size() const;                      ///< stereo pairs
  std::int64_t time_ns(int i) const;
  /// Decodes pair i, and rectifies it if needed.
  /// @throws seq::error for a broken file or a size that differs from the calibration's
  stereo_frame load(int i) const;
  /// Ground truth of the left camera (the body's moved by T_body_left and by the rectifying
  /// rotation), sorted by time; empty if the sequence has none.
  trajectory const& ground_truth() const;
  /// Nothing unless open_options::read_imu was set, and mav0/imu0/data.csv is there with noise and
  /// place of the IMU: those of the calibration that was named, or else of mav0/imu0/sensor.yaml.
  std::optional<imu_recording> const& imu() const;
  /// False if ground truth gives positions only (all orientations identity).
  bool ground_truth_has_orientation() const;

private:
  struct impl;
  explicit sequence(std::unique_ptr<impl> p);
  std::unique_ptr<impl> impl_;
};

}  // namespace seq
