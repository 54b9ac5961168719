// SPDX-License-Identifier: Apache-2.0
/// @file States, integrals and priors of ORB-SLAM3's frames as plain structures, and back.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <type_traits>

#include "integration/orbslam3/conversions.hpp"
#include "integration/orbslam3/inertial_types.hpp"

namespace ft {
namespace orbslam3 {

/// What an inertial optimisation returns instead of a number of observations if it is refused.
inline constexpr int inertial_refused = -1;

namespace inertial_detail {

/// Row-major.
template <typename T, int N, typename Matrix>
void put(T (&to)[N], Matrix const& m) {
  constexpr int columns = N == 3 ? 1 : N == 9 ? 3 : N == 81 ? 9 : 15;
  for (int i = 0; i < N; ++i) { to[i] = static_cast<T>(m(i / columns, i % columns)); }
}
template <typename Bias>
void put_bias(float (&gyro)[3], float (&accel)[3], Bias const& from) {
  gyro[0] = from.bwx;
  gyro[1] = from.bwy;
  gyro[2] = from.bwz;
  accel[0] = from.bax;
  accel[1] = from.bay;
  accel[2] = from.baz;
}
template <typename Bias>
void take_bias(Bias& to, float const (&gyro)[3], float const (&accel)[3]) {
  to.bwx = gyro[0];
  to.bwy = gyro[1];
  to.bwz = gyro[2];
  to.bax = accel[0];
  to.bay = accel[1];
  to.baz = accel[2];
}
template <int Rows, int Columns, typename T>
Eigen::Matrix<T, Rows, Columns> matrix_of(T const* rows) {
  Eigen::Matrix<T, Rows, Columns> m;
  for (int i = 0; i < Rows * Columns; ++i) { m(i / Columns, i % Columns) = rows[i]; }
  return m;
}

/// The steps of an integral, which are private: each adds to the variance of the gyro's walk. None,
/// one and more are told apart; the number of some thousand may be off by one.
template <typename Integral>
int steps_of(Integral const& integral) {
  float const n = integral.C(9, 9) / integral.NgaWalk.diagonal()(0);
  return n > 0 && n < 1e6f ? static_cast<int>(std::lround(n)) : 0;
}
/// Whether an integral is there and says anything.
template <typename Integral>
bool usable(Integral const* integral) {
  return integral != nullptr && steps_of(*integral) > 0;
}

}  // namespace inertial_detail

/// An IMU::Preintegrated.
template <typename Integral>
imu_integral integral_of(Integral const& from) {
  using inertial_detail::put;
  imu_integral to{};
  to.dT = from.dT;
  put(to.dR, from.dR);
  put(to.dV, from.dV);
  put(to.dP, from.dP);
  put(to.JRg, from.JRg);
  put(to.JVg, from.JVg);
  put(to.JVa, from.JVa);
  put(to.JPg, from.JPg);
  put(to.JPa, from.JPa);
  put(to.C, from.C);
  for (int i = 0; i < 6; ++i) { to.walk[i] = from.C(9 + i, 9 + i); }
  inertial_detail::put_bias(to.gyro_bias, to.accel_bias, from.b);
  put(to.mean_accel, from.avgA);
  put(to.mean_gyro, from.avgW);
  to.steps = inertial_detail::steps_of(from);
  return to;
}

/// A state from a Sophus::SE3f, a velocity and an IMU::Bias.
template <typename Pose, typename Vector, typename Bias>
imu_state state_of(Pose const& T_cw, Vector const& velocity, Bias const& bias) {
  imu_state s{};
  rotation_of(T_cw, s.rotation);
  inertial_detail::put(s.t_cw, T_cw.translation());
  inertial_detail::put(s.velocity, velocity);
  inertial_detail::put_bias(s.gyro_bias, s.accel_bias, bias);
  return s;
}
template <typename Frame>
imu_state state_of(Frame& frame) {
  return state_of(frame.GetPose(), frame.GetVelocity(), frame.mImuBias);
}

/// A ConstraintPoseImu.
template <typename Constraint>
imu_prior prior_of(Constraint const& from) {
  using inertial_detail::put;
  imu_prior to{};
  put(to.R, from.Rwb);
  put(to.p, from.twb);
  put(to.v, from.vwb);
  put(to.gyro_bias, from.bg);
  put(to.accel_bias, from.ba);
  put(to.information, from.H);
  return to;
}

/// Whether a frame has all that its inertial optimisation starts from: the last keyframe or the
/// last frame with its prior, and integrals of at least one step.
/// @param slip reads the walk of the biases from the integral since the last keyframe in any case
template <typename Frame>
bool has_inertial_start(Frame const& frame, bool from_last_frame, bool slip) {
  using inertial_detail::usable;
  if (!from_last_frame) {
    return frame.mpLastKeyFrame != nullptr && usable(frame.mpImuPreintegrated);
  }
  return frame.mpPrevFrame != nullptr && frame.mpPrevFrame->mpcpi != nullptr &&
         usable(frame.mpImuPreintegratedFrame) && (!slip || usable(frame.mpImuPreintegrated));
}

/// Steps of the integral from there. @pre has_inertial_start()
template <typename Frame>
int inertial_steps(Frame const& frame, bool from_last_frame) {
  return inertial_detail::steps_of(from_last_frame ? *frame.mpImuPreintegratedFrame
                                                   : *frame.mpImuPreintegrated);
}

/// What the optimisation starts from, but for the buffer. @pre has_inertial_start()
template <typename Frame>
inertial_request inertial_request_of(Frame& frame, bool from_last_frame) {
  inertial_request r;
  r.from_last_frame = from_last_frame;
  r.T_bc = transform_of(frame.mImuCalib.mTbc);
  r.T_cb = transform_of(frame.mImuCalib.mTcb);
  r.start = state_of(frame);
  if (from_last_frame) {
    r.first = state_of(*frame.mpPrevFrame);
    r.prior = prior_of(*frame.mpPrevFrame->mpcpi);
    r.integral = integral_of(*frame.mpImuPreintegratedFrame);
  } else {
    auto& keyframe = *frame.mpLastKeyFrame;
    r.first = state_of(keyframe.GetPose(), keyframe.GetVelocity(), keyframe.GetImuBias());
  }
  if (frame.mpImuPreintegrated != nullptr) {
    r.since_keyframe = integral_of(*frame.mpImuPreintegrated);
  }
  if (!from_last_frame) { r.integral = r.since_keyframe; }
  return r;
}

/// Writes the state into a frame, and its prior, which the frame's owner deletes. The last frame's
/// prior is used once: it is deleted.
template <typename Frame>
void take_inertial_result(Frame& frame, bool from_last_frame, inertial_result const& r) {
  using pose = std::decay_t<decltype(frame.GetPose())>;
  using constraint = std::remove_pointer_t<std::decay_t<decltype(frame.mpcpi)>>;
  using inertial_detail::matrix_of;
  float const* const q = r.state.rotation;
  frame.SetPose(pose(Eigen::Quaternionf(q[3], q[0], q[1], q[2]), matrix_of<3, 1>(r.state.t_cw)));
  frame.SetVelocity(matrix_of<3, 1>(r.state.velocity));
  inertial_detail::take_bias(frame.mImuBias, r.state.gyro_bias, r.state.accel_bias);
  imu_prior const& p = r.prior;
  auto const H = matrix_of<15, 15>(p.information);
  auto* const prior =
      new constraint(matrix_of<3, 3>(p.R), matrix_of<3, 1>(p.p), matrix_of<3, 1>(p.v),
                     matrix_of<3, 1>(p.gyro_bias), matrix_of<3, 1>(p.accel_bias), H);
  prior->H = H;  // its constructor decomposes the matrix once more and rounds it
  frame.mpcpi = prior;
  if (from_last_frame) {
    delete frame.mpPrevFrame->mpcpi;
    frame.mpPrevFrame->mpcpi = nullptr;
  }
}

}  // namespace orbslam3
}  // namespace ft
