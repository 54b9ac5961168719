// SPDX-License-Identifier: Apache-2.0
/// @file States, integrals and priors of ORB-SLAM3's frames as plain structures, and back.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <type_traits>

#include "ft/interop/eigen.hpp"
#include "integration/orbslam3/plain_types.hpp"
#include "integration/orbslam3/settings_of.hpp"

namespace ft::orbslam3 {

namespace inertial_detail {

template <typename Bias>
imu_bias bias_of(Bias const& from) {
  return {{from.bwx, from.bwy, from.bwz}, {from.bax, from.bay, from.baz}};
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
preintegrated integral_of(Integral const& from) {
  preintegrated to{};
  to.dT = from.dT;
  to.dR = mat3_from_eigen(from.dR);
  to.dV = vec3_from_eigen(from.dV);
  to.dP = vec3_from_eigen(from.dP);
  to.JRg = mat3_from_eigen(from.JRg);
  to.JVg = mat3_from_eigen(from.JVg);
  to.JVa = mat3_from_eigen(from.JVa);
  to.JPg = mat3_from_eigen(from.JPg);
  to.JPa = mat3_from_eigen(from.JPa);
  for (int i = 0; i < 81; ++i) { to.C[i] = from.C(i / 9, i % 9); }
  for (int i = 0; i < 6; ++i) { to.walk[i] = from.C(9 + i, 9 + i); }
  to.bias = inertial_detail::bias_of(from.b);
  to.mean_accel = vec3_from_eigen(from.avgA);
  to.mean_gyro = vec3_from_eigen(from.avgW);
  to.steps = inertial_detail::steps_of(from);
  to.status = to.steps > 0 ? integration_status::integrated : integration_status::no_steps;
  return to;
}

/// A state from a Sophus::SE3f, a velocity and an IMU::Bias.
template <typename Pose, typename Vector, typename Bias>
stored_inertial_state state_of(Pose const& T_cw, Vector const& velocity, Bias const& bias) {
  return {rotation_of(T_cw), vec3_from_eigen(T_cw.translation()), vec3_from_eigen(velocity),
          inertial_detail::bias_of(bias)};
}
template <typename Frame>
stored_inertial_state state_of(Frame& frame) {
  return state_of(frame.GetPose(), frame.GetVelocity(), frame.mImuBias);
}

/// A ConstraintPoseImu.
template <typename Constraint>
inertial_prior prior_of(Constraint const& from) {
  inertial_prior to{};
  to.state = {mat3_from_eigen(from.Rwb), vec3_from_eigen(from.twb), vec3_from_eigen(from.vwb),
              vec3_from_eigen(from.bg), vec3_from_eigen(from.ba)};
  for (int i = 0; i < 225; ++i) { to.information[i] = from.H(i / 15, i % 15); }
  to.known = 1;
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
  r.from_last_frame = from_last_frame ? 1 : 0;
  r.mount = {transform_of(frame.mImuCalib.mTbc), transform_of(frame.mImuCalib.mTcb)};
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
  using matrix = Eigen::Matrix<double, 15, 15, Eigen::RowMajor>;
  quaternion<float> const& q = r.state.q_cw;
  frame.SetPose(
      pose(Eigen::Quaternionf(q.w, q.x, q.y, q.z), Eigen::Vector3f(as_eigen(r.state.t_cw))));
  frame.SetVelocity(as_eigen(r.state.v));
  auto& bias = frame.mImuBias;
  bias.bwx = r.state.bias.gyro.x;
  bias.bwy = r.state.bias.gyro.y;
  bias.bwz = r.state.bias.gyro.z;
  bias.bax = r.state.bias.accel.x;
  bias.bay = r.state.bias.accel.y;
  bias.baz = r.state.bias.accel.z;
  inertial_state<double> const& p = r.prior.state;
  Eigen::Matrix<double, 15, 15> const H = Eigen::Map<matrix const>(r.prior.information);
  auto* const prior = new constraint(as_eigen(p.R), as_eigen(p.p), as_eigen(p.v), as_eigen(p.bg),
                                     as_eigen(p.ba), H);
  prior->H = H;  // its constructor decomposes the matrix once more and rounds it
  frame.mpcpi = prior;
  if (from_last_frame) {
    delete frame.mpPrevFrame->mpcpi;
    frame.mpPrevFrame->mpcpi = nullptr;
  }
}

}  // namespace ft::orbslam3
