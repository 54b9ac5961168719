// SPDX-License-Identifier: Apache-2.0
// Poses that start and end in double: without a rounding in between.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"

namespace exact_pose_test {

using test::example_rig;
using test::motion;
using test::turn;

/// Points in front of a rectified pair, with a pixel's noise.
std::vector<ft::observation> observe(ft::rectified_rig const& rig, motion const& T_cw, int n,
                                     std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<ft::observation> all;
  for (int i = 0; i < n; ++i) {
    double const depth = 2 + 5 * (1 + unit(random));
    ft::vec3<double> const seen{0.6 * depth * unit(random), 0.5 * depth * unit(random), depth};
    ft::vec3<double> const world = T_cw.inverse() * seen;
    auto const pixel = rig.camera.cast<double>().project(seen).pixel;
    ft::observation o{};
    o.point = world.cast<float>();
    o.u = static_cast<float>(pixel.x + unit(random));
    o.v = static_cast<float>(pixel.y + unit(random));
    o.right_u =
        i % 2 == 0 ? -1.0f : static_cast<float>(pixel.x - static_cast<double>(rig.bf()) / depth);
    o.inv_sigma2 = 1;
    all.push_back(o);
  }
  return all;
}

struct answer {
  ft::pose rounded;
  motion exact;
};

template <typename Exec>
answer solve(Exec const& exec, ft::rectified_rig const& rig,
             std::vector<ft::observation> const& seen, ft::pose const& start,
             motion const* exact_start) {
  auto const observations = test::to_exec(exec, seen);
  auto const starts = test::to_exec(exec, std::vector<ft::pose>{start});
  auto const exact = test::to_exec(
      exec, std::vector<motion>{exact_start == nullptr ? motion::identity() : *exact_start});
  auto const results = test::to_exec(exec, std::vector<ft::pose>{ft::pose{}});
  auto const exact_results = test::to_exec(exec, std::vector<motion>{motion{}});
  auto const outlier = test::to_exec(exec, std::vector<unsigned char>(seen.size()));
  auto const inliers = test::to_exec(exec, std::vector<int>{0});
  ft::pose_params params;
  params.small_step = 0;
  ft::optimize_pose(exec, rig,
                    {observations.data(), static_cast<int>(seen.size()), starts.data(),
                     results.data(), outlier.data(), inliers.data(), nullptr,
                     exact_start == nullptr ? nullptr : exact.data(), exact_results.data()},
                    params);
  return {test::from_exec(exec, static_cast<ft::pose const*>(results.data()), 1)[0],
          test::from_exec(exec, static_cast<motion const*>(exact_results.data()), 1)[0]};
}

template <typename T>
bool same_bits(T const& a, T const& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}
double distance(motion const& a, motion const& b) {
  double worst =
      std::max({std::abs(a.t.x - b.t.x), std::abs(a.t.y - b.t.y), std::abs(a.t.z - b.t.z)});
  for (int i = 0; i < 9; ++i) { worst = std::max(worst, std::abs(a.R.m[i] - b.R.m[i])); }
  return worst;
}

template <typename Backend>
class exact_pose : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(exact_pose, test::backends);

TYPED_TEST(exact_pose, is_the_result_before_it_is_rounded_and_that_of_the_host) {
  auto const rig = example_rig<ft::rectified_rig>();
  std::mt19937 random(7);
  for (int const n : {3, 40, 400, 1500}) {
    auto const truth = turn({0.3, -0.7, 0.2}, 0.8, {0.5, -0.2, 1.1});
    auto const seen = observe(rig, truth, n, random);
    motion const start = turn({1, -2, 3}, 0.02, {0.05, -0.04, 0.06}) * truth;
    answer const here = solve(this->backend.exec, rig, seen, start.template cast<float>(), &start);
    EXPECT_TRUE(same_bits(here.rounded, here.exact.template cast<float>())) << n;
    EXPECT_FALSE(same_bits(here.exact, here.rounded.template cast<double>())) << n;
    EXPECT_GT(distance(here.exact, start), 1e-3) << n;
    answer const host = solve(ft::host_exec(1), rig, seen, start.template cast<float>(), &start);
    EXPECT_TRUE(same_bits(here.exact, host.exact)) << n;
  }
}

TYPED_TEST(exact_pose, with_too_few_observations_is_the_start) {
  auto const rig = example_rig<ft::rectified_rig>();
  std::mt19937 random(8);
  motion const start = turn({1, -2, 3}, 0.7, {0.05, -0.04, 0.06});
  auto const seen = observe(rig, start, 2, random);
  answer const here = solve(this->backend.exec, rig, seen, start.template cast<float>(), &start);
  EXPECT_TRUE(same_bits(here.exact, start));
  EXPECT_TRUE(same_bits(here.rounded, start.template cast<float>()));
}

TYPED_TEST(exact_pose, begins_at_the_start_in_double) {
  auto const rig = example_rig<ft::rectified_rig>();
  std::mt19937 random(9);
  motion const truth = turn({0.3, -0.7, 0.2}, 0.8, {0.5, -0.2, 1.1});
  auto const seen = observe(rig, truth, 300, random);
  motion const start = turn({1, -2, 3}, 0.02, {0.05, -0.04, 0.06}) * truth;
  ft::pose const elsewhere = ft::pose::identity();
  answer const here = solve(this->backend.exec, rig, seen, elsewhere, &start);
  answer const rounded =
      solve(this->backend.exec, rig, seen, start.template cast<float>(), nullptr);
  EXPECT_LT(distance(here.exact, rounded.exact), 1e-6) << "not from `start`, the identity";
  EXPECT_LT(distance(here.exact, truth), 0.02);
}

}  // namespace exact_pose_test
