// SPDX-License-Identifier: Apache-2.0
/// @file Terms of the linear systems that give a pose graph its start: rotations as any matrices by
/// least squares, projected to rotations, then scales, then translations. Source: Carlone and
/// others, "Initialization techniques for 3D SLAM: a survey on rotation estimation and its use in
/// pose graph optimization", ICRA 2015 (chordal relaxation).
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

  template <typename Group, typename Motion>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, motion_edge<Motion> const* edges,
                                 Motion const* T, double* terms) const {
    constexpr int n = freedom_of<Motion>;
    motion_edge<Motion> const& edge = edges[item];
    auto const Z = edge.T_from_to.R.template cast<real64>();
    real64 const weight =
        (information_at(edge, 3, 3) + information_at(edge, 4, 4) + information_at(edge, 5, 5)) *
        real64(1.0 / 3);
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms<n>;
    for (int k = g.rank(); k < n * n; k += g.size()) {
      int const r = k / n;
      int const c = k % n;
      out[k] = out[n * n + k] = r == c && r < 6 ? weight.value : 0.0;
      bool const joined = r / 3 == c / 3 && r < 6;
      out[2 * n * n + k] = joined ? (-(weight * Z.m[r % 3 * 3 + c % 3])).value : 0.0;
    }
    double* const gradient = out + 3 * n * n;
    for (int k = g.rank(); k < 2; k += g.size()) {
      auto const from = row_of(T[edge.from].R.template cast<real64>(), rows[k]);
      auto const to = row_of(T[edge.to].R.template cast<real64>(), rows[k]);
      strict_vec3d const e = scaled(to - Z.transposed() * from, weight);
      strict_vec3d const back = -(Z * e);
      put(gradient + 3 * k, back);
      put(gradient + n + 3 * k, e);
      if (n == 7) { gradient[6 + 7 * k] = 0.0; }
    }
  }

private:
  FT_HOST_DEVICE static void put(double* to, strict_vec3d v) {
    to[0] = v.x.value;
    to[1] = v.y.value;
    to[2] = v.z.value;
  }
};

/// One item: an edge. Unknowns of a pose: six that stay 0, then the step of the logarithm of its
/// scale.
struct chordal_scale {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, similarity_edge const* edges,
                                 similarity<double> const* T, double* terms) const {
    similarity_edge const& edge = edges[item];
    edge_error<similarity<double>> const at(edge, T[edge.from], T[edge.to]);
    real64 const weight = information_at(edge, 6, 6);
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms<7>;
    for (int k = g.rank(); k < 49; k += g.size()) {
      out[k] = out[49 + k] = k == 48 ? weight.value : 0.0;
      out[98 + k] = k == 48 ? (-weight).value : 0.0;
    }
    for (int k = g.rank(); k < 14; k += g.size()) {
      real64 const pull = weight * at.e[6];
      out[147 + k] = k == 6 ? (-pull).value : k == 13 ? pull.value : 0.0;
    }
  }
};

/// One item: an edge. Unknowns of a pose: the step of its position in the world, then others that
/// stay 0.
struct chordal_translation {
  using scratch = no_scratch;

  template <typename Group, typename Motion>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, motion_edge<Motion> const* edges,
                                 Motion const* T, double* terms) const {
    constexpr int n = freedom_of<Motion>;
    motion_edge<Motion> const& edge = edges[item];
    edge_error<Motion> const at(edge, T[edge.from], T[edge.to]);
    strict_mat3d J = at.Zt * T[edge.from].R.template cast<real64>().transposed();
    if constexpr (n == 7) { J = scaled(J, at.Z_shrinks / real64(T[edge.from].scale)); }
    strict_mat3d W;
    for (int k = 0; k < 9; ++k) { W.m[k] = information_at(edge, k / 3, k % 3); }
    strict_mat3d const H = J.transposed() * (W * J);
    strict_vec3d const b = J.transposed() * (W * strict_vec3d{at.e[0], at.e[1], at.e[2]});
    double* const out = terms + static_cast<std::ptrdiff_t>(item) * edge_terms<n>;
    for (int k = g.rank(); k < n * n; k += g.size()) {
      int const r = k / n;
      int const c = k % n;
      bool const moved = r < 3 && c < 3;
      real64 const h = H.m[r % 3 * 3 + c % 3];
      out[k] = out[n * n + k] = moved ? h.value : (r == c ? 1.0 : 0.0);
      out[2 * n * n + k] = moved ? (-h).value : 0.0;
    }
    for (int k = g.rank(); k < 2 * n; k += g.size()) {
      int const c = k % n;
      real64 const v = c == 0 ? b.x : c == 1 ? b.y : b.z;
      out[3 * n * n + k] = c >= 3 ? 0.0 : (k < n ? (-v).value : v.value);
    }
  }
};

/// One item: a position. Rotation of zeros.
struct clear_rotation {
  using scratch = no_scratch;

  template <typename Group, int N, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<N> const& A,
                                 Motion* T) const {
    for (double& v : T[A.plan.pose[item]].R.m) { v = 0; }
  }
};

/// One item: a position. Takes `count` rows of its rotation from the solution.
struct take_rows {
  using scratch = no_scratch;
  int rows[2];
  int count;

  template <typename Group, int N, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<N> const& A,
                                 Motion* T) const {
    double* const R = T[A.plan.pose[item]].R.m;
    for (int k = 0; k < 3 * count; ++k) { R[3 * rows[k / 3] + k % 3] = A.solution[N * item + k]; }
  }
};

/// One item: a position. The rotation next to its matrix.
struct project_rotation {
  using scratch = no_scratch;

  template <typename Group, int N, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<N> const& A,
                                 Motion* T) const {
    Motion& own = T[A.plan.pose[item]];
    auto turned = own.template cast<real64>();
    turned.R = orthogonal_factor(turned.R);
    own = turned.orthonormalized().template cast<double>();
  }
};

/// One item: a position. Multiplies its scale by what the solution says.
struct scale_pose {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<7> const& A,
                                 similarity<double>* T) const {
    double& scale = T[A.plan.pose[item]].scale;
    scale = (real64(scale) * strict_exp(A.solution[7 * item + 6])).value;
  }
};

/// One item: a position. Moves by the solution, along the axes of the world.
struct shift_pose {
  using scratch = no_scratch;

  template <typename Group, int N, typename Motion>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, graph_system_view<N> const& A,
                                 Motion* T) const {
    double const* const x = A.solution + N * item;
    vec3<double>& t = T[A.plan.pose[item]].t;
    t = t + vec3<double>{x[0], x[1], x[2]};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
