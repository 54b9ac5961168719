// SPDX-License-Identifier: Apache-2.0
/// @file What has to hold for graphs of rigid motions and of similarities alike.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>

#include "ft/pipelines/pose_graph.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/pose_graphs.hpp"

namespace test {

template <typename Exec, typename Graph>
ft::pose_graph_report optimize(Exec const& exec, Graph& graph, ft::pose_graph_start start) {
  ft::pose_graph_params params;
  params.start = start;
  return ft::optimize_pose_graph(exec, graph, params);
}

/// @param cost_of (graph): in plain numbers @param move(pose): by a little
template <typename Exec, typename Graph, typename Cost, typename Move>
void expect_minimum(Exec const& exec, Graph graph, Cost const& cost_of, Move const& move) {
  auto const report = optimize(exec, graph, ft::pose_graph_start::given);
  EXPECT_TRUE(report.converged);
  EXPECT_LT(report.last_chi2, report.first_chi2);
  double const least = cost_of(graph);
  EXPECT_NEAR(report.last_chi2, least, 1e-9 * least);
  for (int round = 0; round < 30; ++round) {
    auto moved = graph;
    for (std::size_t i = 1; i < moved.T_world_pose.size(); ++i) { move(moved.T_world_pose[i]); }
    EXPECT_GT(cost_of(moved), least);
  }
}

/// Six steps have the bits of one thread of the host. By the seed edges have robust kernels.
template <typename Exec, typename Graph>
void expect_bits_of_host(Exec const& exec, Graph graph, ft::pose_graph_start start, unsigned seed) {
  if (seed % 2 == 0) {
    for (auto& e : graph.edges) {
      e.kernel = seed % 4 == 0 ? ft::robust_kernel::huber : ft::robust_kernel::cauchy;
    }
  }
  auto other = graph;
  ft::pose_graph_params params;
  params.start = start;
  params.steps = 6;
  auto const a = ft::optimize_pose_graph(exec, graph, params);
  auto const b = ft::optimize_pose_graph(ft::host_exec(1), other, params);
  EXPECT_TRUE(same_bits(graph.T_world_pose, other.T_world_pose)) << graph.T_world_pose.size();
  EXPECT_TRUE(a.started);
  EXPECT_EQ(a.given_cost, b.given_cost);
  EXPECT_EQ(a.first_cost, b.first_cost);
  EXPECT_EQ(a.last_cost, b.last_cost);
  EXPECT_EQ(a.last_chi2, b.last_chi2);
  EXPECT_EQ(a.steps, b.steps);
  EXPECT_LE(a.last_cost, a.first_cost);
}

/// Both descend to one minimum: costs agree as far as their sums are exact. Poses agree to a share
/// of their uncertainty, which is centimetres.
/// @param solve(graph&): by other code; moves the poses to the minimum near them, and returns the
///   robust cost
template <typename Graph, typename Solve>
void expect_agreement(Graph const& given, Solve const& solve, char const* what) {
  auto own = given;
  ft::pose_graph_params params;
  params.enough = 1e-13;
  auto const report = ft::optimize_pose_graph(ft::host_exec(1), own, params);
  auto want = given;
  double const cost = solve(want);
  EXPECT_LT(report.last_cost, report.first_cost) << what;
  EXPECT_NEAR(report.last_cost, cost, 1e-8 * cost) << what;
  double worst = 0;
  for (std::size_t i = 0; i < own.T_world_pose.size(); ++i) {
    worst = std::max(worst, distance(own.T_world_pose[i], want.T_world_pose[i]));
  }
  EXPECT_LT(worst, 1e-4) << what;
}

/// Loops, laps, robust kernels and fixed poses. @param make(graph_shape, seed)
template <typename Make, typename Solve>
void expect_agreement_of_all(Make const& make, Solve const& solve) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    expect_agreement(make({60, 20}, seed).graph, solve, "loops anywhere");
    expect_agreement(make({150, 100, 0.01, 0.02, 25}, seed).graph, solve, "laps");
  }
  for (auto const kernel : {ft::robust_kernel::huber, ft::robust_kernel::cauchy}) {
    auto robust = make({80, 40}, 7).graph;
    for (auto& e : robust.edges) {
      e.kernel = kernel;
      e.width = 2;
    }
    expect_agreement(robust, solve, kernel == ft::robust_kernel::huber ? "huber" : "cauchy");
  }
  auto graph = make({80, 20}, 9).graph;
  graph.fixed.assign(80, 0);
  graph.fixed[0] = graph.fixed[40] = 1;
  expect_agreement(graph, solve, "fixed");
}

}  // namespace test
