// SPDX-License-Identifier: Apache-2.0
/// @file Prediction of a pose with constant velocity: the last motion continues, scaled by the
/// elapsed time.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// A twist: axis times angle in rad, and the velocity whose integral is the translation.
struct twist {
  vec3<strict_double> w, u;
};

/// Quaternion of a rotation, scalar part not negative. Source: Shepperd, "Quaternion from rotation
/// matrix", 1978.
FT_HOST_DEVICE inline quaternion<strict_double> quaternion_of(mat3<strict_double> const& R) {
  using real = strict_double;
  auto const& m = R.m;
  real const trace = m[0] + m[4] + m[8];
  quaternion<real> q;
  if (trace >= m[0] && trace >= m[4] && trace >= m[8]) {
    q = {m[7] - m[5], m[2] - m[6], m[3] - m[1], real(1) + trace};
  } else if (m[0] >= m[4] && m[0] >= m[8]) {
    q = {real(1) + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6], m[7] - m[5]};
  } else if (m[4] >= m[8]) {
    q = {m[1] + m[3], real(1) - m[0] + m[4] - m[8], m[5] + m[7], m[2] - m[6]};
  } else {
    q = {m[2] + m[6], m[5] + m[7], real(1) - m[0] - m[4] + m[8], m[3] - m[1]};
  }
  real const n = scalar::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
  real const s = (q.w < real(0) ? real(-1) : real(1)) / n;
  return {q.x * s, q.y * s, q.z * s, q.w * s};
}

/// Axis times angle of a rotation. The angle is halved until the series of the arc sine converges
/// fast, so the bits do not depend on a library's functions.
FT_HOST_DEVICE inline vec3<strict_double> log_so3(quaternion<strict_double> q) {
  using real = strict_double;
  real factor = 2;
  real squared = q.x * q.x + q.y * q.y + q.z * q.z;
  FT_NO_UNROLL
  for (int i = 0; i < 4 && squared > real(1.0 / 64); ++i) {
    real const w = scalar::sqrt((real(1) + q.w) * real(0.5));
    real const s = real(0.5) / w;
    q = {q.x * s, q.y * s, q.z * s, w};
    squared = q.x * q.x + q.y * q.y + q.z * q.z;
    factor = factor + factor;
  }
  // asin(x) / x, from the innermost bracket.
  real sum = 1;
  FT_UNROLL
  for (int k = 10; k > 0; --k) {
    double const odd = 2.0 * k - 1.0;
    sum = real(1) + squared * real(odd * odd / (2.0 * k * (2.0 * k + 1.0))) * sum;
  }
  real const f = factor * sum;
  return {q.x * f, q.y * f, q.z * f};
}

/// Logarithm of a rigid motion that turns by less than half a turn. Error below 1e-13 of its
/// length, up to 3 rad. Source: Barfoot, "State estimation for robotics", 2017, section 7.1.
FT_HOST_DEVICE inline twist log_se3(rigid<strict_double> const& T) {
  using real = strict_double;
  quaternion<real> const q = quaternion_of(T.R);
  vec3<real> const w = log_so3(q);
  real const theta2 = dot(w, w);
  // V^-1 = I - W / 2 + c W^2 with c = (1 - a cot a) / theta^2, a = theta / 2.
  real c = 0;
  if (theta2 < real(0.25)) {
    real const terms[] = {1.0 / 12,           1.0 / 720,      1.0 / 30240,
                          1.0 / 1209600,      1.0 / 47900160, 691.0 / 1307674368000.0,
                          1.0 / 74724249600.0};
    FT_UNROLL
    for (int k = 6; k >= 0; --k) { c = terms[k] + theta2 * c; }
  } else {
    real const s = scalar::sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
    real const theta = scalar::sqrt(theta2);
    c = (real(1) - real(0.5) * theta * (q.w / s)) / theta2;
  }
  return {w, one_plus(real(-0.5), c, w, theta2) * T.t};
}

/// The motion T scaled in length: exp(share * log(T)), along the same screw.
FT_HOST_DEVICE inline rigid<strict_double> part_of_motion(rigid<strict_double> const& T,
                                                          strict_double share) {
  twist const all = log_se3(T);
  strict_double const d[6] = {share * all.w.x, share * all.w.y, share * all.w.z,
                              share * all.u.x, share * all.u.y, share * all.u.z};
  return exp_se3(d);
}

}  // namespace detail

/// The last motion of a camera, for a prediction with constant velocity. All functions give the
/// same bits on every executor.
struct constant_velocity {
  rigid<double> motion;      ///< T_cw of a frame times the inverse of the one before
  std::int64_t interval_ns;  ///< time between the two; 0 or below = unknown

  FT_HOST_DEVICE static constant_velocity at_rest() { return {rigid<double>::identity(), 0}; }
  FT_HOST_DEVICE bool known() const { return interval_ns > 0; }

  /// T_cw after `interval` ns more. If an interval is unknown or not above 0, that of the last
  /// motion is used.
  /// @pre the motion turns by less than half a turn
  FT_HOST_DEVICE rigid<double> predict(rigid<double> const& T_cw, std::int64_t interval,
                                       motion_params const& params = {}) const {
    using real = strict_double;
    auto M = motion.cast<real>();
    if (interval > 0 && interval_ns > 0) {
      real const share =
          real(static_cast<double>(interval)) / real(static_cast<double>(interval_ns));
      if (!(scalar::abs(share - real(1)) < real(params.even))) {
        M = detail::part_of_motion(M, min_of(share, real(params.longest)));
      }
    }
    return (M * T_cw.cast<real>()).cast<double>();
  }
  /// States that the camera moved from one pose to the other in `interval` ns.
  FT_HOST_DEVICE void observe(rigid<double> const& from, rigid<double> const& to,
                              std::int64_t interval) {
    using real = strict_double;
    motion = (to.cast<real>() * from.cast<real>().inverse()).orthonormalized().cast<double>();
    interval_ns = interval;
  }
  /// Forgets the motion: predicts none.
  FT_HOST_DEVICE void rest() { *this = at_rest(); }
  /// The camera was not seen for `interval` ns: the motion that is believed to go on shrinks by the
  /// share of params.memory that this is. Nothing happens if the interval is not above 0.
  FT_HOST_DEVICE void slow_down(std::int64_t interval, motion_params const& params = {}) {
    using real = strict_double;
    if (interval <= 0) { return; }
    real const gone = real(static_cast<double>(interval)) / (real(1e9) * real(params.memory));
    real const share = max_of(real(1) - gone, real(0));
    motion = detail::part_of_motion(motion.cast<real>(), share).cast<double>();
  }
};

}  // namespace FT_ABI
}  // namespace ft
