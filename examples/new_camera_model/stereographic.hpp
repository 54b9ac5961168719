// SPDX-License-Identifier: Apache-2.0
/// @file The stereographic fisheye camera.
#pragma once

#include <ft/cameras/camera_model.hpp>
#include <ft/core/arithmetic.hpp>
#include <ft/core/config.hpp>
#include <ft/types/poses.hpp>

/// r = 2 tan(theta / 2), theta the angle off the axis: the unit sphere seen from its rear pole.
/// With d = |(x, y, z)| and s = z + d:
///
///     u = fx 2 x / s + cx,   v = fy 2 y / s + cy
///
/// Domain of project: every direction except straight backwards, where s is 0. Outside: the
/// principal point, invalid. Domain of unproject: every pixel. Rays have length 1 and may have z <=
/// 0.
template <typename Scalar>
struct stereographic {
  using scalar_type = Scalar;
  static constexpr char const* name = "stereographic";
  static constexpr auto parameters = ft::camera_parameters();
  Scalar fx, fy, cx, cy;

  /// @throws ft::bad_argument for a focal length out of range, or a value that is not finite
  void check() const { ft::check_camera(*this); }

  FT_HOST_DEVICE ft::projection<Scalar> project(ft::vec3<Scalar> p) const {
    Scalar const s = divisor(p);
    // Written so that a NaN fails; an s that is not finite would put the point on the axis.
    if (!(s > Scalar(0)) || !ft::scalar::is_finite(s)) { return {{cx, cy}, false}; }
    Scalar const u = fx * (p.x + p.x) / s + cx;
    Scalar const v = fy * (p.y + p.y) / s + cy;
    if (!ft::scalar::is_finite(u) || !ft::scalar::is_finite(v)) { return {{cx, cy}, false}; }
    return {{u, v}, true};
  }

  FT_HOST_DEVICE ft::ray<Scalar> unproject(ft::vec2<Scalar> pixel) const {
    Scalar const one = Scalar(1);
    Scalar const a = (pixel.x - cx) / (fx + fx);  // tan(theta / 2) times a direction in the image
    Scalar const b = (pixel.y - cy) / (fy + fy);
    Scalar const q = a * a + b * b;
    if (!ft::scalar::is_finite(q)) { return {{Scalar(0), Scalar(0), one}, false}; }
    Scalar const n = one + q;
    return {{(a + a) / n, (b + b) / n, (one - q) / n}, true};
  }

  FT_HOST_DEVICE ft::projection_with_jacobian<Scalar> project_with_jacobian(
      ft::vec3<Scalar> p) const {
    Scalar const one = Scalar(1);
    Scalar const d = ft::scalar::sqrt(dot(p, p));
    Scalar const s = divisor(p);
    Scalar const x = p.x / s;
    Scalar const y = p.y / s;
    Scalar const a = (fx + fx) / s;
    Scalar const b = (fy + fy) / s;
    // d s = (x, y, s) / d
    return {project(p),
            {{a * (one - x * p.x / d), -(a * x * p.y / d), -(a * p.x / d), -(b * y * p.x / d),
              b * (one - y * p.y / d), -(b * p.y / d)}}};
  }

  template <typename U>
  FT_HOST_DEVICE stereographic<U> cast() const {
    return ft::cast_camera<stereographic<U>>(*this);
  }

private:
  /// z + d; behind the camera, where the two nearly cancel, as (x^2 + y^2) / (d - z).
  FT_HOST_DEVICE static Scalar divisor(ft::vec3<Scalar> p) {
    Scalar const d = ft::scalar::sqrt(dot(p, p));
    return p.z >= Scalar(0) ? p.z + d : (p.x * p.x + p.y * p.y) / (d - p.z);
  }
};

static_assert(ft::assert_camera_model<stereographic<float>>::value,
              "stereographic keeps the camera contract");
