// SPDX-License-Identifier: Apache-2.0
/// @file The ideal pinhole camera.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// u = (fx x) / z + cx, v = (fy y) / z + cy, defined where z > 0. Source: specification section 12.
template <typename Scalar>
struct pinhole {
  using scalar_type = Scalar;
  static constexpr char const* name = "pinhole";
  static constexpr auto parameters = camera_parameters();
  Scalar fx, fy, cx, cy;

  /// @throws bad_argument for a focal length out of range, or a value that is not finite
  void check() const { check_camera(*this); }

  /// @param p point in the camera frame, metres. Behind the camera: the principal point, invalid.
  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    // Also for a NaN z; a NaN x or y gives a NaN pixel.
    if (!(p.z > Scalar(0))) { return detail::no_pixel(*this); }
    return {{fx * p.x / p.z + cx, fy * p.y / p.z + cy}, true};
  }
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    auto const m = detail::normalized(*this, pixel);
    return {{m.x, m.y, Scalar(1)}, scalar::is_finite(m.x) && scalar::is_finite(m.y)};
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const iz = Scalar(1) / p.z;
    return {
        project(p),
        {{fx * iz, Scalar(0), -(fx * p.x * iz * iz), Scalar(0), fy * iz, -(fy * p.y * iz * iz)}}};
  }
  template <typename U>
  FT_HOST_DEVICE pinhole<U> cast() const {
    return cast_camera<pinhole<U>>(*this);
  }
};

static_assert(assert_camera_model<pinhole<float>>::value, "pinhole keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
