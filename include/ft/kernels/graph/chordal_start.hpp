// SPDX-License-Identifier: Apache-2.0
/// @file Terms of the linear systems that give a pose graph its start: rotations as any matrices by
/// least squares, projected to rotations, then translations. Source: Carlone and others,
/// "Initialization techniques for 3D SLAM: a survey on rotation estimation and its use in pose
/// graph optimization", ICRA 2015 (chordal relaxation).
#pragma once

#include <cstddef>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/config.hpp"
#include "ft/core/stage.hpp"
#include "ft/kernels/graph/edges.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/math/jacobi.hpp"
#include "ft/math/small_matrices.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// One item: an edge. Unknowns of a pose: two rows of its rotation, r_to = r_from Z. Poses that are
/// not fixed have rotations of zeros.
struct chordal_rotation {
  using scratch = no_scratch;
  int rows[2];

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, pose_graph_edge const* edges,
                                 rigid<double> const* T, double* terms) const {
    pose_graph_edge const& edge = edges[item];
    auto const Z = edge.T_from_to.R.cast<real64>();
    real64 const weight =
        (information_at(edge, 3, 3) + information_at(edge, 4, 4) + information_at(edge, 5, 5)) *
        real64(1.0 / 3);
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms;
    for (int k = g.rank(); k < 36; k += g.size()) {
      double const one = k % 7 == 0 ? weight.value : 0.0;
      out[k] = out[36 + k] = one;
      bool const joined = k / 18 == k % 6 / 3;
      out[72 + k] = joined ? (-(weight * Z.m[k / 6 % 3 * 3 + k % 3])).value : 0.0;
    }
    for (int k = g.rank(); k < 2; k += g.size()) {
      auto const from = row_of(T[edge.from].R.cast<real64>(), rows[k]);
      auto const to = row_of(T[edge.to].R.cast<real64>(), rows[k]);
      strict_vec3d const e = scaled(to - Z.transposed() * from, weight);
      strict_vec3d const back = -(Z * e);
      put(out + 108 + 3 * k, back);
      put(out + 114 + 3 * k, e);
    }
  }

private:
  FT_HOST_DEVICE static void put(double* to, strict_vec3d v) {
    to[0] = v.x.value;
    to[1] = v.y.value;
    to[2] = v.z.value;
  }
};

/// One item: an edge. Unknowns of a pose: the step of its position in the world, then three that
/// stay 0.
struct chordal_translation {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, pose_graph_edge const* edges,
                                 rigid<double> const* T, double* terms) const {
    pose_graph_edge const& edge = edges[item];
    edge_error const at(edge, T[edge.from], T[edge.to]);
    strict_mat3d const J = at.Zt * T[edge.from].R.cast<real64>().transposed();
    strict_mat3d W;
    for (int k = 0; k < 9; ++k) { W.m[k] = information_at(edge, k / 3, k % 3); }
    strict_mat3d const H = J.transposed() * (W * J);
    strict_vec3d const b = J.transposed() * (W * strict_vec3d{at.e[0], at.e[1], at.e[2]});
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms;
    for (int k = g.rank(); k < 36; k += g.size()) {
      bool const moved = k < 18 && k % 6 < 3;
      real64 const h = H.m[k / 6 % 3 * 3 + k % 3];
      out[k] = out[36 + k] = moved ? h.value : (k % 7 == 0 ? 1.0 : 0.0);
      out[72 + k] = moved ? (-h).value : 0.0;
    }
    for (int k = g.rank(); k < 12; k += g.size()) {
      real64 const v = k % 3 == 0 ? b.x : k % 3 == 1 ? b.y : b.z;
      out[108 + k] = k % 6 >= 3 ? 0.0 : (k < 6 ? (-v).value : v.value);
    }
  }
};

/// One item: a position. Rotation of zeros.
struct clear_rotation {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view const& A,
                                 rigid<double>* T) const {
    for (double& v : T[A.plan.pose[item]].R.m) { v = 0; }
  }
};

/// One item: a position. Takes `count` rows of its rotation from the solution.
struct take_rows {
  using scratch = no_scratch;
  int rows[2];
  int count;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view const& A,
                                 rigid<double>* T) const {
    double* const R = T[A.plan.pose[item]].R.m;
    for (int k = 0; k < 3 * count; ++k) { R[3 * rows[k / 3] + k % 3] = A.solution[6 * item + k]; }
  }
};

/// One item: a position. The rotation next to its matrix.
struct project_rotation {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view const& A,
                                 rigid<double>* T) const {
    rigid<double>& own = T[A.plan.pose[item]];
    rigid<real64> const turned{orthogonal_factor(own.R.cast<real64>()), own.t.cast<real64>()};
    own = turned.orthonormalized().template cast<double>();
  }
};

/// One item: a position. Moves by the solution, along the axes of the world.
struct shift_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view const& A,
                                 rigid<double>* T) const {
    double const* const x = A.solution + 6 * item;
    vec3<double>& t = T[A.plan.pose[item]].t;
    t = t + vec3<double>{x[0], x[1], x[2]};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
