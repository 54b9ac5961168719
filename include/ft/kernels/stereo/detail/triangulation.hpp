// SPDX-License-Identifier: Apache-2.0
/// @file Linear triangulation of a point from two rays, in strict double. Source: Hartley and
/// Zisserman, "Multiple View Geometry", section 12.2.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// A symmetric 4 x 4 matrix: row i holds columns i to 3.
struct symmetric_4 {
  strict_double m[4][4];

  FT_HOST_DEVICE strict_double& at(int i, int j) { return i <= j ? m[i][j] : m[j][i]; }
  FT_HOST_DEVICE strict_double const& at(int i, int j) const { return i <= j ? m[i][j] : m[j][i]; }
  FT_HOST_DEVICE strict_double trace() const { return (m[0][0] + m[1][1]) + (m[2][2] + m[3][3]); }
  /// The inverse times the determinant. Needs no division, and exists for singular matrices as
  /// well.
  FT_HOST_DEVICE symmetric_4 adjugate() const {
    strict_double const a = m[0][0], b = m[0][1], c = m[0][2], d = m[0][3];
    strict_double const e = m[1][1], f = m[1][2], g = m[1][3];
    strict_double const h = m[2][2], i = m[2][3], j = m[3][3];
    strict_double const lower02 = c * i - h * d;  // minors of rows 2 and 3
    strict_double const lower03 = c * j - i * d;
    strict_double const lower12 = f * i - h * g;
    strict_double const lower13 = f * j - i * g;
    strict_double const lower23 = h * j - i * i;
    strict_double const upper01 = a * e - b * b;  // minors of rows 0 and 1
    strict_double const upper02 = a * f - c * b;
    strict_double const upper03 = a * g - d * b;
    strict_double const upper12 = b * f - c * e;
    strict_double const upper13 = b * g - d * e;
    strict_double const upper23 = c * g - d * f;
    symmetric_4 r;
    r.m[0][0] = e * lower23 - f * lower13 + g * lower12;
    r.m[0][1] = c * lower13 - b * lower23 - d * lower12;
    r.m[0][2] = g * upper23 - i * upper13 + j * upper12;
    r.m[0][3] = h * upper13 - f * upper23 - i * upper12;
    r.m[1][1] = a * lower23 - c * lower03 + d * lower02;
    r.m[1][2] = i * upper03 - d * upper23 - j * upper02;
    r.m[1][3] = c * upper23 - h * upper03 + i * upper02;
    r.m[2][2] = d * upper13 - g * upper03 + j * upper01;
    r.m[2][3] = f * upper03 - c * upper13 - i * upper01;
    r.m[3][3] = c * upper12 - f * upper02 + h * upper01;
    return r;
  }
  FT_HOST_DEVICE symmetric_4 scaled(strict_double factor) const {
    symmetric_4 r;
    FT_UNROLL
    for (int i = 0; i < 4; ++i) {
      FT_UNROLL
      for (int j = i; j < 4; ++j) { r.m[i][j] = m[i][j] * factor; }
    }
    return r;
  }
  FT_HOST_DEVICE symmetric_4 squared() const {
    symmetric_4 r;
    FT_UNROLL
    for (int i = 0; i < 4; ++i) {
      FT_UNROLL
      for (int j = i; j < 4; ++j) {
        r.m[i][j] = (at(i, 0) * at(0, j) + at(i, 1) * at(1, j)) +
                    (at(i, 2) * at(2, j) + at(i, 3) * at(3, j));
      }
    }
    return r;
  }
};

/// Eigenvector of the smallest eigenvalue of a positive semi-definite matrix: that of the largest
/// eigenvalue of the adjugate, which repeated squaring isolates. False if rounding errors could be
/// visible in a float.
FT_HOST_DEVICE inline bool smallest_eigenvector_by_squares(symmetric_4 const& a,
                                                           strict_double (&v)[4]) {
  constexpr double converged = 1.0 - 1.0 / (1 << 24);  // the next square also squares the rest
  constexpr int most = 20;
  symmetric_4 power = a.adjugate();
  strict_double trace = power.trace();
  // Bound on each of the products of three entries that form an entry of the adjugate.
  strict_double const products = a.m[0][0] * a.m[1][1] * (a.m[2][2] + a.m[3][3]) +
                                 a.m[2][2] * a.m[3][3] * (a.m[0][0] + a.m[1][1]);
  constexpr double most_lost = 1.0 / (1 << 20);
  if (!(trace > products * most_lost && trace > 1e-30 && trace < 1e30)) { return false; }
  bool done = false;
  FT_NO_UNROLL
  for (int k = 0; k < most && !done; ++k) {
    // The factor only has to be near 1 / trace, so a float is enough.
    strict_double const factor = static_cast<double>(reciprocal(static_cast<float>(trace.value)));
    power = power.scaled(factor);
    strict_double const before = trace * factor;
    power = power.squared();
    trace = power.trace();
    done = trace >= before * before * converged;
  }
  strict_double largest = power.m[0][0];
  for (int k = 0; k < 4; ++k) { v[k] = power.at(k, 0); }
  FT_UNROLL
  for (int i = 1; i < 4; ++i) {
    bool const larger = power.m[i][i] > largest;
    largest = larger ? power.m[i][i] : largest;
    FT_UNROLL
    for (int k = 0; k < 4; ++k) { v[k] = larger ? power.at(k, i) : v[k]; }
  }
  return done;
}

/// The point, in the left frame, that is seen along the rays `left` and `right`, both with z = 1.
/// @param T_rl left to right
FT_HOST_DEVICE inline vec3<float> triangulate(vec3<float> left, vec3<float> right,
                                              pose const& T_rl) {
  strict_double P[2][3][4];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) { P[0][i][j] = i == j ? 1.0 : 0.0; }
    for (int j = 0; j < 3; ++j) { P[1][i][j] = static_cast<double>(T_rl.R.m[3 * i + j]); }
  }
  P[1][0][3] = static_cast<double>(T_rl.t.x);
  P[1][1][3] = static_cast<double>(T_rl.t.y);
  P[1][2][3] = static_cast<double>(T_rl.t.z);
  strict_double const xy[2][2] = {{static_cast<double>(left.x), static_cast<double>(left.y)},
                                  {static_cast<double>(right.x), static_cast<double>(right.y)}};
  strict_double M[4][4];
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) { M[i][j] = 0.0; }
  }
  for (int c = 0; c < 2; ++c) {
    for (int r = 0; r < 2; ++r) {
      strict_double row[4];
      for (int j = 0; j < 4; ++j) { row[j] = xy[c][r] * P[c][2][j] - P[c][r][j]; }
      for (int i = 0; i < 4; ++i) {
        for (int j = i; j < 4; ++j) { M[i][j] = M[i][j] + row[i] * row[j]; }
      }
    }
  }
  symmetric_4 upper;
  for (int i = 0; i < 4; ++i) {
    for (int j = i; j < 4; ++j) {
      upper.m[i][j] = M[i][j];
      M[j][i] = M[i][j];
    }
  }
  strict_double v[4];
  if (!smallest_eigenvector_by_squares(upper, v)) { smallest_eigenvector_4(M, v); }
  return {static_cast<float>((v[0] / v[3]).value), static_cast<float>((v[1] / v[3]).value),
          static_cast<float>((v[2] / v[3]).value)};
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
