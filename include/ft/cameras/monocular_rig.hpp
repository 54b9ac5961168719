// SPDX-License-Identifier: Apache-2.0
/// @file One camera without any depth.
#pragma once

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// One camera whose map begins from its motion. Without an IMU nothing tells the scale: lengths are
/// in units in which the median depth of the points of a map's first two keyframes is 1 when it
/// begins. Directions 90 degrees or more off the axis get no map points.
/// @tparam Camera any camera model with fx, fy, cx and cy
template <typename Camera = pinhole<float>>
struct monocular_rig {
  // As a rectified pair whose right camera never sees anything.
  static constexpr bool rectified = true;
  static constexpr int cameras = 1;
  static constexpr int images = 1;
  static constexpr int searches = 1;
  using camera_type = typename detail::camera_in_rig<Camera>::type;
  camera_type camera{};
  /// Seconds from the first row's exposure to the last one's, up to 0.1; 0 = a global shutter. See
  /// camera_description.
  float readout_s = 0;

  /// @throws bad_argument as check()
  static monocular_rig make(Camera const& camera) {
    monocular_rig rig;
    rig.camera = camera;
    rig.check();
    return rig;
  }
  /// The camera that two views are reconstructed with.
  pinhole<float> undistorted() const { return {camera.fx, camera.fy, camera.cx, camera.cy}; }

  // What a multi_rig has per camera.

  FT_HOST_DEVICE monocular_rig const& pair(int) const { return *this; }
  FT_HOST_DEVICE static constexpr bool single() { return true; }
  FT_HOST_DEVICE static constexpr float bf() { return 0; }
  /// A unit of length: there is no baseline.
  FT_HOST_DEVICE static strict_float baseline_length() { return 1.0f; }
  template <typename Value>
  FT_HOST_DEVICE static Value const& to_camera(int, Value const& in_body) {
    return in_body;
  }
  template <typename Real>
  FT_HOST_DEVICE static vec3<Real> to_body(int, vec3<Real> in_camera) {
    return in_camera;
  }
  template <typename Real>
  FT_HOST_DEVICE static mat3<Real> const& derivative_in_body(int, mat3<Real> const& in_camera) {
    return in_camera;
  }
  /// @throws bad_argument for an invalid camera or read-out time
  void check() const {
    camera.check();
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

/// Whether a rig is a monocular_rig.
template <typename Rig>
inline constexpr bool is_monocular_v = false;
template <typename Camera>
inline constexpr bool is_monocular_v<monocular_rig<Camera>> = true;

}  // namespace FT_ABI
}  // namespace ft
