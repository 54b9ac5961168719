// SPDX-License-Identifier: Apache-2.0
// Maps against Ceres Solver: the same errors, written again with derivatives that Ceres makes.
#include <gtest/gtest.h>

#include <vector>

#include "bench/bundles/ceres_solution.hpp"
#include "ft/pipelines/adjust_map.hpp"
#include "tests/support/bundles.hpp"

namespace adjust_map_ceres_test {

using lens = ft::radtan4<double>;

inline std::vector<lens> lenses() {
  return {{400, 405, 310, 250, {-0.05, 0.01, 1e-3, -2e-3}}, {500, 500, 0, 0, {0.02, 0, 0, 0}}};
}

/// With the parameters that users have: never more than 1e-5 above what Ceres finds, by conjugate
/// gradients and by a factorisation that goes on to the minimum.
inline void compare(ft::bundle<lens> const& given, double huber, char const* what) {
  auto own = given;
  ft::map_params params;
  params.huber = huber;
  auto const report = ft::adjust_map(ft::host_exec(1), own, params);
  EXPECT_EQ(report.last_without_image, 0) << what;
  for (bool const iterative : {true, false}) {
    auto theirs = given;
    auto const want = bench::solve_by_ceres(theirs, {iterative, 1, huber});
    EXPECT_LT(report.last_cost, (1 + 1e-5) * want.cost) << what << ' ' << iterative;
    // Not another minimum than theirs.
    EXPECT_GT(report.last_cost, (1 - 1e-2) * want.cost) << what << ' ' << iterative;
  }
}

TEST(AdjustMapCeres, MapsAgree) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    compare(test::make_bundle({30, 400}, lenses(), seed).map, 0, "an arc");
    compare(test::make_bundle({130, 600}, lenses(), seed).map, 0, "two laps");
  }
}

TEST(AdjustMapCeres, RobustMapsAgree) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    test::bundle_shape shape{30, 400, 7};
    shape.outliers = 0.03;
    compare(test::make_bundle(shape, lenses(), seed).map, 2.5, "outliers");
  }
}

TEST(AdjustMapCeres, MapsWithOneFixedViewAgree) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    auto map = test::make_bundle({30, 400}, lenses(), seed).map;
    map.fixed.clear();
    compare(map, 0, "one fixed");
  }
}

TEST(AdjustMapCeres, MapsOfRectifiedPairsAgree) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    test::bundle_shape shape{30, 400};
    shape.baseline = 0.2;
    auto map = test::make_bundle(shape, lenses(), seed).map;
    map.fixed.clear();
    compare(map, 0, "pairs");
    shape.outliers = 0.03;
    compare(test::make_bundle(shape, lenses(), seed).map, 2.5, "pairs with outliers");
  }
}

}  // namespace adjust_map_ceres_test
