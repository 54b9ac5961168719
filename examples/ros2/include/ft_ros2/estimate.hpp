// SPDX-License-Identifier: Apache-2.0
/// @file What the tracker is told, and what it tells. Frames are those of REP 103 and 105: odom is
/// where the base was in the first frame. Metres, radians, seconds.
#pragma once

#include <array>
#include <optional>
#include <string>

namespace ft_ros2 {

/// x -> R x + t, row-major R.
struct transform {
  std::array<double, 9> R{1, 0, 0, 0, 1, 0, 0, 0, 1};
  std::array<double, 3> t{};
};

/// A rectified pair, pixels and metres.
struct rectified_pair {
  int width = 0, height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  double baseline = 0;
};

/// Densities: rad/s/sqrt(Hz), m/s^2/sqrt(Hz), and of the biases' walks.
struct imu_settings {
  transform T_imu_camera;  ///< points of the left camera to the IMU
  double gyro_noise = 1.7e-4, accel_noise = 2e-3, gyro_walk = 2e-5, accel_walk = 3e-3;
  double rate_hz = 200;
};

struct tracker_settings {
  rectified_pair pair;
  transform T_base_camera;  ///< points of the left camera (optical frame) to the base
  int features = 1200;      ///< keypoints an image
  int threads = 0;          ///< of the host; 0 = all
  bool gpu = false;         ///< the current GPU, instead of the host
  bool loops = false;       ///< recognises places seen before, and corrects map to odom
  std::optional<imu_settings> imu;
};

/// What is known after a frame. Only a tracked one has a pose.
struct estimate {
  bool tracked = false;
  bool keyframe = false;
  int inliers = 0;  ///< keypoints that agree with the pose
  int map_points = 0;
  transform T_odom_base;  ///< never jumps
  transform T_map_odom;   ///< what loops have corrected; identity without
  /// Row-major, as nav_msgs/Odometry has it: translation, then rotation about the fixed axes of
  /// odom.
  std::array<double, 36> covariance{};
  bool moving_known = false;  ///< the frame before was tracked, too, so there are velocities:
  std::array<double, 3> linear{}, angular{};  ///< mean since then, in the base's frame
  std::string reason;                         ///< why the frame is not tracked; empty if it is
  bool begun_anew = false;  ///< times went back: odom is where the base is in this frame
  int map_id = 0;           ///< of the map that the pose is in, from 1 on; 0 = none
  bool map_begun = false;   ///< the frame begins it
  std::string imu_state;    ///< initialising, known or used, and why not used; empty without an IMU
  std::string warning;      ///< why the pose may be wrong, names and sentences; empty if it is not
  std::string imu_warning;  ///< what is likely wrong with samples of the IMU; empty if nothing
};

}  // namespace ft_ros2
