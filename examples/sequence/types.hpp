// SPDX-License-Identifier: Apache-2.0
/// @file Plain types shared by the generator, the readers, the evaluation and the report.
/// Not part of the ft library: applications and tests only. Eigen is used freely here.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace seq {

/// Thrown by all functions of this folder for bad input: the message names the file and the reason.
struct error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// 8-bit grey image, row-major, no padding.
struct image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;

  bool empty() const { return pixels.empty(); }
  std::uint8_t const* row(int y) const {
    return pixels.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
  }
  std::uint8_t* row(int y) {
    return pixels.data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(width);
  }
};

enum class lens {
  pinhole,            ///< no distortion
  radial_tangential,  ///< OpenCV order k1 k2 p1 p2 [k3 [k4 k5 k6]]
  kannala_brandt,     ///< k1 k2 k3 k4 (OpenCV fisheye, "equidistant")
  double_sphere,      ///< xi alpha
  unified,            ///< xi k1 k2 p1 p2 (OpenCV omnidir, Kalibr's omni)
  extended_unified,   ///< alpha beta
  field_of_view,      ///< omega, radians (Kalibr's fov)
};

/// How many of the distortion's numbers are the shape of a sphere.
constexpr int shape_parameters(lens model) {
  return model == lens::unified                                            ? 1
         : model == lens::double_sphere || model == lens::extended_unified ? 2
                                                                           : 0;
}

struct camera_intrinsics {
  lens model = lens::pinhole;
  int width = 0;
  int height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  std::vector<double> distortion;         ///< in the order of `model`; empty for a pinhole
  /// Seconds from the first row's exposure to the last one's, 0 to 0.1; 0 = a global shutter.
  double readout_s = 0;
};

/// What the cameras of a recording are.
enum class camera_kind {
  any,     ///< in options: what the folder holds
  stereo,  ///< two cameras
  mono,    ///< one camera
  rgbd,    ///< one camera with depth images
  mixed,   ///< in options: a pair and all cameras beside it, as they are
};

constexpr bool is_pair(camera_kind kind) {
  return kind == camera_kind::stereo || kind == camera_kind::mixed;
}

/// A camera on a rig.
struct mounted_camera {
  camera_intrinsics camera;
  Eigen::Isometry3d T_left_this =
      Eigen::Isometry3d::Identity();  ///< maps its points to the left camera
};

/// A calibrated pair, or one camera: `right` equals `left` then, and T_left_right is the identity,
/// or with depth images the place of a virtual right camera. Camera frames: x right, y down, z
/// forward; metres.
struct stereo_rig {
  camera_intrinsics left;
  camera_intrinsics right;
  Eigen::Isometry3d T_left_right =
      Eigen::Isometry3d::Identity();  ///< maps right-camera points to the left camera
  Eigen::Isometry3d T_body_left =
      Eigen::Isometry3d::Identity();  ///< maps left-camera points to the body (IMU) frame
  double fps = 0;                     ///< 0 = unknown
  std::vector<mounted_camera> more;   ///< cameras beside the pair, the third one first
  std::vector<int> depth_cameras;     ///< those of a mixed rig with depth images; 0 is the left one

  double baseline() const { return T_left_right.translation().norm(); }
  /// True if rows of both images correspond: two equal pinholes, T_left_right a translation along
  /// x.
  bool rectified() const;
};

/// Pose of the left camera in the world at a time: x_world = T_world_camera * x_camera.
struct stamped_pose {
  std::int64_t time_ns = 0;
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
};
/// Sorted by time.
using trajectory = std::vector<stamped_pose>;

/// Depths along the camera's axis, row-major, no padding; 0 = none. The sequence says the unit.
struct depth_image {
  int width = 0;
  int height = 0;
  std::vector<std::uint16_t> pixels;
};

struct stereo_frame {
  std::int64_t time_ns = 0;
  image left;
  image right;              ///< of a pair only
  std::vector<image> more;  ///< of stereo_rig::more; empty where a camera has none in this frame
  depth_image depth;        ///< of a camera with depth only: registered to `left`, of its size
  /// Of the cameras in the order of the rig, 0 or 255, of the size of their images; null = all of
  /// the image is used. Empty without open_options::masks. Frames with the same mask share it.
  std::vector<std::shared_ptr<image const>> masks;
  std::vector<depth_image> depths;  ///< of stereo_rig::depth_cameras; empty where one has none
};

/// Noise densities of an IMU. The defaults are those of the EuRoC data sets.
struct imu_noise {
  double gyro = 1.7e-4;        ///< rad/s/sqrt(Hz)
  double accel = 2.0e-3;       ///< m/s^2/sqrt(Hz)
  double gyro_walk = 2.0e-5;   ///< rad/s^2/sqrt(Hz)
  double accel_walk = 3.0e-3;  ///< m/s^3/sqrt(Hz)
};

/// What a tracker has to know about an IMU.
struct imu_calibration {
  imu_noise noise;
  double rate_hz = 0;
  double time_offset_s = 0;  ///< its clock less that of the images: Kalibr's timeshift_cam_imu
  Eigen::Isometry3d T_body_imu =
      Eigen::Isometry3d::Identity();  ///< maps points of the IMU's frame to the body's
};

struct imu_sample {
  std::int64_t time_ns = 0;
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< rad/s, IMU's frame
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< m/s^2, IMU's frame, gravity included
};

/// The shortest rotation that takes one direction to another; neither is zero. Eigen's
/// FromTwoVectors has the same formula, and the compiler half a minute of decompositions for
/// vectors that are opposite.
inline Eigen::Matrix3d shortest_rotation(Eigen::Vector3d const& from, Eigen::Vector3d const& to) {
  Eigen::Vector3d const a = from.normalized();
  Eigen::Vector3d const b = to.normalized();
  double const s = std::sqrt(2 * (1 + a.dot(b)));  // twice the cosine of half the angle
  if (!(s > 1e-6)) {
    return 2 * a.unitOrthogonal() * a.unitOrthogonal().transpose() - Eigen::Matrix3d::Identity();
  }
  Eigen::Vector3d const axis = a.cross(b) * (1 / s);
  return Eigen::Quaterniond(0.5 * s, axis.x(), axis.y(), axis.z()).toRotationMatrix();
}

}  // namespace seq
