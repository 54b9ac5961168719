// SPDX-License-Identifier: Apache-2.0
/// @file Pose graphs: poses, and measured motions between them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// What an edge of error s = e^T W e costs, so that a false one pulls less.
enum class robust_kernel : int {
  none,    ///< s
  huber,   ///< s up to width^2, then 2 width sqrt(s) - width^2
  cauchy,  ///< width^2 log(1 + s / width^2)
};

/// A measured motion between two poses. Its error e has six numbers, the translation and the vector
/// part of the quaternion (scalar part not negative) of Z^-1 T_from^-1 T_to, with Z the measurement
/// and T the poses, as EdgeSE3 of g2o.
struct pose_graph_edge {
  int from = 0;                                         ///< index of a pose
  int to = 0;                                           ///< index of another pose
  rigid<double> T_from_to = rigid<double>::identity();  ///< measurement; metres
  /// W: upper triangle by rows of a symmetric matrix without negative eigenvalues. Translation
  /// first: 1 / m^2; then 1 / (sine of half the angle)^2.
  double information[21] = {1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 1};
  robust_kernel kernel = robust_kernel::none;
  double width = 1;  ///< of the kernel, above 0: errors are weighted, so it has no unit
};
static_assert(std::is_trivially_copyable<pose_graph_edge>::value, "copied to executors");

/// A pose graph in host memory.
struct pose_graph {
  std::vector<rigid<double>> T_world_pose;  ///< metres
  std::vector<pose_graph_edge> edges;
  /// For each pose whether it stays where it is; empty: none does. In a part of the graph without
  /// such a pose the one of lowest index stays.
  std::vector<unsigned char> fixed;
  std::vector<std::int64_t> ids;  ///< of the poses in their file; empty: their indices
};

namespace detail {

/// Whether a symmetric 6 x 6 matrix has no negative eigenvalue, up to rounding of its text: LDL^T
/// with a billionth more on the diagonal. Where that has a 0 the whole row must have.
inline bool is_semidefinite_6(double const (&upper)[21]) {
  double a[6][6];
  for (int i = 0, at = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { a[i][j] = a[j][i] = upper[at++]; }
  }
  for (int i = 0; i < 6; ++i) {
    if (a[i][i] < 0) { return false; }
    if (a[i][i] > 0) {
      a[i][i] *= 1 + 1e-9;
      continue;
    }
    for (int j = 0; j < 6; ++j) {
      if (a[i][j] != 0) { return false; }
    }
    a[i][i] = 1;
  }
  for (int k = 0; k < 6; ++k) {
    if (!(a[k][k] > 0)) { return false; }
    for (int i = k + 1; i < 6; ++i) {
      double const factor = a[k][i] / a[k][k];
      for (int j = i; j < 6; ++j) { a[i][j] -= factor * a[k][j]; }
    }
  }
  return true;
}

inline void check_edge(pose_graph_edge const& e, int poses) {
  require_range("pose at the start of an edge", e.from, 0, poses - 1);
  require_range("pose at the end of an edge", e.to, 0, poses - 1);
  require(e.from != e.to, "an edge joins a pose with itself");
  require_rotation(e.T_from_to.R);
  for (double const v : {e.T_from_to.t.x, e.T_from_to.t.y, e.T_from_to.t.z}) {
    require_finite("translation", v);
  }
  for (double const v : e.information) { require_finite("information", v); }
  require(is_semidefinite_6(e.information), "the information matrix has a negative eigenvalue");
  require(e.kernel == robust_kernel::none || e.kernel == robust_kernel::huber ||
              e.kernel == robust_kernel::cauchy,
          "the edge has an unknown robust kernel");
  require(e.kernel == robust_kernel::none || (e.width >= 1e-50 && e.width <= 1e50),
          "the width of a robust kernel must be in [1e-50, 1e50]");
}

}  // namespace detail

/// @throws bad_argument for a graph that cannot be optimised; the message names the pose or the
///   edge
inline void check(pose_graph const& graph) {
  // An edge is a term of 120 numbers, a pose 6 unknowns; both are counted in 32 bits.
  constexpr std::size_t most = 1 << 24;
  std::size_t const poses = graph.T_world_pose.size();
  detail::require_range("poses of a graph", poses, std::size_t{0}, most);
  detail::require_range("edges of a graph", graph.edges.size(), std::size_t{0}, most);
  detail::require(graph.fixed.empty() || graph.fixed.size() == poses,
                  "`fixed` of a pose graph has as many entries as there are poses, or none");
  detail::require(graph.ids.empty() || graph.ids.size() == poses,
                  "`ids` of a pose graph has as many entries as there are poses, or none");
  for (std::size_t i = 0; i < poses; ++i) {
    detail::check_named("pose", i, [&] {
      auto const& T = graph.T_world_pose[i];
      detail::require_rotation(T.R);
      for (double const v : {T.t.x, T.t.y, T.t.z}) { detail::require_finite("translation", v); }
    });
  }
  for (std::size_t i = 0; i < graph.edges.size(); ++i) {
    detail::check_named("edge", i,
                        [&] { detail::check_edge(graph.edges[i], static_cast<int>(poses)); });
  }
}

}  // namespace FT_ABI
}  // namespace ft
