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
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Error of an edge and what its derivatives need.
struct edge_error {
  real64 e[6];           ///< translation, then vector part of the quaternion
  strict_mat3d Zt;       ///< inverse rotation of the measurement
  strict_mat3d D;        ///< rotation that is left
  strict_vec3d apart;    ///< second pose seen from the first one
  quaternion<real64> q;  ///< of D, scalar part not negative

  FT_HOST_DEVICE edge_error(pose_graph_edge const& edge, rigid<double> const& T_i,
                            rigid<double> const& T_j) {
    auto const Z = edge.T_from_to.cast<real64>();
    auto const Ti = T_i.cast<real64>();
    auto const Tj = T_j.cast<real64>();
    Zt = Z.R.transposed();
    strict_mat3d const Rit = Ti.R.transposed();
    apart = Rit * (Tj.t - Ti.t);
    D = Zt * (Rit * Tj.R);
    q = quaternion_of(D);
    strict_vec3d const t = Zt * (apart - Z.t);
    e[0] = t.x;
    e[1] = t.y;
    e[2] = t.z;
    e[3] = q.x;
    e[4] = q.y;
    e[5] = q.z;
  }
};

/// Entry (r, c) of an edge's information matrix.
FT_HOST_DEVICE inline real64 information_at(pose_graph_edge const& edge, int r, int c) {
  int const low = min_of(r, c);
  return edge.information[low * (11 - low) / 2 + max_of(r, c)];
}

/// e^T W e.
FT_HOST_DEVICE inline real64 squared_error(pose_graph_edge const& edge, real64 const (&e)[6]) {
  real64 sum = 0.0;
  int at = 0;
  FT_UNROLL
  for (int i = 0; i < 6; ++i) {
    real64 row = real64(0.5) * (real64(edge.information[at++]) * e[i]);
    FT_UNROLL
    for (int j = i + 1; j < 6; ++j) { row += real64(edge.information[at++]) * e[j]; }
    sum += e[i] * row;
  }
  return sum + sum;
}

/// What a squared error costs, and the derivative of that: the weight of the edge.
struct edge_cost {
  real64 cost, weight;

  FT_HOST_DEVICE edge_cost(pose_graph_edge const& edge, real64 s) : cost(s), weight(1.0) {
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

/// Derivatives of an edge's error for steps (u, w) of its poses, T -> T (Exp(w), u): 6 x 6, by
/// rows.
FT_HOST_DEVICE inline void edge_jacobians(edge_error const& at, real64 (&J)[2][36]) {
  for (int k = 0; k < 36; ++k) { J[0][k] = J[1][k] = 0.0; }
  strict_mat3d const turned = at.Zt * cross_matrix(at.apart);
  real64 const w = at.q.w * real64(0.5);
  real64 const h = 0.5;
  strict_vec3d const v{at.q.x * h, at.q.y * h, at.q.z * h};
  // Vector part of q (0, w / 2), and of (0, w / 2) q, as matrices of w.
  strict_mat3d const after{{w, -v.z, v.y, v.z, w, -v.x, -v.y, v.x, w}};
  strict_mat3d const before = after.transposed() * at.Zt;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      J[0][6 * r + c] = -at.Zt.m[3 * r + c];
      J[0][6 * r + 3 + c] = turned.m[3 * r + c];
      J[0][6 * (r + 3) + 3 + c] = -before.m[3 * r + c];
      J[1][6 * r + c] = at.D.m[3 * r + c];
      J[1][6 * (r + 3) + 3 + c] = after.m[3 * r + c];
    }
  }
}

/// Where gravity is known poses turn about it alone: the last unknown of a pose is its heading, and
/// the two before are none.
struct heading_axis {
  bool known = false;
  vec3<double> gravity{0, 0, 0};  ///< its direction in the world, of length 1

  FT_HOST_DEVICE strict_vec3d seen_from(rigid<double> const& T) const {
    return T.R.template cast<real64>().transposed() * gravity.template cast<real64>();
  }
  /// Derivatives by turns become derivatives by the heading: 6 x 6, by rows.
  FT_HOST_DEVICE void restrict_turns(rigid<double> const& T, real64 (&J)[36]) const {
    strict_vec3d const axis = seen_from(T);
    for (int r = 0; r < 6; ++r) {
      real64* const turn = J + 6 * r + 3;
      turn[2] = turn[0] * axis.x + turn[1] * axis.y + turn[2] * axis.z;
      turn[0] = turn[1] = 0.0;
    }
  }
};

/// One item: an edge. What it adds to the normal equations of a step of all poses.
struct linearize_edge {
  heading_axis heading;
  struct scratch {
    real64 J[2][36];
    real64 weighted[2][36];  ///< W J
    real64 e[6];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, pose_graph_edge const* edges,
                                 rigid<double> const* T, double* terms) const {
    pose_graph_edge const& edge = edges[item];
    if (g.rank() == 0) {
      edge_error const at(edge, T[edge.from], T[edge.to]);
      real64 const weight = edge_cost(edge, squared_error(edge, at.e)).weight;
      edge_jacobians(at, s.J);
      if (heading.known) {
        heading.restrict_turns(T[edge.from], s.J[0]);
        heading.restrict_turns(T[edge.to], s.J[1]);
      }
      for (int k = 0; k < 6; ++k) { s.e[k] = weight * at.e[k]; }
      s.weighted[0][0] = weight;
    }
    g.sync();
    real64 const weight = s.weighted[0][0];
    g.sync();
    for (int k = g.rank(); k < 72; k += g.size()) {
      int const r = k % 36 / 6;
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < 6; ++m) {
        sum += information_at(edge, r, m) * s.J[k / 36][6 * m + k % 6];
      }
      s.weighted[k / 36][k % 36] = weight * sum;
    }
    // The gradient needs the weighted error against unweighted W J, so its weight is in e alone.
    g.sync();
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms;
    for (int k = g.rank(); k < 108; k += g.size()) {
      int const part = k / 36;
      real64 const* const left = s.J[part == 1 ? 1 : 0];
      real64 const* const right = s.weighted[part == 0 ? 0 : 1];
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < 6; ++m) { sum += left[6 * m + k % 36 / 6] * right[6 * m + k % 6]; }
      out[k] = sum.value;
    }
    for (int k = g.rank(); k < 12; k += g.size()) {
      real64 sum = 0.0;
      FT_UNROLL
      for (int m = 0; m < 6; ++m) {
        real64 row = 0.0;
        FT_UNROLL
        for (int n = 0; n < 6; ++n) { row += information_at(edge, m, n) * s.e[n]; }
        sum += s.J[k / 6][6 * m + k % 6] * row;
      }
      out[108 + k] = sum.value;
    }
  }
};

/// One item: an edge. Its robust cost, and without the kernel.
struct measure_edge {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, pose_graph_edge const* edges,
                                 rigid<double> const* T, double* cost) const {
    pose_graph_edge const& edge = edges[item];
    edge_error const at(edge, T[edge.from], T[edge.to]);
    real64 const s = squared_error(edge, at.e);
    cost[2 * item] = edge_cost(edge, s).cost.value;
    cost[2 * item + 1] = s.value;
  }
};

/// One item: a position. Moves its pose by the solution.
struct move_pose {
  using scratch = no_scratch;
  heading_axis heading;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view const& A,
                                 rigid<double> const* from, rigid<double>* to) const {
    double const* const x = A.solution + 6 * item;
    int const pose = A.plan.pose[item];
    bool stays = true;
    for (int k = 0; k < 6; ++k) { stays = stays && x[k] == 0; }
    if (stays) {  // to the bit
      to[pose] = from[pose];
      return;
    }
    rigid<real64> const T = from[pose].cast<real64>();
    strict_vec3d w{x[3], x[4], x[5]};
    if (heading.known) { w = scaled(heading.seen_from(from[pose]), w.z); }
    real64 const turn[6] = {w.x, w.y, w.z, 0.0, 0.0, 0.0};
    strict_vec3d const shift{x[0], x[1], x[2]};
    to[pose] = rigid<real64>{T.R * exp_se3(turn).R, T.t + T.R * shift}
                   .orthonormalized()
                   .template cast<double>();
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
