// SPDX-License-Identifier: Apache-2.0
/// @file Errors of a pose graph's edges, their derivatives and the terms of the normal equations.
#pragma once

#include <cstddef>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/math/quaternion.hpp"
#include "ft/math/se3.hpp"
#include "ft/math/sim3.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Error of an edge and what its derivatives need.
template <typename Motion>
struct edge_error {
  static constexpr int size = freedom_of<Motion>;
  real64 e[size];         ///< translation, vector part of the quaternion, logarithm of the scale
  strict_mat3d Zt;        ///< inverse rotation of the measurement
  strict_mat3d D;         ///< rotation that is left
  strict_vec3d apart;     ///< second pose seen from the first one
  quaternion<real64> q;   ///< of D, scalar part not negative
  real64 Z_shrinks{1.0};  ///< 1 / scale of the measurement
  real64 scale_left{1.0};

  FT_HOST_DEVICE edge_error(motion_edge<Motion> const& edge, Motion const& T_i, Motion const& T_j) {
    auto const Z = edge.T_from_to.template cast<real64>();
    auto const Ti = T_i.template cast<real64>();
    auto const Tj = T_j.template cast<real64>();
    Zt = Z.R.transposed();
    strict_mat3d const Rit = Ti.R.transposed();
    apart = Rit * (Tj.t - Ti.t);
    D = Zt * (Rit * Tj.R);
    q = quaternion_of(D);
    if constexpr (size == 7) {
      real64 const shrink = scalar::reciprocal(Ti.scale);
      apart = scaled(apart, shrink);
      Z_shrinks = scalar::reciprocal(Z.scale);
      scale_left = Z_shrinks * (shrink * Tj.scale);
      e[6] = strict_log(scale_left);
    }
    strict_vec3d t = Zt * (apart - Z.t);
    if constexpr (size == 7) { t = scaled(t, Z_shrinks); }
    e[0] = t.x;
    e[1] = t.y;
    e[2] = t.z;
    e[3] = q.x;
    e[4] = q.y;
    e[5] = q.z;
  }
};

/// Entry (r, c) of an edge's information matrix.
template <typename Motion>
FT_HOST_DEVICE real64 information_at(motion_edge<Motion> const& edge, int r, int c) {
  int const low = min_of(r, c);
  return edge.information[low * (2 * freedom_of<Motion> - 1 - low) / 2 + max_of(r, c)];
}

/// e^T W e.
template <typename Motion>
FT_HOST_DEVICE real64 squared_error(motion_edge<Motion> const& edge,
                                    real64 const (&e)[freedom_of<Motion>]) {
  constexpr int n = freedom_of<Motion>;
  real64 sum = 0.0;
  int at = 0;
  FT_UNROLL
  for (int i = 0; i < n; ++i) {
    real64 row = real64(0.5) * (real64(edge.information[at++]) * e[i]);
    FT_UNROLL
    for (int j = i + 1; j < n; ++j) { row += real64(edge.information[at++]) * e[j]; }
    sum += e[i] * row;
  }
  return sum + sum;
}

/// What a squared error costs, and the derivative of that: the weight of the edge.
struct edge_cost {
  real64 cost, weight;

  template <typename Motion>
  FT_HOST_DEVICE edge_cost(motion_edge<Motion> const& edge, real64 s) : cost(s), weight(1.0) {
    real64 const width = edge.width;
    if (edge.kernel == robust_kernel::huber && s > width * width) {
      real64 const root = scalar::sqrt(s);
      cost = real64(2.0) * (width * root) - width * width;
      weight = width / root;
    } else if (edge.kernel == robust_kernel::cauchy) {
      real64 const share = s / (width * width);
      cost = width * width * log_of(share);
      weight = scalar::reciprocal(real64(1.0) + share);
    }
  }

private:
  /// Logarithm of 1 + x, x at least 0, with equal bits on every executor: 2 artanh of a fraction,
  /// from what is left after halvings. Exact for a small x.
  FT_HOST_DEVICE static real64 log_of(real64 x) {
    real64 v = real64(1.0) + x;
    real64 halvings = 0.0;
    FT_NO_UNROLL
    while (v > real64(1.5) && scalar::is_finite(v)) {
      v = v * real64(0.5);
      halvings += real64(1.0);
    }
    real64 const t = (halvings > real64(0.0) ? v - real64(1.0) : x) / (v + real64(1.0));
    real64 const t2 = t * t;
    real64 sum = 0.0;
    FT_NO_UNROLL
    for (int k = 41; k > 0; k -= 2) { sum = real64(1.0 / static_cast<double>(k)) + t2 * sum; }
    return halvings * real64(0.6931471805599453) + real64(2.0) * t * sum;
  }
};

/// Derivatives of an edge's error for steps (u, w) of its poses, T -> T (Exp(w), u), of
/// similarities (u, w, x), T -> T (Exp(w), u, exp x): square, by rows.
template <typename Motion>
FT_HOST_DEVICE void edge_jacobians(edge_error<Motion> const& at,
                                   real64 (&J)[2][freedom_of<Motion> * freedom_of<Motion>]) {
  constexpr int n = freedom_of<Motion>;
  for (int k = 0; k < n * n; ++k) { J[0][k] = J[1][k] = 0.0; }
  strict_mat3d const turned = at.Zt * cross_matrix(at.apart);
  real64 const w = at.q.w * real64(0.5);
  real64 const h = 0.5;
  strict_vec3d const v{at.q.x * h, at.q.y * h, at.q.z * h};
  // Vector part of q (0, w / 2), and of (0, w / 2) q, as matrices of w.
  strict_mat3d const after{{w, -v.z, v.y, v.z, w, -v.x, -v.y, v.x, w}};
  strict_mat3d const before = after.transposed() * at.Zt;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      J[0][n * r + c] = -at.Zt.m[3 * r + c];
      J[0][n * r + 3 + c] = turned.m[3 * r + c];
      J[0][n * (r + 3) + 3 + c] = -before.m[3 * r + c];
      J[1][n * r + c] = at.D.m[3 * r + c];
      J[1][n * (r + 3) + 3 + c] = after.m[3 * r + c];
    }
  }
  if constexpr (n == 7) {
    strict_vec3d const stretched = -(at.Zt * at.apart);
    real64 const by_scale[3] = {stretched.x, stretched.y, stretched.z};
    for (int r = 0; r < 3; ++r) {
      J[0][n * r + 6] = by_scale[r];
      for (int c = 0; c < n; ++c) { J[0][n * r + c] *= at.Z_shrinks; }
      for (int c = 0; c < 3; ++c) { J[1][n * r + c] *= at.scale_left; }
    }
    J[0][48] = -1.0;
    J[1][48] = 1.0;
  }
}

/// Where gravity is known poses turn about it alone: the third turn of a pose is its heading, and
/// the two before are none.
struct heading_axis {
  bool known = false;
  vec3<double> gravity{0, 0, 0};  ///< its direction in the world, of length 1

  template <typename Motion>
  FT_HOST_DEVICE strict_vec3d seen_from(Motion const& T) const {
    return T.R.template cast<real64>().transposed() * gravity.template cast<real64>();
  }
  /// Derivatives by turns become derivatives by the heading: square, by rows.
  template <typename Motion>
  FT_HOST_DEVICE void restrict_turns(Motion const& T,
                                     real64 (&J)[freedom_of<Motion> * freedom_of<Motion>]) const {
    strict_vec3d const axis = seen_from(T);
    for (int r = 0; r < freedom_of<Motion>; ++r) {
      real64* const turn = J + freedom_of<Motion> * r + 3;
      turn[2] = turn[0] * axis.x + turn[1] * axis.y + turn[2] * axis.z;
      turn[0] = turn[1] = 0.0;
    }
  }
};

/// One item: an edge. What it adds to the normal equations of a step of all poses.
template <int N>
struct linearize_edge {
  heading_axis heading;
  struct scratch {
    real64 J[2][N * N];
    real64 weighted[2][N * N];  ///< W J
    real64 e[N];
  };

  template <typename Group, typename Motion>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, motion_edge<Motion> const* edges,
                                 Motion const* T, double* terms) const {
    static_assert(N == freedom_of<Motion>, "unknowns of a pose");
    motion_edge<Motion> const& edge = edges[item];
    if (g.rank() == 0) {
      edge_error<Motion> const at(edge, T[edge.from], T[edge.to]);
      real64 const weight = edge_cost(edge, squared_error(edge, at.e)).weight;
      edge_jacobians(at, s.J);
      if (heading.known) {
        heading.restrict_turns(T[edge.from], s.J[0]);
        heading.restrict_turns(T[edge.to], s.J[1]);
      }
      for (int k = 0; k < N; ++k) { s.e[k] = weight * at.e[k]; }
      s.weighted[0][0] = weight;
    }
    g.sync();
    real64 const weight = s.weighted[0][0];
    g.sync();
    for (int k = g.rank(); k < 2 * N * N; k += g.size()) {
      int const r = k % (N * N) / N;
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < N; ++m) {
        sum += information_at(edge, r, m) * s.J[k / (N * N)][N * m + k % (N * N) % N];
      }
      s.weighted[k / (N * N)][k % (N * N)] = weight * sum;
    }
    // The gradient needs the weighted error against unweighted W J, so its weight is in e alone.
    g.sync();
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms<N>;
    for (int k = g.rank(); k < 3 * N * N; k += g.size()) {
      int const part = k / (N * N);
      int const own = k % (N * N);
      real64 const* const left = s.J[part == 1 ? 1 : 0];
      real64 const* const right = s.weighted[part == 0 ? 0 : 1];
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < N; ++m) { sum += left[N * m + own / N] * right[N * m + own % N]; }
      out[k] = sum.value;
    }
    for (int k = g.rank(); k < 2 * N; k += g.size()) {
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < N; ++m) {
        real64 row = 0.0;
        FT_UNROLL
        for (int n = 0; n < N; ++n) { row += information_at(edge, m, n) * s.e[n]; }
        sum += s.J[k / N][N * m + k % N] * row;
      }
      out[3 * N * N + k] = sum.value;
    }
  }
};

/// One item: an edge. Its robust cost, and without the kernel.
struct measure_edge {
  using scratch = no_scratch;

  template <typename Group, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, motion_edge<Motion> const* edges,
                                 Motion const* T, double* cost) const {
    motion_edge<Motion> const& edge = edges[item];
    edge_error<Motion> const at(edge, T[edge.from], T[edge.to]);
    real64 const s = squared_error(edge, at.e);
    cost[2 * item] = edge_cost(edge, s).cost.value;
    cost[2 * item + 1] = s.value;
  }
};

/// One item: a position. Moves its pose by the solution.
struct move_pose {
  using scratch = no_scratch;
  heading_axis heading;

  template <typename Group, int N, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<N> const& A,
                                 Motion const* from, Motion* to) const {
    double const* const x = A.solution + N * item;
    int const pose = A.plan.pose[item];
    bool stays = true;
    for (int k = 0; k < N; ++k) { stays = stays && x[k] == 0; }
    if (stays) {  // to the bit
      to[pose] = from[pose];
      return;
    }
    auto T = from[pose].template cast<real64>();
    strict_vec3d w{x[3], x[4], x[5]};
    if (heading.known) { w = scaled(heading.seen_from(from[pose]), w.z); }
    real64 const turn[6] = {w.x, w.y, w.z, 0.0, 0.0, 0.0};
    strict_vec3d shift{x[0], x[1], x[2]};
    if constexpr (N == 7) {
      shift = scaled(shift, T.scale);
      T.scale = T.scale * strict_exp(x[6]);
    }
    T.t = T.t + T.R * shift;
    T.R = T.R * exp_se3(turn).R;
    to[pose] = T.orthonormalized().template cast<double>();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
