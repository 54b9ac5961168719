// SPDX-License-Identifier: Apache-2.0
/// @file The motions that a fundamental matrix or a homography leaves possible. Sources: Hartley
/// and Zisserman, "Multiple view geometry in computer vision", 2nd edition, result 9.19; Faugeras
/// and Lustman, "Motion and structure from motion in a piecewise planar environment", 1988.
#pragma once

#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/matrices/small_eigen.hpp"
#include "ft/kernels/matrices/small_matrices.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using wide_motion = rigid<wide>;

/// A camera in double precision.
FT_HOST_DEVICE inline pinhole<wide> wide_camera(pinhole<float> const& c) {
  return {static_cast<double>(c.fx), static_cast<double>(c.fy), static_cast<double>(c.cx),
          static_cast<double>(c.cy)};
}
FT_HOST_DEVICE inline wide_mat3 calibration_matrix(pinhole<wide> const& c) {
  wide const zero = 0.0;
  return {{c.fx, zero, c.cx, zero, c.fy, c.cy, zero, zero, wide(1.0)}};
}

/// Four motions with translations of length 1. In R = U W V^T and U W^T V^T, W turns by 90 degrees
/// about z.
/// @param out written from its start @return 4
FT_HOST_DEVICE inline int motions_of_fundamental(wide_mat3 const& F, pinhole<wide> const& camera,
                                                 rigid<double>* out) {
  wide_mat3 const K = calibration_matrix(camera);
  singular_vectors const s = singular_vectors_of(K.transposed() * (F * K));
  wide_mat3 const Vt = from_rows(s.v[0], s.v[1], s.v[2]);
  auto const turned = [&](wide sign) {
    wide_mat3 const UW =
        from_rows(scaled(s.u[1], sign), scaled(s.u[0], -sign), s.u[2]).transposed();
    wide_mat3 const R = UW * Vt;
    return determinant(R) < wide(0.0) ? scaled(R, wide(-1.0)) : R;
  };
  wide_vec3 const t = unit(s.u[2]);
  wide_mat3 const R[2] = {turned(1.0), turned(-1.0)};
  for (int k = 0; k < 4; ++k) { out[k] = wide_motion{R[k % 2], k < 2 ? t : -t}.cast<double>(); }
  return 4;
}

/// Eight motions with translations of length 1; none where two singular values are almost equal.
/// @param out written from its start @return 8 or 0
FT_HOST_DEVICE inline int motions_of_homography(wide_mat3 const& H, pinhole<wide> const& camera,
                                                rigid<double>* out) {
  wide const zero = 0.0;
  wide const one = 1.0;
  wide const fx = one / camera.fx;
  wide const fy = one / camera.fy;
  wide_mat3 const K_inv{
      {fx, zero, -(camera.cx * fx), zero, fy, -(camera.cy * fy), zero, zero, one}};
  singular_vectors const sv = singular_vectors_of(K_inv * (H * calibration_matrix(camera)));
  wide const d1 = sv.d[0];
  wide const d2 = sv.d[1];
  wide const d3 = sv.d[2];
  wide const apart = 1.00001;
  // written so that a NaN fails
  if (!(d1 / d2 >= apart && d2 / d3 >= apart)) { return 0; }
  wide_mat3 const U = from_rows(sv.u[0], sv.u[1], sv.u[2]).transposed();
  wide_mat3 const Vt = from_rows(sv.v[0], sv.v[1], sv.v[2]);
  wide const s = determinant(U) * determinant(Vt) < zero ? -1.0 : 1.0;
  wide const above = d1 * d1 - d2 * d2;
  wide const below = d2 * d2 - d3 * d3;
  wide const both = d1 * d1 - d3 * d3;
  wide const x1 = scalar::sqrt(above / both);
  wide const x3 = scalar::sqrt(below / both);
  wide const q = scalar::sqrt(above * below);
  for (int k = 0; k < 8; ++k) {
    wide const d = k < 4 ? wide(1.0) : wide(-1.0);  // sign of the plane's distance
    int const turn = k % 4;
    wide const divisor = (d1 + d * d3) * d2;
    wide const sine = (turn == 0 || turn == 3 ? q : -q) / divisor;
    wide const cosine = (d1 * d3 + d * d2 * d2) / divisor;
    wide_mat3 const turned{{cosine, zero, -(d * sine), zero, d, zero, sine, zero, d * cosine}};
    wide_vec3 const t = U * wide_vec3{turn < 2 ? x1 : -x1, zero, -(d * (turn % 2 == 0 ? x3 : -x3))};
    wide_mat3 const R = scaled(U * (turned * Vt), s);
    out[k] = wide_motion{R, unit(t)}.cast<double>();
  }
  return 8;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
