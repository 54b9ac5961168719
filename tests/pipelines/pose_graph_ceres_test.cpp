// SPDX-License-Identifier: Apache-2.0
// Pose graphs against Ceres Solver: the same errors, written again with other derivatives' code.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "bench/pose_graphs/ceres_solution.hpp"
#include "ft/pipelines/pose_graph.hpp"
#include "tests/support/pose_graphs.hpp"

namespace pose_graph_ceres_test {

inline double distance(ft::rigid<double> const& a, ft::rigid<double> const& b) {
  double worst = 0;
  for (int k = 0; k < 9; ++k) { worst = std::max(worst, std::abs(a.R.m[k] - b.R.m[k])); }
  auto const d = a.t - b.t;
  return std::max(worst, std::sqrt(ft::dot(d, d)));
}

/// Both descend to one minimum: costs agree as far as their sums are exact. Poses agree to a share
/// of their uncertainty, which is centimetres.
inline void compare(ft::pose_graph const& given, char const* what) {
  auto own = given;
  ft::pose_graph_params params;
  params.enough = 1e-13;
  auto const report = ft::optimize_pose_graph(ft::host_exec(1), own, params);
  auto want = given;
  auto const found = bench::solve_by_ceres(want, 1);
  EXPECT_NEAR(report.last_cost, found.chi2, 1e-8 * found.chi2) << what;
  double worst = 0;
  for (std::size_t i = 0; i < own.T_world_pose.size(); ++i) {
    worst = std::max(worst, distance(own.T_world_pose[i], want.T_world_pose[i]));
  }
  EXPECT_LT(worst, 1e-4) << what;
}

TEST(PoseGraphCeres, GraphsAgree) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    compare(test::make_graph({60, 20}, seed).graph, "loops anywhere");
    compare(test::make_graph({150, 100, 0.01, 0.02, 25}, seed).graph, "laps");
  }
}

TEST(PoseGraphCeres, RobustKernelsAgree) {
  for (auto const kernel : {ft::robust_kernel::huber, ft::robust_kernel::cauchy}) {
    auto graph = test::make_graph({80, 40}, 7).graph;
    for (auto& e : graph.edges) {
      e.kernel = kernel;
      e.width = 2;
    }
    compare(graph, kernel == ft::robust_kernel::huber ? "huber" : "cauchy");
  }
}

TEST(PoseGraphCeres, FixedPosesAgree) {
  auto graph = test::make_graph({80, 20}, 9).graph;
  graph.fixed.assign(80, 0);
  graph.fixed[0] = graph.fixed[40] = 1;
  compare(graph, "fixed");
}

}  // namespace pose_graph_ceres_test
