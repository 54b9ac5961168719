// SPDX-License-Identifier: Apache-2.0
/// @file Rigs, poses and undistortion of ft from the plain types of the shim.
#pragma once

#include <type_traits>
#include <utility>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/relocalizer.hpp"
#include "ft/types/poses.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {
inline namespace FT_ABI {

using fisheye_rig = stereo_rig<kannala_brandt<float>, kannala_brandt<float>>;

/// Cameras of a pair whose keypoints are searched: of a rectified pair only the left one.
template <typename Rig>
inline constexpr int searched_cameras = Rig::rectified ? 1 : 2;

/// The camera that relocalisation finds points with.
template <typename Rig>
using left_camera_of = std::decay_t<decltype(detail::left_camera(std::declval<Rig const&>()))>;

/// The cameras of the settings. A single kannala_brandt camera becomes a pair without baseline
/// whose right camera has no keypoints.
/// @throws bad_argument
template <typename Rig>
Rig rig_of(settings const& s) {
  float const* const l = s.left.values;
  if constexpr (Rig::rectified) {
    // As rectified_rig::from_bf(), but 0 is allowed, for a monocular camera.
    rectified_rig const rig{{l[0], l[1], l[2], l[3]},
                            static_cast<double>(s.bf) / static_cast<double>(l[0])};
    rig.camera.check();
    if (s.images == 2 || s.bf != 0) { rig.check(); }
    return rig;
  } else {
    float const* const r = s.images == 2 ? s.right.values : l;
    fisheye_rig rig{{l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7]},
                    {r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7]},
                    s.T_rl};
    if (s.images == 1) { rig.T_rl = {mat3<float>::identity(), {-1e-6f, 0.0f, 0.0f}}; }
    rig.check();
    require_invertible(rig.left, s.width, s.height, 0.25);
    require_invertible(rig.right, s.width, s.height, 0.25);
    return rig;
  }
}

/// @throws bad_argument naming the setting
template <typename Rig>
settings const& checked(settings const& s) {
  detail::require_range("images", s.images, 1, 2);
  detail::require_range("most_keypoints", s.most_keypoints, 0, 1 << 20);
  detail::require_range("map_points", s.map_points, 1, 1 << 26);
  detail::require_range("local_points", s.local_points, 1, 1 << 24);
  detail::require(s.left.kind == s.right.kind || s.images == 1 || Rig::rectified,
                  "both cameras of a pair are of one kind");
  return s;
}

/// cv::undistortPoints(from, to, K, (k1 k2 p1 p2 k3), noArray(), K): five steps of a fixed-point
/// iteration in double, rounded to float at the end. Its operations and their order are those of
/// OpenCV 4, compiled without fused multiply-add.
/// Source: OpenCV documentation, calib3d, undistortPoints.
class undistortion {
public:
  undistortion() = default;
  explicit undistortion(lens_distortion const& d)
      : fx_(d.fx),
        fy_(d.fy),
        cx_(d.cx),
        cy_(d.cy),
        inv_fx_(1.0 / static_cast<double>(d.fx)),
        inv_fy_(1.0 / static_cast<double>(d.fy)),
        k1_(d.k1),
        k2_(d.k2),
        p1_(d.p1),
        p2_(d.p2),
        k3_(d.k3),
        any_(d.any()) {}

  /// @param seen pixels
  FT_HOST_DEVICE vec2<float> operator()(vec2<float> seen) const {
    if (!any_) { return seen; }
    vec2<strict_double> const start{
        (strict_double(static_cast<double>(seen.x)) - strict_double(cx_)) * strict_double(inv_fx_),
        (strict_double(static_cast<double>(seen.y)) - strict_double(cy_)) * strict_double(inv_fy_)};
    vec2<strict_double> p = start;
    for (int i = 0; i < steps; ++i) {
      strict_double const r2 = p.x * p.x + p.y * p.y;
      strict_double const inverse =
          one() /
          (one() + ((strict_double(k3_) * r2 + strict_double(k2_)) * r2 + strict_double(k1_)) * r2);
      if (inverse < strict_double(0.0)) {  // far outside: the place in the plane as it is seen
        p = start;
        break;
      }
      strict_double const x = p.x;
      strict_double const y = p.y;
      p.x = (start.x -
             (two() * strict_double(p1_) * x * y + strict_double(p2_) * (r2 + two() * x * x))) *
            inverse;
      p.y = (start.y -
             (strict_double(p1_) * (r2 + two() * y * y) + two() * strict_double(p2_) * x * y)) *
            inverse;
    }
    return {static_cast<float>((strict_double(fx_) * p.x + strict_double(cx_)).value),
            static_cast<float>((strict_double(fy_) * p.y + strict_double(cy_)).value)};
  }

private:
  static constexpr int steps = 5;
  FT_HOST_DEVICE static strict_double one() { return {1.0}; }
  FT_HOST_DEVICE static strict_double two() { return {2.0}; }

  double fx_ = 0, fy_ = 0, cx_ = 0, cy_ = 0;
  double inv_fx_ = 0, inv_fy_ = 0;
  double k1_ = 0, k2_ = 0, p1_ = 0, p2_ = 0, k3_ = 0;
  bool any_ = false;
};

}  // namespace FT_ABI
}  // namespace ft::orbslam3
