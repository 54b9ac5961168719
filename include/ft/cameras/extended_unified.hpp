// SPDX-License-Identifier: Apache-2.0
/// @file The extended unified camera ("EUCM"), for wide-angle and fisheye lenses.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/detail/intrinsics.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A point is projected on an ellipsoid around the axis, and from there by a shifted pinhole. With
/// d = sqrt(beta (x^2 + y^2) + z^2) and s = alpha d + (1 - alpha) z:
///
///     u = fx x / s + cx,   v = fy y / s + cy
///
/// Domain of project: z > -w d, with w = alpha / (1 - alpha) for alpha <= 0.5, else (1 - alpha) /
/// alpha; there the mapping is one-to-one. It reaches behind the camera (z < 0). Outside: the
/// principal point, invalid. Domain of unproject: with m = ((u - cx) / fx, (v - cy) / fy), every
/// pixel for alpha <= 0.5, else (2 alpha - 1) beta |m|^2 < 1. Rays have length 1 and may have z <=
/// 0.
///
/// Source: Khomutenko, Garcia and Martinet, "An enhanced unified camera model", RA-L 2016; the
/// domain as in section 2 of Usenko, Demmel and Cremers, 3DV 2018.
template <typename Scalar>
struct extended_unified {
  using scalar_type = Scalar;
  static constexpr char const* name = "extended_unified";
  static constexpr auto parameters = camera_parameters({{"alpha", 0, 1}, {"beta", 1e-6, 1e6}});
  Scalar fx, fy, cx, cy, alpha, beta;

  /// @throws bad_argument for a value outside the limits of `parameters`
  void check() const { check_camera(*this); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    Scalar const rest = Scalar(1) - alpha;
    Scalar const reach = alpha <= rest ? alpha / rest : rest / alpha;
    Scalar const d = scalar::sqrt(beta * (p.x * p.x + p.y * p.y) + p.z * p.z);
    Scalar const depth = alpha * d + rest * p.z;
    if (!(p.z > -(reach * d)) || !(depth > Scalar(0)) || !scalar::is_finite(d)) {
      return detail::no_pixel(*this);
    }
    return detail::finite_pixel(*this, fx * p.x / depth + cx, fy * p.y / depth + cy);
  }
  /// Ray of length 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const one = Scalar(1);
    auto const m = detail::normalized(*this, pixel);
    Scalar const r2 = m.x * m.x + m.y * m.y;
    Scalar const rest = one - (alpha + alpha - one) * (beta * r2);
    if (!(rest > Scalar(0))) { return detail::no_ray<Scalar>(); }
    Scalar const z =
        (one - alpha * alpha * (beta * r2)) / (alpha * scalar::sqrt(rest) + (one - alpha));
    return detail::unit_ray(vec3<Scalar>{m.x, m.y, z}, scalar::sqrt(r2 + z * z));
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const one = Scalar(1);
    Scalar const d = scalar::sqrt(beta * (p.x * p.x + p.y * p.y) + p.z * p.z);
    Scalar const s = one / (alpha * d + (one - alpha) * p.z);
    Scalar const by_d = alpha / d;
    vec3<Scalar> const depth{by_d * (beta * p.x), by_d * (beta * p.y), by_d * p.z + (one - alpha)};
    Scalar const a = fx * s;
    Scalar const b = fy * s;
    Scalar const x = p.x * s;
    Scalar const y = p.y * s;
    return {project(p),
            {{a * (one - x * depth.x), -(a * x * depth.y), -(a * x * depth.z), -(b * y * depth.x),
              b * (one - y * depth.y), -(b * y * depth.z)}}};
  }
  template <typename U>
  FT_HOST_DEVICE extended_unified<U> cast() const {
    return cast_camera<extended_unified<U>>(*this);
  }
};

static_assert(assert_camera_model<extended_unified<float>>::value,
              "extended_unified keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
