// SPDX-License-Identifier: Apache-2.0
/// @file An observation's part of the normal equations of a pose.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// 6 of the gradient, 21 of the upper triangle, the cost.
inline constexpr int pose_terms = 28;

/// Adds an observation to the normal equations: gradient, then upper triangle by rows. A small
/// twist (w, t) moves the point p by w x p + t; so with M = P^T W P and f = P^T W e the blocks of
/// the curvature are [p]x M [p]x^T, [p]x M and M, and those of the gradient p x f and f.
/// @param P d prediction / d p @param rectified P[0][1], P[1][0] and P[2][1] are 0
template <typename Number>
FT_HOST_DEVICE void add_motion_terms(vec3<Number> p, Number const (&P)[3][3], vec3<Number> const& W,
                                     vec3<Number> const& e, bool rectified,
                                     float (&sums)[pose_terms]) {
  Number M[3][3];
  vec3<Number> f;
  if (rectified) {
    Number const w0 = W.x * P[0][0];
    Number const w2 = W.z * P[2][0];
    Number const w1 = W.y * P[1][1];
    Number const w02 = W.x * P[0][2];
    Number const w12 = W.y * P[1][2];
    Number const w22 = W.z * P[2][2];
    M[0][0] = w0 * P[0][0] + w2 * P[2][0];
    M[0][1] = Number(0.0f);
    M[0][2] = w02 * P[0][0] + w22 * P[2][0];
    M[1][1] = w1 * P[1][1];
    M[1][2] = w12 * P[1][1];
    M[2][2] = w02 * P[0][2] + w12 * P[1][2] + w22 * P[2][2];
    f = {w0 * e.x + w2 * e.z, w1 * e.y, w02 * e.x + w12 * e.y + w22 * e.z};
  } else {  // two rows
    vec3<Number> const u{W.x * P[0][0], W.x * P[0][1], W.x * P[0][2]};
    vec3<Number> const v{W.y * P[1][0], W.y * P[1][1], W.y * P[1][2]};
    M[0][0] = u.x * P[0][0] + v.x * P[1][0];
    M[0][1] = u.x * P[0][1] + v.x * P[1][1];
    M[0][2] = u.x * P[0][2] + v.x * P[1][2];
    M[1][1] = u.y * P[0][1] + v.y * P[1][1];
    M[1][2] = u.y * P[0][2] + v.y * P[1][2];
    M[2][2] = u.z * P[0][2] + v.z * P[1][2];
    f = {u.x * e.x + v.x * e.y, u.y * e.x + v.y * e.y, u.z * e.x + v.z * e.y};
  }
  M[1][0] = M[0][1];
  M[2][0] = M[0][2];
  M[2][1] = M[1][2];
  auto const add = [&](int at, Number v) { sums[at] += v.value; };
  add(0, p.y * f.z - p.z * f.y);
  add(1, p.z * f.x - p.x * f.z);
  add(2, p.x * f.y - p.y * f.x);
  add(3, f.x);
  add(4, f.y);
  add(5, f.z);
  Number G[3][3];  // [p]x M
  FT_UNROLL
  for (int k = 0; k < 3; ++k) {
    G[0][k] = p.y * M[2][k] - p.z * M[1][k];
    G[1][k] = p.z * M[0][k] - p.x * M[2][k];
    G[2][k] = p.x * M[1][k] - p.y * M[0][k];
  }
  add(6, p.y * G[0][2] - p.z * G[0][1]);
  add(7, p.z * G[0][0] - p.x * G[0][2]);
  add(8, p.x * G[0][1] - p.y * G[0][0]);
  add(12, p.z * G[1][0] - p.x * G[1][2]);
  add(13, p.x * G[1][1] - p.y * G[1][0]);
  add(17, p.x * G[2][1] - p.y * G[2][0]);
  FT_UNROLL
  for (int k = 0; k < 3; ++k) {
    add(9 + k, G[0][k]);
    add(14 + k, G[1][k]);
    add(18 + k, G[2][k]);
    add(21 + k, M[0][k]);
  }
  add(24, M[1][1]);
  add(25, M[1][2]);
  add(26, M[2][2]);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
