// SPDX-License-Identifier: Apache-2.0
/// @file The ideal pinhole camera.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

/// u = (fx x) / z + cx, v = (fy y) / z + cy, defined where z > 0. Source: specification section 12.
template <typename Scalar>
struct pinhole {
  using scalar_type = Scalar;
  static constexpr int num_params = 4;  ///< fx, fy, cx, cy
  static constexpr char const* name = "pinhole";
  Scalar fx, fy, cx, cy;

  /// @throws bad_argument for a focal length that is not positive, or a NaN
  void check() const { check_intrinsics(fx, fy, cx, cy); }

  /// @param p point in the camera frame, metres. Behind the camera: the principal point, invalid.
  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    if (!(p.z > Scalar(0))) {
      return {{cx, cy}, false};
    }  // also for a NaN z; a NaN x or y gives a NaN pixel
    return {{fx * p.x / p.z + cx, fy * p.y / p.z + cy}, true};
  }
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const x = (pixel.x - cx) / fx;
    Scalar const y = (pixel.y - cy) / fy;
    return {{x, y, Scalar(1)}, scalar::is_finite(x) && scalar::is_finite(y)};
  }
  FT_HOST_DEVICE mat23<Scalar> project_jacobian(vec3<Scalar> p) const {
    Scalar const iz = Scalar(1) / p.z;
    return {{fx * iz, Scalar(0), -(fx * p.x * iz * iz), Scalar(0), fy * iz, -(fy * p.y * iz * iz)}};
  }
  template <typename U>
  FT_HOST_DEVICE pinhole<U> cast() const {
    using P = plain_scalar_t<U>;
    return {U(static_cast<P>(to_plain(fx))), U(static_cast<P>(to_plain(fy))),
            U(static_cast<P>(to_plain(cx))), U(static_cast<P>(to_plain(cy)))};
  }
};

static_assert(assert_camera_model<pinhole<float>>::value, "pinhole keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
