// SPDX-License-Identifier: Apache-2.0
/// @file The field-of-view camera ("FOV", "ATAN"), a fisheye with one parameter.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// With r = sqrt(x^2 + y^2): the distorted radius is r_d = atan2(2 r tan(omega / 2), z) / omega,
///
///     u = fx r_d x / r + cx,   v = fy r_d y / r + cy
///
/// The scale on the axis is fx 2 tan(omega / 2) / omega. As omega goes to 0 the model becomes the
/// pinhole. Below 1e-8 the two differ by less than a rounding of a double and the pinhole is used,
/// so omega = 0 is allowed.
///
/// Domain of project: z > 0. The formula continues smoothly beyond 90 degrees, but does not
/// describe lenses there. Outside: the principal point, invalid.
///
/// Domain of unproject: omega r_d < pi / 2. Rays have z = 1.
///
/// Unit of omega: radians.
/// Source: Devernay and Faugeras, "Straight lines have to be straight", Machine Vision and
/// Applications 2001.
template <typename Scalar>
struct field_of_view {
  using scalar_type = Scalar;
  static constexpr char const* name = "field_of_view";
  static constexpr auto parameters = camera_parameters({{"omega", 0, 3.14}});
  Scalar fx, fy, cx, cy, omega;

  /// @throws bad_argument for a value outside the limits of `parameters`
  void check() const { check_camera(*this); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    Scalar const r = scalar::sqrt(p.x * p.x + p.y * p.y);
    if (!(p.z > Scalar(0)) || !scalar::is_finite(p.z) || !scalar::is_finite(r)) {
      return detail::no_pixel(*this);
    }
    Scalar const g = enlargement(r, p.z);
    return detail::finite_pixel(*this, fx * (p.x * g) + cx, fy * (p.y * g) + cy);
  }
  /// Ray with z = 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    auto const m = detail::normalized(*this, pixel);
    Scalar const r_d = scalar::sqrt(m.x * m.x + m.y * m.y);
    Scalar factor = Scalar(1);
    bool valid = true;
    if (!is_pinhole()) {
      Scalar const angle = omega * r_d;
      valid = angle < number(1.5707963267948966);
      factor = r_d > Scalar(0) ? scalar::tan(angle) / (slope() * r_d) : omega / slope();
    }
    vec3<Scalar> const d{m.x * factor, m.y * factor, Scalar(1)};
    // Close to a right angle the tangent of a rounded angle may have the wrong sign.
    valid = valid && factor > Scalar(0) && scalar::is_finite(d.x) && scalar::is_finite(d.y);
    if (!valid) { return detail::no_ray<Scalar>(); }
    return {d, true};
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const r = scalar::sqrt(r2);
    Scalar const g = enlargement(r, p.z);
    Scalar by_r = Scalar(0);  // r d g / d r
    Scalar by_z = -(g / p.z);
    if (!is_pinhole()) {
      Scalar const a = slope();
      Scalar const share = a / (omega * (p.z * p.z + a * a * r2));
      by_z = -share;
      by_r = share * p.z - g;
    }
    Scalar const x = r > Scalar(0) ? p.x / r : Scalar(0);
    Scalar const y = r > Scalar(0) ? p.y / r : Scalar(0);
    return {project(p),
            {{fx * (g + x * x * by_r), fx * (x * y * by_r), fx * (p.x * by_z), fy * (x * y * by_r),
              fy * (g + y * y * by_r), fy * (p.y * by_z)}}};
  }
  template <typename U>
  FT_HOST_DEVICE field_of_view<U> cast() const {
    return cast_camera<field_of_view<U>>(*this);
  }

private:
  FT_HOST_DEVICE static Scalar number(double v) {
    return Scalar(static_cast<plain_scalar_t<Scalar>>(v));
  }
  FT_HOST_DEVICE bool is_pinhole() const { return omega < number(1e-8); }
  FT_HOST_DEVICE Scalar slope() const { return Scalar(2) * scalar::tan(omega * number(0.5)); }
  /// r_d / r.
  FT_HOST_DEVICE Scalar enlargement(Scalar r, Scalar z) const {
    if (is_pinhole()) { return Scalar(1) / z; }
    if (!(r > Scalar(0))) { return slope() / (omega * z) + r; }  // + r keeps a NaN
    return scalar::atan2(slope() * r, z) / (omega * r);
  }
};

static_assert(assert_camera_model<field_of_view<float>>::value,
              "field_of_view keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
