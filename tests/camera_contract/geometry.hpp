// SPDX-License-Identifier: Apache-2.0
/// @file Geometry, in double. Part of tests/camera_contract.hpp.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <random>

#include "ft/types/poses.hpp"

namespace camera_contract {
inline namespace FT_ABI {

using vector = ft::vec3<double>;
using motion = ft::rigid<double>;
inline constexpr double pi = 3.14159265358979323846;
inline constexpr double nan = std::numeric_limits<double>::quiet_NaN();
inline constexpr double infinity = std::numeric_limits<double>::infinity();

inline std::size_t at(std::ptrdiff_t i) { return static_cast<std::size_t>(i); }
inline double length(vector v) { return std::sqrt(ft::dot(v, v)); }
inline vector scaled(vector v, double s) { return {v.x * s, v.y * s, v.z * s}; }
/// Between two directions of any length, radians; accurate where it is small.
inline double angle_between(vector a, vector b) {
  vector const cross{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return std::atan2(length(cross), ft::dot(a, b));
}
/// @param polar off the axis @param azimuth about it; radians
inline vector direction(double polar, double azimuth) {
  return {std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
          std::cos(polar)};
}
/// Rotation by `angle` about an axis, then a translation.
inline motion turn(vector axis, double angle, vector t) {
  vector const a = scaled(axis, 1 / length(axis));
  double const c = std::cos(angle);
  double const s = std::sin(angle);
  double const d = 1 - c;
  return {{{c + a.x * a.x * d, a.x * a.y * d - a.z * s, a.x * a.z * d + a.y * s,
            a.y * a.x * d + a.z * s, c + a.y * a.y * d, a.y * a.z * d - a.x * s,
            a.z * a.x * d - a.y * s, a.z * a.y * d + a.x * s, c + a.z * a.z * d}},
          t};
}
inline vector random_direction(std::mt19937& random) {
  std::normal_distribution<double> gauss;
  double const x = gauss(random);
  double const y = gauss(random);
  return {x, y, gauss(random)};
}

}  // namespace FT_ABI
}  // namespace camera_contract
