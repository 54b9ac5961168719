// SPDX-License-Identifier: Apache-2.0
/// @file The linear systems of the initialisation of a body with an IMU. Not API.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

FT_HOST_DEVICE inline wide_mat3 sum_of(wide_mat3 a, wide_mat3 const& b) {
  for (int i = 0; i < 9; ++i) { a.m[i] += b.m[i]; }
  return a;
}
FT_HOST_DEVICE inline wide component(wide_vec3 v, int i) {
  return i == 0 ? v.x : i == 1 ? v.y : v.z;
}
FT_HOST_DEVICE inline wide norm_of(wide_vec3 v) { return scalar::sqrt(dot(v, v)); }

/// A least-squares problem of up to N unknowns as normal equations, solved as L D L^T. All threads
/// of a group make the same calls; an entry belongs to one of them, so that it is a sum in the
/// order of the calls.
template <int N>
struct least_squares {
  int unknowns;
  int solvable;
  wide A[N * N];  ///< lower triangle; after factor() L below D
  wide b[N];

  /// Ends with a sync.
  template <typename Group>
  FT_HOST_DEVICE void begin(Group g, int n) {
    if (g.rank() == 0) { unknowns = n; }
    for (int i = g.rank(); i < N * N; i += g.size()) { A[i] = 0.0; }
    for (int i = g.rank(); i < N; i += g.size()) { b[i] = 0.0; }
    g.sync();
  }
  /// row . x = right, with a weight. What follows reads it after a sync.
  template <typename Group>
  FT_HOST_DEVICE void add(Group g, wide const (&row)[N], wide right, wide weight) {
    // Where there are more threads than columns, several share a column.
    static_assert(Group::max_threads == 1 || Group::max_threads % 16 == 0, "shared evenly");
    int const columns = min_of(g.size(), 16);
    int const sharers = g.size() / columns;
    int const first = g.rank() / columns;
    for (int j = g.rank() % columns; j <= unknowns; j += columns) {
      if (j == unknowns) {
        for (int i = first; i < unknowns; i += sharers) { b[i] += weight * row[i] * right; }
        continue;
      }
      wide const own = row[j];
      for (int i = j + first; i < unknowns; i += sharers) { A[N * i + j] += weight * row[i] * own; }
    }
  }
  /// x_i = 0, with a weight. What follows reads it after a sync.
  template <typename Group>
  FT_HOST_DEVICE void pull_to_zero(Group g, int i, wide weight) {
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
        wide const before = A[N * i + j];
        wide rest = before;
        for (int k = 0; k < j; ++k) { rest -= A[N * i + k] * (A[N * j + k] * A[N * k + k]); }
        A[N * i + j] = rest;
        // the rest of a difference of equal numbers is rounding
        if (i == j) { solvable = rest > before * wide(1e-13) ? 1 : 0; }
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
  /// Each thread for itself. @pre factor() was true
  FT_HOST_DEVICE void solve(wide (&x)[N]) const {
    for (int i = 0; i < unknowns; ++i) {
      for (int k = 0; k < i; ++k) { x[i] -= A[N * i + k] * x[k]; }
    }
    for (int i = unknowns - 1; i >= 0; --i) {
      x[i] = x[i] / A[N * i + i];
      for (int k = i + 1; k < unknowns; ++k) { x[i] -= A[N * k + i] * x[k]; }
    }
  }
  /// row . A^-1 . row, the variance of row . x.
  FT_HOST_DEVICE wide variance(wide const (&row)[N]) const {
    wide x[N];
    for (int i = 0; i < N; ++i) { x[i] = row[i]; }
    solve(x);
    wide sum = 0.0;
    for (int i = 0; i < unknowns; ++i) { sum += row[i] * x[i]; }
    return sum;
  }
};

/// Rotation of an integral at another bias of the gyro.
FT_HOST_DEVICE inline wide_mat3 rotation_at(preintegrated const& in, wide_vec3 gyro_bias) {
  wide_vec3 const w = in.JRg.cast<wide>() * (gyro_bias - in.bias.gyro.cast<wide>());
  return in.dR.cast<wide>() * rotation_exp(w);
}

/// Integrals joined in the world of the poses: position and velocity since the first keyframe are
/// p0 + v0 T + g T^2 / 2 + D + E ba and v0 + g T + U + W ba, with the accelerometer's bias ba.
struct joined_integrals {
  wide T;
  wide_vec3 D, U;
  wide_mat3 E, W;

  FT_HOST_DEVICE static joined_integrals none() {
    wide_vec3 const zero{0.0, 0.0, 0.0};
    wide_mat3 nothing;
    for (int i = 0; i < 9; ++i) { nothing.m[i] = 0.0; }
    return {0.0, zero, zero, nothing, nothing};
  }
  /// @param R body to world at the integral's begin
  FT_HOST_DEVICE void append(preintegrated const& in, wide_mat3 const& R, wide_vec3 gyro_bias) {
    wide const t = static_cast<double>(in.dT);
    wide_vec3 const dg = gyro_bias - in.bias.gyro.cast<wide>();
    wide_vec3 const ba = in.bias.accel.cast<wide>();
    wide_mat3 const JVa = in.JVa.cast<wide>();
    wide_mat3 const JPa = in.JPa.cast<wide>();
    wide_vec3 const dV = in.dV.cast<wide>() + in.JVg.cast<wide>() * dg - JVa * ba;
    wide_vec3 const dP = in.dP.cast<wide>() + in.JPg.cast<wide>() * dg - JPa * ba;
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
