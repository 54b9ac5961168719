// SPDX-License-Identifier: Apache-2.0
/// @file Reads the calibration of a stereo pair, of one camera or of one with depth images: EuRoC
/// sensor.yaml, KITTI calib.txt, ORB-SLAM3 settings, camera.txt of a TUM RGB-D folder, Kalibr's
/// chain, OpenCV's and ROS's files, basalt's JSON, and those of RealSense, DepthAI and COLMAP.
///
/// Every value read is checked (finite, focal lengths above 0, sizes 1 to 16384, baseline above 0,
/// rotations orthonormal). An error names file, key, value and limit. A radial-tangential camera
/// whose coefficients are all zero becomes a pinhole.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/types.hpp"

namespace seq {

/// The content of a calibration file.
struct calibration {
  stereo_rig rig;
  orb_settings settings;        ///< ORB-SLAM3 settings files only
  bool has_body_frame = false;  ///< the file gives T_body_left; otherwise it is the identity
  /// ORB-SLAM3 settings, Kalibr and basalt, with an IMU's noise: the body is the IMU.
  std::optional<imu_calibration> imu;
  /// What is added to a time of the cameras' clock to have that of the IMU's, where the file says
  /// it: Kalibr's timeshift_cam_imu, basalt's cam_time_offset_ns.
  std::optional<double> imu_time_offset_s;
  /// KITTI: maps points of the left camera to the reference frame, which poses.txt is about.
  Eigen::Isometry3d T_reference_left = Eigen::Isometry3d::Identity();
  /// Metres per unit of 16-bit depth images, where the file says it.
  std::optional<double> depth_unit;
  /// The camera's y axis points up in the file, and in the recording's poses: fy was below 0.
  bool y_up = false;
  /// What of the file may change the result and is not taken, a sentence each.
  std::vector<std::string> warnings;
};

/// Baseline of the virtual pair of a camera with depth images, metres, where nothing else is given.
constexpr double usual_virtual_baseline = 0.08;

/// EuRoC: `mav0`/cam0/sensor.yaml and `mav0`/cam1/sensor.yaml. Distortion models radial-tangential
/// (or radtan), equidistant (= Kannala-Brandt), none. T_BS maps camera points into the body.
/// readout_s, which EuRoC's own files do not have, is camera_intrinsics::readout_s.
/// @param kind stereo, or mono: cam0 alone
/// @throws seq::error
calibration read_euroc_calibration(std::string const& mav0, camera_kind kind = camera_kind::stereo);

/// Only T_BS of `mav0`/cam0/sensor.yaml: maps points of the raw left camera into the body, metres.
/// @throws seq::error
Eigen::Isometry3d read_euroc_body_frame(std::string const& mav0);

/// EuRoC: sensor.yaml of an IMU: T_BS (maps points of its frame into the body), rate_hz, and
/// gyroscope_noise_density, gyroscope_random_walk, accelerometer_noise_density,
/// accelerometer_random_walk.
/// @throws seq::error; rate 1 to 20000 Hz, densities above 0
imu_calibration read_euroc_imu_calibration(std::string const& path);

/// KITTI: the lines "P0:" and "P1:" (or "P2:" and "P3:") of 12 numbers, 3x4 row-major projections
/// of one reference frame; or of KITTI raw's calib_cam_to_cam.txt "P_rect_00:" ..., with the IMU's
/// place by calib_imu_to_velo.txt and calib_velo_to_cam.txt beside it.
/// @param width,height the images' size, which the file does not give, pixels
/// @param left_camera number of the left camera, 0 (grey) or 2 (colour)
/// @param kind stereo, or mono: the left camera's line alone
/// @throws seq::error
calibration read_kitti_calibration(std::string const& path, int width, int height,
                                   int left_camera = 0, camera_kind kind = camera_kind::stereo);

/// ORB-SLAM3 settings, both formats: `Camera1.fx` with `Stereo.T_c1_c2` (maps camera-2 points into
/// camera 1) or `Stereo.b`; and the older `Camera.fx` with `Camera.bf`, `LEFT.K` .. `RIGHT.P`, or
/// `Tlr`. IMU.T_b_c1 or Tbc gives the body frame. With any of IMU.NoiseGyro, NoiseAcc, GyroWalk,
/// AccWalk and Frequency (1 to 20000 Hz) all five must be there, densities above 0, and the body
/// frame. OpenCV's dialect of YAML is read. What is not applied is named in the warnings:
/// Camera.newWidth and newHeight (a scaling), and keys of cameras, IMU, depth or extractor that are
/// not known.
/// @param width,height size to assume if the file gives none; 0 = the file must give it
/// @param kind stereo; mono or rgbd: the first camera alone, so that also settings for one camera
///   are taken. rgbd has Stereo.b or Camera.bf as the virtual baseline, and the depth unit from
///   RGBD.DepthMapFactor or DepthMapFactor, which are units per metre
/// @throws seq::error
calibration read_orb_slam3_settings(std::string const& path, int width = 0, int height = 0,
                                    camera_kind kind = camera_kind::stereo);

/// camera.txt: one line "fx fy cx cy", or with the coefficients "k1 k2 p1 p2 [k3 [k4 k5 k6]]" after
/// them, pixels. Lines starting with # are comments; one with "depth in units of 1 mm" (any number;
/// m, cm, mm or um) gives the depth unit. An fy below 0 without coefficients is ICL-NUIM's: y
/// points up in its files. |fy| is taken, and a warning says that the poses of the recording are
/// mirrored.
/// @param kind mono or rgbd
/// @throws seq::error
calibration read_camera_txt(std::string const& path, int width, int height,
                            camera_kind kind = camera_kind::rgbd);

/// The calibration that the TUM RGB-D benchmark publishes of its cameras freiburg1, 2 and 3, whose
/// recordings hold none; with a warning that says so. @param camera 1 to 3 @param kind mono or rgbd
calibration published_tum_calibration(int camera, camera_kind kind = camera_kind::rgbd);

/// Kalibr's chain: `cam0`, `cam1` with camera_model (pinhole, omni, ds, eucm), intrinsics,
/// distortion_model (radtan, equidistant, fov, none), distortion_coeffs, resolution, T_cn_cnm1
/// (maps cam0 points into cam1), and with an IMU T_cam_imu (or OpenVINS's T_imu_cam) and
/// timeshift_cam_imu. The IMU's noise is read from the imu.yaml that lies beside it (imu0.yaml,
/// kalibr_imu_chain.yaml, TUM-VI's imu_config.yaml, or `imu` in place of `camchain-imucam` in its
/// name). line_delay is the time from a row to the next one, s, or ns where it is 1 or more. Key
/// names are Kalibr's.
/// @throws seq::error
calibration read_kalibr_calibration(std::string const& path,
                                    camera_kind kind = camera_kind::stereo);

/// basalt's JSON: `value0` with intrinsics (pinhole, pinhole-radtan8, kb4, ds, eucm, ucm),
/// T_imu_cam, resolution, and the IMU's noise. @throws seq::error
calibration read_basalt_calibration(std::string const& path,
                                    camera_kind kind = camera_kind::stereo);

/// COLMAP's cameras.txt: lines "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]" of its models of pinholes,
/// OPENCV, FULL_OPENCV, radial and fisheye ones. Its pixels begin at 0.5, which is subtracted. A
/// pair is that of rigs.txt beside it, whose unit is taken for metres, with a warning; else the
/// first camera is taken. @throws seq::error
calibration read_colmap_calibration(std::string const& path,
                                    camera_kind kind = camera_kind::stereo);

/// What librealsense's `rs-enumerate-devices -c` prints: "Infrared 1" and "Infrared 2" (or
/// "Fisheye 1" and "2") as a pair; of one camera "Infrared 1", with depth "Color". Extrinsics are
/// in metres, rotations in rows; the body is the IMU, where it has one.
/// @param width,height of the images, which choose the intrinsics; 0 = there is one size only
/// @throws seq::error
calibration read_realsense_calibration(std::string const& path, int width, int height,
                                       camera_kind kind = camera_kind::stereo);

/// DepthAI's JSON, as CalibrationHandler.eepromToJsonFile writes it: the pair is that of
/// stereoRectificationData; of one camera the left one, with depth the one at socket 0.
/// Translations are in centimetres where no lengthUnit is given. The body is the IMU, where
/// imuExtrinsics say it.
/// @param width,height of the images: of another size than the calibration's, they are scaled
///   until they fill it and cut at the middle, with a warning; 0 = as calibrated
/// @throws seq::error
calibration read_depthai_calibration(std::string const& path, int width, int height,
                                     camera_kind kind = camera_kind::stereo);

/// OpenCV's FileStorage (YAML, XML, JSON) of a pair: M1, D1, M2, D2 (or K1, cameraMatrix1,
/// camera_matrix_left ...), and R, T, which map points of camera 1 into camera 2, in metres; in
/// this file, or in the extrinsics.yml beside an intrinsics.yml. Or a file a camera, as ROS has its
/// camera_info: camera_matrix (or K), distortion_coefficients (D), distortion_model,
/// rectification_matrix (R), projection_matrix (P); the right one's file has right in place of left
/// (or cam1 in place of cam0) in its name. Images are those that were calibrated, not rectified
/// ones.
/// @param width,height size to assume if the file gives none; 0 = the file must give it
/// @throws seq::error
calibration read_opencv_calibration(std::string const& path, int width = 0, int height = 0,
                                    camera_kind kind = camera_kind::stereo);

/// The calibration in a folder, recognised by content: of several files, left and right of a pair
/// and intrinsics and extrinsics are one. @return its path; empty without any
/// @throws seq::error for several
std::string find_calibration_file(std::string const& folder);

/// The formats that read_calibration knows, for messages.
extern char const* const accepted_calibrations;

/// Any of these: a folder (`mav0`, or one that contains `mav0` or calib.txt), a cam0/sensor.yaml, a
/// KITTI calib.txt, an ORB-SLAM3 settings file, Kalibr's chain, OpenCV's or ROS's files, basalt's
/// or DepthAI's JSON, RealSense's listing, COLMAP's cameras.txt or a camera.txt; recognised by
/// content.
/// @param width,height the images' size, for files that do not give it; 0 = unknown
/// @param left_camera see read_kitti_calibration
/// @param kind stereo, mono or rgbd: of one camera the right one's calibration is not needed
/// @throws seq::error
calibration read_calibration(std::string const& path, int width = 0, int height = 0,
                             int left_camera = 0, camera_kind kind = camera_kind::stereo);

/// @param source file to name in the message
/// @throws seq::error if the rig is not usable
void check_rig(stereo_rig const& rig, std::string const& source,
               camera_kind kind = camera_kind::stereo);

}  // namespace seq
