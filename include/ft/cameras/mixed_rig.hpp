// SPDX-License-Identifier: Apache-2.0
/// @file Cameras of the models of any_camera fixed to each other: pairs, rectified or not, depth
/// cameras and single ones mixed.
#pragma once

#include <cmath>
#include <limits>
#include <string>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A camera of a mixed_rig. Its depths come from the other camera of its pair, from the right image
/// of a rectified pair, from a depth image, or there are none. A distorted image is searched as it
/// is.
struct mixed_rig_camera {
  any_camera<float> camera{};
  double baseline = 0;  ///< to the right camera, or of a depth camera's virtual pair, metres
  pose T_cb = pose::identity();  ///< body to camera
  bool used = true;              ///< as in rig_camera
  bool has_right_image = false;  ///< whether it is the left one of a rectified pair
  bool has_depth_image = false;
  int right = -1;         ///< camera of the rig that is the right one of its pair; -1 = none
  int left = -1;          ///< camera of the rig whose right one it is; -1 = none
  float depth_scale = 0;  ///< as in rgbd_rig, and so are the next two
  float min_depth = 0;    ///< metres
  float max_depth = std::numeric_limits<float>::infinity();  ///< metres
  float readout_s = 0;                                       ///< as in rig_camera

  /// A camera whose keypoints have no depth of their own.
  static mixed_rig_camera single(any_camera<float> const& camera, pose const& T_cb) {
    mixed_rig_camera c;
    c.camera = camera;
    c.T_cb = T_cb;
    return c;
  }
  /// The left one of a rectified pair of pinholes. @param baseline metres
  static mixed_rig_camera rectified(pinhole<float> const& camera, double baseline,
                                    pose const& T_cb) {
    mixed_rig_camera c = single(any_camera<float>::of(camera), T_cb);
    c.baseline = baseline;
    c.has_right_image = true;
    return c;
  }
  /// A camera with a depth image that is registered to its grey one.
  /// @param baseline of the virtual pair, metres; 0.08 suits sensors that see 0.5 to 4 m
  /// @param depth_scale as in rgbd_rig
  static mixed_rig_camera with_depth(any_camera<float> const& camera, double baseline,
                                     float depth_scale, pose const& T_cb) {
    mixed_rig_camera c = single(camera, T_cb);
    c.baseline = baseline;
    c.depth_scale = depth_scale;
    c.has_depth_image = true;
    return c;
  }
  /// As rig_camera::none().
  static mixed_rig_camera none() {
    rig_camera const other = rig_camera::none();
    mixed_rig_camera c = single(any_camera<float>::of(other.camera), other.T_cb);
    c.used = false;
    return c;
  }
  /// Whether there is no right image.
  FT_HOST_DEVICE bool single() const { return !has_right_image; }
  /// Baseline times fx, metres * pixels. A keypoint has a right column only with a right or a depth
  /// image.
  FT_HOST_DEVICE float bf() const {
    return static_cast<float>(baseline * static_cast<double>(camera.fx));
  }
  FT_HOST_DEVICE strict_float baseline_length() const { return static_cast<float>(baseline); }

  /// @throws bad_argument for an invalid camera, baseline, depth scale or limit, a motion that is
  ///   not rigid, more than one origin of depths, or a rectified pair that is not of pinholes
  void check() const {
    camera.check();
    detail::require_rigid(T_cb);
    int const origins = int{has_right_image} + int{has_depth_image} + int{right >= 0};
    detail::require(origins + int{left >= 0} <= 1,
                    "a camera of a mixed rig has depths of one origin, and a right one has none");
    detail::require(used || (origins == 0 && left < 0),
                    "a camera of a mixed rig that is not used has no other image");
    detail::require_finite("baseline", baseline);
    if (origins > 0) {
      detail::require_range("baseline", static_cast<float>(baseline), 1e-6f, 1e6f);
    } else {
      detail::require(baseline == 0, "a camera without depths of its own has a baseline of 0");
    }
    detail::require(!has_right_image || camera.is(camera_kind::pinhole),
                    "a rectified pair is one of pinholes");
    if (depth_scale != 0) { detail::require_range("depth scale", depth_scale, 1e-9f, 1e9f); }
    detail::require_range("min_depth", min_depth, 0.0f, std::numeric_limits<float>::max());
    detail::require_range("max_depth", max_depth, min_depth,
                          std::numeric_limits<float>::infinity());
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
  /// The distance of two cameras, metres.
  static double distance(mixed_rig_camera const& a, mixed_rig_camera const& b) {
    vec3<double> const apart =
        a.T_cb.template cast<double>().centre() - b.T_cb.template cast<double>().centre();
    return std::sqrt(dot(apart, apart));
  }
  /// @throws bad_argument if a camera's right one is no other camera, has another left one, or was
  ///   moved since they became a pair
  static void check_pairs(mixed_rig_camera const* of, int cameras) {
    for (int c = 0; c < cameras; ++c) {
      detail::require_range("right camera", of[c].right, -1, cameras - 1);
      detail::require_range("left camera", of[c].left, -1, cameras - 1);
      int const r = of[c].right;
      int const l = of[c].left;
      bool const agree = (r < 0 || (r != c && of[r].left == c && of[r].used)) &&
                         (l < 0 || (l != c && of[l].right == c && of[l].used));
      if (!agree) {
        throw bad_argument("ft: camera " + std::to_string(c) +
                           " of a mixed rig and its other one do not name each other as a pair; "
                           "pair_up() makes one");
      }
      double const apart = r < 0 ? of[c].baseline : distance(of[c], of[r]);
      if (!(std::abs(of[c].baseline - apart) <= 1e-4 * apart)) {
        throw bad_argument("ft: camera " + std::to_string(c) +
                           " of a mixed rig has a baseline of " + std::to_string(of[c].baseline) +
                           " m, but is " + std::to_string(apart) +
                           " m from its right one: call pair_up() when T_cb is set");
      }
    }
  }
};

/// A multi_rig of cameras of the models of any_camera.
template <int N>
using mixed_rig = multi_rig<N, mixed_rig_camera>;

/// Makes two single cameras a pair: depths of `left`'s keypoints come from both. They need not be
/// rectified, or of one model, but see the same from about the same direction.
/// @throws bad_argument for cameras that there are not, or two centres in one place
template <int N>
void pair_up(mixed_rig<N>& rig, int left, int right) {
  detail::require_range("left camera", left, 0, N - 1);
  detail::require_range("right camera", right, 0, N - 1);
  detail::require(left != right,
                  "the right camera of a pair is its left one, must be another camera");
  rig.of[left].right = right;
  rig.of[right].left = left;
  rig.of[left].baseline = mixed_rig_camera::distance(rig.of[left], rig.of[right]);
  detail::require(rig.of[left].baseline > 1e-6, "the cameras of a pair are in one place");
}

/// Left-camera points to the right camera of the pair whose left camera is c. @pre there is one
template <int N>
FT_HOST_DEVICE pose pair_motion(mixed_rig<N> const& rig, int c) {
  auto const T_lb = rig.of[c].T_cb.template cast<strict_float>();
  auto const T_rb = rig.of[rig.of[c].right].T_cb.template cast<strict_float>();
  return (T_rb * T_lb.inverse()).template cast<float>();
}

}  // namespace FT_ABI
}  // namespace ft
