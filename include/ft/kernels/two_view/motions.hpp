// SPDX-License-Identifier: Apache-2.0
/// @file The motions that a fundamental matrix or a homography leaves possible. Sources: Hartley
/// and Zisserman, "Multiple view geometry in computer vision", 2nd edition, result 9.19; Faugeras
/// and Lustman, "Motion and structure from motion in a piecewise planar environment", 1988.
#pragma once

#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/matrices/small_eigen.hpp"
#include "ft/kernels/two_view/problem.hpp"

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
  auto const turned = [&](wide sign) {
    wide_mat3 R;
    wide_vec3 const u[3] = {scaled(s.u[1], sign), scaled(s.u[0], -sign), s.u[2]};
    auto const row = [&](int i, wide a, wide b, wide c) {
      R.m[3 * i] = a * s.v[0].x + (b * s.v[1].x + c * s.v[2].x);
      R.m[3 * i + 1] = a * s.v[0].y + (b * s.v[1].y + c * s.v[2].y);
      R.m[3 * i + 2] = a * s.v[0].z + (b * s.v[1].z + c * s.v[2].z);
    };
    row(0, u[0].x, u[1].x, u[2].x);
    row(1, u[0].y, u[1].y, u[2].y);
    row(2, u[0].z, u[1].z, u[2].z);
    return determinant(R) < wide(0.0) ? scaled(R, wide(-1.0)) : R;
  };
  wide_vec3 const t = scaled(s.u[2], scalar::reciprocal(scalar::sqrt(dot(s.u[2], s.u[2]))));
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
  auto const columns = [](wide_vec3 const(&c)[3]) {
    return wide_mat3{{c[0].x, c[1].x, c[2].x, c[0].y, c[1].y, c[2].y, c[0].z, c[1].z, c[2].z}};
  };
  wide_mat3 const U = columns(sv.u);
  wide_mat3 const V = columns(sv.v);
  wide const s = determinant(U) * determinant(V) < zero ? -1.0 : 1.0;
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
    wide_mat3 const R = scaled(U * (turned * V.transposed()), s);
    out[k] = wide_motion{R, scaled(t, scalar::reciprocal(scalar::sqrt(dot(t, t))))}.cast<double>();
  }
  return 8;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
