// SPDX-License-Identifier: Apache-2.0
/// @file Steps of recorded chains as problems of poses with an IMU, and distances of states.
#pragma once

#include <cmath>

#include "ft/containers/inertial.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "ft/types/poses.hpp"
#include "tests/conformance/inertial_case.hpp"
#include "tests/support/inertial_poses.hpp"

namespace test {

/// Adds the recorded inputs of step s.
inline void add_recorded_step(inertial_pose_batch& b, inertial_chain const& chain, int s) {
  int const from = chain.mode(s);
  b.from_last_frame.push_back(from);
  b.first.push_back(state_at(from != 0 ? chain.lf_state : chain.kf_state, s).stored);
  b.start.push_back(state_at(chain.pred_state, s).stored);
  b.integral.push_back(from != 0 ? chain.frame_integral(s) : chain.keyframe_integral(s));
  b.since_keyframe.push_back(chain.keyframe_integral(s));
  b.prior.push_back(chain.prior(s));
  b.count.push_back(chain.observation_count(s));
  b.observations.emplace_back();
  b.distance.emplace_back();
  for (int i = 0; i < chain.observation_count(s); ++i) {
    auto const o = chain.observation(chain.obs_start(s) + i);
    b.observations.back().push_back({o.point, o.u, o.v, o.right_u, o.inverse_sigma2, o.camera});
    b.distance.back().push_back(o.depth);
  }
}

/// A stored state, in double precision.
inline ft::inertial_state<double> wide_state_of(ft::stored_inertial_state const& s,
                                                ft::imu_mount const& mount) {
  ft::quaternion<double> q{s.q_cw.x, s.q_cw.y, s.q_cw.z, s.q_cw.w};
  auto const R_wc = ft::detail::rotation_of(q).transposed();
  auto const T_cb = mount.T_cb.cast<double>();
  auto const p = R_wc * (T_cb.t - s.t_cw.cast<double>());
  return {R_wc * T_cb.R, p, s.v.cast<double>(), s.bias.gyro.cast<double>(),
          s.bias.accel.cast<double>()};
}

/// How far two states are apart, or may be.
struct inertial_state_distance {
  double turn, position, velocity, gyro_bias, accel_bias;
};

inline inertial_state_distance distance_between(ft::inertial_state<double> const& a,
                                                ft::inertial_state<double> const& b) {
  auto const turn = b.R.transposed() * a.R;
  auto const& m = turn.m;
  ft::vec3<double> const axis{m[7] - m[5], m[2] - m[6], m[3] - m[1]};
  auto const apart = [](ft::vec3<double> x, ft::vec3<double> y) {
    return std::sqrt(dot(x - y, x - y));
  };
  return {std::atan2(std::sqrt(dot(axis, axis)), m[0] + m[4] + m[8] - 1), apart(a.p, b.p),
          apart(a.v, b.v), apart(a.bg, b.bg), apart(a.ba, b.ba)};
}

}  // namespace test
