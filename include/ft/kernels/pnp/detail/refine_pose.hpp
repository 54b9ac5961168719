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
#include "ft/core/geometry.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/pnp/detail/linear_pose.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr double not_solved = std::numeric_limits<double>::quiet_NaN();

/// A rotation as its vector w, |w| the angle, and a translation.
struct pose_vector {
  strict_vec3d w, t;
};

/// A rotation, and the derivative of its turning by its vector: R(w + d) = R(w) Exp(J d).
struct turned_pose {
  rigid<real64> T;
  strict_mat3d J;
};
FT_HOST_DEVICE inline turned_pose turned_by(pose_vector const& x) {
  auto const turn = rotation_exp_and_jacobian(x.w);
  return {{turn.E, x.t}, turn.Jr};
}

/// Residuals of a correspondence and their derivatives: what the direction to the point has along
/// two axes that are perpendicular to the ray. Row: derivatives by w, by t, the residual.
FT_HOST_DEVICE inline void direction_rows(turned_pose const& at, strict_vec3d ray,
                                          strict_vec3d point, real64 (&row)[14]) {
  strict_vec3d const b = unit(ray);
  real64 const zero = 0.0;
  real64 const one = 1.0;
  real64 const x = scalar::abs(b.x);
  real64 const y = scalar::abs(b.y);
  real64 const z = scalar::abs(b.z);
  bool const x_least = x <= y && x <= z;
  strict_vec3d const far{x_least ? one : zero, !x_least && y <= z ? one : zero,
                         !x_least && !(y <= z) ? one : zero};
  strict_vec3d const side = unit(cross(b, far));
  strict_vec3d const other = cross(b, side);
  strict_vec3d const seen = at.T * point;
  real64 const inverse = scalar::reciprocal(norm(seen));
  strict_vec3d const u = scaled(seen, inverse);
  mat3<real64> const back = at.T.R.transposed();
  mat3<real64> const J = at.J.transposed();
  for (int k = 0; k < 2; ++k) {
    strict_vec3d const n = k == 0 ? side : other;
    real64 const residual = dot(n, u);
    strict_vec3d const by_t = scaled(n - scaled(u, residual), inverse);
    strict_vec3d const by_w = J * cross(point, back * by_t);
    real64* const to = row + 7 * k;
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
      real64 sum = first == 0 ? real64(0.0) : s.sum[e];
      for (int p = 0; p < size; ++p) {
        real64 const* const row = s.row[p];
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
FT_HOST_DEVICE real64 largest_effect(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                     turned_pose const& at, real64 const (&d)[6]) {
  double largest = 0;
  for (int i = g.rank(); i < from.count; i += g.size()) {
    real64 again[14];
    real64 const* row = again;
    if (from.count <= s.chunk) {
      row = s.row[i];
    } else {
      direction_rows(at, from.ray_of(i), from.point_of(i), again);
    }
    for (int k = 0; k < 14; k += 7) {
      real64 sum = 0.0;
      for (int c = 0; c < 6; ++c) { sum += row[k + c] * d[c]; }
      largest = max_of(largest, scalar::abs(sum).value);
    }
  }
  return g.reduce(largest, max_op{});
}

/// At most five steps of Gauss and Newton. A step with a part above 5, or with none below 1, is not
/// taken and is the last one. NaN where there is no pose.
template <typename Group>
FT_HOST_DEVICE rigid<real64> refined_pose(Group g, mlpnp_scratch& s, pnp_selection const& from,
                                          rigid<real64> const& start) {
  pose_vector x{rotation_vector(start.R), start.t};
  FT_NO_UNROLL
  for (int step = 0; step < 5; ++step) {
    turned_pose const at = turned_by(x);
    sum_rows(g, s, from, at);
    real64 d[6];
    solve_symmetric_6(s.sum, d);
    real64 largest = 0.0;
    real64 least = scalar::abs(d[0]);
    real64 whole = 0.0;
    FT_UNROLL
    for (int k = 0; k < 6; ++k) {
      largest = max_of(largest, scalar::abs(d[k]));
      least = min_of(least, scalar::abs(d[k]));
      whole += d[k] - d[k];
    }
    if (largest > real64(5.0) || least > real64(1.0)) { break; }
    x.w = x.w - strict_vec3d{d[0], d[1], d[2]};
    x.t = x.t - strict_vec3d{d[3], d[4], d[5]};
    // Without a number there is no pose any more.
    if (!(whole == real64(0.0)) || largest_effect(g, s, from, at, d) < real64(1e-5)) { break; }
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
  rigid<real64> const T = refined_pose(g, s, from, linear_pose(g, s, from));
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
