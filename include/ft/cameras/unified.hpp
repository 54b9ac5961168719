// SPDX-License-Identifier: Apache-2.0
/// @file The unified omnidirectional camera with distortion ("Mei", OpenCV's omnidir).
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A point is projected on the unit sphere, from there by a pinhole that is shifted by xi, and
/// distorted as in radtan4. With d = |(x, y, z)|:
///
///     m = (x, y) / (z + xi d),  (u, v) = (fx m'x + cx, fy m'y + cy),  m' = m distorted by
///     k1, k2, p1, p2
///
/// OpenCV's cv::omnidir with a skew of 0. The scale on the axis is fx / (1 + xi).
///
/// Domain of project: z > -w d, with w = xi for xi <= 1, else 1 / xi, and m inside the disc on
/// which the distortion is one-to-one (see radtan). It reaches behind the camera (z < 0). Outside:
/// the principal point, invalid.
/// Domain of unproject: pixels whose undistorted m is in that disc and, for xi > 1, has
/// (xi^2 - 1) |m|^2 < 1. Rays have length 1 and may have z <= 0.
///
/// Source: Mei and Rives, "Single View Point Omnidirectional Camera Calibration from Planar
/// Grids", ICRA 2007.
template <typename Scalar>
struct unified {
  using scalar_type = Scalar;
  static constexpr char const* name = "unified";
  static constexpr auto parameters =
      camera_parameters({{"xi", 0, 1000}, {"k1"}, {"k2"}, {"p1"}, {"p2"}});
  Scalar fx, fy, cx, cy, xi;
  Scalar distortion[4];  ///< k1, k2, p1, p2

  /// @throws bad_argument for a value outside the limits of `parameters`
  void check() const { check_camera(*this); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    Scalar const reach = xi <= Scalar(1) ? xi : Scalar(1) / xi;
    Scalar const d = scalar::sqrt(dot(p, p));
    Scalar const depth = p.z + xi * d;
    if (!(p.z > -(reach * d)) || !(depth > Scalar(0)) || !scalar::is_finite(d)) {
      return detail::no_pixel(*this);
    }
    vec2<Scalar> const m{p.x / depth, p.y / depth};
    if (!lens().one_to_one(m.x * m.x + m.y * m.y)) { return detail::no_pixel(*this); }
    vec2<Scalar> const m2 = lens().distort(m);
    return detail::finite_pixel(*this, fx * m2.x + cx, fy * m2.y + cy);
  }
  /// Ray of length 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const one = Scalar(1);
    auto const found = lens().undistort(detail::normalized(*this, pixel));
    if (!found.valid) { return detail::no_ray<Scalar>(); }
    vec2<Scalar> const m = found.at;
    Scalar const r2 = m.x * m.x + m.y * m.y;
    Scalar const rest = one + (one - xi) * (one + xi) * r2;
    if (!(rest > Scalar(0))) { return detail::no_ray<Scalar>(); }
    Scalar const root = scalar::sqrt(rest);
    vec3<Scalar> const way{(xi + root) * m.x, (xi + root) * m.y, root - xi * r2};
    return detail::unit_ray(way, scalar::sqrt(dot(way, way)));
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const one = Scalar(1);
    Scalar const d = scalar::sqrt(dot(p, p));
    Scalar const s = one / (p.z + xi * d);
    vec2<Scalar> const m{p.x * s, p.y * s};
    auto const j = lens().jacobian(m);
    Scalar const shift = xi / d;
    vec3<Scalar> const depth{shift * p.x, shift * p.y, shift * p.z + one};
    // Rows of d m / d p, over s.
    vec3<Scalar> const a{one - m.x * depth.x, -(m.x * depth.y), -(m.x * depth.z)};
    vec3<Scalar> const b{-(m.y * depth.x), one - m.y * depth.y, -(m.y * depth.z)};
    Scalar const f = fx * s;
    Scalar const g = fy * s;
    return {project(p),
            {{f * (j.xx * a.x + j.xy * b.x), f * (j.xx * a.y + j.xy * b.y),
              f * (j.xx * a.z + j.xy * b.z), g * (j.xy * a.x + j.yy * b.x),
              g * (j.xy * a.y + j.yy * b.y), g * (j.xy * a.z + j.yy * b.z)}}};
  }
  template <typename U>
  FT_HOST_DEVICE unified<U> cast() const {
    return cast_camera<unified<U>>(*this);
  }

private:
  FT_HOST_DEVICE detail::radtan_distortion<Scalar, 4> lens() const { return {distortion}; }
};

static_assert(assert_camera_model<unified<float>>::value, "unified keeps the camera contract");

// The extended unified camera ("EUCM"), for wide-angle and fisheye lenses.

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
