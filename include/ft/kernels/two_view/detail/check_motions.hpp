// SPDX-License-Identifier: Apache-2.0
/// @file Fourth step of a reconstruction from two views: triangulates the inliers with each
/// possible motion. Source: Hartley and Zisserman, "Multiple view geometry in computer vision", 2nd
/// edition, section 12.2.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

// The motions that a fundamental matrix or a homography leaves possible. Sources: Hartley
// and Zisserman, "Multiple view geometry in computer vision", 2nd edition, result 9.19; Faugeras
// and Lustman, "Motion and structure from motion in a piecewise planar environment", 1988.

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

/// From this cosine between its rays on, a point has no depth to speak of.
inline constexpr double parallel_cosine = 0.99998;

/// A float as an integer of the same order.
FT_HOST_DEVICE inline std::uint32_t ordered_key(float v) {
  std::uint32_t bits;
  std::memcpy(&bits, &v, sizeof bits);
  return (bits >> 31) != 0 ? ~bits : bits | 0x80000000u;
}
FT_HOST_DEVICE inline float value_of_key(std::uint32_t key) {
  std::uint32_t const bits = (key >> 31) != 0 ? key & 0x7fffffffu : ~key;
  float v;
  std::memcpy(&v, &bits, sizeof v);
  return v;
}
/// Greater than the key of any number.
inline constexpr std::uint32_t no_point_key = 0xffffffffu;

/// The angle of a cosine, degrees.
FT_HOST_DEVICE inline float degrees_of_cosine(float cosine) {
  real64 const c = static_cast<double>(cosine);
  real64 const one = 1.0;
  if (!(c < one)) { return 0; }
  real64 const s = scalar::sqrt((one - c) * (one + c));
  return static_cast<float>((strict_atan2(s, c) * real64(57.295779513082323)).value);
}

/// Two cameras, the first in the origin.
struct two_cameras {
  pinhole<real64> camera;
  wide_motion T_21;
  strict_vec3d centre;  ///< of the second
  real64 P[12];         ///< projection matrix of the second, 3 x 4
  real64 limit;         ///< of a squared error, pixels^2

  FT_HOST_DEVICE void set(pinhole<real64> const& c, wide_motion const& T, real64 sigma) {
    camera = c;
    T_21 = T;
    centre = T.centre();
    limit = real64(4.0) * (sigma * sigma);
    strict_mat3d const KR = calibration_matrix(c) * T.R;
    strict_vec3d const Kt = calibration_matrix(c) * T.t;
    real64 const t[3] = {Kt.x, Kt.y, Kt.z};
    for (int k = 0; k < 12; ++k) { P[k] = k % 4 < 3 ? KR.m[3 * (k / 4) + k % 4] : t[k / 4]; }
  }

  /// The point of a match: the least right singular vector of the four equations x P3 - P1 = 0, y
  /// P3
  /// - P2 = 0 of both images.
  FT_HOST_DEVICE strict_vec3d triangulated(matched_pixels const& m) const {
    real64 const zero = 0.0;
    real64 const x1 = static_cast<double>(m.x1);
    real64 const y1 = static_cast<double>(m.y1);
    real64 const x2 = static_cast<double>(m.x2);
    real64 const y2 = static_cast<double>(m.y2);
    real64 A[16] = {-camera.fx, zero, x1 - camera.cx, zero, zero, -camera.fy, y1 - camera.cy, zero};
    FT_UNROLL
    for (int k = 0; k < 4; ++k) {
      A[8 + k] = x2 * P[8 + k] - P[k];
      A[12 + k] = y2 * P[8 + k] - P[4 + k];
    }
    small_eigen<4> eigen;
    FT_UNROLL
    for (int e = 0; e < 16; ++e) {
      int const i = e / 4;
      int const j = e % 4;
      eigen.a[e] =
          (A[i] * A[j] + A[4 + i] * A[4 + j]) + (A[8 + i] * A[8 + j] + A[12 + i] * A[12 + j]);
    }
    eigen.diagonalize();
    int const k = eigen.smallest();
    real64 const w = eigen.component(3, k);
    return {eigen.component(0, k) / w, eigen.component(1, k) / w, eigen.component(2, k) / w};
  }

  /// Squared distance of a projected point from a pixel.
  FT_HOST_DEVICE real64 error2(strict_vec3d X, float x, float y) const {
    real64 const iz = scalar::reciprocal(X.z);
    real64 const dx = camera.fx * X.x * iz + camera.cx - real64(static_cast<double>(x));
    real64 const dy = camera.fy * X.y * iz + camera.cy - real64(static_cast<double>(y));
    return dx * dx + dy * dy;
  }

  FT_HOST_DEVICE checked_point check(matched_pixels const& m) const {
    strict_vec3d const X = triangulated(m);
    checked_point out{X.cast<float>(), no_point_key};
    if (!scalar::is_finite(out.X.x) || !scalar::is_finite(out.X.y) || !scalar::is_finite(out.X.z)) {
      return out;
    }
    strict_vec3d const from_second = X - centre;
    strict_vec3d const X2 = T_21 * X;
    real64 const lengths = scalar::sqrt(dot(X, X)) * scalar::sqrt(dot(from_second, from_second));
    auto const c = static_cast<float>((dot(X, from_second) / lengths).value);
    bool const apart = static_cast<double>(c) < parallel_cosine;
    real64 const zero = 0.0;
    // written so that a NaN fails
    bool const in_front = !apart || (X.z > zero && X2.z > zero);
    bool const near = error2(X, m.x1, m.y1) <= limit && error2(X2, m.x2, m.y2) <= limit;
    if (in_front && near && scalar::is_finite(c)) { out.key = ordered_key(c); }
    return out;
  }
};

/// Item: a possible motion of a pair.
struct check_motion {
  struct scratch {
    two_cameras cameras;
  };
  /// The parallax is that of the point with so many others that have more.
  static constexpr int rank_of_parallax = 50;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, two_view_input const& in,
                                 two_view_params const& params, two_view_workspace const& w) const {
    int const pair = item / w.most_motions;
    if (item % w.most_motions >= w.chosen[pair].motions) {
      if (g.rank() == 0) { w.checked[item] = {}; }
      return;
    }
    if (g.rank() == 0) {
      s.cameras.set(wide_camera(in.camera[pair]), w.motion[item].cast<real64>(),
                    real64(static_cast<double>(params.sigma_px)));
    }
    g.sync();
    std::ptrdiff_t const from = std::ptrdiff_t{pair} * w.capacity;
    checked_point* const points = w.point + std::ptrdiff_t{item} * w.capacity;
    int const n = w.prepared[pair].matches;
    checked_motion sums{};
    for (int i = g.rank(); i < n; i += g.size()) {
      checked_point p{{0, 0, 0}, no_point_key};
      if (w.inlier[from + i] != 0) { p = s.cameras.check(w.matched[from + i]); }
      points[i] = p;
      sums.points += static_cast<int>(p.key != no_point_key);
      sums.triangulated += static_cast<int>(is_triangulated(p));
    }
    sums.points = g.reduce(sums.points, sum_op{});
    sums.triangulated = g.reduce(sums.triangulated, sum_op{});
    if (sums.points > 0) {
      int const rank = min_of(rank_of_parallax, sums.points - 1);
      sums.parallax = degrees_of_cosine(value_of_key(key_of_rank(g, points, n, rank)));
    }
    if (g.rank() == 0) { w.checked[item] = sums; }
  }

  /// Whether it is good and its rays are not almost parallel.
  FT_HOST_DEVICE static bool is_triangulated(checked_point const& p) {
    return p.key != no_point_key && static_cast<double>(value_of_key(p.key)) < parallel_cosine;
  }

private:
  /// The key with that many smaller or equal ones before it, by bisection. Threads look at the
  /// points that they wrote.
  template <typename Group>
  FT_HOST_DEVICE static std::uint32_t key_of_rank(Group g, checked_point const* points, int n,
                                                  int rank) {
    std::uint32_t key = 0;
    FT_NO_UNROLL
    for (std::uint32_t bit = 0x80000000u; bit != 0; bit >>= 1) {
      int below = 0;  // keys that are smaller than the key with this bit
      for (int i = g.rank(); i < n; i += g.size()) {
        below += static_cast<int>(points[i].key < (key | bit));
      }
      if (g.reduce(below, sum_op{}) <= rank) { key |= bit; }
    }
    return key;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
