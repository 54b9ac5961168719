// SPDX-License-Identifier: Apache-2.0
/// @file Two cameras fixed to each other.
#pragma once

#include <cmath>
#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Replaces a type that misses the camera contract, so that the assertion about it is the only
/// error.
template <typename Scalar>
struct stand_in_camera : pinhole<Scalar> {
  stand_in_camera() = default;
  template <typename... Any>
  FT_HOST_DEVICE stand_in_camera(Any const&...) {}  // NOLINT(google-explicit-constructor)
};

/// Camera, checked at compile time.
template <typename Camera>
struct camera_in_rig {
  static_assert(assert_camera_model<Camera>::value, "a rig needs camera models");
  using type = std::conditional_t<is_camera_model_v<Camera>, Camera, stand_in_camera<float>>;
};

}  // namespace detail

// A rig states at compile time:
//   cameras    whose keypoints are searched and tracked
//   images     of a frame; camera c's image is number c * images / cameras
//   searches   independent searches of a frame, each in cameras / searches cameras
//   rectified  whether a searched camera may have a right image, in which keypoints have a column

/// Two cameras of any models. `T_rl` maps left-camera points to the right camera; metres.
template <typename Left, typename Right>
struct stereo_rig {
  static constexpr bool rectified = false;
  static constexpr int cameras = 2;
  static constexpr int images = 2;
  static constexpr int searches = 1;
  using left_type = typename detail::camera_in_rig<Left>::type;
  using right_type = typename detail::camera_in_rig<Right>::type;
  left_type left;
  right_type right;
  pose T_rl;
  /// Seconds from the first row's exposure to the last one's, of both cameras, up to 0.1; 0 = a
  /// global shutter. See camera_description.
  float readout_s = 0;

  /// Distance of the two centres, metres.
  FT_HOST_DEVICE strict_float baseline_length() const {
    auto const t = T_rl.template cast<strict_float>().t;
    return scalar::sqrt(dot(t, t));
  }
  /// @throws bad_argument for an invalid camera, a motion that is not rigid, or a zero baseline
  void check() const {
    left.check();
    right.check();
    for (float v : T_rl.R.m) { detail::require_finite("rig rotation", v); }
    mat3<float> const RRt = T_rl.R * T_rl.R.transposed();
    for (int i = 0; i < 9; ++i) {
      detail::require(std::abs(RRt.m[i] - (i % 4 == 0 ? 1.0f : 0.0f)) < 1e-3f,
                      "the rig's rotation is not a rotation matrix");
    }
    auto const& m = T_rl.R.m;
    detail::require(m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
                            m[2] * (m[3] * m[7] - m[4] * m[6]) >
                        0,
                    "the rig's rotation is a reflection");
    float const length = baseline_length().value;
    detail::require_finite("rig translation", length);
    detail::require_range("baseline", length, 1e-6f, 1e6f);
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

/// A rectified pair: one pinhole, rows correspond, the right camera is `baseline` metres to the
/// right.
///
/// The baseline is a double, so that both ways to state it are exact: a float baseline b gives bf()
/// = b * fx rounded once, and a float bf given to from_bf() is returned by bf() to the bit.
struct rectified_rig {
  static constexpr bool rectified = true;
  static constexpr int cameras = 1;
  static constexpr int images = 2;
  static constexpr int searches = 1;
  pinhole<float> camera;
  double baseline = 0;  ///< metres
  /// Seconds from the first row's exposure to the last one's, up to 0.1; 0 = a global shutter. See
  /// camera_description.
  float readout_s = 0;

  /// @throws bad_argument as check()
  static rectified_rig make(pinhole<float> const& camera, double baseline) {
    rectified_rig const rig{camera, baseline};
    rig.check();
    return rig;
  }
  /// The rig of a calibration that states baseline times fx, metres * pixels.
  /// @throws bad_argument as check()
  static rectified_rig from_bf(pinhole<float> const& camera, float bf) {
    return make(camera, static_cast<double>(bf) / static_cast<double>(camera.fx));
  }

  /// Baseline times fx, metres * pixels: the disparity of a point at a depth of 1 m.
  FT_HOST_DEVICE float bf() const {
    return static_cast<float>(baseline * static_cast<double>(camera.fx));
  }
  FT_HOST_DEVICE strict_float baseline_length() const { return static_cast<float>(baseline); }

  // What a multi_rig has per camera, here of the only one, whose frame is that of the pose.

  FT_HOST_DEVICE rectified_rig const& pair(int) const { return *this; }
  FT_HOST_DEVICE static constexpr bool single() {
    return false;
  }  ///< whether there is no right image
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

  /// @throws bad_argument for an invalid camera or baseline
  void check() const {
    camera.check();
    detail::require_finite("baseline", baseline);
    detail::require_range("baseline", static_cast<float>(baseline), 1e-6f, 1e6f);
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

}  // namespace FT_ABI
}  // namespace ft
