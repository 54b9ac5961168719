// SPDX-License-Identifier: Apache-2.0
/// @file Similarities and their tangent vectors: exponential and logarithm. Equal bits on every
/// executor. Source: Strasdat, "Local accuracy and global consistency for efficient visual SLAM",
/// 2012, section 2.4.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/log.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// e^v, with an error below 1 unit in the last place. With v = k log 2 + r: 2^k times the series of
/// e^r. 0 below -708, infinite above 709.7.
FT_HOST_DEVICE inline strict_double strict_exp(strict_double v) {
  if (!(v.value <= 709.7)) { return v + strict_double(-log_of_zero); }
  if (v.value < -708) { return 0.0; }
  strict_double const k = ::rint((v * strict_double(1.4426950408889634)).value);
  // The first part of log 2 has 42 bits, so that its product with k is exact.
  strict_double const r =
      (v - k * strict_double(0x1.62e42fefa3800p-1)) - k * strict_double(0x1.ef35793c76730p-45);
  strict_double sum = 1.0;
  FT_UNROLL
  for (int n = 14; n > 1; --n) { sum = strict_double(1.0) + r * strict_double(1.0 / n) * sum; }
  sum = strict_double(1.0) + r * sum;
  // 2^1024 is no double: in two parts.
  int const exponent = static_cast<int>(k.value);
  int const part[2] = {exponent / 2, exponent - exponent / 2};
  for (int const p : part) {
    std::uint64_t const bits = static_cast<std::uint64_t>(p + 1023) << 52;
    double power = 0;
    std::memcpy(&power, &bits, sizeof power);
    sum = sum * strict_double(power);
  }
  return sum;
}

/// V = sum of M^k / (k + 1)! with M = [w] + sigma I, so that exp(M) = I + M V: what the translation
/// of a tangent vector is multiplied by. By its series for a part of M, and V(2 M) = (I + exp(M))
/// V(M) / 2.
FT_HOST_DEVICE inline strict_mat3d translation_factor(strict_vec3d w, real64 sigma) {
  real64 const one_half = 0.5;
  int halvings = 0;
  FT_NO_UNROLL
  while (dot(w, w) + sigma * sigma > real64(1.0 / 64) && halvings < 60) {
    w = scaled(w, one_half);
    sigma = sigma * one_half;
    ++halvings;
  }
  strict_mat3d const M{{sigma, -w.z, w.y, w.z, sigma, -w.x, -w.y, w.x, sigma}};
  auto const add_one = [](strict_mat3d& A) {
    for (int k = 0; k < 9; k += 4) { A.m[k] += real64(1.0); }
  };
  strict_mat3d V = strict_mat3d::identity();
  FT_NO_UNROLL
  for (int n = 12; n > 1; --n) {
    V = scaled(M * V, real64(1.0) / real64(n));
    add_one(V);
  }
  strict_mat3d E = M * V;
  add_one(E);
  FT_NO_UNROLL
  for (; halvings > 0; --halvings) {
    strict_mat3d sum = E;
    add_one(sum);
    V = scaled(sum * V, one_half);
    E = E * E;
  }
  return V;
}

/// Exponential of a tangent vector: rotation, translation, logarithm of the scale.
FT_HOST_DEVICE inline similarity<real64> exp_sim3(real64 const (&d)[7]) {
  strict_vec3d const w{d[0], d[1], d[2]};
  return {rotation_exp(w), translation_factor(w, d[6]) * strict_vec3d{d[3], d[4], d[5]},
          strict_exp(d[6])};
}

/// Logarithm of a similarity that turns by less than half a turn, in the order of exp_sim3.
FT_HOST_DEVICE inline void log_sim3(similarity<real64> const& T, real64 (&d)[7]) {
  strict_vec3d const w = log_so3(quaternion_of(T.R));
  d[6] = strict_log(T.scale);
  // Cramer's rule.
  strict_mat3d const V = translation_factor(w, d[6]);
  strict_vec3d const a = column_of(V, 0);
  strict_vec3d const b = column_of(V, 1);
  strict_vec3d const c = column_of(V, 2);
  real64 const inverse = scalar::reciprocal(dot(a, cross(b, c)));
  d[0] = w.x;
  d[1] = w.y;
  d[2] = w.z;
  d[3] = dot(T.t, cross(b, c)) * inverse;
  d[4] = dot(T.t, cross(c, a)) * inverse;
  d[5] = dot(T.t, cross(a, b)) * inverse;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
