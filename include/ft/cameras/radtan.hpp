// SPDX-License-Identifier: Apache-2.0
/// @file Pinhole cameras with radial-tangential distortion (Brown-Conrady), as in OpenCV.
#pragma once

#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Whether c[0] + c[1] s + ... + c[Degree] s^Degree > 0 for every s in [0, end]. Apart from
/// rounding it is never wrongly true. It is false if 32 intervals do not decide, which happens if
/// the polynomial almost touches zero.
///
/// The negative terms alone, which decrease with s, decide most points. Otherwise it proceeds by
/// intervals from 0. On an interval, the smallest Bernstein coefficient is a lower bound of the
/// polynomial, and the last coefficient is its value at the interval's end.
template <int Degree, typename Scalar>
FT_HOST_DEVICE bool stays_positive(Scalar const (&c)[Degree + 1], Scalar end) {
  Scalar low = Scalar(0);
  for (int i = Degree; i > 0; --i) { low = (low + (c[i] < Scalar(0) ? c[i] : Scalar(0))) * end; }
  if (low + c[0] > Scalar(0)) { return true; }

  Scalar at = Scalar(0);
  Scalar length = end;
  for (int tries = 0; tries < 32; ++tries) {
    Scalar b[Degree + 1];
    for (int i = 0; i <= Degree; ++i) { b[i] = c[i]; }
    for (int i = 0; i < Degree; ++i) {  // powers of (s - at)
      for (int j = Degree - 1; j >= i; --j) { b[j] = b[j] + at * b[j + 1]; }
    }
    Scalar factor = Scalar(1);  // length^i / binomial(Degree, i)
    for (int i = 1; i <= Degree; ++i) {
      factor = factor * length *
               (Scalar(static_cast<plain_scalar_t<Scalar>>(i)) /
                Scalar(static_cast<plain_scalar_t<Scalar>>(Degree + 1 - i)));
      b[i] = b[i] * factor;
    }
    for (int k = 1; k <= Degree; ++k) {
      for (int i = Degree; i >= k; --i) { b[i] = b[i] + b[i - 1]; }
    }
    bool positive = true;
    for (int i = 0; i <= Degree; ++i) { positive = positive && b[i] > Scalar(0); }
    if (positive) {
      at = at + length;
      if (!(at < end)) { return true; }
      length = min_of(length + length, end - at);
    } else if (!(b[Degree] > Scalar(0))) {
      return false;
    } else {
      length = length / Scalar(2);
    }
  }
  return false;
}

/// fx, fy, cx, cy and the coefficients.
template <int Coefficients>
constexpr camera_parameter_list<4 + Coefficients> radtan_parameters() {
  constexpr char const* names[] = {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  camera_parameter coefficients[Coefficients]{};
  for (int i = 0; i < Coefficients; ++i) { coefficients[i].name = names[i]; }
  return camera_parameters(coefficients);
}

/// A point of the plane z = 1, and whether the method that found it succeeded.
template <typename Scalar>
struct plane_point {
  vec2<Scalar> at;
  bool valid;
};

/// The distortion of radtan (see there) on the plane z = 1. Its Jacobian is symmetric.
/// @tparam Coefficients 4: k1 k2 p1 p2; 5: and k3; 8: and k4 k5 k6
template <typename Scalar, int Coefficients>
struct radtan_distortion {
  static_assert(Coefficients == 4 || Coefficients == 5 || Coefficients == 8,
                "radial-tangential distortion has 4, 5 or 8 coefficients");
  static constexpr int radial_terms = Coefficients == 4 ? 2 : 3;
  static constexpr bool rational = Coefficients == 8;

  Scalar const (&k)[Coefficients];

  /// Rows (xx, xy), (xy, yy).
  struct symmetric {
    Scalar xx, xy, yy;
  };

  FT_HOST_DEVICE vec2<Scalar> distort(vec2<Scalar> p) const {
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const c = numerator(r2) / denominator(r2);
    Scalar const xy2 = Scalar(2) * p.x * p.y;
    return {p.x * c + k[2] * xy2 + k[3] * (r2 + Scalar(2) * p.x * p.x),
            p.y * c + k[2] * (r2 + Scalar(2) * p.y * p.y) + k[3] * xy2};
  }

  /// d distorted / d p.
  FT_HOST_DEVICE symmetric jacobian(vec2<Scalar> p) const {
    Scalar const r2 = p.x * p.x + p.y * p.y;
    Scalar const d = denominator(r2);
    Scalar const c = numerator(r2) / d;
    Scalar slope = k[0] + r2 * Scalar(2) * k[1];  // d c / d r^2
    if constexpr (radial_terms == 3) { slope = slope + r2 * r2 * Scalar(3) * k[4]; }
    if constexpr (rational) {
      slope = (slope - c * (k[5] + r2 * (Scalar(2) * k[6] + r2 * Scalar(3) * k[7]))) / d;
    }
    Scalar const twice = Scalar(2) * slope;
    return {c + twice * p.x * p.x + Scalar(2) * k[2] * p.y + Scalar(6) * k[3] * p.x,
            twice * p.x * p.y + Scalar(2) * k[2] * p.x + Scalar(2) * k[3] * p.y,
            c + twice * p.y * p.y + Scalar(6) * k[2] * p.y + Scalar(2) * k[3] * p.x};
  }

  /// Whether the distortion is one-to-one on the disc of squared radius `r2`. If true for a disc,
  /// it is true for smaller ones. With rho(r) = r * numerator / denominator and p = sqrt(p1^2 +
  /// p2^2), the condition is rho' > 6 p r and a positive denominator on all of [0, r].
  ///
  /// Why: the Jacobian has a radial part, with the eigenvalues rho' and rho / r, which is a mean of
  /// rho', and a tangential part, whose eigenvalues are at most 6 p r in size. So it is positive
  /// definite on the disc. It is symmetric, so the distortion is the gradient of a function. That
  /// function is strictly convex on the disc, so no two points share a gradient. Without tangential
  /// terms the rule is exact. With them it is conservative: it excludes a ring where rho grows by
  /// less than 6 p r.
  FT_HOST_DEVICE bool one_to_one(Scalar r2) const {
    if (!scalar::is_finite(r2)) { return false; }
    Scalar const margin = Scalar(6) * scalar::sqrt((k[2] * k[2] + k[3] * k[3]) * r2);
    if constexpr (Coefficients == 4) {
      Scalar const growth[3] = {Scalar(1) - margin, Scalar(3) * k[0], Scalar(5) * k[1]};
      return stays_positive<2>(growth, r2);
    } else if constexpr (Coefficients == 5) {
      Scalar const growth[4] = {Scalar(1) - margin, Scalar(3) * k[0], Scalar(5) * k[1],
                                Scalar(7) * k[4]};
      return stays_positive<3>(growth, r2);
    } else {
      Scalar const n[4] = {Scalar(1), k[0], k[1], k[4]};
      Scalar const d[4] = {Scalar(1), k[5], k[6], k[7]};
      if (!stays_positive<3>(d, r2)) { return false; }
      Scalar growth[7];  // (rho' - margin) denominator^2, in powers of r^2
      for (int i = 0; i < 7; ++i) { growth[i] = Scalar(0); }
      for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) {
          Scalar const power = Scalar(static_cast<plain_scalar_t<Scalar>>(1 + 2 * i - 2 * j));
          growth[i + j] = growth[i + j] + power * n[i] * d[j] - margin * d[i] * d[j];
        }
      }
      return stays_positive<6>(growth, r2);
    }
  }

  /// The point that is distorted to `target`, by Newton's method from `target` itself, in the
  /// region where the distortion is one-to-one. A step that leaves the region or brings no gain is
  /// halved. Valid if the remaining distance is below 8 roundings of the scalar. Close to a pole of
  /// the denominator no point is valid, because a rounding of the point moves its image farther
  /// than that.
  FT_HOST_DEVICE plane_point<Scalar> undistort(vec2<Scalar> target) const {
    using P = plain_scalar_t<Scalar>;
    P const rounding = std::is_same<P, float>::value ? P(1.2e-7) : P(2.2e-16);
    Scalar const size = Scalar(1) + scalar::abs(target.x) + scalar::abs(target.y);
    Scalar const enough = Scalar(P(0.5) * rounding) * size;
    Scalar const most = Scalar(P(8) * rounding) * size;
    Scalar const one_half = Scalar(P(0.5));
    vec2<Scalar> at = target;
    bool inside = one_to_one(norm2(at));
    for (int i = 0; i < 10 && !inside; ++i) {
      at = {at.x * one_half, at.y * one_half};
      inside = one_to_one(norm2(at));
    }
    if (!inside) { return {{Scalar(0), Scalar(0)}, false}; }
    vec2<Scalar> left = minus(distort(at), target);
    for (int i = 0; i < 30 && norm2(left) > enough * enough; ++i) {
      symmetric const j = jacobian(at);
      Scalar const det = j.xx * j.yy - j.xy * j.xy;
      vec2<Scalar> step{(j.yy * left.x - j.xy * left.y) / det,
                        (j.xx * left.y - j.xy * left.x) / det};
      int const halvings = norm2(left) > most * most ? 12 : 0;
      bool better = false;
      for (int h = 0; h <= halvings && !better; ++h) {
        vec2<Scalar> const next = minus(at, step);
        if (one_to_one(norm2(next))) {
          vec2<Scalar> const then = minus(distort(next), target);
          better = norm2(then) < norm2(left);
          if (better) {
            at = next;
            left = then;
          }
        }
        step = {step.x * one_half, step.y * one_half};
      }
      if (!better) { break; }
    }
    return {at, norm2(left) <= most * most};
  }

private:
  FT_HOST_DEVICE static vec2<Scalar> minus(vec2<Scalar> a, vec2<Scalar> b) {
    return {a.x - b.x, a.y - b.y};
  }
  FT_HOST_DEVICE static Scalar norm2(vec2<Scalar> a) { return a.x * a.x + a.y * a.y; }
  FT_HOST_DEVICE Scalar numerator(Scalar r2) const {
    if constexpr (radial_terms == 3) {
      return Scalar(1) + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    } else {
      return Scalar(1) + r2 * (k[0] + r2 * k[1]);
    }
  }
  FT_HOST_DEVICE Scalar denominator(Scalar r2) const {
    if constexpr (rational) {
      return Scalar(1) + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
    } else {
      static_cast<void>(r2);
      return Scalar(1);
    }
  }
};

}  // namespace detail

/// With x = X / Z, y = Y / Z, r^2 = x^2 + y^2 and
/// c = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6):
///
///     u = fx (c x + 2 p1 x y + p2 (r^2 + 2 x^2)) + cx
///     v = fy (c y + p1 (r^2 + 2 y^2) + 2 p2 x y) + cy
///
/// Coefficients that a model does not have are zero.
///
/// Domain of project: Z > 0, and r inside the disc around the axis on which the distortion is known
/// to be one-to-one. Beyond some radius polynomials fold back, and points far outside the field of
/// view would appear inside the image. The rule, evaluated per call from the coefficients: from 0
/// to r, c r grows by more than 6 sqrt(p1^2 + p2^2) r; radtan_distortion::one_to_one explains why.
/// It is exact for p1 = p2 = 0 and slightly conservative otherwise. Outside: the principal point,
/// invalid.
/// Domain of unproject: pixels that are the image of a point in that disc. Rays have z = 1.
///
/// For the coverage of an image see ft/cameras/image_domain.hpp.
/// Source: Brown, "Decentering distortion of lenses", Photogrammetric Engineering 1966; order and
/// rational form as in OpenCV's calib3d documentation.
/// @tparam Coefficients 4, 5 or 8, see the aliases radtan4, radtan5, radtan8
template <typename Scalar, int Coefficients>
struct radtan {
  using scalar_type = Scalar;
  static constexpr char const* name =
      Coefficients == 4 ? "radtan4" : (Coefficients == 5 ? "radtan5" : "radtan8");
  static constexpr auto parameters = detail::radtan_parameters<Coefficients>();
  Scalar fx, fy, cx, cy;
  Scalar distortion[Coefficients];  ///< k1, k2, p1, p2, k3, k4, k5, k6

  /// @throws bad_argument for a focal length out of range, or a value that is not finite
  void check() const { check_camera(*this); }

  FT_HOST_DEVICE projection<Scalar> project(vec3<Scalar> p) const {
    if (!(p.z > Scalar(0)) || !scalar::is_finite(p.z)) { return detail::no_pixel(*this); }
    vec2<Scalar> const at{p.x / p.z, p.y / p.z};
    if (!lens().one_to_one(at.x * at.x + at.y * at.y)) { return detail::no_pixel(*this); }
    vec2<Scalar> const d = lens().distort(at);
    return detail::finite_pixel(*this, fx * d.x + cx, fy * d.y + cy);
  }
  /// Ray with z = 1; the axis if invalid.
  FT_HOST_DEVICE ray<Scalar> unproject(vec2<Scalar> pixel) const {
    auto const found = lens().undistort(detail::normalized(*this, pixel));
    if (!found.valid) { return detail::no_ray<Scalar>(); }
    return {{found.at.x, found.at.y, Scalar(1)}, true};
  }
  FT_HOST_DEVICE projection_with_jacobian<Scalar> project_with_jacobian(vec3<Scalar> p) const {
    Scalar const iz = Scalar(1) / p.z;
    vec2<Scalar> const at{p.x * iz, p.y * iz};
    auto const j = lens().jacobian(at);
    return {project(p),
            {{fx * j.xx * iz, fx * j.xy * iz, -(fx * (j.xx * at.x + j.xy * at.y) * iz),
              fy * j.xy * iz, fy * j.yy * iz, -(fy * (j.xy * at.x + j.yy * at.y) * iz)}}};
  }
  template <typename U>
  FT_HOST_DEVICE radtan<U, Coefficients> cast() const {
    return cast_camera<radtan<U, Coefficients>>(*this);
  }

private:
  FT_HOST_DEVICE detail::radtan_distortion<Scalar, Coefficients> lens() const {
    return {distortion};
  }
};

template <typename Scalar>
using radtan4 = radtan<Scalar, 4>;  ///< k1, k2, p1, p2
template <typename Scalar>
using radtan5 = radtan<Scalar, 5>;  ///< k1, k2, p1, p2, k3
template <typename Scalar>
using radtan8 = radtan<Scalar, 8>;  ///< k1, k2, p1, p2, k3, k4, k5, k6

static_assert(assert_camera_model<radtan4<float>>::value, "radtan4 keeps the camera contract");
static_assert(assert_camera_model<radtan5<float>>::value, "radtan5 keeps the camera contract");
static_assert(assert_camera_model<radtan8<float>>::value, "radtan8 keeps the camera contract");

}  // namespace FT_ABI
}  // namespace ft
