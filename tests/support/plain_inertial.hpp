// SPDX-License-Identifier: Apache-2.0
/// @file Rotations and the integration of IMU measurements in double precision, written plainly.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "ft/containers/inertial.hpp"
#include "ft/types/poses.hpp"

namespace test {

using vec3d = ft::vec3<double>;
using mat3d = ft::mat3<double>;

inline vec3d times(double s, vec3d v) { return {s * v.x, s * v.y, s * v.z}; }
inline double norm(vec3d v) { return std::sqrt(dot(v, v)); }

/// The matrix of v -> w x v.
inline mat3d cross_matrix(vec3d w) { return {{0, -w.z, w.y, w.z, 0, -w.x, -w.y, w.x, 0}}; }

/// The exponential of [w] by its power series, after halving w until that converges fast.
inline mat3d plain_exp(vec3d w) {
  int halvings = 0;
  for (; norm(w) > 0.1; ++halvings) { w = times(0.5, w); }
  mat3d const W = cross_matrix(w);
  mat3d sum = mat3d::identity();
  mat3d term = mat3d::identity();
  for (int k = 1; k < 14; ++k) {
    term = term * W;
    for (double& v : term.m) { v /= k; }
    for (int i = 0; i < 9; ++i) { sum.m[i] += term.m[i]; }
  }
  for (; halvings > 0; --halvings) { sum = sum * sum; }
  return sum;
}

/// Axis times angle of a rotation by less than half a turn.
inline vec3d plain_log(mat3d const& R) {
  auto const& m = R.m;
  vec3d const axis{(m[7] - m[5]) / 2, (m[2] - m[6]) / 2, (m[3] - m[1]) / 2};
  double const s = norm(axis);
  double const angle = std::atan2(s, (m[0] + m[4] + m[8] - 1) / 2);
  return s < 1e-12 ? axis : times(angle / s, axis);
}

/// What preintegrated holds, without covariance and derivatives.
struct plain_integral {
  double dT = 0;
  mat3d dR = mat3d::identity();
  vec3d dV{0, 0, 0};
  vec3d dP{0, 0, 0};

  /// A step with constant specific force and rate, both without bias.
  void add(vec3d force, vec3d rate, double dt) {
    vec3d const f = dR * force;
    dP = dP + times(dt, dV) + times(dt * dt / 2, f);
    dV = dV + times(dt, f);
    dR = dR * plain_exp(times(dt, rate));
    dT += dt;
  }
};

/// A bias in double precision, so that it can be moved a little.
struct plain_bias {
  vec3d gyro{0, 0, 0};
  vec3d accel{0, 0, 0};
};
inline plain_bias widened(ft::imu_bias const& b) {
  return {b.gyro.cast<double>(), b.accel.cast<double>()};
}

inline plain_integral integrate_plainly(std::vector<ft::imu_step> const& steps,
                                        plain_bias const& bias) {
  plain_integral out;
  for (auto const& s : steps) {
    out.add(s.accel.cast<double>() - bias.accel, s.gyro.cast<double>() - bias.gyro,
            static_cast<double>(s.dt));
  }
  return out;
}

/// Steps of a body that shakes: about 10 m/s^2 with gravity, up to 2 rad/s, of `dt` seconds or
/// nearly so.
inline std::vector<ft::imu_step> shaken_steps(std::mt19937& random, int count, float dt) {
  std::uniform_real_distribution<float> u(-1, 1);
  std::vector<ft::imu_step> steps;
  for (int i = 0; i < count; ++i) {
    steps.push_back({{3 * u(random), 3 * u(random), 9.81f + 3 * u(random)},
                     {2 * u(random), 2 * u(random), 2 * u(random)},
                     dt * (1 + 0.1f * u(random))});
  }
  return steps;
}

inline ft::imu_bias random_bias(std::mt19937& random) {
  std::uniform_real_distribution<float> u(-1, 1);
  return {{0.02f * u(random), 0.02f * u(random), 0.02f * u(random)},
          {0.2f * u(random), 0.2f * u(random), 0.2f * u(random)}};
}

inline double largest(vec3d v) {
  return std::fmax(std::fabs(v.x), std::fmax(std::fabs(v.y), std::fabs(v.z)));
}
inline double angle_of(mat3d const& a, mat3d const& b) {
  return norm(plain_log(a.transposed() * b));
}

}  // namespace test
