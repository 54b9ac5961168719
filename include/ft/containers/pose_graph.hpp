// SPDX-License-Identifier: Apache-2.0
/// @file Pose graphs: poses, and measured motions between them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
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

namespace detail {

/// Degrees of freedom of a motion: of a rigid one, or of a similarity.
template <typename Motion>
inline constexpr int freedom_of = 6;
template <>
inline constexpr int freedom_of<similarity<double>> = 7;

}  // namespace detail

/// A measured motion between two poses: rigid<double>, or similarity<double> where the poses have
/// scales. Its error e is that of D = Z^-1 T_from^-1 T_to, with Z the measurement and T the poses:
/// its translation and the vector part of its quaternion (scalar part not negative), six numbers,
/// as EdgeSE3 of g2o; of similarities then the natural logarithm of its scale.
template <typename Motion>
struct motion_edge {
  int from = 0;                           ///< index of a pose
  int to = 0;                             ///< index of another pose
  Motion T_from_to = Motion::identity();  ///< measurement; metres, or units of the pose `from`
  /// W: upper triangle by rows of a symmetric matrix without negative eigenvalues; at first the
  /// identity. Translation first: 1 / m^2 (where there are scales in units of the pose `to`); then
  /// 1 / (sine of half the angle)^2; of similarities then 1 / (logarithm of the scale)^2.
  double information[detail::freedom_of<Motion> * (detail::freedom_of<Motion> + 1) / 2] = {};
  robust_kernel kernel = robust_kernel::none;
  double width = 1;  ///< of the kernel, above 0: errors are weighted, so it has no unit

  constexpr motion_edge() {
    for (int row = detail::freedom_of<Motion>, at = 0; row > 0; at += row--) {
      information[at] = 1;
    }
  }
};
using pose_graph_edge = motion_edge<rigid<double>>;
using similarity_edge = motion_edge<similarity<double>>;
static_assert(std::is_trivially_copyable<pose_graph_edge>::value, "copied to executors");
static_assert(std::is_trivially_copyable<similarity_edge>::value, "copied to executors");

/// A graph of poses in host memory.
template <typename Motion>
struct motion_graph {
  /// Metres. A similarity has units of its own, each `scale` metres long, as maps of one camera
  /// whose scale drifts.
  std::vector<Motion> T_world_pose;
  std::vector<motion_edge<Motion>> edges;
  /// For each pose whether it stays where it is; empty: none does. In a part of the graph without
  /// such a pose the one of lowest index stays.
  std::vector<unsigned char> fixed;
  std::vector<std::int64_t> ids;  ///< of the poses in their file; empty: their indices
};
using pose_graph = motion_graph<rigid<double>>;             ///< six degrees of freedom
using similarity_graph = motion_graph<similarity<double>>;  ///< seven: each pose has a scale

namespace detail {

/// Whether a symmetric N x N matrix has no negative eigenvalue, up to rounding of its text: LDL^T
/// with a billionth more on the diagonal. Where that has a 0 the whole row must have.
template <int N>
bool is_semidefinite(double const (&upper)[N * (N + 1) / 2]) {
  double a[N][N];
  for (int i = 0, at = 0; i < N; ++i) {
    for (int j = i; j < N; ++j) { a[i][j] = a[j][i] = upper[at++]; }
  }
  for (int i = 0; i < N; ++i) {
    if (a[i][i] < 0) { return false; }
    if (a[i][i] > 0) {
      a[i][i] *= 1 + 1e-9;
      continue;
    }
    for (int j = 0; j < N; ++j) {
      if (a[i][j] != 0) { return false; }
    }
    a[i][i] = 1;
  }
  for (int k = 0; k < N; ++k) {
    if (!(a[k][k] > 0)) { return false; }
    for (int i = k + 1; i < N; ++i) {
      double const factor = a[k][i] / a[k][k];
      for (int j = i; j < N; ++j) { a[i][j] -= factor * a[k][j]; }
    }
  }
  return true;
}

inline void check_motion(rigid<double> const& T) {
  require_rotation(T.R);
  for (double const v : {T.t.x, T.t.y, T.t.z}) { require_finite("translation", v); }
}
inline void check_motion(similarity<double> const& T) {
  check_motion(rigid<double>{T.R, T.t});
  require(T.scale >= 1e-50 && T.scale <= 1e50, "a scale must be in [1e-50, 1e50]");
}

template <typename Motion>
void check_edge(motion_edge<Motion> const& e, int poses) {
  require_range("pose at the start of an edge", e.from, 0, poses - 1);
  require_range("pose at the end of an edge", e.to, 0, poses - 1);
  require(e.from != e.to, "an edge joins a pose with itself");
  check_motion(e.T_from_to);
  for (double const v : e.information) { require_finite("information", v); }
  require(is_semidefinite<freedom_of<Motion>>(e.information),
          "the information matrix has a negative eigenvalue");
  require(e.kernel == robust_kernel::none || e.kernel == robust_kernel::huber ||
              e.kernel == robust_kernel::cauchy,
          "the edge has an unknown robust kernel");
  require(e.kernel == robust_kernel::none || (e.width >= 1e-50 && e.width <= 1e50),
          "the width of a robust kernel must be in [1e-50, 1e50]");
}

}  // namespace detail

/// @throws bad_argument for a graph that cannot be optimised; the message names the pose or the
///   edge
template <typename Motion>
void check(motion_graph<Motion> const& graph) {
  // The unknowns of all poses, and four terms of each edge, are counted in 32 bits.
  constexpr std::size_t most = 1 << 24;
  std::size_t const poses = graph.T_world_pose.size();
  detail::require_range("poses of a graph", poses, std::size_t{0}, most);
  detail::require_range("edges of a graph", graph.edges.size(), std::size_t{0}, most);
  detail::require(graph.fixed.empty() || graph.fixed.size() == poses,
                  "`fixed` of a pose graph has as many entries as there are poses, or none");
  detail::require(graph.ids.empty() || graph.ids.size() == poses,
                  "`ids` of a pose graph has as many entries as there are poses, or none");
  auto const named = [](char const* what, std::size_t at, auto const& check_one) {
    try {
      check_one();
    } catch (bad_argument const& e) {
      throw bad_argument(std::string(e.what()) + " (" + what + " " + std::to_string(at) + ")");
    }
  };
  for (std::size_t i = 0; i < poses; ++i) {
    named("pose", i, [&] { detail::check_motion(graph.T_world_pose[i]); });
  }
  for (std::size_t i = 0; i < graph.edges.size(); ++i) {
    named("edge", i, [&] { detail::check_edge(graph.edges[i], static_cast<int>(poses)); });
  }
}

}  // namespace FT_ABI
}  // namespace ft
