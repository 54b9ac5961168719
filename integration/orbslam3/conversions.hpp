// SPDX-License-Identifier: Apache-2.0
/// @file Cameras and poses of ORB-SLAM3 as plain structures, and back.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstring>

#include "ft/core/error.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

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

inline constexpr int number_type = 5;  ///< CV_32FC1

/// Reads mK and mDistCoef of a frame.
/// @return whether the distortion is one that undistortion.hpp knows: none, or 4 or 5 coefficients
template <typename Frame>
bool read_distortion(Frame const& frame, lens_distortion& d) {
  d = {};
  int const n = frame.mDistCoef.rows * frame.mDistCoef.cols;
  if (n == 0) { return true; }
  if (frame.mDistCoef.type() != number_type || frame.mK.type() != number_type) { return false; }
  float k[5] = {};
  std::memcpy(k, frame.mDistCoef.data, sizeof(float) * static_cast<std::size_t>(n < 5 ? n : 5));
  if (k[0] == 0) { return true; }
  if (n < 4 || n > 5) { return false; }
  float K[9];
  std::memcpy(K, frame.mK.data, sizeof K);
  d = {K[0], K[4], K[2], K[5], k[0], k[1], k[2], k[3], k[4]};
  return true;
}

/// The transform of a Sophus::SE3f.
template <typename Pose>
transform transform_of(Pose const& pose) {
  Eigen::Matrix3f const R = pose.rotationMatrix();
  Eigen::Vector3f const t = pose.translation();
  transform T;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { T.R[3 * r + c] = R(r, c); }
    T.t[r] = t(r);
  }
  return T;
}
/// The rotation of a Sophus::SE3f: x, y, z, w.
template <typename Pose>
void rotation_of(Pose const& pose, float (&rotation)[4]) {
  Eigen::Quaternionf const q = pose.unit_quaternion();
  for (int i = 0; i < 4; ++i) { rotation[i] = q.coeffs()(i); }
}
/// The centres of a frame's cameras in the world, computed as the frame does: the left one by the
/// pose's quaternion, whose result differs from the matrix's in the last bit.
template <typename Frame>
void centres_of(Frame& frame, int cameras, float (&centres)[2][3]) {
  auto const T_wc = frame.GetPose().inverse();
  Eigen::Vector3f const left = T_wc.translation();
  Eigen::Vector3f right = left;
  if (cameras == 2) {
    right = T_wc.rotationMatrix() * frame.GetRelativePoseTlr().translation() + left;
  }
  for (int i = 0; i < 3; ++i) {
    centres[0][i] = left(i);
    centres[1][i] = right(i);
  }
}
/// A Sophus::SE3f, through a unit quaternion.
template <typename Pose>
Pose pose_of(transform const& T) {
  Eigen::Matrix3f R;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { R(r, c) = T.R[3 * r + c]; }
  }
  return Pose(Eigen::Quaternionf(R).normalized(), Eigen::Vector3f(T.t[0], T.t[1], T.t[2]));
}

}  // namespace orbslam3
}  // namespace ft
