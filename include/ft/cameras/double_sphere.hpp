// SPDX-License-Identifier: Apache-2.0
/// @file The double sphere camera, for wide-angle and fisheye lenses.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/geometry.hpp"

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
/// Parameters (check): finite; fx and fy in [1e-3, 1e6]; alpha in [0, 1]; xi in (-1, 1].
/// Source: Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 3DV 2018.
template <typename Scalar>
struct double_sphere {
  using scalar_type = Scalar;
  static constexpr int num_params = 6;  ///< fx, fy, cx, cy, xi, alpha
  static constexpr char const* name = "double_sphere";
  Scalar fx, fy, cx, cy, xi, alpha;

  /// @throws bad_argument for a value out of the ranges above
  void check() const {
    check_intrinsics(fx, fy, cx, cy);
    detail::require_range("camera xi", static_cast<double>(to_plain(xi)), -1.0, 1.0);
    detail::require(xi > Scalar(-1), "camera xi is -1, must be in (-1, 1]");
    detail::require_range("camera alpha", static_cast<double>(to_plain(alpha)), 0.0, 1.0);
  }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    projection<Scalar> const outside{{cx, cy}, false};
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const q = xi * scalar::sqrt(r2 + p.z * p.z) + p.z;
    Scalar const d2 = scalar::sqrt(r2 + q * q);
    Scalar const depth = alpha * d2 + (Scalar(1) - alpha) * q;
    if (!(q > -(reach() * d2)) || !(depth > Scalar(0)) || !scalar::is_finite(d2)) {
      return outside;
    }
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
    Scalar const rest = one - (alpha + alpha - one) * r2;
    if (!(rest > Scalar(0))) { return none; }
    // On the second sphere: the direction (x, y, z) from its centre.
    Scalar const z = (one - alpha * alpha * r2) / (alpha * scalar::sqrt(rest) + (one - alpha));
    // Intersect it with the first sphere, whose centre is at (0, 0, xi). Of the two forms of the
    // solution this one has no cancellation.
    Scalar const inner = (one - xi) * (one + xi);
    Scalar const root = scalar::sqrt(z * z + inner * r2);
    Scalar const along = z * xi;
    Scalar const length =
        along >= Scalar(0) ? (along + root) / (z * z + r2) : inner / (root - along);
    vec3<Scalar> const d{length * x, length * y, length * z - xi};
    Scalar const norm = scalar::sqrt(dot(d, d));
    if (!(length > Scalar(0)) || !(norm > Scalar(0)) || !scalar::is_finite(norm)) { return none; }
    return {{d.x / norm, d.y / norm, d.z / norm}, true};
  }
  FT_HOST_DEVICE mat23<Scalar> project_jacobian(vec3<Scalar> p) const {
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
    return {{a * (one - x * depth.x), -(a * x * depth.y), -(a * x * depth.z), -(b * y * depth.x),
             b * (one - y * depth.y), -(b * y * depth.z)}};
  }
  template <typename U>
  FT_HOST_DEVICE double_sphere<U> cast() const {
    using P = plain_scalar_t<U>;
    return {U(static_cast<P>(to_plain(fx))), U(static_cast<P>(to_plain(fy))),
            U(static_cast<P>(to_plain(cx))), U(static_cast<P>(to_plain(cy))),
            U(static_cast<P>(to_plain(xi))), U(static_cast<P>(to_plain(alpha)))};
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
