// SPDX-License-Identifier: Apache-2.0
/// @file Shared by the camera models: the intrinsics fx, fy, cx and cy, and results outside the
/// domain.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A pixel in the image plane z = 1 of an ideal pinhole.
template <typename Camera, typename Scalar>
FT_HOST_DEVICE vec2<Scalar> normalized(Camera const& c, vec2<Scalar> pixel) {
  return {(pixel.x - c.cx) / c.fx, (pixel.y - c.cy) / c.fy};
}

/// The principal point, invalid.
template <typename Camera>
FT_HOST_DEVICE projection<typename Camera::scalar_type> no_pixel(Camera const& c) {
  return {{c.cx, c.cy}, false};
}

/// The pixel (u, v); the principal point, invalid, if it is not finite.
template <typename Camera, typename Scalar>
FT_HOST_DEVICE projection<Scalar> finite_pixel(Camera const& c, Scalar u, Scalar v) {
  if (!scalar::is_finite(u) || !scalar::is_finite(v)) { return no_pixel(c); }
  return {{u, v}, true};
}

/// The optical axis, invalid.
template <typename Scalar>
FT_HOST_DEVICE ray<Scalar> no_ray() {
  return {{Scalar(0), Scalar(0), Scalar(1)}, false};
}

/// The ray of length 1 along d; the axis, invalid, if d has no direction.
template <typename Scalar>
FT_HOST_DEVICE ray<Scalar> unit_ray(vec3<Scalar> d, Scalar norm) {
  if (!(norm > Scalar(0)) || !scalar::is_finite(norm)) { return no_ray<Scalar>(); }
  return {{d.x / norm, d.y / norm, d.z / norm}, true};
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
