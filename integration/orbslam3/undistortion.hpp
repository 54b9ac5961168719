// SPDX-License-Identifier: Apache-2.0
/// @file Positions of keypoints without the distortion of a pinhole camera, to the bits of OpenCV.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

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
}  // namespace orbslam3
}  // namespace ft
