// SPDX-License-Identifier: Apache-2.0
/// @file Prediction of a pose with constant velocity: the last motion continues, scaled by the
/// elapsed time.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/se3.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

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

// Poses of a camera from three points and the directions in which it sees them. Source:
// Persson and Nordberg, "Lambda Twist: an accurate fast robust perspective three point (P3P)
// solver", ECCV 2018.

namespace detail {

/// Poses that three points allow, at most four.
struct three_point_poses {
  rigid<strict_double> T_cw[4];
  int count = 0;
};

/// The solver. Its arithmetic is that of +, -, *, / and square roots, so that its bits are the same
/// on every executor.
class three_point_solver {
  using real = strict_double;
  using vec = vec3<real>;

public:
  /// @param ray unit directions in the camera's frame @param point world, metres
  FT_HOST_DEVICE three_point_solver(vec const (&ray)[3], vec const (&point)[3])
      : ray_(ray), point_(point) {
    vec const d12 = point[0] - point[1], d13 = point[0] - point[2], d23 = point[1] - point[2];
    a12_ = dot(d12, d12);
    a13_ = dot(d13, d13);
    a23_ = dot(d23, d23);
    b12_ = real(-2) * dot(ray[0], ray[1]);
    b13_ = real(-2) * dot(ray[0], ray[2]);
    b23_ = real(-2) * dot(ray[1], ray[2]);
  }

  /// All poses that see the points in the directions, in front of the camera along them. None for
  /// points or directions that are degenerate, or not finite.
  FT_HOST_DEVICE three_point_poses solve() const {
    three_point_poses out;
    for_each_pose([&](rigid<real> const& T_cw) { out.T_cw[out.count++] = T_cw; });
    return out;
  }
  /// visit(T_cw) of each. Room for all of them would be local memory on a device.
  template <typename Visit>
  FT_HOST_DEVICE void for_each_pose(Visit const& visit) const {
    pencil const p = degenerate_form();
    if (!(p.ratio >= real(0))) { return; }  // also NaN
    real root = scalar::sqrt(p.ratio);
    FT_NO_UNROLL
    for (int plane = 0; plane < 2; ++plane, root = -root) { find_poses(p, root, visit); }
  }

private:
  /// The quadratic form of the distances that is a product of two planes.
  struct pencil {
    vec first, second;  ///< eigenvectors of its eigenvalues that are not 0, larger one first
    real ratio;         ///< minus the second eigenvalue by the first
  };

  /// A real root of x^3 + b x^2 + c x + d, by Newton's method from beside the outer extremum.
  FT_HOST_DEVICE static real cubic_root(real b, real c, real d) {
    auto const value = [&](real x) { return ((x + b) * x + c) * x + d; };
    real x = -b / real(3);
    real const apart = b * b - real(3) * c;
    if (apart >= real(0)) {
      real const v = scalar::sqrt(apart);
      real const low = (-b - v) / real(3), high = (-b + v) / real(3);
      // Beyond an extremum the parabola that touches it there is a good start.
      if (value(low) > real(0)) {
        x = low - scalar::sqrt(-value(low) / (real(3) * low + b));
      } else {
        x = high + scalar::sqrt(-value(high) / (real(3) * high + b));
      }
    } else if (scalar::abs((real(3) * x + real(2) * b) * x + c) < real(1e-4)) {
      x += real(1);
    }
    FT_NO_UNROLL
    for (int i = 0; i < 50; ++i) {
      real const f = value(x);
      if (!(scalar::abs(f) > real(1e-13)) && i >= 7) { break; }
      x -= f / ((real(3) * x + real(2) * b) * x + c);
    }
    return x;
  }

  FT_HOST_DEVICE pencil degenerate_form() const {
    real const half = 0.5;
    real const c12 = -half * b12_, c13 = -half * b13_, c23 = -half * b23_;
    real const s12 = real(1) - c12 * c12, s13 = real(1) - c13 * c13, s23 = real(1) - c23 * c23;
    real const blob = c12 * c23 * c13 - real(1);
    real const p3 = a13_ * (a23_ * s13 - a13_ * s23);
    real const p2 = real(2) * blob * a23_ * a13_ + a13_ * (real(2) * a12_ + a13_) * s23 +
                    a23_ * (a23_ - a12_) * s13;
    real const p1 = a23_ * (a13_ - a23_) * s12 - a12_ * a12_ * s23 -
                    real(2) * a12_ * (blob * a23_ + a13_ * s23);
    real const p0 = a12_ * (a12_ * s23 - a23_ * s12);
    real const g = cubic_root(p2 / p3, p1 / p3, p0 / p3);
    real const m00 = a23_ * (real(1) - g), m01 = a23_ * b12_ * half,
               m02 = -(a23_ * b13_ * g * half);
    real const m11 = a23_ - a12_ + a13_ * g, m12 = b23_ * (a13_ * g - a12_) * half;
    real const m22 = g * (a13_ - a23_) - a12_;
    // Eigenvalues of a symmetric matrix with determinant 0.
    real const b = -(m00 + m11 + m22);
    real const c = m00 * (m11 + m22) + m11 * m22 - m01 * m01 - m02 * m02 - m12 * m12;
    real const root = scalar::sqrt(b * b - real(4) * c);
    real e1 = (-b + root) * half, e2 = (-b - root) * half;
    if (scalar::abs(e1) < scalar::abs(e2)) {
      real const other = e1;
      e1 = e2;
      e2 = other;
    }
    auto const vector_of = [&](real e) {
      real const by = real(1) / (e * (m00 + m11) - m00 * m11 - e * e + m01 * m01);
      real const x = -((e * m02 + (m01 * m12 - m02 * m11)) * by);
      real const y = -((e * m12 + (m01 * m02 - m00 * m12)) * by);
      real const unit = real(1) / scalar::sqrt(x * x + y * y + real(1));
      return vec{x * unit, y * unit, unit};
    };
    real const ratio = -e2 / e1;
    return {vector_of(e1), vector_of(e2), ratio < real(0) ? real(0) : ratio};
  }

  /// The poses of one of the two planes.
  template <typename Visit>
  FT_HOST_DEVICE void find_poses(pencil const& p, real s, Visit const& visit) const {
    real const w2 = real(1) / (s * p.second.x - p.first.x);
    real const w0 = (p.first.y - s * p.second.y) * w2;
    real const w1 = (p.first.z - s * p.second.z) * w2;
    real const a = real(1) / ((a13_ - a12_) * w1 * w1 - a12_ * b13_ * w1 - a12_);
    real const b = (a13_ * b12_ * w1 - a12_ * b13_ * w0 - real(2) * w0 * w1 * (a12_ - a13_)) * a;
    real const c = ((a13_ - a12_) * w0 * w0 + a13_ * b12_ * w0 + a13_) * a;
    real const under = b * b - real(4) * c;
    if (!(under >= real(0))) { return; }
    real root = scalar::sqrt(under);
    FT_NO_UNROLL
    for (int k = 0; k < 2; ++k, root = -root) {
      real const tau = (-b + root) * real(0.5);
      if (!(tau > real(0))) { continue; }
      real const d = a23_ / (tau * (b23_ + tau) + real(1));
      if (!(d > real(0))) { continue; }
      real const l2 = scalar::sqrt(d), l3 = tau * l2;
      real const l1 = w0 * l2 + w1 * l3;
      if (l1 >= real(0)) { visit(pose_of(l1, l2, l3)); }
    }
  }

  /// The motion that takes the points to these distances along their directions.
  FT_HOST_DEVICE rigid<real> pose_of(real l1, real l2, real l3) const {
    vec const seen = scaled(ray_[0], l1);
    vec const y1 = seen - scaled(ray_[1], l2), y2 = seen - scaled(ray_[2], l3);
    vec const y3 = cross(y1, y2);
    vec const x1 = point_[0] - point_[1], x2 = point_[0] - point_[2];
    vec const x3 = cross(x1, x2);
    // Rows of the inverse of the matrix with columns x1, x2, x3.
    real const by = real(1) / dot(x3, x3);
    vec const r1 = scaled(cross(x2, x3), by), r2 = scaled(cross(x3, x1), by), r3 = scaled(x3, by);
    rigid<real> T{
        {{y1.x * r1.x + (y2.x * r2.x + y3.x * r3.x), y1.x * r1.y + (y2.x * r2.y + y3.x * r3.y),
          y1.x * r1.z + (y2.x * r2.z + y3.x * r3.z), y1.y * r1.x + (y2.y * r2.x + y3.y * r3.x),
          y1.y * r1.y + (y2.y * r2.y + y3.y * r3.y), y1.y * r1.z + (y2.y * r2.z + y3.y * r3.z),
          y1.z * r1.x + (y2.z * r2.x + y3.z * r3.x), y1.z * r1.y + (y2.z * r2.y + y3.z * r3.y),
          y1.z * r1.z + (y2.z * r2.z + y3.z * r3.z)}},
        {real(0), real(0), real(0)}};
    T = T.orthonormalized();
    T.t = seen - T.R * point_[0];
    return T;
  }

  vec const (&ray_)[3];
  vec const (&point_)[3];
  real a12_, a13_, a23_;  ///< squared distances of the points
  real b12_, b13_, b23_;  ///< -2 cosines of the angles between the directions
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
