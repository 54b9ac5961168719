// SPDX-License-Identifier: Apache-2.0
// Pose graphs against Ceres Solver: the same errors, written again with other derivatives' code.
#include <gtest/gtest.h>

#include "bench/pose_graphs/ceres_solution.hpp"
#include "tests/support/pose_graph_checks.hpp"
#include "tests/support/pose_graphs.hpp"

namespace pose_graph_ceres_test {

TEST(PoseGraphCeres, Agrees) {
  test::expect_agreement_of_all(test::make_graph,
                                [](auto& graph) { return bench::solve_by_ceres(graph, 1).chi2; });
}

}  // namespace pose_graph_ceres_test
