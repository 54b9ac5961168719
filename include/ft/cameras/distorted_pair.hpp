// SPDX-License-Identifier: Apache-2.0
/// @file A stereo pair whose images are rectified before they are searched.
#pragma once

#include <cmath>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Two cameras of any models, such as pinholes with radial-tangential distortion, and the rectified
/// pair `target` that their images are mapped to. Poses and points are those of the left camera of
/// `target`: the left camera, turned by R_left.
template <typename Left, typename Right = Left>
struct distorted_pair {
  static constexpr bool rectified = true;
  static constexpr int cameras = 1;
  static constexpr int images = 2;
  static constexpr int searches = 1;
  using left_type = typename detail::camera_in_rig<Left>::type;
  using right_type = typename detail::camera_in_rig<Right>::type;
  left_type left{};
  right_type right{};
  /// Rotate points of a camera into its rectified one: R1 and R2 of OpenCV's stereoRectify.
  mat3<double> R_left = mat3<double>::identity();
  mat3<double> R_right = mat3<double>::identity();
  rectified_rig target;
  int width = 0;  ///< of the images that come in, pixels; 0 = that of the rectified ones
  int height = 0;
  /// Seconds from the first row's exposure to the last one's, up to 0.1; 0 = a global shutter. See
  /// camera_description.
  float readout_s = 0;

  /// Rectified cameras look in the mean direction of both, with x along the baseline. Source:
  /// Fusiello, Trucco and Verri, "A compact algorithm for rectification of stereo pairs", Machine
  /// Vision and Applications 2000.
  /// @param T_rl left-camera points to the right camera, metres
  /// @param wanted both rectified cameras, for instance one with the mean focal length
  /// @throws bad_argument as check(), and if the right camera is not to the right: the baseline is
  ///   45 degrees or more off the x axis
  static distorted_pair make(Left const& left, Right const& right, pose const& T_rl,
                             pinhole<float> const& wanted) {
    stereo_rig<Left, Right>{left, right, T_rl}.check();
    rigid<double> const T = T_rl.cast<double>().orthonormalized();
    vec3<double> const centre = T.centre();  // of the right camera, in the left one's frame
    double const baseline = std::sqrt(dot(centre, centre));
    detail::require(centre.x > baseline * std::sqrt(0.5),
                    "a pair is rectified in rows: its right camera must be to the right of the "
                    "left one, less than 45 degrees off its x axis");
    auto const unit = [](vec3<double> v) {
      double const n = std::sqrt(dot(v, v));
      return vec3<double>{v.x / n, v.y / n, v.z / n};
    };
    vec3<double> const x = unit(centre);
    vec3<double> const ahead{T.R.m[6], T.R.m[7], T.R.m[8] + 1};  // both axes, in the left frame
    vec3<double> const y = unit(cross(ahead, x));
    vec3<double> const z = cross(x, y);
    distorted_pair rig;
    rig.left = left;
    rig.right = right;
    rig.R_left = {{x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z}};
    rig.R_right = rig.R_left * T.R.transposed();
    rig.target = {wanted, baseline};
    rig.check();
    return rig;
  }

  strict_float baseline_length() const { return target.baseline_length(); }
  /// @throws bad_argument for an invalid camera, size or baseline. Rotations are checked when
  /// images
  ///   are to be rectified
  void check() const {
    left.check();
    right.check();
    target.check();
    detail::require_range("width of raw images", width, 0, 16384);
    detail::require_range("height of raw images", height, 0, 16384);
    detail::require((width == 0) == (height == 0),
                    "width and height of raw images are both 0 or both above it");
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

}  // namespace FT_ABI
}  // namespace ft
