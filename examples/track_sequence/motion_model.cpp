// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/motion_model.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace app {

namespace {

using rotation = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// t = V u, for a rotation by the vector w at the velocity u: the integral of exp(x w) over x in
/// [0, 1].
Eigen::Matrix3d integral_of_turn(Eigen::Vector3d const& w) {
  double const angle = w.norm();
  bool const small = angle < 1e-4;  // below, the next terms of the series are below rounding
  double const a = small ? 0.5 : (1 - std::cos(angle)) / (angle * angle);
  double const b = small ? 1.0 / 6 : (angle - std::sin(angle)) / (angle * angle * angle);
  Eigen::Matrix3d cross;
  cross << 0, -w.z(), w.y(), w.z(), 0, -w.x(), -w.y(), w.x(), 0;
  return Eigen::Matrix3d::Identity() + a * cross + b * cross * cross;
}

}  // namespace

rigid_pose part_of_motion(rigid_pose const& T, double share) {
  Eigen::AngleAxisd const turn(Eigen::Matrix3d(Eigen::Map<rotation const>(T.R.data())));
  Eigen::Vector3d const w = turn.angle() * turn.axis();
  Eigen::Vector3d const u =
      integral_of_turn(w).inverse() * Eigen::Map<Eigen::Vector3d const>(T.t.data());
  rigid_pose part;
  Eigen::Map<rotation>(part.R.data()) =
      Eigen::AngleAxisd(share * turn.angle(), turn.axis()).toRotationMatrix();
  Eigen::Map<Eigen::Vector3d>(part.t.data()) = integral_of_turn(share * w) * (share * u);
  return part;
}

rigid_pose motion_model::predict(rigid_pose const& T_cw, std::int64_t interval_ns) const {
  if (interval_ns <= 0 || interval_ns_ <= 0) { return motion_ * T_cw; }
  double const share = static_cast<double>(interval_ns) / static_cast<double>(interval_ns_);
  if (std::abs(share - 1) < even) { return motion_ * T_cw; }
  return part_of_motion(motion_, std::min(share, longest)) * T_cw;
}

void motion_model::observe(rigid_pose const& from, rigid_pose const& to, std::int64_t interval_ns) {
  motion_ = to * from.inverse();
  motion_.orthonormalize();
  interval_ns_ = interval_ns;
}

void motion_model::rest() { motion_ = {}; }

void motion_model::slow_down() { motion_ = part_of_motion(motion_, 0.5); }

}  // namespace app
