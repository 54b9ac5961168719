// SPDX-License-Identifier: Apache-2.0
/// @file Reads the calibration of a stereo pair: EuRoC sensor.yaml, KITTI calib.txt, ORB-SLAM3
/// settings.
///
/// Every value read is checked (finite, focal lengths above 0, sizes 1 to 16384, baseline above 0,
/// rotations orthonormal). An error names file, key, value and limit. A radial-tangential camera
/// whose coefficients are all zero becomes a pinhole.
#pragma once

#include <optional>
#include <string>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/types.hpp"

namespace seq {

/// The content of a calibration file.
struct calibration {
  stereo_rig rig;
  orb_settings settings;        ///< ORB-SLAM3 settings files only
  bool has_body_frame = false;  ///< the file gives T_body_left; otherwise it is the identity
  /// ORB-SLAM3 settings files with an IMU's noise, whose body is the IMU.
  std::optional<imu_calibration> imu;
  /// KITTI: maps points of the left camera to the reference frame, which poses.txt is about.
  Eigen::Isometry3d T_reference_left = Eigen::Isometry3d::Identity();
};

/// EuRoC: `mav0`/cam0/sensor.yaml and `mav0`/cam1/sensor.yaml. Distortion models radial-tangential
/// (or radtan), equidistant (= Kannala-Brandt), none. T_BS maps camera points into the body.
/// @throws seq::error
calibration read_euroc_calibration(std::string const& mav0);

/// Only T_BS of `mav0`/cam0/sensor.yaml: maps points of the raw left camera into the body, metres.
/// @throws seq::error
Eigen::Isometry3d read_euroc_body_frame(std::string const& mav0);

/// EuRoC: sensor.yaml of an IMU: T_BS (maps points of its frame into the body), rate_hz, and
/// gyroscope_noise_density, gyroscope_random_walk, accelerometer_noise_density,
/// accelerometer_random_walk.
/// @throws seq::error; rate 1 to 20000 Hz, densities above 0
imu_calibration read_euroc_imu_calibration(std::string const& path);

/// KITTI: the lines "P0:" and "P1:" (or "P2:" and "P3:") of 12 numbers, 3x4 row-major projections
/// of one reference frame.
/// @param width,height the images' size, which the file does not give, pixels
/// @param left_camera number of the left camera, 0 (grey) or 2 (colour)
/// @throws seq::error
calibration read_kitti_calibration(std::string const& path, int width, int height,
                                   int left_camera = 0);

/// ORB-SLAM3 settings, both formats: `Camera1.fx` with `Stereo.T_c1_c2` (maps camera-2 points into
/// camera 1) or `Stereo.b`; and the older `Camera.fx` with `Camera.bf`, `LEFT.K` .. `RIGHT.P`, or
/// `Tlr`. IMU.T_b_c1 or Tbc gives the body frame. With any of IMU.NoiseGyro, NoiseAcc, GyroWalk,
/// AccWalk and Frequency (1 to 20000 Hz) all five must be there, densities above 0, and the body
/// frame. Camera.newWidth and newHeight (a scaling) are not applied.
/// @param width,height size to assume if the file gives none; 0 = the file must give it
/// @throws seq::error
calibration read_orb_slam3_settings(std::string const& path, int width = 0, int height = 0);

/// Any of these: a folder (`mav0`, or one that contains `mav0` or calib.txt), a cam0/sensor.yaml, a
/// KITTI calib.txt or an ORB-SLAM3 settings file; recognised by content.
/// @param width,height the images' size, for files that do not give it; 0 = unknown
/// @param left_camera see read_kitti_calibration
/// @throws seq::error
calibration read_calibration(std::string const& path, int width = 0, int height = 0,
                             int left_camera = 0);

/// @param source file to name in the message
/// @throws seq::error if the rig is not usable
void check_rig(stereo_rig const& rig, std::string const& source);

}  // namespace seq
