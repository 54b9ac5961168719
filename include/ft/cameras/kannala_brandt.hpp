// SPDX-License-Identifier: Apache-2.0
/// @file The Kannala-Brandt fisheye camera with four coefficients, also called KB4, equidistant, or
/// OpenCV's fisheye model.
#pragma once

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// With theta = atan2(sqrt(x^2 + y^2), z) and
/// r = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9:
///
///     u = fx r x / sqrt(x^2 + y^2) + cx,   v = fy r y / sqrt(x^2 + y^2) + cy
///
/// Defined for every direction in which r grows with theta. Directions behind the camera can be
/// visible, so `valid` only requires a finite point other than the centre. Source: Kannala and
/// Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
/// fish-eye lenses", PAMI 2006; specification section 12.
template <typename Scalar>
struct kannala_brandt {
  using scalar_type = Scalar;
  static constexpr char const* name = "kannala_brandt";
  static constexpr auto parameters = camera_parameters(
      {{"k1", -1e6, 1e6}, {"k2", -1e6, 1e6}, {"k3", -1e6, 1e6}, {"k4", -1e6, 1e6}});
  Scalar fx, fy, cx, cy, k1, k2, k3, k4;

  /// Larger coefficients could make the polynomial overflow.
  /// @throws bad_argument for a value outside the limits of `parameters`
  void check() const { check_camera(*this); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    Scalar const radius = scalar::sqrt(p.x * p.x + p.y * p.y);
    if (!(radius > Scalar(0))) { return project_axis(radius, p.z); }
    return project_at(p, radius, distorted(scalar::atan2(radius, p.z)));
  }

  /// The ray with z = 1: (x, y) tan(theta) / theta_d. More than 90 degrees off the axis, the result
  /// is the opposite ray and invalid. Solves for theta by at most 10 Newton steps, until a step is
  /// below 1e-6; theta_d is clamped to [-pi/2, pi/2].
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    Scalar const half_pi = Scalar(static_cast<plain_scalar_t<Scalar>>(1.5707963267948966));
    auto const m = detail::normalized(*this, pixel);
    Scalar theta_d = scalar::sqrt(m.x * m.x + m.y * m.y);
    if (theta_d > half_pi) { theta_d = half_pi; }
    Scalar factor = Scalar(1);
    Scalar theta = theta_d;
    bool converged = true;
    if (theta_d > Scalar(static_cast<plain_scalar_t<Scalar>>(1e-8))) {
      converged = false;
      for (int i = 0; i < 10 && !converged; ++i) {
        Scalar const t2 = theta * theta;
        Scalar const t4 = t2 * t2;
        Scalar const a = k1 * t2;
        Scalar const b = k2 * t4;
        Scalar const c = k3 * (t4 * t2);
        Scalar const d = k4 * (t4 * t4);
        Scalar const step =
            (theta * (Scalar(1) + a + b + c + d) - theta_d) /
            (Scalar(1) + Scalar(3) * a + Scalar(5) * b + Scalar(7) * c + Scalar(9) * d);
        theta = theta - step;
        converged = scalar::abs(step) < Scalar(static_cast<plain_scalar_t<Scalar>>(1e-6));
      }
      factor = scalar::tan(theta) / theta_d;
    }
    bool const valid = converged && scalar::is_finite(factor) && scalar::is_finite(m.x) &&
                       scalar::is_finite(m.y) && theta < half_pi && theta >= Scalar(0);
    return {{m.x * factor, m.y * factor, Scalar(1)}, valid};
  }

  /// Both with one arc tangent. For a float scalar that is scalar::quick_atan2(), so the pixel may
  /// differ from project()'s in the last digits.
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const radius = scalar::sqrt(r2);
    if (!(radius > Scalar(0))) {
      return {project_axis(radius, p.z),
              {{fx / p.z, Scalar(0), Scalar(0), Scalar(0), fy / p.z, Scalar(0)}}};
    }
    Scalar const theta = scalar::quick_atan2(radius, p.z);
    Scalar const t2 = theta * theta;
    Scalar const r = distorted(theta);
    Scalar const dr =
        Scalar(1) + t2 * (Scalar(3) * k1 +
                          t2 * (Scalar(5) * k2 + t2 * (Scalar(7) * k3 + t2 * (Scalar(9) * k4))));
    // (c, s) is the direction in the image plane. Per metre, `along` is the change of r along it,
    // and `across` is the motion of the image perpendicular to it.
    Scalar const c = p.x / radius;
    Scalar const s = p.y / radius;
    Scalar const across = r / radius;
    Scalar const turn = dr / (r2 + p.z * p.z);
    Scalar const along = turn * p.z;
    Scalar const mixed = (along - across) * (c * s);
    return {{{fx * r * c + cx, fy * r * s + cy}, is_somewhere(p, radius)},
            {{fx * (along * (c * c) + across * (s * s)), fx * mixed, -(fx * (turn * p.x)),
              fy * mixed, fy * (along * (s * s) + across * (c * c)), -(fy * (turn * p.y))}}};
  }

  template <typename U>
  FT_HOST_DEVICE kannala_brandt<U> cast() const {
    return cast_camera<kannala_brandt<U>>(*this);
  }

private:
  /// On the axis, or NaN. @param radius of the point
  FT_HOST_DEVICE projection<Scalar> project_axis(Scalar radius, Scalar z) const {
    return {{cx + radius, cy + radius}, radius == Scalar(0) && z > Scalar(0)};
  }
  /// @param r of the image point
  FT_HOST_DEVICE projection<Scalar> project_at(vec3<Scalar> p, Scalar radius, Scalar r) const {
    return {{fx * r * (p.x / radius) + cx, fy * r * (p.y / radius) + cy}, is_somewhere(p, radius)};
  }
  FT_HOST_DEVICE static bool is_somewhere(vec3<Scalar> p, Scalar radius) {
    return scalar::is_finite(radius) && scalar::is_finite(p.z);
  }
  FT_HOST_DEVICE Scalar distorted(Scalar theta) const {
    Scalar const t2 = theta * theta;
    Scalar const t3 = theta * t2;
    Scalar const t5 = t3 * t2;
    Scalar const t7 = t5 * t2;
    Scalar const t9 = t7 * t2;
    return theta + k1 * t3 + k2 * t5 + k3 * t7 + k4 * t9;
  }
};

static_assert(assert_camera_model<kannala_brandt<float>>::value,
              "kannala_brandt keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
