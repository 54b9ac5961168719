// SPDX-License-Identifier: Apache-2.0
// The information matrix of an optimised pose against one from finite differences of projections,
// and which observations agree with it, where the right column counts and where the disparity does.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "tests/support/backends.hpp"

namespace pose_information_test {

constexpr double fx = 400, fy = 410, cx = 320, cy = 240, baseline = 0.2;

struct seen {
  double row[3];
};

seen project(double x, double y, double z) {
  return {{fx * x / z + cx, fy * y / z + cy, fx * x / z + cx - fx * baseline / z}};
}

/// Where a point in the camera's frame is seen after a small twist, rotation first.
seen after(double const (&p)[3], int parameter, double step) {
  double w[3] = {0, 0, 0};
  double t[3] = {0, 0, 0};
  (parameter < 3 ? w[parameter] : t[parameter - 3]) = step;
  return project(p[0] + w[1] * p[2] - w[2] * p[1] + t[0], p[1] + w[2] * p[0] - w[0] * p[2] + t[1],
                 p[2] + w[0] * p[1] - w[1] * p[0] + t[2]);
}

/// The third row of an observation: the right column, or with a weight the disparity.
double third_row(seen const& s, double disparity_weight) {
  return disparity_weight > 0 ? std::sqrt(disparity_weight) * (s.row[2] - s.row[0]) : s.row[2];
}

ft::rectified_rig rig() {
  return ft::rectified_rig::make({static_cast<float>(fx), static_cast<float>(fy),
                                  static_cast<float>(cx), static_cast<float>(cy)},
                                 baseline);
}
ft::pose_params weighing(double disparity_weight) {
  ft::pose_params p;
  p.disparity_weight = disparity_weight;
  return p;
}

template <typename Backend>
class pose_information : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(pose_information, test::backends);

template <typename Exec>
void check_information(Exec const& exec, double disparity_weight) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<ft::observation> all;
  double want[6][6] = {};
  for (int i = 0; i < 200; ++i) {
    // In both images: a negative right column is none.
    double const z = 4 + 2 * unit(random);
    double const p[3] = {0.5 * z * unit(random), 0.4 * z * unit(random), z};
    seen const s = project(p[0], p[1], p[2]);
    bool const stereo = i % 3 != 0;
    double const weight = i % 2 == 0 ? 1 : 0.25;
    all.push_back({{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])},
                   static_cast<float>(s.row[0]),
                   static_cast<float>(s.row[1]),
                   stereo ? static_cast<float>(s.row[2]) : -1.0f,
                   static_cast<float>(weight),
                   0});
    for (int row = 0; row < (stereo ? 3 : 2); ++row) {
      double J[6];
      for (int k = 0; k < 6; ++k) {
        constexpr double h = 1e-5;
        seen const more = after(p, k, h);
        seen const less = after(p, k, -h);
        J[k] = row < 2 ? more.row[row] - less.row[row]
                       : third_row(more, disparity_weight) - third_row(less, disparity_weight);
        J[k] /= 2 * h;
      }
      for (int a = 0; a < 6; ++a) {
        for (int b = 0; b < 6; ++b) { want[a][b] += weight * J[a] * J[b]; }
      }
    }
  }
  auto const observations = test::to_exec(exec, all);
  auto const start = test::to_exec(exec, std::vector<ft::pose>{ft::pose::identity()});
  auto const result = test::to_exec(exec, std::vector<ft::pose>(1));
  auto const outlier = test::to_exec(exec, std::vector<unsigned char>(all.size()));
  auto const inliers = test::to_exec(exec, std::vector<int>(1));
  auto const information = test::to_exec(exec, std::vector<float>(ft::information_terms, -1.0f));
  auto const solve = [&](int count) {
    ft::optimize_pose(exec, rig(),
                      ft::pose_problem{observations.data(), count, start.data(), result.data(),
                                       outlier.data(), inliers.data(), information.data()},
                      weighing(disparity_weight));
    return test::from_exec(exec, information.data(), std::size_t{ft::information_terms});
  };
  auto const got = solve(static_cast<int>(all.size()));
  ASSERT_EQ(test::from_exec(exec, inliers.data(), 1)[0], 200);
  std::size_t at = 0;
  for (int a = 0; a < 6; ++a) {
    for (int b = a; b < 6; ++b) {
      double const scale = std::sqrt(want[a][a] * want[b][b]);
      EXPECT_NEAR(static_cast<double>(got[at++]) / scale, want[a][b] / scale, 1e-4)
          << a << " " << b;
    }
  }
  for (float const v : solve(2)) { EXPECT_EQ(v, 0.0f); }  // no pose from two observations
}

TYPED_TEST(pose_information, is_that_of_the_weighted_projections) {
  TypeParam backend;
  check_information(backend.exec, 0);
}
TYPED_TEST(pose_information, is_that_of_weighted_disparities) {
  TypeParam backend;
  check_information(backend.exec, 16);
}

TYPED_TEST(pose_information, a_weighted_disparity_tells_a_wrong_depth_from_a_moved_corner) {
  TypeParam backend;
  auto const& exec = backend.exec;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1, 1);
  std::vector<ft::observation> all;
  for (int i = 0; i < 100; ++i) {
    double const z = 4 + 2 * unit(random);
    double const p[3] = {0.5 * z * unit(random), 0.4 * z * unit(random), z};
    seen const s = project(p[0], p[1], p[2]);
    // One corner is found a pixel and a half aside in both images, one disparity is a pixel off.
    double const moved = i == 30 ? 1.5 : 0;
    double const deeper = i == 60 ? 1 : 0;
    all.push_back({{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])},
                   static_cast<float>(s.row[0] + moved),
                   static_cast<float>(s.row[1]),
                   static_cast<float>(s.row[2] + moved + deeper),
                   1.0f,
                   0});
  }
  auto const observations = test::to_exec(exec, all);
  auto const start = test::to_exec(exec, std::vector<ft::pose>{ft::pose::identity()});
  auto const result = test::to_exec(exec, std::vector<ft::pose>(1));
  auto const outlier = test::to_exec(exec, std::vector<unsigned char>(all.size()));
  auto const inliers = test::to_exec(exec, std::vector<int>(1));
  for (double const weight : {0.0, 16.0}) {
    ft::optimize_pose(exec, rig(),
                      ft::pose_problem{observations.data(), 100, start.data(), result.data(),
                                       outlier.data(), inliers.data()},
                      weighing(weight));
    auto const out = test::from_exec(exec, outlier.data(), all.size());
    EXPECT_EQ(out[30], 0) << weight;                   // 2 * 1.5^2 = 4.5, or 1.5^2, is below 7.8
    EXPECT_EQ(out[60], weight > 0 ? 1 : 0) << weight;  // 1, or 16
    EXPECT_EQ(test::from_exec(exec, inliers.data(), 1)[0], weight > 0 ? 99 : 100);
  }
}

}  // namespace pose_information_test
