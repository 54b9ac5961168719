// SPDX-License-Identifier: Apache-2.0
/// @file A camera with a depth image (RGB-D).
#pragma once

#include <limits>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"

namespace ft {
inline namespace FT_ABI {

/// A camera whose grey images come with registered depth images. A keypoint with a depth d counts
/// as a match of a virtual rectified pair: its right column is x - baseline fx / d. Source:
/// Mur-Artal and Tardos, "ORB-SLAM2: an open-source SLAM system for monocular, stereo and RGB-D
/// cameras", T-RO 2017, section III.
///
/// Keypoints of a distorted camera are moved to where a pinhole with its focal lengths and
/// principal point would see them.
/// @tparam Camera of the grey images: a model with fx, fy, cx and cy
template <typename Camera = pinhole<float>>
struct rgbd_rig {
  static constexpr bool rectified = true;
  static constexpr int cameras = 1;
  static constexpr int images = 1;
  static constexpr int searches = 1;
  using camera_type = typename detail::camera_in_rig<Camera>::type;
  camera_type camera{};
  double baseline = 0;  ///< of the virtual pair, metres; 0.08 suits sensors that see 0.5 to 4 m
  /// Metres per unit of a depth image: 0.001 for millimetres, 1 / 5000 for TUM's images. 0: none is
  /// given, so depths are metres, and images of 16 bits are refused.
  float depth_scale = 0;
  float min_depth = 0;                                       ///< metres; smaller depths are none
  float max_depth = std::numeric_limits<float>::infinity();  ///< metres; larger depths are none
  /// Seconds from the first row's exposure to the last one's, up to 0.1; 0 = a global shutter. See
  /// camera_description.
  float readout_s = 0;

  /// @throws bad_argument as check()
  static rgbd_rig make(Camera const& camera, double baseline, float depth_scale = 0) {
    rgbd_rig rig;
    rig.camera = camera;
    rig.baseline = baseline;
    rig.depth_scale = depth_scale;
    rig.check();
    return rig;
  }
  /// The camera of the keypoints that are searched, of poses and points.
  pinhole<float> undistorted() const { return {camera.fx, camera.fy, camera.cx, camera.cy}; }
  /// The virtual pair.
  rectified_rig pair() const { return {undistorted(), baseline}; }
  strict_float baseline_length() const { return pair().baseline_length(); }
  /// @throws bad_argument for an invalid camera, baseline, scale or limit of depth
  void check() const {
    camera.check();
    pair().check();
    if (depth_scale != 0) { detail::require_range("depth scale", depth_scale, 1e-9f, 1e9f); }
    detail::require_range("min_depth", min_depth, 0.0f, std::numeric_limits<float>::max());
    detail::require_range("max_depth", max_depth, min_depth,
                          std::numeric_limits<float>::infinity());
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

}  // namespace FT_ABI
}  // namespace ft
