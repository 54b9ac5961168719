// SPDX-License-Identifier: Apache-2.0
/// @file What an initialisation of a body with an IMU takes and gives.
#pragma once

#include <limits>

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// @throws bad_argument naming the value and the limit
inline void check(initialization_params const& p) {
  constexpr float most = std::numeric_limits<float>::max();
  detail::require_range("gravity", p.gravity, 0.1f, 100.0f);
  detail::require_range("least_keyframes", p.least_keyframes, 3, 1 << 20);
  detail::require_range("position_sigma", p.position_sigma, 1e-9f, most);
  detail::require_range("rotation_sigma", p.rotation_sigma, 1e-9f, most);
  detail::require_range("accel_bias_sigma", p.accel_bias_sigma, 1e-9f, 1e6f);
  detail::require_range("rest_distance", p.rest_distance, 0.0f, most);
  detail::require_range("rest_angle", p.rest_angle, 0.0f, most);
  constexpr float any = std::numeric_limits<float>::infinity();  // no limit
  detail::require_range("max_gyro_sigma", p.max_gyro_sigma, 0.0f, any);
  detail::require_range("max_tilt_sigma", p.max_tilt_sigma, 0.0f, any);
  detail::require_range("max_velocity_sigma", p.max_velocity_sigma, 0.0f, any);
  detail::require_range("max_scale_sigma", p.max_scale_sigma, 0.0f, any);
  detail::require_range("max_position_rms", p.max_position_rms, 0.0f, any);
  detail::require_range("max_rotation_rms", p.max_rotation_rms, 0.0f, any);
}

/// Gravity, velocity and biases. Standard deviations come from the poses' given ones, or from
/// what the poses are off by, if that is more.
struct inertial_initialization {
  initialization_status status;
  vec3<double> gravity;           ///< m/s^2, in the world of the poses
  mat3<double> R_up;              ///< turns that world, least of all, so that its z points up
  double scale;                   ///< metres per unit of the poses; 1 if known
  inertial_state<double> newest;  ///< of the last keyframe in the world of the poses, metres
  float gyro_bias_sigma;          ///< rad/s, of an axis
  float accel_bias_sigma;         ///< m/s^2, of the least certain axis of the body at first
  float tilt_sigma;               ///< rad
  float velocity_sigma;           ///< m/s, of the last velocity
  float scale_sigma;              ///< share; 0 if known
  float position_rms;             ///< what the poses are off by, m
  float rotation_rms;             ///< rad, for an interval

  FT_HOST_DEVICE bool succeeded() const {
    return status == initialization_status::initialized || status == initialization_status::at_rest;
  }
};

/// Keyframes of one body, in order of time.
struct initialization_window {
  rigid<double> const* T_wc;       ///< poses of the left camera, in any world
  preintegrated const* integrals;  ///< k: from keyframe k to k + 1, at any bias near the true one
  int count;                       ///< keyframes
  imu_mount mount;
};

/// Windows of a batch: keyframe k of window b is element b * capacity + k, as is the integral that
/// begins with it.
struct initialization_windows {
  rigid<double> const* T_wc;
  preintegrated const* integrals;
  int const* counts;  ///< [batch], at most `capacity`
  int capacity;
  int batch;
  imu_mount mount;
};

// The linear systems of the initialisation of a body with an IMU. Not API.

namespace detail {

FT_HOST_DEVICE inline strict_mat3d sum_of(strict_mat3d a, strict_mat3d const& b) {
  for (int i = 0; i < 9; ++i) { a.m[i] += b.m[i]; }
  return a;
}
FT_HOST_DEVICE inline real64 component(strict_vec3d v, int i) {
  return i == 0 ? v.x : i == 1 ? v.y : v.z;
}
FT_HOST_DEVICE inline real64 norm_of(strict_vec3d v) { return scalar::sqrt(dot(v, v)); }

/// A least-squares problem of up to N unknowns as normal equations, solved as L D L^T, in memory
/// that a group shares. All its threads make the same calls; an entry belongs to one of them, so
/// that it is a sum in the order of the calls. Rows and solutions are here, too: threads that index
/// arrays of their own keep them in local memory, of which a device sets aside that of all its
/// threads.
template <int N>
struct least_squares {
  int unknowns;
  int solvable;
  real64 A[N * N];  ///< lower triangle; after factor() L below D
  real64 b[N];
  real64 x[N];  ///< of solve()

  /// Ends with a sync.
  template <typename Group>
  FT_HOST_DEVICE void begin(Group g, int n) {
    if (g.rank() == 0) { unknowns = n; }
    for (int i = g.rank(); i < N * N; i += g.size()) { A[i] = 0.0; }
    for (int i = g.rank(); i < N; i += g.size()) { b[i] = 0.0; }
    g.sync();
  }
  /// row . x = right, with a weight. What follows reads it after a sync.
  /// @param row row(i) is the factor of unknown i
  template <typename Group, typename Row>
  FT_HOST_DEVICE void add(Group g, Row const& row, real64 right, real64 weight) {
    // Where there are more threads than columns, several share a column.
    static_assert(Group::max_threads == 1 || Group::max_threads % 16 == 0, "shared evenly");
    int const columns = min_of(g.size(), 16);
    int const sharers = g.size() / columns;
    int const first = g.rank() / columns;
    for (int j = g.rank() % columns; j <= unknowns; j += columns) {
      if (j == unknowns) {
        for (int i = first; i < unknowns; i += sharers) { b[i] += weight * row(i) * right; }
        continue;
      }
      real64 const own = row(j);
      for (int i = j + first; i < unknowns; i += sharers) { A[N * i + j] += weight * row(i) * own; }
    }
  }
  /// x_i = 0, with a weight. What follows reads it after a sync.
  template <typename Group>
  FT_HOST_DEVICE void pull_to_zero(Group g, int i, real64 weight) {
    if (g.rank() == i % min_of(g.size(), 16)) { A[N * i + i] += weight; }
  }

  /// After a sync. @return false if the unknowns do not follow from the equations, or one of those
  /// is NaN
  template <typename Group>
  FT_HOST_DEVICE bool factor(Group g) {
    return factor_columns(g, unknowns);
  }
  /// The first `columns` of L and D, which eliminate as many unknowns. The rest stays as it was.
  /// After a sync.
  template <typename Group>
  FT_HOST_DEVICE bool factor_columns(Group g, int columns) {
    for (int j = 0; j < columns; ++j) {
      for (int i = j + g.rank(); i < unknowns; i += g.size()) {
        real64 const before = A[N * i + j];
        real64 rest = before;
        for (int k = 0; k < j; ++k) { rest -= A[N * i + k] * (A[N * j + k] * A[N * k + k]); }
        A[N * i + j] = rest;
        // the rest of a difference of equal numbers is rounding
        if (i == j) { solvable = rest > before * real64(1e-13) ? 1 : 0; }
      }
      g.sync();
      if (solvable == 0) { return false; }
      for (int i = j + 1 + g.rank(); i < unknowns; i += g.size()) {
        A[N * i + j] = A[N * i + j] / A[N * j + j];
      }
      g.sync();
    }
    return true;
  }
  /// The solution into `x`, by one thread. @pre factor() was true
  FT_HOST_DEVICE void solve() {
    for (int i = 0; i < unknowns; ++i) { x[i] = b[i]; }
    substitute(x);
  }
  /// row . A^-1 . row, the variance of row . x, by one thread. @param work is overwritten
  FT_HOST_DEVICE real64 variance(real64 const (&row)[N], real64 (&work)[N]) const {
    for (int i = 0; i < N; ++i) { work[i] = row[i]; }
    substitute(work);
    real64 sum = 0.0;
    for (int i = 0; i < unknowns; ++i) { sum += row[i] * work[i]; }
    return sum;
  }

private:
  FT_HOST_DEVICE void substitute(real64 (&v)[N]) const {
    for (int i = 0; i < unknowns; ++i) {
      for (int k = 0; k < i; ++k) { v[i] -= A[N * i + k] * v[k]; }
    }
    for (int i = unknowns - 1; i >= 0; --i) {
      v[i] = v[i] / A[N * i + i];
      for (int k = i + 1; k < unknowns; ++k) { v[i] -= A[N * k + i] * v[k]; }
    }
  }
};

/// Rotation of an integral at another bias of the gyro.
FT_HOST_DEVICE inline strict_mat3d rotation_at(preintegrated const& in, strict_vec3d gyro_bias) {
  strict_vec3d const w = in.JRg.cast<real64>() * (gyro_bias - in.bias.gyro.cast<real64>());
  return in.dR.cast<real64>() * rotation_exp(w);
}

/// Integrals joined in the world of the poses: position and velocity since the first keyframe are
/// p0 + v0 T + g T^2 / 2 + D + E ba and v0 + g T + U + W ba, with the accelerometer's bias ba.
struct joined_integrals {
  real64 T;
  strict_vec3d D, U;
  strict_mat3d E, W;

  FT_HOST_DEVICE static joined_integrals none() {
    strict_vec3d const zero{0.0, 0.0, 0.0};
    strict_mat3d nothing;
    for (int i = 0; i < 9; ++i) { nothing.m[i] = 0.0; }
    return {0.0, zero, zero, nothing, nothing};
  }
  /// @param R body to world at the integral's begin
  FT_HOST_DEVICE void append(preintegrated const& in, strict_mat3d const& R,
                             strict_vec3d gyro_bias) {
    real64 const t = static_cast<double>(in.dT);
    strict_vec3d const dg = gyro_bias - in.bias.gyro.cast<real64>();
    strict_vec3d const ba = in.bias.accel.cast<real64>();
    strict_mat3d const JVa = in.JVa.cast<real64>();
    strict_mat3d const JPa = in.JPa.cast<real64>();
    strict_vec3d const dV = in.dV.cast<real64>() + in.JVg.cast<real64>() * dg - JVa * ba;
    strict_vec3d const dP = in.dP.cast<real64>() + in.JPg.cast<real64>() * dg - JPa * ba;
    D = D + scaled(U, t) + R * dP;
    E = sum_of(sum_of(E, scaled(W, t)), R * JPa);
    U = U + R * dV;
    W = sum_of(W, R * JVa);
    T += t;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
