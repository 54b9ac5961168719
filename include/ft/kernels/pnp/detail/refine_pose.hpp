// SPDX-License-Identifier: Apache-2.0
/// @file Improves a pose so that directions to points agree with rays: the second part of MLPnP,
/// and MLPnP itself.
///
/// Source: Urban, Leitloff and Hinz, "MLPnP: a real-time maximum likelihood solution to the
/// perspective-n-point problem", ISPRS Annals 2016, without covariances.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/core/group.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/pnp/detail/linear_pose.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/math/positive_definite.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

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

// Hypotheses of poses, many at once: samples, their poses, and how many correspondences
// agree with each.

template <typename Camera>
FT_HOST_DEVICE projection<typename Camera::scalar_type> project_any_side(
    Camera const& camera, vec3<typename Camera::scalar_type> p) {
  return camera.project(p);
}
/// As in the reference also behind the camera, where a point has the pixel of its mirror image.
template <typename Scalar>
FT_HOST_DEVICE projection<Scalar> project_any_side(pinhole<Scalar> const& camera, vec3<Scalar> p) {
  return {{camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy}, true};
}

/// Whether a pose moves a point to where its pixel is: in double to the camera, from there in
/// float.
/// @param camera of strict_float
template <typename Camera>
FT_HOST_DEVICE bool is_inlier(Camera const& camera, rigid<real64> const& T, pnp_problem const& from,
                              int i) {
  strict_vec3d const seen = T * from.point[i].template cast<double>().template cast<real64>();
  auto const at =
      project_any_side(camera, seen.template cast<float>().template cast<strict_float>());
  strict_float const x = at.pixel.x - strict_float(from.pixel[i].x);
  strict_float const y = at.pixel.y - strict_float(from.pixel[i].y);
  return at.valid && x * x + y * y < strict_float(from.max_error2[i]);
}

template <typename Group, typename Camera>
FT_HOST_DEVICE int count_inliers(Group g, Camera const& camera, rigid<real64> const& T,
                                 pnp_problem const& from) {
  int count = 0;
  FT_NO_UNROLL
  for (int i = g.rank(); i < from.count; i += g.size()) {
    count += static_cast<int>(is_inlier(camera, T, from, i));
  }
  return g.reduce(count, sum_op{});
}

/// First number behind the hypotheses that the next call may need.
FT_HOST_DEVICE inline int needed_hypotheses(pnp_state const& state, pnp_limits const& limits,
                                            pnp_params const& params) {
  return max_of(limits.iterations, state.done + params.iterations_of_call);
}

/// Item: a hypothesis that the next call of a problem may need, and that is not known yet.
template <typename Camera>
struct evaluate_hypothesis {
  struct scratch {
    mlpnp_scratch solver;
    int sample[pnp_sample];
  };
  Camera camera;  ///< of strict_float
  pnp_params params;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, pnp_problems_view const& problems,
                                 pnp_workspace const& work) const {
    int const b = item / work.hypotheses;
    if (!problems.is_active(b)) { return; }
    pnp_problem const from = problems.of(b);
    pnp_limits const limits = pnp_limits_of(from.count, params);
    pnp_state const& state = work.state[b];
    int const h = state.evaluated + (item - b * work.hypotheses);
    if (from.count < limits.inliers || h >= needed_hypotheses(state, limits, params)) { return; }
    if (g.rank() == 0) {
      counter_draws const draws{problems.seed[b]};
      draws.distinct(from.count, static_cast<std::uint64_t>(h), s.sample);
    }
    g.sync();
    pnp_pose const found = mlpnp(g, s.solver, {from.ray, from.point, s.sample, pnp_sample});
    int count = 0;
    if (found.valid) { count = count_inliers(g, camera, found.T_cw.template cast<real64>(), from); }
    if (g.rank() == 0) {
      std::ptrdiff_t const slot = work.slot(b, h);
      work.T_cw[slot] = found.T_cw;
      work.inliers[slot] = count;
    }
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
