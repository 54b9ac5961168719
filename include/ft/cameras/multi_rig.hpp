// SPDX-License-Identifier: Apache-2.0
/// @file Any number of cameras fixed to each other, stereo pairs and single ones mixed.
#pragma once

#include <cmath>
#include <type_traits>

#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// @throws bad_argument for a motion of a rig's camera that is not rigid
inline void require_rigid(pose const& T_cb) {
  for (float const v : T_cb.R.m) { detail::require_finite("rig rotation", v); }
  float const t[3] = {T_cb.t.x, T_cb.t.y, T_cb.t.z};
  for (float const v : t) { detail::require_finite("rig translation", v); }
  mat3<float> const RRt = T_cb.R * T_cb.R.transposed();
  for (int i = 0; i < 9; ++i) {
    detail::require(std::abs(RRt.m[i] - (i % 4 == 0 ? 1.0f : 0.0f)) < 1e-3f,
                    "a camera's rotation is not a rotation matrix");
  }
  auto const& m = T_cb.R.m;
  vec3<float> const x{m[0], m[1], m[2]};
  vec3<float> const y{m[3], m[4], m[5]};
  vec3<float> const z{m[6], m[7], m[8]};
  detail::require(dot(cross(x, y), z) > 0, "a camera's rotation is a reflection");
}

}  // namespace detail

/// A camera of a multi_rig: the left one of a rectified pair, or a single one.
struct rig_camera {
  pinhole<float> camera;
  double baseline = 0;           ///< to the right camera of the pair, metres; 0 = a single camera
  pose T_cb = pose::identity();  ///< body to (left) camera
  bool used = true;              ///< false: there is no such camera, see none()
  /// Seconds from the first row's exposure to the last one's, up to 0.1; 0 = a global shutter. See
  /// camera_description.
  float readout_s = 0;

  /// No camera: it has no images and sees no point. Rigs of fewer than N cameras, whose number is
  /// known at run time, fill a multi_rig<N> with these; they take memory and hardly any time.
  static rig_camera none() {
    constexpr float ahead = 1e9f;  // metres: all points are behind it
    return {{1, 1, 0, 0}, 0, {mat3<float>::identity(), {0, 0, -ahead}}, false};
  }
  /// Whether there is no right image.
  FT_HOST_DEVICE bool single() const { return !(baseline > 0); }
  /// Baseline times fx, metres * pixels; 0 for a single camera.
  FT_HOST_DEVICE float bf() const {
    return static_cast<float>(baseline * static_cast<double>(camera.fx));
  }
  FT_HOST_DEVICE strict_float baseline_length() const { return static_cast<float>(baseline); }
  /// @throws bad_argument for an invalid camera or baseline, or a motion that is not rigid
  void check() const {
    camera.check();
    detail::require_finite("baseline", baseline);
    if (baseline != 0) {
      detail::require_range("baseline", static_cast<float>(baseline), 1e-6f, 1e6f);
    }
    detail::require_rigid(T_cb);
    detail::require_range("readout_s", readout_s, 0.0f, 0.1f);
  }
};

/// N cameras, each the left one of a rectified pair or a single one, fixed to a body whose pose is
/// tracked from all of them. The frame of the body is any: that of the first camera if its T_cb is
/// the identity. Poses `T_cw` of this rig are those of the body, world to body.
///
/// Image 2 c of a frame is that of camera c, image 2 c + 1 the right one of its pair. A single
/// camera has no right image; its keypoints have no depth.
/// @tparam Camera rig_camera, or the mixed_rig_camera of a mixed_rig
template <int N, typename Camera = rig_camera>
struct multi_rig {
  static_assert(N >= 1 && N <= 16, "a rig has 1 to 16 cameras");
  static constexpr bool rectified = true;
  static constexpr int cameras = N;
  static constexpr int images = 2 * N;
  static constexpr int searches = N;
  Camera of[N];

  /// Camera c, in the terms of a rectified_rig.
  FT_HOST_DEVICE Camera const& pair(int c) const { return of[c]; }

  /// Point in the body's frame to camera c's.
  template <typename Real>
  FT_HOST_DEVICE vec3<Real> to_camera(int c, vec3<Real> const& in_body) const {
    return of[c].T_cb.template cast<Real>() * in_body;
  }
  /// World to body, to world to camera c.
  template <typename Real>
  FT_HOST_DEVICE rigid<Real> to_camera(int c, rigid<Real> const& T_bw) const {
    return of[c].T_cb.template cast<Real>() * T_bw;
  }
  FT_HOST_DEVICE pose to_camera(int c, pose const& T_bw) const {
    return to_camera(c, T_bw.cast<strict_float>()).template cast<float>();
  }
  /// Point in camera c's frame to the body's.
  template <typename Real>
  FT_HOST_DEVICE vec3<Real> to_body(int c, vec3<Real> in_camera) const {
    auto const T = of[c].T_cb.template cast<Real>();
    return T.R.transposed() * (in_camera - T.t);
  }
  /// Derivative by a point in camera c's frame, to that by the point in the body's.
  template <typename Real>
  FT_HOST_DEVICE mat3<Real> derivative_in_body(int c, mat3<Real> const& in_camera) const {
    return in_camera * of[c].T_cb.template cast<Real>().R;
  }
  /// The longest baseline, metres; 0 without pairs.
  FT_HOST_DEVICE strict_float baseline_length() const {
    double longest = 0;
    for (int c = 0; c < N; ++c) { longest = of[c].baseline > longest ? of[c].baseline : longest; }
    return static_cast<float>(longest);
  }
  /// @throws bad_argument as the check() of a camera, and for pairs that are none
  void check() const {
    for (Camera const& c : of) { c.check(); }
    if constexpr (!std::is_same_v<Camera, rig_camera>) { Camera::check_pairs(of, N); }
  }
};

/// Whether a rig has cameras of the models of any_camera, as a mixed_rig.
template <typename Rig>
inline constexpr bool is_mixed_v = false;
template <int N, typename Camera>
inline constexpr bool is_mixed_v<multi_rig<N, Camera>> = !std::is_same_v<Camera, rig_camera>;

}  // namespace FT_ABI
}  // namespace ft
