// SPDX-License-Identifier: Apache-2.0
/// @file From poses of the camera to poses and velocities of the base that it is fixed to.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/types/poses.hpp"
#include "ft_ros2/estimate.hpp"

namespace ft_ros2 {

using rigid = ft::rigid<double>;
using vec3 = ft::vec3<double>;
using mat3 = ft::mat3<double>;

inline rigid rigid_of(transform const& T) {
  rigid r;
  std::copy(T.R.begin(), T.R.end(), r.R.m);
  r.t = {T.t[0], T.t[1], T.t[2]};
  return r;
}
inline transform transform_of(rigid const& T) {
  transform r;
  std::copy(T.R.m, T.R.m + 9, r.R.begin());
  r.t = {T.t.x, T.t.y, T.t.z};
  return r;
}

/// [v]x, so that skew(v) * w = v x w.
inline mat3 skew(vec3 v) { return {{0, -v.z, v.y, v.z, 0, -v.x, -v.y, v.x, 0}}; }

/// The rotation vector of R, radians, for angles below pi.
inline vec3 rotation_vector(mat3 const& R) {
  vec3 const twice_sine{R.m[7] - R.m[5], R.m[2] - R.m[6], R.m[3] - R.m[1]};
  double const sine = 0.5 * std::sqrt(ft::dot(twice_sine, twice_sine));
  double const angle = std::atan2(sine, 0.5 * (R.m[0] + R.m[4] + R.m[8] - 1));
  return ft::scaled(twice_sine, sine > 1e-9 ? 0.5 * angle / sine : 0.5);
}

/// J C J^T, 6 x 6, row-major.
inline std::array<double, 36> moved_covariance(std::array<double, 36> const& J, double const* C) {
  std::array<double, 36> half{}, all{};
  for (std::size_t i = 0; i < 36; ++i) {
    for (std::size_t k = 0; k < 6; ++k) { half[i] += J[i / 6 * 6 + k] * C[6 * k + i % 6]; }
  }
  for (std::size_t i = 0; i < 36; ++i) {
    for (std::size_t k = 0; k < 6; ++k) { all[i] += half[i / 6 * 6 + k] * J[i % 6 * 6 + k]; }
  }
  return all;
}

/// Poses of the camera, one after the other, as estimates of the base. With B = T_base_camera the
/// pose is T_odom_base = B T_world_camera B^-1, as both worlds are the first frame's.
class base_frame {
public:
  explicit base_frame(transform const& T_base_camera) : T_bc_(rigid_of(T_base_camera)) {}

  /// @param covariance as that of ft::tracking @param to gets pose, covariance and velocities
  void take(rigid const& T_world_camera, double const* covariance, std::int64_t time_ns,
            estimate& to) {
    rigid const T = (T_bc_ * T_world_camera * T_bc_.inverse()).orthonormalized();
    to.T_odom_base = transform_of(T);
    to.covariance = moved_covariance(jacobian(T), covariance);
    to.moving_known = has_last_ && time_ns > time_ns_;
    if (to.moving_known) {
      double const rate = 1e9 / static_cast<double>(time_ns - time_ns_);
      mat3 const back = T.R.transposed();
      vec3 const v = ft::scaled(back * (T.t - last_.t), rate);
      vec3 const w = ft::scaled(rotation_vector(last_.R.transposed() * T.R), rate);
      to.linear = {v.x, v.y, v.z};
      to.angular = {w.x, w.y, w.z};
    }
    last_ = T;
    time_ns_ = time_ns;
    has_last_ = true;
  }
  /// A correction of the camera's world as one of odom: both begin at the same place.
  transform correction(rigid const& T_world_odom) const {
    return transform_of((T_bc_ * T_world_odom * T_bc_.inverse()).orthonormalized());
  }
  /// A frame without a pose: the next one has no velocities.
  void skip() { has_last_ = false; }

private:
  /// Of (translation, rotation about fixed axes) of the base in odom by the twist x, rotation
  /// first, of T_world_camera exp(x): B exp(x) B^-1 = exp(Ad(B) x).
  std::array<double, 36> jacobian(rigid const& T) const {
    mat3 const turn = T.R * T_bc_.R;
    mat3 const lever = T.R * skew(T_bc_.t) * T_bc_.R;
    std::array<double, 36> J{};
    for (std::size_t r = 0; r < 3; ++r) {
      for (std::size_t c = 0; c < 3; ++c) {
        J[6 * r + c] = lever.m[3 * r + c];
        J[6 * r + 3 + c] = turn.m[3 * r + c];
        J[6 * (r + 3) + c] = turn.m[3 * r + c];
      }
    }
    return J;
  }

  rigid T_bc_;
  rigid last_ = rigid::identity();
  std::int64_t time_ns_ = 0;
  bool has_last_ = false;
};

}  // namespace ft_ros2
