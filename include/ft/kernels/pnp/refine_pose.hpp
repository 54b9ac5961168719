// SPDX-License-Identifier: Apache-2.0
/// @file Improves a pose so that directions to points agree with rays: the second part of MLPnP,
/// and MLPnP itself.
///
/// Source: Urban, Leitloff and Hinz, "MLPnP: a real-time maximum likelihood solution to the
/// perspective-n-point problem", ISPRS Annals 2016, without covariances.
#pragma once

#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/kernels/matrices/small_matrices.hpp"
#include "ft/kernels/pnp/linear_pose.hpp"
#include "ft/kernels/pose/se3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr double not_solved = std::numeric_limits<double>::quiet_NaN();

/// A rotation as its vector w, |w| the angle, and a translation.
struct pose_vector {
  wide_vec3 w, t;
};

/// The vector of a rotation. As in the reference NaN for no rotation at all, and where rounding
/// makes the cosine of the angle larger than 1.
FT_HOST_DEVICE inline wide_vec3 rotation_vector(wide_mat3 const& R) {
  auto const& m = R.m;
  wide const c = (m[0] + m[4] + m[8] - wide(1.0)) * wide(0.5);
  if (!(c <= wide(1.0) && c >= wide(-1.0))) { return {not_solved, not_solved, not_solved}; }
  wide const angle = strict_atan2(scalar::sqrt((wide(1.0) - c) * (wide(1.0) + c)), c);
  wide const sine = strict_sin_cos(angle).sine;
  return scaled(wide_vec3{m[7] - m[5], m[2] - m[6], m[3] - m[1]}, angle / (sine + sine));
}

/// A rotation, and the derivative of its turning by its vector: R(w + d) = R(w) Exp(J d).
struct turned_pose {
  rigid<wide> T;
  wide_mat3 J;
};
FT_HOST_DEVICE inline turned_pose turned_by(pose_vector const& x) {
  wide const angle2 = dot(x.w, x.w);
  wide_rotation_terms const terms = wide_terms_of_rotation(angle2);
  return {{one_plus(terms.a, terms.b, x.w, angle2), x.t}, one_plus(-terms.b, terms.c, x.w, angle2)};
}

/// Residuals of a correspondence and their derivatives: what the direction to the point has along
/// two axes that are perpendicular to the ray. Row: derivatives by w, by t, the residual.
FT_HOST_DEVICE inline void direction_rows(turned_pose const& at, wide_vec3 ray, wide_vec3 point,
                                          wide (&row)[14]) {
  wide_vec3 const b = unit(ray);
  wide const zero = 0.0;
  wide const one = 1.0;
  wide const x = scalar::abs(b.x);
  wide const y = scalar::abs(b.y);
  wide const z = scalar::abs(b.z);
  bool const x_least = x <= y && x <= z;
  wide_vec3 const far{x_least ? one : zero, !x_least && y <= z ? one : zero,
                      !x_least && !(y <= z) ? one : zero};
  wide_vec3 const side = unit(cross(b, far));
  wide_vec3 const other = cross(b, side);
  wide_vec3 const seen = at.T * point;
  wide const inverse = scalar::reciprocal(norm(seen));
  wide_vec3 const u = scaled(seen, inverse);
  mat3<wide> const back = at.T.R.transposed();
  mat3<wide> const J = at.J.transposed();
  for (int k = 0; k < 2; ++k) {
    wide_vec3 const n = k == 0 ? side : other;
    wide const residual = dot(n, u);
    wide_vec3 const by_t = scaled(n - scaled(u, residual), inverse);
    wide_vec3 const by_w = J * cross(point, back * by_t);
    wide* const to = row + 7 * k;
    to[0] = by_w.x;
    to[1] = by_w.y;
    to[2] = by_w.z;
    to[3] = by_t.x;
    to[4] = by_t.y;
    to[5] = by_t.z;
    to[6] = residual;
  }
}

/// Sets s.sum to the normal equations, 6 x 7, upper triangle. Leaves the rows of the last chunk.
/// Ends with a sync.
template <typename Group>
FT_HOST_DEVICE void sum_rows(Group g, mlpnp_scratch& s, pnp_selection const& from,
                             turned_pose const& at) {
  FT_NO_UNROLL
  for (int first = 0; first < from.count; first += s.chunk) {
    int const size = min_of(mlpnp_scratch::chunk, from.count - first);
    g.sync();
    for (int i = g.rank(); i < size; i += g.size()) {
      direction_rows(at, from.ray_of(first + i), from.point_of(first + i), s.row[i]);
    }
    g.sync();
    for (int e = g.rank(); e < 42; e += g.size()) {
      int const r = e / 7;
      int const c = e - 7 * r;
      if (r > c) { continue; }
      wide sum = first == 0 ? wide(0.0) : s.sum[e];
      for (int p = 0; p < size; ++p) {
        wide const* const row = s.row[p];
        sum += row[r] * row[c] + row[7 + r] * row[7 + c];
      }
      s.sum[e] = sum;
    }
  }
  g.sync();
}

/// The largest change of a residual by a step, to first order. The group has synced after
/// sum_rows().
template <typename Group>
FT_HOST_DEVICE wide largest_effect(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                   turned_pose const& at, wide const (&d)[6]) {
  double largest = 0;
  for (int i = g.rank(); i < from.count; i += g.size()) {
    wide again[14];
    wide const* row = again;
    if (from.count <= s.chunk) {
      row = s.row[i];
    } else {
      direction_rows(at, from.ray_of(i), from.point_of(i), again);
    }
    for (int k = 0; k < 14; k += 7) {
      wide sum = 0.0;
      for (int c = 0; c < 6; ++c) { sum += row[k + c] * d[c]; }
      largest = max_of(largest, scalar::abs(sum).value);
    }
  }
  return g.reduce(largest, max_op{});
}

/// At most five steps of Gauss and Newton. A step with a part above 5, or with none below 1, is not
/// taken and is the last one. NaN where there is no pose.
template <typename Group>
FT_HOST_DEVICE rigid<wide> refined_pose(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                        rigid<wide> const& start) {
  pose_vector x{rotation_vector(start.R), start.t};
  FT_NO_UNROLL
  for (int step = 0; step < 5; ++step) {
    turned_pose const at = turned_by(x);
    sum_rows(g, s, from, at);
    wide d[6];
    solve_symmetric_6(s.sum, d);
    wide largest = 0.0;
    wide least = scalar::abs(d[0]);
    wide whole = 0.0;
    FT_UNROLL
    for (int k = 0; k < 6; ++k) {
      largest = max_of(largest, scalar::abs(d[k]));
      least = min_of(least, scalar::abs(d[k]));
      whole += d[k] - d[k];
    }
    if (largest > wide(5.0) || least > wide(1.0)) { break; }
    x.w = x.w - wide_vec3{d[0], d[1], d[2]};
    x.t = x.t - wide_vec3{d[3], d[4], d[5]};
    // Without a number there is no pose any more.
    if (!(whole == wide(0.0)) || largest_effect(g, s, from, at, d) < wide(1e-5)) { break; }
  }
  return turned_by(x).T;
}

/// A pose, and whether there is one. Without one all its numbers are the same NaN.
struct pnp_pose {
  rigid<double> T_cw;
  bool valid;
};

/// Pose from at least six rays and points, by MLPnP. All threads of the group get it.
template <typename Group>
FT_HOST_DEVICE pnp_pose mlpnp(Group g, mlpnp_scratch& s, pnp_selection const& from) {
  rigid<wide> const T = refined_pose(g, s, from, linear_pose(g, s, from));
  bool valid = scalar::is_finite(T.t.x) && scalar::is_finite(T.t.y) && scalar::is_finite(T.t.z);
  for (int k = 0; k < 9; ++k) { valid = valid && scalar::is_finite(T.R.m[k]); }
  pnp_pose out{T.template cast<double>(), valid};
  if (!valid) {
    for (double& k : out.T_cw.R.m) { k = not_solved; }
    out.T_cw.t = {not_solved, not_solved, not_solved};
  }
  return out;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
