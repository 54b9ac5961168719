// SPDX-License-Identifier: Apache-2.0
/// @file Opens a sequence on disk: a rig of cameras, a pair or one, in EuRoC's (ASL), KITTI
/// odometry's (image_0 and image_1, or without them the colour images image_2 and image_3) or KITTI
/// raw's layout, or a camera with depth images in that of TUM RGB-D (rgb.txt and depth.txt, or
/// associations.txt), ICL-NUIM, OpenLORIS or 7-Scenes, or plain folders of images (left and right,
/// or one). Depth images of a rig's camera cam2 are in depth2 beside it.
#pragma once

#include <cstdint>
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

/// Reads the samples of an IMU, a line each: time stamp in ns, angular rate in rad/s, specific
/// force in m/s^2, as EuRoC's data.csv, or in the columns that a heading names so (omega_x, gyro_x,
/// wx; alpha_x, acc_x, ax ...); others are ignored. A line that is not finite, or whose stamp is
/// doubled or out of order, is left out.
/// @param warnings gets a sentence for lines that were left out, for columns that were taken by
///   name, and for stamps that are not in ns
/// @throws seq::error naming file and line: not seven numbers; or without any sample
std::vector<imu_sample> read_imu_samples(std::string const& path,
                                         std::vector<std::string>* warnings = nullptr);

struct open_options {
  /// Calibration file or folder to use instead of the folder's own: whatever read_calibration
  /// knows. Empty = the folder's.
  std::string calibration;
  /// Keeps fisheye (Kannala-Brandt) pairs and single cameras as they are; others are rectified on
  /// load: a single camera to a pinhole. Mixed rigs are never rectified. A rectified row of a
  /// rolling shutter has one time, though the lens shows rows of several; with `mixed` times are
  /// exact.
  bool keep_fisheye = true;
  /// Reads at most this many frames; 0 = all.
  int max_frames = 0;
  /// Reads the IMU's samples from mav0/imu0, or of plain folders from imu0/data.csv or imu.csv.
  /// Without it no file of the IMU is opened.
  bool read_imu = false;
  /// What to open: with `any` a pair where there is one, else the camera with its depth images
  /// where there are some, else the one camera. With `mixed` a pair and the cameras beside it.
  camera_kind rig = camera_kind::any;
  /// How far the time stamps of the two images of a frame may be apart, at least 0. Nothing = 1 ms
  /// for a pair of cameras, 20 ms for colour and depth.
  std::optional<std::int64_t> max_time_difference_ns;
  /// Metres per unit of the depth images, 1e-9 to 1e3; 0 = as the calibration says (camera.txt, or
  /// a settings file's RGBD.DepthMapFactor), else 0.001 of OpenLORIS and 7-Scenes, else 1/5000, as
  /// TUM RGB-D has it.
  double depth_unit = 0;
  /// Bits that hold the samples of 16-bit images of one channel, 8 to 16; 0 = 16, with a warning
  /// where up to eight images of each camera have none of 2^14 or more. Depth images have all 16.
  int image_bits = 0;
  /// Of each camera in turn, left, right, cam2 ...: an image that is 0 where no keypoints are
  /// wanted, or a folder with one for each frame that has the name of the camera's image. They have
  /// the size of the images on disk, and are rectified with them. Empty text = none; cameras after
  /// the last one have none.
  std::vector<std::string> masks;
  /// Images a second, 1e-3 to 1e5, of plain folders whose file names are no times, of 7-Scenes, and
  /// of ICL-NUIM, whose stamps count frames; 0 = the names, or the file that has the times, say it;
  /// 7-Scenes has 30.
  double fps = 0;
  /// Of plain folders: file with a time for each image, a line each, in seconds with a decimal
  /// point, in whole seconds, milli-, micro- or nanoseconds, or as dates such as
  /// 2011-09-26 13:02:25.964. Whole numbers that are no times since 1970 are told apart by their
  /// step. Empty = times.txt or timestamps.txt, if it is there.
  std::string times;
};

/// Where things were found, for people.
struct recording_source {
  std::string calibration;   ///< file or folder
  std::string stamps;        ///< a file's name, the file names, or the rate
  std::string imu_left_out;  ///< why no IMU was read although it was asked for; else empty
};

/// The sequence has no calibration of its own and none was named.
struct missing_calibration : error {
  using error::error;
};

/// Images that were left out because the other camera has none of the same time; with depth images
/// `left` are those of the camera, `right` the depth images.
struct unpaired_images {
  int left = 0;
  int right = 0;
};

/// An opened sequence; frames are loaded one at a time. Movable. Several threads may call the
/// functions of one object that are const.
class sequence {
public:
  /// @throws seq::error: no such folder, no layout recognised, no images, not the rig asked for,
  ///   unreadable or absurd calibration (focal length not positive, NaN, zero baseline, sizes that
  ///   differ from the images'), no frame with all its images, an IMU's file that is damaged;
  ///   missing_calibration
  static sequence open(std::string const& directory, open_options const& options = {});

  sequence(sequence&&) noexcept;
  sequence& operator=(sequence&&) noexcept;
  ~sequence();

  std::string const& name() const;  ///< the folder's name
  /// "euroc", "kitti", "kitti_raw", "tum", "openloris", "7scenes" or "folders"
  std::string const& layout() const;
  recording_source const& source() const;
  camera_kind kind() const;  ///< stereo, mono or rgbd
  /// The rig of the frames that load() returns: pinholes, rectified for a pair, or with fisheye()
  /// Kannala-Brandt cameras. See stereo_rig for one camera.
  stereo_rig const& rig() const;
  /// The cameras as calibrated.
  stereo_rig const& raw_rig() const;
  bool fisheye() const;
  /// Whether the images are those of rig_cameras(), as they are: `mixed` was asked for.
  bool mixed() const;
  double depth_unit() const;                   ///< metres per unit of depth images; 0 without
  std::string const& depth_unit_from() const;  ///< who says so, for people
  /// What was left out or looks wrong, a sentence each: lines with doubled time stamps, stamps that
  /// differ, units, an IMU's rate, keys of the calibration that are not taken. Unpaired images are
  /// not among them.
  std::vector<std::string> const& warnings() const;
  bool has_body_frame() const;  ///< rig().T_body_left was given; otherwise it is the identity
  bool masked() const;          ///< whether frames have masks
  unpaired_images unpaired() const;
  orb_settings const& settings() const;  ///< empty unless an ORB-SLAM3 settings file was given
  int size() const;                      ///< frames
  std::int64_t time_ns(int i) const;
  /// Decodes frame i, and rectifies it if needed: a depth image takes the nearest pixel then.
  /// @throws seq::error for a broken file or a size that differs from the calibration's
  stereo_frame load(int i) const;
  /// Ground truth of the left camera (the body's moved by T_body_left and by the rectifying
  /// rotation), sorted by time; empty if the sequence has none.
  trajectory const& ground_truth() const;
  /// Nothing unless open_options::read_imu was set, and samples are there with noise and place of
  /// the IMU: those of the calibration, or else of the sensor.yaml beside the samples.
  std::optional<imu_recording> const& imu() const;
  /// False if ground truth gives positions only (all orientations identity).
  bool ground_truth_has_orientation() const;

private:
  struct impl;
  explicit sequence(std::unique_ptr<impl> p);
  std::unique_ptr<impl> impl_;
};

/// A camera of a rig that is not rectified.
struct rig_camera : mounted_camera {
  int right = -1;  ///< number of the camera that its depths come from; -1 = it is a single one
  bool has_depth = false;  ///< it has depth images, and is in no pair
};

/// All cameras of a rig, the left one first. Two without depth images make a pair that look the
/// same way within 45 degrees and are in two places; the first one that is left is taken.
std::vector<rig_camera> rig_cameras(stereo_rig const& rig);

/// What was found in a recording, for people.
struct description_line {
  std::string name;  ///< sequence, cameras, images, imu, truth; left out
  std::string text;
};

/// Five lines: layout and calibration; cameras and their size; rate and length; IMU; ground truth.
/// A sixth where images were left out; other things that were are warnings().
std::vector<description_line> describe(sequence const& s, bool imu_asked_for = true);

}  // namespace seq
