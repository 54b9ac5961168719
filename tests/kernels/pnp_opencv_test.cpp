// SPDX-License-Identifier: Apache-2.0
// Poses from points against cv::solvePnPRansac and cv::solvePnP.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "tests/support/pnp_scene.hpp"

namespace pnp_oracle_test {

using test::at;

struct cv_scene {
  std::vector<cv::Point3f> points;
  std::vector<cv::Point2f> pixels;
  cv::Matx33d K;

  cv_scene(test::pnp_scene const& s, ft::pinhole<double> const& c)
      : K(c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1) {
    for (int i = 0; i < s.size(); ++i) {
      points.emplace_back(s.point[at(i)].x, s.point[at(i)].y, s.point[at(i)].z);
      pixels.emplace_back(s.pixel[at(i)].x, s.pixel[at(i)].y);
    }
  }
};
ft::rigid<double> pose_of(cv::Mat const& w, cv::Mat const& t) {
  cv::Mat R;
  cv::Rodrigues(w, R);
  ft::rigid<double> T{};
  for (int k = 0; k < 9; ++k) { T.R.m[k] = R.at<double>(k / 3, k % 3); }
  T.t = {t.at<double>(0), t.at<double>(1), t.at<double>(2)};
  return T;
}
double apart(ft::vec3<double> a, ft::vec3<double> b) {
  auto const d = a - b;
  return std::sqrt(dot(d, d));
}

TEST(PnpOracle, poses_and_inliers_are_those_of_solvePnPRansac) {
  ft::host_exec const exec(1);
  auto const camera = test::pnp_camera();
  std::mt19937 random(1);
  for (int round = 0; round < 30; ++round) {
    SCOPED_TRACE(round);
    test::pnp_scene_params p;
    p.points = 60 + 10 * round;
    p.outliers = 0.01 * round;
    p.noise = 0.3;
    auto s = make_pnp_scene(random, camera, p);
    std::fill(s.max_error2.begin(), s.max_error2.end(), 5.991f);
    test::pnp_batch<ft::host_exec> b(exec, {s}, {});
    ft::pnp_rays(exec, camera, b.problems());
    ft::solve_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
    ASSERT_EQ(b.result(0).status, ft::pnp_status::found);
    // The first pose is that of six noisy points; from its inliers another time, as OpenCV does.
    for (int k = 0; k < 3; ++k) {
      ft::refine_pnp(exec, camera, b.problems(), b.results(), b.results(), b.work());
    }
    cv_scene const cv(s, camera);
    cv::Mat w;
    cv::Mat t;
    std::vector<int> listed;
    ASSERT_TRUE(cv::solvePnPRansac(cv.points, cv.pixels, cv.K, cv::noArray(), w, t, false, 300,
                                   std::sqrt(5.991f), 0.9999, listed));
    std::vector<int> want(at(s.size()), 0);
    for (int const i : listed) { want[at(i)] = 1; }
    auto const got = b.inliers(0);
    int differing = 0;
    for (int i = 0; i < s.size(); ++i) {
      differing += static_cast<int>((got[at(i)] != 0) != (want[at(i)] != 0));
      EXPECT_EQ(got[at(i)], s.good[at(i)]) << i;  // noise of 0.3 pixels is below the limit of 2.4
    }
    // OpenCV's are those of the best sample.
    EXPECT_LE(differing, s.size() / 20);
    auto const T = pose_of(w, t);
    auto const mine = b.result(0).T_cw.cast<double>();
    EXPECT_LT(test::angle_between_rotations(mine.R, T.R), 1.5e-3);
    EXPECT_LT(apart(mine.t, T.t), 1.5e-2);
  }
}

TEST(PnpOracle, a_pose_from_all_is_that_of_solvePnP) {
  ft::host_exec const exec(1);
  auto const camera = test::pnp_camera();
  std::mt19937 random(2);
  for (int round = 0; round < 20; ++round) {
    SCOPED_TRACE(round);
    test::pnp_scene_params p;
    p.noise = 0.2;
    p.plane = round % 4 == 0;
    auto const s = make_pnp_scene(random, camera, p);
    test::pnp_batch<ft::host_exec> b(exec, {s}, {});
    ft::pnp_rays(exec, camera, b.problems());
    ft::solve_pnp(exec, camera, b.problems(), {}, b.results(), b.work());
    std::fill_n(b.results().inlier, s.size(), std::uint8_t{1});
    ft::refine_pnp(exec, camera, b.problems(), b.results(), b.results(), b.work());
    cv_scene const cv(s, camera);
    cv::Mat w;
    cv::Mat t;
    ASSERT_TRUE(cv::solvePnP(cv.points, cv.pixels, cv.K, cv::noArray(), w, t, false,
                             cv::SOLVEPNP_ITERATIVE));
    auto const T = pose_of(w, t);
    auto const mine = b.result(0).T_cw.cast<double>();
    // One weighs errors in pixels, the other one angles.
    EXPECT_LT(test::angle_between_rotations(mine.R, T.R), 3e-4);
    EXPECT_LT(apart(mine.t, T.t), 3e-3);
  }
}

}  // namespace pnp_oracle_test
