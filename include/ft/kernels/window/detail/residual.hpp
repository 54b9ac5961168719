// SPDX-License-Identifier: Apache-2.0
/// @file Errors of a window's observations, their robust costs and their derivatives.
#pragma once

#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

using window_real = strict_double;

FT_HOST_DEVICE inline vec3<window_real> to_real(vec3<double> const& v) { return {v.x, v.y, v.z}; }
FT_HOST_DEVICE inline vec3<double> from_real(vec3<window_real> const& v) {
  return {v.x.value, v.y.value, v.z.value};
}

/// Cost of a squared weighted error. Source: Huber, "Robust estimation of a location parameter",
/// 1964.
FT_HOST_DEVICE inline window_real robust_cost(window_real chi2, double huber2) {
  window_real const limit = huber2;
  return chi2 <= limit ? chi2 : window_real(2.0) * scalar::sqrt(limit * chi2) - limit;
}
/// Its derivative by chi2.
FT_HOST_DEVICE inline window_real robust_weight(window_real chi2, double huber2) {
  window_real const limit = huber2;
  return chi2 <= limit ? window_real(1.0) : scalar::sqrt(limit / chi2);
}

/// An error of one or two rows: projected minus measured, pixels, and its derivative by the point
/// in the frame of the pose: that of the left camera, or of a multi_rig's body.
struct window_error {
  window_real e[2];
  vec3<window_real> J[2];
  window_real weight;
  bool seen;  ///< whether the point has an image

  FT_HOST_DEVICE window_real chi2() const { return weight * (e[0] * e[0] + e[1] * e[1]); }
  /// At NaN the point has no image.
  FT_HOST_DEVICE bool valid() const { return seen && scalar::is_finite(chi2()); }
};

/// The errors of an observation: first() its pixel's, and for a rectified pair with a right column
/// second() its disparity's, which counts as an observation of its own.
template <typename Rig>
struct window_residual {
  using real = window_real;
  Rig const& rig;
  window_observation const& o;
  vec3<real> x;  ///< point in the frame of the pose, metres

  FT_HOST_DEVICE static real wide(float v) { return real(static_cast<double>(v)); }

  /// @param camera of the rig
  FT_HOST_DEVICE window_error first(int camera) const {
    window_error r;
    r.weight = wide(o.inv_sigma2);
    if constexpr (is_monocular_v<Rig>) {
      static_cast<void>(camera);
      set(r, rig.camera.template cast<real>().project_with_jacobian(x));
    } else if constexpr (is_mixed_v<Rig>) {
      auto const model = rig.pair(camera).camera.template cast<real>();
      set(r, model.project_with_jacobian(rig.to_camera(camera, x)));
      r.J[0] = by_body(camera, r.J[0]);
      r.J[1] = by_body(camera, r.J[1]);
    } else if constexpr (Rig::rectified) {
      real const zero = real(0.0);
      vec3<real> const p = rig.to_camera(camera, x);
      auto const& k = rig.pair(camera).camera;
      real const iz = scalar::reciprocal(p.z);
      real const u = wide(k.fx) * (p.x * iz);
      real const v = wide(k.fy) * (p.y * iz);
      r.e[0] = u + wide(k.cx) - wide(o.x);
      r.e[1] = v + wide(k.cy) - wide(o.y);
      r.J[0] = by_body(camera, {wide(k.fx) * iz, zero, -(u * iz)});
      r.J[1] = by_body(camera, {zero, wide(k.fy) * iz, -(v * iz)});
      r.seen = p.z > zero;
    } else if (camera == 0) {
      set(r, rig.left.template cast<real>().project_with_jacobian(x));
    } else {
      auto const T = rig.T_rl.template cast<real>();
      set(r, rig.right.template cast<real>().project_with_jacobian(T * x));
      r.J[0] = row_times(r.J[0], T.R);
      r.J[1] = row_times(r.J[1], T.R);
    }
    return r;
  }
  FT_HOST_DEVICE bool has_second() const {
    return Rig::rectified && !is_monocular_v<Rig> && o.right_x >= 0;
  }
  FT_HOST_DEVICE window_error second(window_params const& params, int camera = 0) const {
    window_error r;
    real const zero = real(0.0);
    r.e[1] = zero;
    r.J[1] = {zero, zero, zero};
    if constexpr (Rig::rectified && !is_monocular_v<Rig>) {
      real const z = rig.to_camera(camera, x).z;
      real const iz = scalar::reciprocal(z);
      real const disparity = wide(rig.pair(camera).bf()) * iz;
      r.weight = wide(o.inv_sigma2) * real(params.disparity_weight);
      r.e[0] = disparity - (wide(o.x) - wide(o.right_x));
      r.J[0] = by_body(camera, {zero, zero, -(disparity * iz)});
      r.seen = z > zero;
    } else {
      r.weight = r.e[0] = zero;
      r.J[0] = r.J[1];
      r.seen = false;
    }
    return r;
  }

private:
  /// A row of the derivative by the point in a camera's frame, to that in the frame of the pose.
  FT_HOST_DEVICE vec3<real> by_body(int camera, vec3<real> row) const {
    if constexpr (std::is_same_v<Rig, rectified_rig>) {
      static_cast<void>(camera);
      return row;
    } else {
      return row_times(row, rig.pair(camera).T_cb.template cast<real>().R);
    }
  }
  FT_HOST_DEVICE void set(window_error& r, projection_with_jacobian<real> const& p) const {
    r.e[0] = p.value.pixel.x - wide(o.x);
    r.e[1] = p.value.pixel.y - wide(o.y);
    r.J[0] = {p.jacobian.m[0], p.jacobian.m[1], p.jacobian.m[2]};
    r.J[1] = {p.jacobian.m[3], p.jacobian.m[4], p.jacobian.m[5]};
    r.seen = p.value.valid;
  }
};

/// Sums over the errors of a point in a view: the curvature A of the cost by the point's position
/// and half its gradient f, along the axes of the world.
struct window_normal {
  symmetric_3<window_real> A;
  vec3<window_real> f;
  window_real cost;
  bool linked;  ///< whether A and f have a term

  FT_HOST_DEVICE static window_normal zero() {
    window_real const z = window_real(0.0);
    return {{z, z, z, z, z, z}, {z, z, z}, z, false};
  }
  /// @param R of T_cw
  FT_HOST_DEVICE void add(window_error const& r, mat3<window_real> const& R,
                          window_params const& params) {
    if (!r.valid()) {
      cost += window_real(params.no_image);
      return;
    }
    window_real const chi2 = r.chi2();
    cost += robust_cost(chi2, params.huber2);
    window_real const w = r.weight * robust_weight(chi2, params.huber2);
    vec3<window_real> const rows[2] = {row_times(r.J[0], R), row_times(r.J[1], R)};
    if (!scalar::is_finite(dot(rows[0], rows[0]) + dot(rows[1], rows[1]))) { return; }
    FT_UNROLL
    for (int k = 0; k < 2; ++k) {
      vec3<window_real> const a = rows[k];
      vec3<window_real> const b = scaled(a, w);
      A.xx += b.x * a.x;
      A.xy += b.x * a.y;
      A.xz += b.x * a.z;
      A.yy += b.y * a.y;
      A.yz += b.y * a.z;
      A.zz += b.z * a.z;
      f = f + scaled(b, r.e[k]);
    }
    linked = true;
  }
};

// The links of a window: their costs, and their terms of the reduced system.
//
// For a link from view i to view j = i + 1 let R and C be their rotations and centres, M the
// measured rotation from frame i to frame j, q the measured vector from C_i to C_j along the axes
// of the world, and A = R_i^T M^T R_j, the identity if M is right. The errors are
//
//     e = axis of the skew part of A,   s = C_j - C_i - q.
//
// Where a view turns by w and its points move by u (see adjust_window.hpp), e changes by w_j - w_i
// and s by u_i - u_j + w_i x q, up to first order about e = 0.

struct link_error {
  using real = window_real;
  real turn_weight, shift_weight;
  vec3<real> turn;   ///< e
  vec3<real> shift;  ///< s
  vec3<real> lever;  ///< q

  FT_HOST_DEVICE static link_error of(window_link const& link, rigid<double> const& before,
                                      rigid<double> const& now) {
    auto const measured = [](double weight) { return weight > 0 ? weight : 0.0; };
    real const turn_weight = measured(link.rotation_weight);
    real const shift_weight = measured(link.translation_weight);
    if (!(turn_weight + shift_weight > real(0.0))) { return none(); }
    rigid<real> const M = link.motion.cast<real>();
    rigid<real> const T_i = before.cast<real>();
    rigid<real> const T_j = now.cast<real>();
    mat3<real> const R_wi = T_i.R.transposed();
    mat3<real> const A = R_wi * (M.R.transposed() * T_j.R);
    real const half = 0.5;
    vec3<real> const q = R_wi * M.centre();
    return {turn_weight,
            shift_weight,
            {half * (A.m[7] - A.m[5]), half * (A.m[2] - A.m[6]), half * (A.m[3] - A.m[1])},
            T_j.centre() - T_i.centre() - q,
            q};
  }
  FT_HOST_DEVICE static link_error none() {
    vec3<real> const zero{0.0, 0.0, 0.0};
    return {0.0, 0.0, zero, zero, zero};
  }
  FT_HOST_DEVICE real cost() const {
    return turn_weight * dot(turn, turn) + shift_weight * dot(shift, shift);
  }
};

/// Adds the links' terms of one view to a reduced system. Terms of different views are different
/// entries.
struct link_terms {
  using real = window_real;
  double* a;  ///< the system: lower triangle, and the right-hand side in its last row
  int side;
  real damping;

  /// @param v moving view that the link ends at @param linked whether the view before moves, too
  FT_HOST_DEVICE void add_end(int v, link_error const& e, bool linked) const {
    for (int k = 0; k < 3; ++k) {
      add_diagonal(6 * v + k, e.turn_weight);
      add_diagonal(6 * v + 3 + k, e.shift_weight);
      add_right(6 * v + k, -(e.turn_weight * component(e.turn, k)));
      add_right(6 * v + 3 + k, e.shift_weight * component(e.shift, k));
    }
    if (!linked) { return; }
    int const before = 6 * (v - 1);
    for (int k = 0; k < 3; ++k) {
      add(6 * v + k, before + k, -e.turn_weight);
      add(6 * v + 3 + k, before + 3 + k, -e.shift_weight);
    }
    add_cross(6 * v + 3, before, e.lever, e.shift_weight);
  }
  /// @param v moving view that the link begins at
  FT_HOST_DEVICE void add_begin(int v, link_error const& e) const {
    vec3<real> const q = e.lever;
    vec3<real> const turned = cross(q, e.shift);
    real const square = dot(q, q);
    for (int k = 0; k < 3; ++k) {
      real const own = component(q, k);
      add_diagonal(6 * v + k, e.turn_weight + e.shift_weight * (square - own * own));
      add_diagonal(6 * v + 3 + k, e.shift_weight);
      for (int c = 0; c < k; ++c) {
        add(6 * v + k, 6 * v + c, -(e.shift_weight * (own * component(q, c))));
      }
      add_right(6 * v + k,
                e.turn_weight * component(e.turn, k) - e.shift_weight * component(turned, k));
      add_right(6 * v + 3 + k, -(e.shift_weight * component(e.shift, k)));
    }
    add_cross(6 * v + 3, 6 * v, q, -e.shift_weight);
  }

  /// @param q of views v and u, which move, u <= v: an entry of a cost of centres
  FT_HOST_DEVICE void add_stiffness(int v, int u, real q) const {
    for (int k = 0; k < 3; ++k) {
      if (u == v) {
        add_diagonal(6 * v + 3 + k, q);
      } else {
        add(6 * v + 3 + k, 6 * u + 3 + k, q);
      }
    }
  }
  /// @param pull half the derivative of a cost by the centre of view v
  FT_HOST_DEVICE void add_pull(int v, vec3<real> const& pull) const {
    for (int k = 0; k < 3; ++k) { add_right(6 * v + 3 + k, component(pull, k)); }
  }

private:
  FT_HOST_DEVICE static real component(vec3<real> const& v, int k) {
    return k == 0 ? v.x : k == 1 ? v.y : v.z;
  }
  FT_HOST_DEVICE void add(int row, int column, real value) const {
    double& to = a[row * side + column];
    to = (real(to) + value).value;
  }
  FT_HOST_DEVICE void add_diagonal(int row, real value) const {
    add(row, row, value + value * damping);
  }
  FT_HOST_DEVICE void add_right(int row, real value) const { add(side - 1, row, value); }
  /// factor [q]x
  FT_HOST_DEVICE void add_cross(int row, int column, vec3<real> const& q, real factor) const {
    add(row, column + 1, -(factor * q.z));
    add(row, column + 2, factor * q.y);
    add(row + 1, column, factor * q.z);
    add(row + 1, column + 2, -(factor * q.x));
    add(row + 2, column, -(factor * q.y));
    add(row + 2, column + 1, factor * q.x);
  }
};

/// Cost of the link that ends at view v of problem b. 0 where there is none, or no view of it
/// moves.
FT_HOST_DEVICE inline double link_cost(window_problem_view const& problem, int b, int v,
                                       rigid<double> const* T_cw) {
  if (problem.link == nullptr || v < max_of(1, problem.fixed_count[b])) { return 0; }
  return link_error::of(problem.link[problem.view(b, v)], T_cw[v - 1], T_cw[v]).cost().value;
}

/// Adds the terms of all links of a problem. Every thread of the group calls it.
template <typename Group>
FT_HOST_DEVICE void add_links(Group g, window_problem_view const& problem, int b,
                              rigid<double> const* T_cw, link_terms const& to) {
  if (problem.link == nullptr) { return; }
  window_link const* const links = problem.link + problem.view(b, 0);
  int const views = problem.view_count[b];
  int const fixed = problem.fixed_count[b];
  for (int v = fixed + g.rank(); v < views; v += g.size()) {
    if (v > 0) { to.add_end(v - fixed, link_error::of(links[v], T_cw[v - 1], T_cw[v]), v > fixed); }
    if (v + 1 < views) {
      to.add_begin(v - fixed, link_error::of(links[v + 1], T_cw[v], T_cw[v + 1]));
    }
  }
  g.sync();
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
