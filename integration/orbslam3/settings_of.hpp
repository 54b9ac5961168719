// SPDX-License-Identifier: Apache-2.0
/// @file The shim's settings from the members of Tracking; cameras and poses as plain structures,
/// and back.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "ft/core/error.hpp"
#include "ft/interop/eigen.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

/// Parameters of a GeometricCamera: GetType() 0 is a pinhole, 1 Kannala-Brandt.
/// @throws bad_argument for others
template <typename Camera>
camera_parameters parameters_of(Camera& camera) {
  auto const type = camera.GetType();
  detail::require(type == 0u || type == 1u, "the camera's type is neither 0 nor 1");
  camera_parameters p;
  p.kind = type == 0u ? lens::pinhole : lens::kannala_brandt;
  for (int i = 0; i < (type == 0u ? 4 : 8); ++i) {
    p.values[i] = static_cast<float>(camera.getParameter(i));
  }
  return p;
}

/// Of a Sophus::SE3f.
template <typename Pose>
pose transform_of(Pose const& T) {
  return {mat3_from_eigen(T.rotationMatrix()), vec3_from_eigen(T.translation())};
}

/// The rotation of a Sophus::SE3f.
template <typename Pose>
quaternion<float> rotation_of(Pose const& T) {
  Eigen::Quaternionf const q = T.unit_quaternion();
  return {q.x(), q.y(), q.z(), q.w()};
}
/// The centres of a frame's cameras in the world, computed as the frame does: the left one by the
/// pose's quaternion, whose result differs from the matrix's in the last bit.
template <typename Frame>
void centres_of(Frame& frame, int cameras, vec3<float> (&centres)[2]) {
  auto const T_wc = frame.GetPose().inverse();
  Eigen::Vector3f const left = T_wc.translation();
  Eigen::Vector3f right = left;
  if (cameras == 2) {
    right = T_wc.rotationMatrix() * frame.GetRelativePoseTlr().translation() + left;
  }
  centres[0] = vec3_from_eigen(left);
  centres[1] = vec3_from_eigen(right);
}
/// The same in double, by the quaternion: the rotation matrix of floats is another rotation, by up
/// to 1e-7 rad.
template <typename Pose>
rigid<double> exact_transform_of(Pose const& T) {
  Eigen::Quaterniond const q = T.unit_quaternion().template cast<double>().normalized();
  Eigen::Vector3d const t = T.translation().template cast<double>();
  return {mat3_from_eigen(q.toRotationMatrix()), vec3_from_eigen(t)};
}
/// A Sophus::SE3f, through a unit quaternion that is rounded once.
template <typename Pose>
Pose pose_of(rigid<double> const& T) {
  Eigen::Quaterniond q = to_quaternion(T.R);
  if (q.w() < 0) { q.coeffs() = -q.coeffs(); }
  Eigen::Vector3d const t = as_eigen(T.t);
  return Pose(Eigen::Quaternionf(q.cast<float>()), Eigen::Vector3f(t.cast<float>()));
}

/// A system's types, for the template parameter `Types` of the shim.
template <typename Frame, typename MapPoint, typename FisheyeCamera>
struct types_of {
  using frame = Frame;
  using map_point = MapPoint;
  using fisheye_camera = FisheyeCamera;
};

/// The arguments of the constructor of ORBextractor, in the same order.
struct extractor_parameters {
  int features = 0;
  float scale_factor = 0;
  int levels = 0;
  int ini_threshold = 0;
  int min_threshold = 0;
};

/// @param image the first one, for its size
/// @param sensor System::eSensor as a number
/// @param bf Tracking's mbf, unused for monocular
/// @param left,right Tracking's mpCamera and mpCamera2, the latter of two fisheye cameras alone
/// @param T_lr Tracking's mTlr, likewise
/// @tparam Types with fisheye_camera: ORB_SLAM3::KannalaBrandt8
/// @throws bad_argument
template <typename Types, typename Image, typename Camera, typename Pose>
settings settings_of(extractor_parameters const& features, int sensor, Image const& image, float bf,
                     Camera* left, Camera* right, Pose const& T_lr) {
  detail::require(left != nullptr, "there is no camera yet");
  settings s;
  s.width = image.cols;
  s.height = image.rows;
  s.features = features.features;
  s.scale_factor = features.scale_factor;
  s.levels = features.levels;
  s.ini_threshold = features.ini_threshold;
  s.min_threshold = features.min_threshold;
  s.left = parameters_of(*left);
  detail::require_range("sensor", sensor, 0, 5);
  // Monocular, stereo, RGB-D; those with an IMU follow in the same order.
  bool const stereo = sensor % 3 == 1;
  s.images = stereo ? 2 : 1;
  if (sensor % 3 == 0) {
    s.most_keypoints =
        6 * features.features;  // initial frames, extracted by the CPU, have five times as many
    return s;
  }
  s.bf = bf;
  if (!stereo || s.left.kind == lens::pinhole) { return s; }
  detail::require(right != nullptr, "a fisheye pair needs its second camera");
  s.right = parameters_of(*right);
  s.T_rl = transform_of(T_lr.inverse());
  for (int i = 0; i < 2; ++i) {
    auto const& fisheye =
        static_cast<typename Types::fisheye_camera const&>(i == 0 ? *left : *right);
    for (unsigned end = 0; end < 2; ++end) {
      s.overlap[i][end] = static_cast<float>(fisheye.mvLappingArea.at(end));
    }
  }
  return s;
}

}  // namespace ft::orbslam3
