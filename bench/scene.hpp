// SPDX-License-Identifier: Apache-2.0
/// @file The input of the benches, as plain types: images of a generated room, cameras, poses.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace bench {

struct plain_pose {
  float R[9];
  float t[3];
};

struct plain_camera {
  float fx = 0, fy = 0, cx = 0, cy = 0;
  float k[4] = {0, 0, 0, 0};  ///< fisheye only: k1 to k4 of Kannala and Brandt
};

struct scene_frame {
  std::vector<std::uint8_t> left, right;
  std::vector<std::uint8_t> aside[2];  ///< of the second pair of four cameras, left and right
  plain_pose T_cw;                     ///< world to left camera
};

struct scene_imu_sample {
  std::int64_t time_ns;  ///< frame k is taken at k * scene::period_ns
  float accel[3];        ///< m/s^2, gravity included
  float gyro[3];         ///< rad/s
};

/// The IMU of the body that carries the cameras.
struct scene_imu {
  plain_pose T_imu_left;                                                 ///< left camera to IMU
  float gyro_noise = 0, accel_noise = 0, gyro_walk = 0, accel_walk = 0;  ///< densities
  float rate_hz = 0;
  std::vector<scene_imu_sample> samples;  ///< from the first frame to the last; empty: no IMU
};

/// Of four cameras: two rectified pairs of the same cameras.
enum class rig_type { rectified, fisheye, four_cameras };

struct scene {
  rig_type rig = rig_type::rectified;
  int width = 0, height = 0;
  plain_camera left, right;  ///< a rectified pair has the same camera twice
  plain_pose T_rl;           ///< left camera to right camera
  plain_pose T_al;           ///< left camera to that of the second pair of four cameras
  float baseline = 0;        ///< metres
  int features = 1200;       ///< keypoints per image
  int local_points = 3000;
  static constexpr std::int64_t period_ns = 50'000'000;
  std::vector<scene_frame> frames;  ///< consecutive in time
  scene_imu imu;
};

/// Renders `images` consecutive stereo frames of the generator's route, in motion, on all threads.
/// @param width,height 0 = the rig's own
/// @throws seq::error
scene make_scene(rig_type rig, int width, int height, int images, int features, int local_points);

/// The first stereo frames of a recorded sequence (EuRoC or KITTI layout), rectified.
/// @throws seq::error if it cannot be read, or has no ground truth with orientations
scene read_scene(std::string const& folder, int images, int features, int local_points);

}  // namespace bench
