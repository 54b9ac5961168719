// SPDX-License-Identifier: Apache-2.0
/// @file The motions that a fundamental matrix or a homography leaves possible. Sources: Hartley
/// and Zisserman, "Multiple view geometry in computer vision", 2nd edition, result 9.19; Faugeras
/// and Lustman, "Motion and structure from motion in a piecewise planar environment", 1988.
#pragma once

#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/math/small_matrices.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using wide_motion = rigid<real64>;

/// A camera in double precision.
FT_HOST_DEVICE inline pinhole<real64> wide_camera(pinhole<float> const& c) {
  return {static_cast<double>(c.fx), static_cast<double>(c.fy), static_cast<double>(c.cx),
          static_cast<double>(c.cy)};
}
FT_HOST_DEVICE inline strict_mat3d calibration_matrix(pinhole<real64> const& c) {
  real64 const zero = 0.0;
  return {{c.fx, zero, c.cx, zero, c.fy, c.cy, zero, zero, real64(1.0)}};
}

/// Four motions with translations of length 1. In R = U W V^T and U W^T V^T, W turns by 90 degrees
/// about z.
/// @param out written from its start @return 4
FT_HOST_DEVICE inline int motions_of_fundamental(strict_mat3d const& F,
                                                 pinhole<real64> const& camera,
                                                 rigid<double>* out) {
  strict_mat3d const K = calibration_matrix(camera);
  singular_vectors const s = singular_vectors_of(K.transposed() * (F * K));
  strict_mat3d const Vt = from_rows(s.v[0], s.v[1], s.v[2]);
  auto const turned = [&](real64 sign) {
    strict_mat3d const UW =
        from_rows(scaled(s.u[1], sign), scaled(s.u[0], -sign), s.u[2]).transposed();
    strict_mat3d const R = UW * Vt;
    return determinant(R) < real64(0.0) ? scaled(R, real64(-1.0)) : R;
  };
  strict_vec3d const t = unit(s.u[2]);
  strict_mat3d const R[2] = {turned(1.0), turned(-1.0)};
  for (int k = 0; k < 4; ++k) { out[k] = wide_motion{R[k % 2], k < 2 ? t : -t}.cast<double>(); }
  return 4;
}

/// Eight motions with translations of length 1; none where two singular values are almost equal.
/// @param out written from its start @return 8 or 0
FT_HOST_DEVICE inline int motions_of_homography(strict_mat3d const& H,
                                                pinhole<real64> const& camera, rigid<double>* out) {
  real64 const zero = 0.0;
  real64 const one = 1.0;
  real64 const fx = one / camera.fx;
  real64 const fy = one / camera.fy;
  strict_mat3d const K_inv{
      {fx, zero, -(camera.cx * fx), zero, fy, -(camera.cy * fy), zero, zero, one}};
  singular_vectors const sv = singular_vectors_of(K_inv * (H * calibration_matrix(camera)));
  real64 const d1 = sv.d[0];
  real64 const d2 = sv.d[1];
  real64 const d3 = sv.d[2];
  real64 const apart = 1.00001;
  // written so that a NaN fails
  if (!(d1 / d2 >= apart && d2 / d3 >= apart)) { return 0; }
  strict_mat3d const U = from_rows(sv.u[0], sv.u[1], sv.u[2]).transposed();
  strict_mat3d const Vt = from_rows(sv.v[0], sv.v[1], sv.v[2]);
  real64 const s = determinant(U) * determinant(Vt) < zero ? -1.0 : 1.0;
  real64 const above = d1 * d1 - d2 * d2;
  real64 const below = d2 * d2 - d3 * d3;
  real64 const both = d1 * d1 - d3 * d3;
  real64 const x1 = scalar::sqrt(above / both);
  real64 const x3 = scalar::sqrt(below / both);
  real64 const q = scalar::sqrt(above * below);
  for (int k = 0; k < 8; ++k) {
    real64 const d = k < 4 ? real64(1.0) : real64(-1.0);  // sign of the plane's distance
    int const turn = k % 4;
    real64 const divisor = (d1 + d * d3) * d2;
    real64 const sine = (turn == 0 || turn == 3 ? q : -q) / divisor;
    real64 const cosine = (d1 * d3 + d * d2 * d2) / divisor;
    strict_mat3d const turned{{cosine, zero, -(d * sine), zero, d, zero, sine, zero, d * cosine}};
    strict_vec3d const t =
        U * strict_vec3d{turn < 2 ? x1 : -x1, zero, -(d * (turn % 2 == 0 ? x3 : -x3))};
    strict_mat3d const R = scaled(U * (turned * Vt), s);
    out[k] = wide_motion{R, unit(t)}.cast<double>();
  }
  return 8;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
