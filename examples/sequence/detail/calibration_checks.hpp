// SPDX-License-Identifier: Apache-2.0
/// @file What values of a calibration must be, with errors that name file, key, value and limit.
/// Not API.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq::detail {

constexpr double max_focal = 1e5;       // pixels
constexpr double min_baseline = 1e-4;   // metres
constexpr double max_baseline = 100.0;  // metres
constexpr double max_coefficient = 1e4;

/// Allowed values of a number; the lower end may be excluded.
struct limits {
  double low;
  double high;
  bool above_low = false;
};
constexpr limits focal_limits{0, max_focal, true};
constexpr limits centre_limits{-max_focal, max_focal};
constexpr limits coefficient_limits{-max_coefficient, max_coefficient};
constexpr limits side_limits{1, 16384};
constexpr limits fps_limits{0, 1e5};
constexpr limits imu_rate_limits{1, 2e4};
constexpr limits time_offset_limits{-10, 10};  // s
constexpr limits density_limits{0, 1e3, true};
constexpr limits readout_limits{0, 0.1};        // s, of all rows
constexpr limits depth_unit_limits{1e-9, 1e3};  // metres

/// @param text the value as it is written @throws seq::error not finite, or outside the limits
void check_number(double value, limits const& range, std::string const& path,
                  std::string const& key, std::string const& text);
void check_number(double value, limits const& range, std::string const& path,
                  std::string const& key);

/// The closest rotation. @throws seq::error if `m` is farther than 1e-3 from every rotation
Eigen::Matrix3d checked_rotation(Eigen::Matrix3d const& m, std::string const& path,
                                 std::string const& key);

/// From 16 (or 12: without the last row) numbers, row-major. @throws seq::error
Eigen::Isometry3d checked_transform(std::vector<double> const& m, std::string const& path,
                                    std::string const& key);

/// A radial-tangential camera whose coefficients are all zero becomes a pinhole. (A Kannala-Brandt
/// one stays: it has r = f theta then.)
void drop_zero_distortion(camera_intrinsics& camera);

/// fx, fy, cx, cy of a 3x3 matrix, row-major. @throws seq::error also for a skew
void set_camera_matrix(camera_intrinsics& camera, std::vector<double> const& m,
                       std::string const& path, std::string const& key);

/// Model and coefficients by a maker's name of the distortion: radtan, radtan8, radial-tangential,
/// plumb_bob, rational_polynomial; equidistant, fisheye, kb4; fov; none. More than 8 coefficients
/// of OpenCV's are taken if the rest is zero. @throws seq::error
void set_distortion(camera_intrinsics& camera, std::string const& model,
                    std::vector<double> coefficients, std::string const& path,
                    std::string const& key);

/// @throws seq::error that asks for the unit where the cameras are more than max_baseline apart
void check_baseline(stereo_rig const& rig, std::string const& path, std::string const& key);

/// Makes the rig that of its left camera alone: a virtual right one for depth images, else none.
void set_one_camera(stereo_rig& rig, camera_kind kind);

/// Adds camera k, beside the pair, to a rig, and checks it. @param add appends it, or throws
/// @return whether it is there: else a warning says why it is not taken
bool added_camera(stereo_rig& rig, int k, std::string const& source,
                  std::function<void()> const& add, std::vector<std::string>& warnings);

/// @throws seq::error naming both sizes where they differ, and the lens that no rig has; without
///   any pair
void check_mixed(stereo_rig const& rig, std::string const& source);

/// @param name of the camera, for the message @throws seq::error
void check_camera(camera_intrinsics const& camera, std::string const& name,
                  std::string const& source);

}  // namespace seq::detail
