// SPDX-License-Identifier: Apache-2.0
/// @file The extended unified camera ("EUCM"), for wide-angle and fisheye lenses.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

/// A point is projected on an ellipsoid round the axis, from there by a shifted pinhole. With
/// d = sqrt(beta (x^2 + y^2) + z^2) and s = alpha d + (1 - alpha) z:
///
///     u = fx x / s + cx,   v = fy y / s + cy
///
/// Domain of project: z > -w d, with w = alpha / (1 - alpha) for alpha <= 0.5, else
/// (1 - alpha) / alpha; there the mapping is one-to-one. It reaches behind the camera (z < 0).
/// Outside: the principal point, invalid.
/// Domain of unproject: with m = ((u - cx) / fx, (v - cy) / fy), every pixel for alpha <= 0.5, else
/// (2 alpha - 1) beta |m|^2 < 1. Rays have length 1 and may have z <= 0.
///
/// Parameters (check): finite; fx and fy in [1e-3, 1e6]; alpha in [0, 1]; beta in [1e-6, 1e6].
/// Source: Khomutenko, Garcia and Martinet, "An enhanced unified camera model", RA-L 2016; the
/// domain as in section 2 of Usenko, Demmel and Cremers, 3DV 2018.
template <typename Scalar>
struct extended_unified {
  using scalar_type = Scalar;
  static constexpr int num_params = 6;  ///< fx, fy, cx, cy, alpha, beta
  static constexpr char const* name = "extended_unified";
  Scalar fx, fy, cx, cy, alpha, beta;

  /// @throws bad_argument for a value out of the ranges above
  void check() const {
    check_intrinsics(fx, fy, cx, cy);
    detail::require_range("camera alpha", static_cast<double>(to_plain(alpha)), 0.0, 1.0);
    detail::require_range("camera beta", static_cast<double>(to_plain(beta)), 1e-6, 1e6);
  }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    projection<Scalar> const outside{{cx, cy}, false};
    Scalar const rest = Scalar(1) - alpha;
    Scalar const reach = alpha <= rest ? alpha / rest : rest / alpha;
    Scalar const d = scalar::sqrt(beta * (p.x * p.x + p.y * p.y) + p.z * p.z);
    Scalar const depth = alpha * d + rest * p.z;
    if (!(p.z > -(reach * d)) || !(depth > Scalar(0)) || !scalar::is_finite(d)) { return outside; }
    Scalar const u = fx * p.x / depth + cx;
    Scalar const v = fy * p.y / depth + cy;
    if (!scalar::is_finite(u) || !scalar::is_finite(v)) { return outside; }
    return {{u, v}, true};
  }
  /// Ray of length 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const one = Scalar(1);
    ray<Scalar> const none{{Scalar(0), Scalar(0), one}, false};
    Scalar const x = (pixel.x - cx) / fx;
    Scalar const y = (pixel.y - cy) / fy;
    Scalar const r2 = x * x + y * y;
    Scalar const rest = one - (alpha + alpha - one) * (beta * r2);
    if (!(rest > Scalar(0))) { return none; }
    Scalar const z =
        (one - alpha * alpha * (beta * r2)) / (alpha * scalar::sqrt(rest) + (one - alpha));
    Scalar const norm = scalar::sqrt(r2 + z * z);
    if (!(norm > Scalar(0)) || !scalar::is_finite(norm)) { return none; }
    return {{x / norm, y / norm, z / norm}, true};
  }
  FT_HOST_DEVICE mat23<Scalar> project_jacobian(vec3<Scalar> p) const {
    Scalar const one = Scalar(1);
    Scalar const d = scalar::sqrt(beta * (p.x * p.x + p.y * p.y) + p.z * p.z);
    Scalar const s = one / (alpha * d + (one - alpha) * p.z);
    Scalar const by_d = alpha / d;
    vec3<Scalar> const depth{by_d * (beta * p.x), by_d * (beta * p.y), by_d * p.z + (one - alpha)};
    Scalar const a = fx * s;
    Scalar const b = fy * s;
    Scalar const x = p.x * s;
    Scalar const y = p.y * s;
    return {{a * (one - x * depth.x), -(a * x * depth.y), -(a * x * depth.z), -(b * y * depth.x),
             b * (one - y * depth.y), -(b * y * depth.z)}};
  }
  template <typename U>
  FT_HOST_DEVICE extended_unified<U> cast() const {
    using P = plain_scalar_t<U>;
    return {U(static_cast<P>(to_plain(fx))),    U(static_cast<P>(to_plain(fy))),
            U(static_cast<P>(to_plain(cx))),    U(static_cast<P>(to_plain(cy))),
            U(static_cast<P>(to_plain(alpha))), U(static_cast<P>(to_plain(beta)))};
  }
};

static_assert(assert_camera_model<extended_unified<float>>::value,
              "extended_unified keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
