// SPDX-License-Identifier: Apache-2.0
/// @file Which calibration a file is, and which files belong together. Not API.
#pragma once

#include <optional>
#include <string>

#include "examples/sequence/detail/yaml_file.hpp"

namespace seq::detail {

enum class calibration_format {
  unknown,
  kitti,
  camera_txt,
  euroc,
  orb_slam3,
  kalibr,
  basalt,
  opencv,      ///< of one camera or two
  extrinsics,  ///< R and T alone
  colmap,
  realsense,
  depthai,
};

/// @throws seq::error for a file that cannot be read, or not as YAML, XML or JSON
calibration_format format_of(std::string const& path);

/// KITTI raw: maps points of the rectified camera 0 to the IMU, by the files that lie beside
/// calib_cam_to_cam.txt; nothing without them. @throws seq::error
std::optional<Eigen::Isometry3d> read_oxts_mount(std::string const& cam_to_cam);

/// A line of COLMAP's cameras.txt, of a model that is known or not.
bool is_colmap_camera(std::string const& line);
/// The heading of a stream in what rs-enumerate-devices -c prints.
bool is_realsense_stream(std::string const& line);
bool is_opencv_calibration(yaml_file const& file);
bool is_opencv_extrinsics(yaml_file const& file);

struct pair_of_files {
  std::string first;   ///< the left camera's
  std::string second;  ///< the right one's; empty if it is not there
};

/// The files of both cameras, by the one of either: left and right, cam0 and cam1 in their names.
pair_of_files camera_files(std::string const& path);
/// The intrinsics beside a file with extrinsics in its name; otherwise `path`.
std::string intrinsics_file(std::string const& path);
/// The file beside a calibration that has R and T: extrinsics in place of intrinsics, of left or of
/// cam0 in its name, or that name alone. Empty if it is not there.
std::string extrinsics_file(std::string const& path);

}  // namespace seq::detail
