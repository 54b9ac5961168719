// SPDX-License-Identifier: Apache-2.0
/// @file A pose from at least six rays and points by linear equations: the first part of MLPnP.
///
/// Source: Urban, Leitloff and Hinz, "MLPnP: a real-time maximum likelihood solution to the
/// perspective-n-point problem", ISPRS Annals 2016, without covariances.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/group_eigen.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Some correspondences of a problem.
struct pnp_selection {
  vec3<double> const* ray;
  vec3<float> const* point;
  int const* index;  ///< [count]
  int count;         ///< at least 6

  FT_HOST_DEVICE strict_vec3d ray_of(int i) const { return ray[index[i]].cast<real64>(); }
  FT_HOST_DEVICE strict_vec3d point_of(int i) const {
    return point[index[i]].cast<double>().cast<real64>();
  }
};

/// Working memory of a pose from points.
struct mlpnp_scratch {
  static constexpr int chunk = 16;  ///< correspondences that are prepared at a time

  paired_eigen<12> eigen;
  real64 row[chunk][14];
  real64 sum[42];
};

/// How badly rays and points agree: over the first six, 1 minus the product of the ray, which is
/// not of unit length, and the point's direction.
FT_HOST_DEVICE inline real64 disagreement(pnp_selection const& from, rigid<real64> const& T) {
  real64 sum = 0.0;
  for (int i = 0; i < 6; ++i) {
    sum += real64(1.0) - dot(unit(T * from.point_of(i)), from.ray_of(i));
  }
  return sum;
}

/// Sets eigen.a to A^T A, where A has the two equations of each correspondence: what the ray does
/// not share with R X + t is 0. Their sum of squares is that of (I - u u^T)(R X + t), u the ray's
/// direction. Unknowns: R by rows, then t. Ends with a sync.
/// @param axes null, or the axes of a plane in which the points lie, as rows, its normal first: the
///   points are turned to these, and R lacks its first column
template <typename Group>
FT_HOST_DEVICE void set_equations(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                  strict_mat3d const* axes) {
  int const columns = axes == nullptr ? 3 : 2;  // of R
  int const n = 3 * columns + 3;
  real64* const a = s.eigen.a;
  small_divider const by_n(n);
  FT_NO_UNROLL
  for (int first = 0; first < from.count; first += s.chunk) {
    int const size = min_of(mlpnp_scratch::chunk, from.count - first);
    g.sync();
    for (int i = g.rank(); i < size; i += g.size()) {
      strict_vec3d const u = unit(from.ray_of(first + i));
      strict_vec3d x = from.point_of(first + i);
      if (axes != nullptr) {
        x = *axes * x;
        x = {x.y, x.z, 1.0};
      }
      real64* const row = s.row[i];
      row[0] = u.x;
      row[1] = u.y;
      row[2] = u.z;
      row[3] = x.x;
      row[4] = x.y;
      row[5] = x.z;
      row[6] = 1.0;
    }
    g.sync();
    for (int e = g.rank(); e < n * n; e += g.size()) {
      int const r = by_n(e);
      int const c = e - n * r;
      if (r > c) { continue; }
      // An unknown is element (i, k) of [R t].
      int const i = r < 3 * columns ? r / columns : r - 3 * columns;
      int const k = r < 3 * columns ? r - i * columns : columns;
      int const j = c < 3 * columns ? c / columns : c - 3 * columns;
      int const l = c < 3 * columns ? c - j * columns : columns;
      real64 const one = i == j ? 1.0 : 0.0;
      real64 sum = first == 0 ? real64(0.0) : a[e];
      for (int p = 0; p < size; ++p) {
        real64 const* const row = s.row[p];
        sum += (one - row[i] * row[j]) * (row[3 + k] * row[3 + l]);
      }
      a[e] = sum;
    }
  }
  g.sync();
  for (int e = g.rank(); e < n * n; e += g.size()) {
    int const r = by_n(e);
    int const c = e - n * r;
    if (r > c) { a[e] = a[n * c + r]; }
  }
  g.sync();
}

/// Sum of X X^T, in the world. Ends with a sync.
template <typename Group>
FT_HOST_DEVICE strict_mat3d second_moments(Group g, mlpnp_scratch& s, pnp_selection const& from) {
  g.sync();
  for (int e = g.rank(); e < 9; e += g.size()) {
    auto const coordinate = [](strict_vec3d v, int k) {
      return k == 0 ? v.x : (k == 1 ? v.y : v.z);
    };
    real64 sum = 0.0;
    for (int p = 0; p < from.count; ++p) {
      strict_vec3d const x = from.point_of(p);
      sum += coordinate(x, e / 3) * coordinate(x, e % 3);
    }
    s.sum[e] = sum;
  }
  g.sync();
  strict_mat3d S;
  for (int e = 0; e < 9; ++e) { S.m[e] = s.sum[e]; }
  g.sync();
  return S;
}

/// The pose of points in general position.
template <typename Group>
FT_HOST_DEVICE rigid<real64> general_pose(Group g, mlpnp_scratch& s, pnp_selection const& from) {
  set_equations(g, s, from, nullptr);
  s.eigen.diagonalize(g, 12);
  int const k = s.eigen.smallest(12);
  auto const v = [&](int i) { return s.eigen.v[12 * i + k]; };
  strict_mat3d const M{{v(0), v(1), v(2), v(3), v(4), v(5), v(6), v(7), v(8)}};
  real64 const size = norm(row_of(M, 0)) * norm(row_of(M, 1)) * norm(row_of(M, 2));
  real64 const scale = scalar::reciprocal(cube_root(size));
  strict_vec3d const t = scaled(strict_vec3d{v(9), v(10), v(11)}, scale);
  rigid<real64> const plus{orthogonal_factor(M), t};
  rigid<real64> const minus{plus.R, -t};
  return disagreement(from, minus) < disagreement(from, plus) ? minus : plus;
}

/// The pose of points in a plane through the world's origin, whose moments have the rank 2. The
/// scale is the reference's: a product of columns where rows are meant, so that the distance of a
/// plane that lies straight before the camera comes out too large.
/// @param moments sum of X X^T
template <typename Group>
FT_HOST_DEVICE rigid<real64> plane_pose(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                        strict_mat3d const& moments) {
  for (int e = g.rank(); e < 9; e += g.size()) { s.eigen.a[e] = moments.m[e]; }
  g.sync();
  s.eigen.diagonalize(g, 3);
  auto const moment = [&](int k) { return s.eigen.value(k, 3); };
  int const low = s.eigen.smallest(3);
  int const b = low == 0 ? 1 : 0;
  int const c = low == 2 ? 1 : 2;
  int const middle = moment(c) < moment(b) ? c : b;
  auto const axis = [&](int k) {
    return strict_vec3d{s.eigen.v[k], s.eigen.v[3 + k], s.eigen.v[6 + k]};
  };
  strict_mat3d const E = from_rows(axis(low), axis(middle), axis(b + c - middle));

  set_equations(g, s, from, &E);
  s.eigen.diagonalize(g, 9);
  int const k = s.eigen.smallest(9);
  auto const v = [&](int i) { return s.eigen.v[9 * i + k]; };
  strict_vec3d const c1{v(0), v(2), v(4)};
  strict_vec3d const c2{v(1), v(3), v(5)};
  strict_mat3d const T = from_rows(cross(c1, c2), c1, c2);
  real64 const size = norm(column_of(T, 1)) * norm(column_of(T, 2));
  real64 const scale = scalar::reciprocal(scalar::sqrt(size));
  strict_vec3d const t = scaled(strict_vec3d{v(6), v(7), v(8)}, scale);

  strict_mat3d Q = scaled((E.transposed() * orthogonal_factor(T)).transposed(), real64(-1.0));
  if (determinant(Q) < real64(0.0)) {
    Q = {{Q.m[0], Q.m[1], -Q.m[2], Q.m[3], Q.m[4], -Q.m[5], Q.m[6], Q.m[7], -Q.m[8]}};
  }
  strict_mat3d const turned{
      {-Q.m[0], -Q.m[1], Q.m[2], -Q.m[3], -Q.m[4], Q.m[5], -Q.m[6], -Q.m[7], Q.m[8]}};
  rigid<real64> best{Q, t};
  real64 least = disagreement(from, best);
  for (int other = 1; other < 4; ++other) {
    rigid<real64> const candidate{other < 2 ? Q : turned, other % 2 == 0 ? t : -t};
    real64 const sum = disagreement(from, candidate);
    if (sum < least) {
      best = candidate;
      least = sum;
    }
  }
  return best;
}

/// The pose by linear equations. Its rotation is orthogonal; NaN where there is none.
template <typename Group>
FT_HOST_DEVICE rigid<real64> linear_pose(Group g, mlpnp_scratch& s, pnp_selection const& from) {
  strict_mat3d const moments = second_moments(g, s, from);
  return rank_of(moments) == 2 ? plane_pose(g, s, from, moments) : general_pose(g, s, from);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
