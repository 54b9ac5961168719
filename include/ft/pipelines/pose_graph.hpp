// SPDX-License-Identifier: Apache-2.0
/// @file Optimisation of pose graphs.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "ft/containers/pose_graph.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/graph/edges.hpp"
#include "ft/kernels/graph/elimination_order.hpp"
#include "ft/kernels/graph/system.hpp"
#include "ft/pipelines/detail/descent.hpp"
#include "ft/pipelines/detail/pose_graph_solver.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Where an optimisation of a pose graph begins.
enum class pose_graph_start {
  given,     ///< at the graph's poses
  odometry,  ///< measured motions chained: each pose from the one before where an edge joins them
  chordal,   ///< rotations by linear least squares and projection, then scales, then translations
};

struct pose_graph_params {
  pose_graph_start start = pose_graph_start::given;
  int steps = 100;              ///< most steps to try, 0 to 10000
  double enough = 1e-9;         ///< ends with a step that lowers the cost by a smaller share
  double first_damping = 1e-9;  ///< of the first step, relative to the diagonal, 0 to 1e9
  /// Direction of gravity in the world, of any length from 1e-9 on; 0: not known. Where an IMU told
  /// it, poses keep their angles against it: heading and position of each are found (four degrees
  /// of freedom), and its scale where it has one. The start must be the given one.
  vec3<double> gravity{0, 0, 0};
};

/// What became of a pose graph. Costs are sums of robust_kernel over the edges.
struct pose_graph_report {
  double given_cost = 0;  ///< of the poses that were given
  double first_cost = 0;  ///< of the start
  double last_cost = 0;   ///< of the result, at most first_cost
  double given_chi2 = 0;  ///< the same without robust kernels: sums of e^T W e
  double first_chi2 = 0;
  double last_chi2 = 0;
  int steps = 0;           ///< that were tried, refused ones included
  bool converged = false;  ///< false: there were not enough steps, or no step lowers the cost
  /// Of the step that would be next: first_damping of a call that goes on from here.
  double next_damping = 0;
  /// Whether the start was made as asked; false: its equations have no solution, and the poses that
  /// were given were taken.
  bool started = true;
  int dense_poses = 0;    ///< poses that were solved as a dense matrix
  long long blocks = 0;   ///< of the factor; 6 x 6 numbers each, 7 x 7 where poses have scales
  std::size_t bytes = 0;  ///< of executor memory
};

namespace detail {

inline heading_axis axis_of(pose_graph_params const& params) {
  vec3<double> const g = params.gravity;
  double const length = std::sqrt(dot(g, g));
  if (!(length >= 1e-9)) { return {}; }
  return {true, {g.x / length, g.y / length, g.z / length}};
}

/// Poses by chaining measured motions: each from one that is known, over the edge to the pose
/// before or after it where there is one, and over other edges only from where no such edge leads
/// on.
/// @param position of each pose in the system; -1: it stays
template <typename Motion>
std::vector<Motion> chained_poses(motion_graph<Motion> const& graph,
                                  std::vector<int> const& position) {
  std::size_t const poses = graph.T_world_pose.size();
  std::vector<Motion> T = graph.T_world_pose;
  std::vector<std::vector<int>> edges_of(poses);
  for (std::size_t e = 0; e < graph.edges.size(); ++e) {
    edges_of[static_cast<std::size_t>(graph.edges[e].from)].push_back(static_cast<int>(e));
    edges_of[static_cast<std::size_t>(graph.edges[e].to)].push_back(static_cast<int>(e));
  }
  std::vector<char> known(poses, 0);
  std::vector<int> chain;  // poses whose neighbours along the chain are looked at next
  std::vector<std::pair<int, int>> others;  // pose and edge; first in, first out
  std::size_t next_other = 0;
  auto const learn = [&](int pose) {
    known[static_cast<std::size_t>(pose)] = 1;
    chain.push_back(pose);
  };
  auto const follow = [&](int pose, int edge) {
    motion_edge<Motion> const& e = graph.edges[static_cast<std::size_t>(edge)];
    int const to = e.from == pose ? e.to : e.from;
    if (known[static_cast<std::size_t>(to)] != 0) { return; }
    auto const Z = e.T_from_to.template cast<strict_double>();
    auto const here = T[static_cast<std::size_t>(pose)].template cast<strict_double>();
    T[static_cast<std::size_t>(to)] =
        (here * (e.from == pose ? Z : Z.inverse())).orthonormalized().template cast<double>();
    learn(to);
  };
  for (std::size_t i = 0; i < poses; ++i) {
    if (position[i] < 0) { learn(static_cast<int>(i)); }
  }
  std::reverse(chain.begin(), chain.end());
  while (!chain.empty() || next_other < others.size()) {
    if (chain.empty()) {
      auto const other = others[next_other++];
      follow(other.first, other.second);
      continue;
    }
    int const pose = chain.back();
    chain.pop_back();
    for (int const e : edges_of[static_cast<std::size_t>(pose)]) {
      motion_edge<Motion> const& edge = graph.edges[static_cast<std::size_t>(e)];
      int const apart = edge.to - edge.from;
      if (apart == 1 || apart == -1) {
        follow(pose, e);
      } else {
        others.push_back({pose, e});
      }
    }
  }
  return T;
}

}  // namespace detail

/// @throws bad_argument for a number out of range
inline void check(pose_graph_params const& params) {
  detail::require(params.start == pose_graph_start::given ||
                      params.start == pose_graph_start::odometry ||
                      params.start == pose_graph_start::chordal,
                  "the pose graph's start is unknown");
  detail::require_range("steps of a pose graph", params.steps, 0, 10000);
  detail::require_range("enough of a pose graph", params.enough, 0.0, 1.0);
  detail::require_range("first_damping of a pose graph", params.first_damping, 0.0, 1e9);
  vec3<double> const g = params.gravity;
  for (double const v : {g.x, g.y, g.z}) {
    detail::require_range("gravity of a pose graph", v, -1e9, 1e9);
  }
  bool const known = detail::axis_of(params).known;
  detail::require(known || (g.x == 0 && g.y == 0 && g.z == 0),
                  "gravity of a pose graph is shorter than 1e-9 and not 0");
  detail::require(params.start == pose_graph_start::given || !known,
                  "a pose graph with known gravity starts at the poses that are given");
}

/// Moves the poses of a graph so that the sum of its edges' costs is as low as near the start: by
/// Levenberg's and Marquardt's method, with each linear system solved exactly. Equal bits on every
/// executor. Allocates, and returns when all is done. Memory: linear in the edges and in the blocks
/// of the factor.
/// @param graph its poses that are not fixed get the result; a fixed one keeps its scale, too. With
///   a similarity_graph each pose has seven degrees of freedom
/// @throws bad_argument for an invalid graph, or one whose factor does not fit into 32-bit indices;
///   std::bad_alloc, cuda_error
template <typename Exec, typename Motion>
pose_graph_report optimize_pose_graph(Exec const& exec, motion_graph<Motion>& graph,
                                      pose_graph_params const& params = {}) {
  check(params);
  check(graph);
  pose_graph_report report;
  if (graph.edges.empty()) {
    report.converged = true;
    return report;
  }
  detail::elimination_order const order(graph);
  detail::pose_graph_solver<Exec, Motion> solver(exec, graph, order, detail::axis_of(params));
  report.dense_poses = order.dense;
  report.blocks = order.blocks();
  report.bytes = solver.bytes();
  auto const given = solver.measure();
  auto best = given;
  if (params.start == pose_graph_start::odometry) {
    solver.set_poses(detail::chained_poses(graph, order.position));
    best = solver.measure();
  } else if (params.start == pose_graph_start::chordal) {
    solver.start_chordal();
    best = solver.measure();
  }
  report.started = std::isfinite(best.cost);
  if (!report.started) {
    solver.set_poses(graph.T_world_pose);
    best = solver.measure();
  }
  report.given_cost = given.cost;
  report.given_chi2 = given.chi2;
  report.first_cost = best.cost;
  report.first_chi2 = best.chi2;

  auto const found =
      detail::descend(solver, best, {params.steps, params.enough, params.first_damping});
  report.steps = found.steps;
  report.converged = found.converged;
  report.next_damping = found.damping;
  report.last_cost = found.best.cost;
  report.last_chi2 = found.best.chi2;
  solver.download(graph.T_world_pose);
  return report;
}

}  // namespace FT_ABI
}  // namespace ft
