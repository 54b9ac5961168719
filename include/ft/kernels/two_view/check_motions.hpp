// SPDX-License-Identifier: Apache-2.0
/// @file Fourth step of a reconstruction from two views: triangulates the inliers with each
/// possible motion. Source: Hartley and Zisserman, "Multiple view geometry in computer vision", 2nd
/// edition, section 12.2.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/matrices/small_eigen.hpp"
#include "ft/kernels/two_view/motions.hpp"
#include "ft/kernels/two_view/problem.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

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
  wide const c = static_cast<double>(cosine);
  wide const one = 1.0;
  if (!(c < one)) { return 0; }
  wide const s = scalar::sqrt((one - c) * (one + c));
  return static_cast<float>((strict_atan2(s, c) * wide(57.295779513082323)).value);
}

/// Two cameras, the first in the origin.
struct two_cameras {
  pinhole<wide> camera;
  wide_motion T_21;
  wide_vec3 centre;  ///< of the second
  wide P[12];        ///< projection matrix of the second, 3 x 4
  wide limit;        ///< of a squared error, pixels^2

  FT_HOST_DEVICE void set(pinhole<wide> const& c, wide_motion const& T, wide sigma) {
    camera = c;
    T_21 = T;
    centre = T.centre();
    limit = wide(4.0) * (sigma * sigma);
    wide_mat3 const KR = calibration_matrix(c) * T.R;
    wide_vec3 const Kt = calibration_matrix(c) * T.t;
    wide const t[3] = {Kt.x, Kt.y, Kt.z};
    for (int k = 0; k < 12; ++k) { P[k] = k % 4 < 3 ? KR.m[3 * (k / 4) + k % 4] : t[k / 4]; }
  }

  /// The point of a match: the least right singular vector of the four equations x P3 - P1 = 0, y
  /// P3
  /// - P2 = 0 of both images.
  FT_HOST_DEVICE wide_vec3 triangulated(matched_pixels const& m) const {
    wide const zero = 0.0;
    wide const x1 = static_cast<double>(m.x1);
    wide const y1 = static_cast<double>(m.y1);
    wide const x2 = static_cast<double>(m.x2);
    wide const y2 = static_cast<double>(m.y2);
    wide A[16] = {-camera.fx, zero, x1 - camera.cx, zero, zero, -camera.fy, y1 - camera.cy, zero};
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
    wide const w = eigen.component(3, k);
    return {eigen.component(0, k) / w, eigen.component(1, k) / w, eigen.component(2, k) / w};
  }

  /// Squared distance of a projected point from a pixel.
  FT_HOST_DEVICE wide error2(wide_vec3 X, float x, float y) const {
    wide const iz = scalar::reciprocal(X.z);
    wide const dx = camera.fx * X.x * iz + camera.cx - wide(static_cast<double>(x));
    wide const dy = camera.fy * X.y * iz + camera.cy - wide(static_cast<double>(y));
    return dx * dx + dy * dy;
  }

  FT_HOST_DEVICE checked_point check(matched_pixels const& m) const {
    wide_vec3 const X = triangulated(m);
    checked_point out{X.cast<float>(), no_point_key};
    if (!scalar::is_finite(out.X.x) || !scalar::is_finite(out.X.y) || !scalar::is_finite(out.X.z)) {
      return out;
    }
    wide_vec3 const from_second = X - centre;
    wide_vec3 const X2 = T_21 * X;
    wide const lengths = scalar::sqrt(dot(X, X)) * scalar::sqrt(dot(from_second, from_second));
    auto const c = static_cast<float>((dot(X, from_second) / lengths).value);
    bool const apart = static_cast<double>(c) < parallel_cosine;
    wide const zero = 0.0;
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
      s.cameras.set(wide_camera(in.camera[pair]), w.motion[item].cast<wide>(),
                    wide(static_cast<double>(params.sigma_px)));
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
