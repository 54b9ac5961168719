// SPDX-License-Identifier: Apache-2.0
/// @file A rig of each kind, and motions, for tests of poses and windows.
#pragma once

#include <cmath>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/types/poses.hpp"

namespace test {

using fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;
using three_camera_rig = ft::multi_rig<3>;
using motion = ft::rigid<double>;

/// Rotation by `angle` about an axis of any length, then a translation. Source: Rodrigues' formula.
inline motion turn(ft::vec3<double> axis, double angle, ft::vec3<double> t) {
  double const length = std::sqrt(ft::dot(axis, axis));
  double const x = axis.x / length;
  double const y = axis.y / length;
  double const z = axis.z / length;
  double const c = std::cos(angle);
  double const s = std::sin(angle);
  double const d = 1 - c;
  return {{{c + x * x * d, x * y * d - z * s, x * z * d + y * s, y * x * d + z * s, c + y * y * d,
            y * z * d - x * s, z * x * d - y * s, z * y * d + x * s, c + z * z * d}},
          t};
}
/// A turn about w by its length, rad, then a translation.
inline motion turn(ft::vec3<double> w, ft::vec3<double> t) {
  double const angle = std::sqrt(ft::dot(w, w));
  return angle == 0 ? motion{ft::mat3<double>::identity(), t} : turn(w, angle, t);
}

template <typename Rig>
Rig example_rig();
template <>
inline ft::rectified_rig example_rig<ft::rectified_rig>() {
  return ft::rectified_rig::make({435.2f, 436.1f, 367.2f, 252.3f}, 0.11f);
}
template <>
inline fisheye_rig example_rig<fisheye_rig>() {
  return {{190.9f, 190.8f, 254.9f, 256.8f, 0.0034f, 0.0007f, -0.0020f, 0.0002f},
          {190.4f, 190.5f, 252.6f, 255.0f, 0.0040f, -0.0010f, -0.0010f, 0.0001f},
          turn({0.1, 1, 0.2}, 0.03, {-0.1, 0.002, 0.001}).cast<float>()};
}
/// Two pairs and a single camera between them, none in the body's frame.
template <>
inline three_camera_rig example_rig<three_camera_rig>() {
  auto const at = [](ft::vec3<double> w, ft::vec3<double> t) { return turn(w, t).cast<float>(); };
  return {{{{435.2f, 436.1f, 367.2f, 252.3f}, 0.11, at({0.02, -0.25, 0.01}, {0.1, 0.02, -0.05})},
           {{300.5f, 301.5f, 320.2f, 240.1f}, 0, at({-0.1, 0.05, 0.3}, {-0.2, 0.1, 0.02})},
           {{380.3f, 379.1f, 330.7f, 242.3f}, 0.2, at({0.1, 0.2, -0.02}, {-0.1, 0.03, 0.04})}}};
}

/// The left camera c.
template <typename Rig>
auto const& model_of(Rig const& rig, int c) {
  if constexpr (Rig::rectified) {
    return rig.pair(c).camera;
  } else {
    return rig.left;
  }
}

}  // namespace test
