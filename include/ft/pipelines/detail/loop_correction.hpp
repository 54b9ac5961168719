// SPDX-License-Identifier: Apache-2.0
/// @file Corrects a path by its loops, in slices whose length is known before.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/graph/elimination_order.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/pose_graph.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Information of an edge to a pose, from that of the pose: from a twist on the left of its
/// inverse, rotation first, to the error of a pose_graph_edge. Sums of floats are positive
/// semidefinite up to their rounding only: the diagonal grows by more than that.
/// @param scale of the information
inline void edge_information(float const (&of_pose)[21], double scale, double (&to)[21]) {
  double full[6][6];
  bool known = true;
  for (int i = 0, at = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) { full[i][j] = full[j][i] = static_cast<double>(of_pose[at++]); }
  }
  for (float const v : of_pose) { known = known && std::isfinite(v); }
  for (int i = 0, at = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      double const half = (i < 3 ? 1.0 : 2.0) * (j < 3 ? 1.0 : 2.0);  // sines of half angles
      double const entry = known ? full[(i + 3) % 6][(j + 3) % 6] : 0.0;
      to[at++] = scale * half * entry * (i == j ? 1 + 1e-5 : 1.0);
    }
  }
  // So that an edge of a frame about which nothing is known still holds its two poses together.
  for (int i = 0, at = 0; i < 6; at += 6 - i, ++i) { to[at] += 100; }
}

/// Poses and edges of a path. Its first keyframe is fixed. @tparam Motion rigid<double>, or
/// similarity<double> of a path whose scale drifts
template <typename Motion>
struct path_graph {
  /// Information of the logarithm of the scale, from a keyframe to the next: it drifts by 1 %.
  static constexpr double kept_scale = 1e4;

  static void give(similarity<double> const& from, similarity<double>& to) { to = from; }
  static void give(similarity<double> const& from, rigid<double>& to) { to = without_scale(from); }
  static void give(rigid<double> const& from, similarity<double>& to) { to = with_scale(from); }

  static motion_graph<Motion> of(loop_path const& path) {
    motion_graph<Motion> graph;
    for (path_keyframe const& k : path.keyframes) {
      graph.T_world_pose.emplace_back();
      give(k.T_world_camera.orthonormalized(), graph.T_world_pose.back());
      graph.fixed.push_back(graph.fixed.empty() ? 1 : 0);
    }
    for (int i = 1; i < path.size(); ++i) {
      path_keyframe const& from = path.at(i - 1);
      path_keyframe const& to = path.at(i);
      if (to.map != from.map) { continue; }
      path_loop step;
      step.from = i - 1;
      step.to = i;
      step.T_from_to = with_scale(from.T_odom_camera.inverse() * to.T_odom_camera);
      std::copy(to.information, to.information + 21, step.information);
      step.scale_information = kept_scale;
      graph.edges.push_back(edge(step, 1.0 / to.steps));
    }
    for (path_loop const& l : path.loops) {
      graph.edges.push_back(edge(l, 1));
      graph.edges.back().kernel = robust_kernel::huber;
      graph.edges.back().width = path.scaled ? 3.75 : 3.5;  // 95 % of 7 and 6 degrees of freedom
    }
    return graph;
  }

private:
  /// @param weight of its information
  static motion_edge<Motion> edge(path_loop const& l, double weight) {
    constexpr int freedom = freedom_of<Motion>;
    motion_edge<Motion> e;
    e.from = l.from;
    e.to = l.to;
    give(l.T_from_to.orthonormalized(), e.T_from_to);
    for (int i = 0, from = 0, at = 0; i < freedom; ++i) {
      for (int j = i; j < freedom; ++j, ++at) {
        e.information[at] =
            weight * (j < 6 ? l.information[from++] : (i < 6 ? 0 : l.scale_information));
      }
    }
    return e;
  }
};

/// About how long one core takes for a step of an optimisation: from counts alone, so that it is
/// the same on every machine. The factors are those of a core of 2026 (bench/lab_notes.md).
/// @return nanoseconds
template <typename Motion>
std::int64_t nanoseconds_of_step(motion_graph<Motion> const& graph,
                                 elimination_order const& order) {
  constexpr int freedom = freedom_of<Motion>;
  std::int64_t products = 0;  // of blocks, where the matrix is sparse
  for (std::size_t c = 1; c < order.column_begin.size(); ++c) {
    std::int64_t const blocks = order.column_begin[c] - order.column_begin[c - 1];
    products += blocks * (blocks + 1) / 2;
  }
  std::int64_t const tiles = ceil_div(freedom * order.dense, tile_side<freedom>);
  std::int64_t const factored = tiles * (tiles + 1) / 2;
  std::int64_t const updated = (tiles - 1) * tiles * (tiles + 1) / 6;
  std::int64_t const sparse = 1500 * static_cast<std::int64_t>(graph.edges.size()) +
                              90 * static_cast<std::int64_t>(order.sparse_blocks()) +
                              110 * products;
  return sparse * (freedom * freedom * freedom) / 216 + 28000 * factored + 25000 * updated;
}

/// A part of an optimisation.
struct correction_slice {
  int steps = 0;   ///< at most
  int frames = 0;  ///< that it takes
};

/// The next slice of an optimisation. A frame is 5 ms, in which tracking may leave half a core;
/// what takes less than one is 0 frames. Allocates.
template <typename Motion>
correction_slice slice_of(motion_graph<Motion> const& graph) {
  constexpr int steps = 3;     // the first two gain most of what there is
  constexpr int prepared = 1;  // steps that memory and the order of elimination take
  constexpr std::int64_t of_frame = 5'000'000 / 2;
  std::int64_t const step = nanoseconds_of_step(graph, elimination_order(graph));
  std::int64_t const frames = (prepared + steps) * step / of_frame;
  return {steps, static_cast<int>(std::min<std::int64_t>(frames, 1 << 20))};
}
inline correction_slice slice_of(loop_path const& path) {
  return path.scaled ? slice_of(path_graph<similarity<double>>::of(path))
                     : slice_of(path_graph<rigid<double>>::of(path));
}

/// Where an optimisation begins.
inline constexpr double first_path_damping = 1e-9;

template <typename Motion, typename Exec>
void optimize_as(Exec const& exec, loop_path& path, int steps) {
  auto graph = path_graph<Motion>::of(path);
  pose_graph_params params;
  params.steps = steps;
  // To 1e-9 it took up to three times as many steps, for a cost that was lower by 3e-5 of itself.
  params.enough = 1e-5;
  params.gravity = path.gravity;
  params.first_damping = path.damping > 0 ? path.damping : first_path_damping;
  auto const report = optimize_pose_graph(exec, graph, params);
  for (int i = 0; i < path.size(); ++i) {
    path_graph<Motion>::give(graph.T_world_pose[static_cast<std::size_t>(i)],
                             path.keyframes[static_cast<std::size_t>(i)].T_world_camera);
  }
  // With more damping than that no step lowers the cost.
  bool const ended = report.converged || report.next_damping > 1e9;
  path.damping = ended ? 0 : report.next_damping;
}
/// Moves the keyframes' poses in the world to where motions and loops agree best: with known
/// gravity their headings and positions. Goes on from path.damping, and writes it. Allocates.
/// @param steps at most
template <typename Exec>
void optimize(Exec const& exec, loop_path& path, int steps = 100) {
  if (path.scaled) {
    optimize_as<similarity<double>>(exec, path, steps);
  } else {
    optimize_as<rigid<double>>(exec, path, steps);
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
