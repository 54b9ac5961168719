// SPDX-License-Identifier: Apache-2.0
/// @file Poses, states and IMU integrals of the shape that the shim finds in ORB-SLAM3.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace stand_in {

/// What the original leaves uninitialised has these here, so that whoever reads it is seen.
inline constexpr int garbage = 0x5a5a5a5a;
inline constexpr float garbage_number = -3.4e20f;

/// Of Sophus::SE3f, which stores a quaternion and rotates points by it. Keeps the matrix as well,
/// so that recorded poses pass through unchanged.
class se3 {
public:
  se3() = default;
  se3(Eigen::Quaternionf const& q, Eigen::Vector3f const& t)
      : q_(q), R_(q.toRotationMatrix()), t_(t) {}
  se3(Eigen::Matrix3f const& R, Eigen::Vector3f const& t)
      : q_(Eigen::Quaternionf(R).normalized()), R_(R), t_(t) {}
  Eigen::Quaternionf unit_quaternion() const { return q_; }
  Eigen::Matrix3f rotationMatrix() const { return R_; }
  Eigen::Vector3f translation() const { return t_; }
  se3 inverse() const {
    se3 const back(q_.conjugate(), Eigen::Vector3f::Zero());
    return {q_.conjugate(), back * Eigen::Vector3f(t_ * -1.0f)};
  }
  Eigen::Vector3f operator*(Eigen::Vector3f const& p) const {
    Eigen::Vector3f turned = q_.vec().cross(p);
    turned += turned;
    Eigen::Vector3f const rotated = p + q_.w() * turned + q_.vec().cross(turned);
    return rotated + t_;
  }

private:
  Eigen::Quaternionf q_ = Eigen::Quaternionf::Identity();
  Eigen::Matrix3f R_ = Eigen::Matrix3f::Identity();
  Eigen::Vector3f t_ = Eigen::Vector3f::Zero();
};

/// Of IMU::Bias.
struct bias {
  float bax = 0, bay = 0, baz = 0;
  float bwx = 0, bwy = 0, bwz = 0;
};

/// Of IMU::Calib.
struct calibration {
  se3 mTcb;
  se3 mTbc;
};

/// Of IMU::Preintegrated: what is public. The measurements are not.
struct preintegrated {
  float dT = 0;
  Eigen::Matrix<float, 15, 15> C = Eigen::Matrix<float, 15, 15>::Zero();
  Eigen::DiagonalMatrix<float, 6> Nga, NgaWalk;
  bias b;
  Eigen::Matrix3f dR = Eigen::Matrix3f::Identity();
  Eigen::Vector3f dV = Eigen::Vector3f::Zero(), dP = Eigen::Vector3f::Zero();
  Eigen::Matrix3f JRg, JVg, JVa, JPg, JPa;
  Eigen::Vector3f avgA = Eigen::Vector3f::Zero(), avgW = Eigen::Vector3f::Zero();
};

/// Of ConstraintPoseImu.
struct pose_constraint {
  using matrix15 = Eigen::Matrix<double, 15, 15>;

  /// The original's makes the matrix positive, which rounds it.
  pose_constraint(Eigen::Matrix3d const& R, Eigen::Vector3d const& t, Eigen::Vector3d const& v,
                  Eigen::Vector3d const& gyro, Eigen::Vector3d const& accel,
                  matrix15 const& information)
      : Rwb(R), twb(t), vwb(v), bg(gyro), ba(accel), H((information / 3.0) * 3.0) {}

  Eigen::Matrix3d Rwb;
  Eigen::Vector3d twb, vwb, bg, ba;
  matrix15 H;
};

}  // namespace stand_in
