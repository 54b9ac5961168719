// SPDX-License-Identifier: Apache-2.0
/// @file The double sphere camera, for wide-angle and fisheye lenses.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// A point is projected on a unit sphere, from there on a second one whose centre is shifted by
/// xi, from there by a pinhole shifted by alpha / (1 - alpha). With d1 = |(x, y, z)|,
/// q = xi d1 + z, d2 = |(x, y, q)| and s = alpha d2 + (1 - alpha) q:
///
///     u = fx x / s + cx,   v = fy y / s + cy
///
/// The scale on the axis is fx / (1 + xi), not fx.
///
/// Domain of project: q > -w d2, with w = alpha / (1 - alpha) for alpha <= 0.5, else
/// (1 - alpha) / alpha; there the mapping is one-to-one. It reaches behind the camera (z < 0).
/// The paper gives a bound on z; testing q at the second sphere, where the limit arises, is exact.
/// Outside: the principal point, invalid.
/// Domain of unproject: with m = ((u - cx) / fx, (v - cy) / fy), every pixel for alpha <= 0.5, else
/// (2 alpha - 1) |m|^2 < 1. Rays have length 1 and may have z <= 0.
///
/// Source: Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 3DV 2018.
template <typename Scalar>
struct double_sphere {
  using scalar_type = Scalar;
  static constexpr char const* name = "double_sphere";
  static constexpr auto parameters = camera_parameters({{"xi", -1, 1}, {"alpha", 0, 1}});
  Scalar fx, fy, cx, cy, xi, alpha;

  /// @throws bad_argument for a value outside the limits of `parameters`
  void check() const {
    check_camera(*this);
    detail::require(xi > Scalar(-1), "camera xi is -1, must be in (-1, 1]");
  }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const q = xi * scalar::sqrt(r2 + p.z * p.z) + p.z;
    Scalar const d2 = scalar::sqrt(r2 + q * q);
    Scalar const depth = alpha * d2 + (Scalar(1) - alpha) * q;
    if (!(q > -(reach() * d2)) || !(depth > Scalar(0)) || !scalar::is_finite(d2)) {
      return detail::no_pixel(*this);
    }
    return detail::finite_pixel(*this, fx * p.x / depth + cx, fy * p.y / depth + cy);
  }
  /// Ray of length 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const one = Scalar(1);
    auto const m = detail::normalized(*this, pixel);
    Scalar const r2 = m.x * m.x + m.y * m.y;
    Scalar const rest = one - (alpha + alpha - one) * r2;
    if (!(rest > Scalar(0))) { return detail::no_ray<Scalar>(); }
    // On the second sphere: the direction (m.x, m.y, z) from its centre.
    Scalar const z = (one - alpha * alpha * r2) / (alpha * scalar::sqrt(rest) + (one - alpha));
    // Intersect it with the first sphere, whose centre is at (0, 0, xi). Of the two forms of the
    // solution this one has no cancellation.
    Scalar const inner = (one - xi) * (one + xi);
    Scalar const root = scalar::sqrt(z * z + inner * r2);
    Scalar const along = z * xi;
    Scalar const length =
        along >= Scalar(0) ? (along + root) / (z * z + r2) : inner / (root - along);
    if (!(length > Scalar(0))) { return detail::no_ray<Scalar>(); }
    vec3<Scalar> const d{length * m.x, length * m.y, length * z - xi};
    return detail::unit_ray(d, scalar::sqrt(dot(d, d)));
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const one = Scalar(1);
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const d1 = scalar::sqrt(r2 + p.z * p.z);
    Scalar const q = xi * d1 + p.z;
    Scalar const d2 = scalar::sqrt(r2 + q * q);
    Scalar const s = one / (alpha * d2 + (one - alpha) * q);
    Scalar const shift = xi / d1;
    vec3<Scalar> const dq{shift * p.x, shift * p.y, shift * p.z + one};
    Scalar const by_q = alpha * q / d2 + (one - alpha);  // d depth / d q
    Scalar const by_r = alpha / d2;
    vec3<Scalar> const depth{by_q * dq.x + by_r * p.x, by_q * dq.y + by_r * p.y, by_q * dq.z};
    Scalar const a = fx * s;
    Scalar const b = fy * s;
    Scalar const x = p.x * s;
    Scalar const y = p.y * s;
    return {project(p),
            {{a * (one - x * depth.x), -(a * x * depth.y), -(a * x * depth.z), -(b * y * depth.x),
              b * (one - y * depth.y), -(b * y * depth.z)}}};
  }
  template <typename U>
  FT_HOST_DEVICE double_sphere<U> cast() const {
    return cast_camera<double_sphere<U>>(*this);
  }

private:
  FT_HOST_DEVICE Scalar reach() const {
    Scalar const rest = Scalar(1) - alpha;
    return alpha <= rest ? alpha / rest : rest / alpha;
  }
};

static_assert(assert_camera_model<double_sphere<float>>::value,
              "double_sphere keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
