// SPDX-License-Identifier: Apache-2.0
// Reconstruction from two views against OpenCV: models of eight matches, motions of both models,
// triangulated points, whole reconstructions.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "ft/core/counter_draws.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/two_view/reconstruct.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/two_view_scene.hpp"

namespace two_view_oracle_test {

using test::make_two_views;
using test::scene_kind;
using test::two_view_scene;

cv::Matx33d matrix_of(ft::mat3<double> const& m) { return cv::Matx33d(m.m); }
cv::Matx33d camera_of(two_view_scene const& s) {
  auto const c = s.camera.cast<double>();
  return {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
}

/// Matched pixels, in the order of the first image's keypoints.
struct matched {
  std::vector<cv::Point2d> first, second;
  std::vector<std::size_t> keypoint;

  explicit matched(two_view_scene const& s) {
    for (std::size_t i = 0; i < s.match.size(); ++i) {
      if (s.match[i] < 0) { continue; }
      auto const& q = s.second[static_cast<std::size_t>(s.match[i])];
      first.emplace_back(s.first[i].x, s.first[i].y);
      second.emplace_back(q.x, q.y);
      keypoint.push_back(i);
    }
  }
  /// Those of one sample.
  matched sample(two_view_scene const& s, int round) const {
    int taken[8];
    ft::counter_draws{s.seed}.distinct(static_cast<int>(first.size()),
                                       static_cast<std::uint64_t>(round), taken);
    matched some(*this);
    some.first.clear();
    some.second.clear();
    for (int const k : taken) {
      some.first.push_back(first[static_cast<std::size_t>(k)]);
      some.second.push_back(second[static_cast<std::size_t>(k)]);
    }
    return some;
  }
};

cv::Point2d transferred(cv::Matx33d const& H, cv::Point2d p) {
  cv::Vec3d const v = H * cv::Vec3d(p.x, p.y, 1);
  return {v[0] / v[2], v[1] / v[2]};
}
double line_distance(cv::Matx33d const& F, cv::Point2d p, cv::Point2d q) {
  cv::Vec3d const l = F * cv::Vec3d(p.x, p.y, 1);
  return (l[0] * q.x + l[1] * q.y + l[2]) / std::hypot(l[0], l[1]);
}

TEST(TwoViewsAndOpencv, HaveTheSameModelsOfEightMatches) {
  std::mt19937 random(1);
  ft::two_view_params params;
  params.samples = 40;
  for (int round = 0; round < test::effort(4); ++round) {
    auto const plane = make_two_views(random, {scene_kind::plane, 100, 0, 0, 20});
    auto const scene = make_two_views(random, {scene_kind::general, 100, 0, 0, 20});
    auto const got = test::reconstruct(ft::host_exec(1), {plane, scene}, params);
    matched const on_plane(plane);
    matched const in_scene(scene);
    int near_H = 0;
    int near_F = 0;
    for (int k = 0; k < params.samples; ++k) {
      auto const at = static_cast<std::size_t>(k);
      auto const eight = on_plane.sample(plane, k);
      cv::Matx33d const H = cv::findHomography(eight.first, eight.second, 0);
      cv::Matx33d const ours_H = matrix_of(got[0].models[at]);
      auto const more = in_scene.sample(scene, k);
      cv::Mat const found = cv::findFundamentalMat(more.first, more.second, cv::FM_8POINT);
      ASSERT_EQ(found.rows, 3);
      cv::Matx33d const F = found;
      cv::Matx33d const ours_F =
          matrix_of(got[1].models[static_cast<std::size_t>(params.samples) + at]);
      double worst_H = 0;
      double worst_F = 0;
      for (std::size_t i = 0; i < 100; ++i) {
        cv::Point2d const p = on_plane.first[i];
        worst_H = std::max(worst_H, cv::norm(transferred(H, p) - transferred(ours_H, p)));
        double const a = line_distance(F, in_scene.first[i], in_scene.second[i]);
        double const b = line_distance(ours_F, in_scene.first[i], in_scene.second[i]);
        worst_F = std::max(worst_F, std::min(std::abs(a - b), std::abs(a + b)));
      }
      // Rounding of pixels, 3e-5, grows away from the eight.
      near_H += static_cast<int>(worst_H < 5e-3);
      near_F += static_cast<int>(worst_F < 5e-2);
    }
    EXPECT_GE(near_H, params.samples * 95 / 100);
    EXPECT_GE(near_F, params.samples * 95 / 100);
  }
}

/// Difference of rotations plus that of directions.
double difference(ft::rigid<double> const& a, cv::Matx33d const& R, cv::Vec3d const& t) {
  double const length = cv::norm(t);
  return cv::norm(matrix_of(a.R) - R) + cv::norm(cv::Vec3d(a.t.x, a.t.y, a.t.z) - t * (1 / length));
}

TEST(TwoViewsAndOpencv, HaveTheSameMotions) {
  std::mt19937 random(2);
  for (int round = 0; round < test::effort(10); ++round) {
    auto const scene = make_two_views(random, {scene_kind::general, 200, 0.1, 10, 10});
    auto const plane = make_two_views(random, {scene_kind::plane, 200, 0.1, 10, 10});
    ft::two_view_params always_F;
    always_F.homography_ratio = 2;
    always_F.min_points = 1;
    ft::two_view_params always_H;
    always_H.homography_ratio = -1;
    auto const by_F = test::reconstruct(ft::host_exec(1), {scene}, always_F)[0];
    auto const by_H = test::reconstruct(ft::host_exec(1), {plane}, always_H)[0];

    // recoverPose() counts points with depth in front of both cameras.
    cv::Matx33d const K = camera_of(scene);
    cv::Matx33d const F = matrix_of(by_F.result.F_21.cast<double>());
    cv::Matx33d R;
    cv::Vec3d t;
    matched const all(scene);
    cv::recoverPose(cv::Mat(K.t() * F * K), all.first, all.second, cv::Mat(K), R, t);
    if (by_F.result.status == ft::two_view_status::reconstructed) {
      EXPECT_LT(difference(by_F.result.T_21.cast<double>(), R, t), 2e-5) << round;
    }
    double nearest = 1e9;
    for (std::size_t k = 0; k < 4; ++k) {
      nearest = std::min(nearest, difference(by_F.motions[k], R, t));
    }
    EXPECT_LT(nearest, 2e-5) << round;

    cv::Matx33d const H = matrix_of(by_H.result.H_21.cast<double>());
    std::vector<cv::Mat> rotations;
    std::vector<cv::Mat> translations;
    std::vector<cv::Mat> normals;
    cv::decomposeHomographyMat(cv::Mat(H), cv::Mat(K), rotations, translations, normals);
    ASSERT_EQ(rotations.size(), 4u);
    ASSERT_EQ(by_H.result.motions, 8);
    for (std::size_t i = 0; i < 4; ++i) {
      nearest = 1e9;
      for (auto const& m : by_H.motions) {
        nearest =
            std::min(nearest, difference(m, cv::Matx33d(rotations[i]), cv::Vec3d(translations[i])));
      }
      EXPECT_LT(nearest, 1e-4) << round << " " << i;
    }
  }
}

TEST(TwoViewsAndOpencv, HaveTheSamePoints) {
  std::mt19937 random(3);
  std::vector<two_view_scene> scenes;
  for (int round = 0; round < test::effort(6); ++round) {
    scenes.push_back(make_two_views(random, {scene_kind::general, 200, 0.1, 0, 10}));
  }
  auto const got = test::reconstruct(ft::host_exec(), scenes);
  int compared = 0;
  for (std::size_t s = 0; s < scenes.size(); ++s) {
    if (got[s].result.status != ft::two_view_status::reconstructed) { continue; }
    matched const all(scenes[s]);
    cv::Matx33d const K = camera_of(scenes[s]);
    auto const& T = got[s].result.T_21;
    cv::Matx34d const P1(K(0, 0), 0, K(0, 2), 0, 0, K(1, 1), K(1, 2), 0, 0, 0, 1, 0);
    auto const& m = T.R.m;
    cv::Matx34d const P2 =
        K * cv::Matx34d(m[0], m[1], m[2], T.t.x, m[3], m[4], m[5], T.t.y, m[6], m[7], m[8], T.t.z);
    cv::Mat homogeneous;
    cv::triangulatePoints(cv::Mat(P1), cv::Mat(P2), all.first, all.second, homogeneous);
    for (int i = 0; i < homogeneous.cols; ++i) {
      auto const k = all.keypoint[static_cast<std::size_t>(i)];
      if ((got[s].flags[k] & ft::two_view_flag::triangulated) == 0) { continue; }
      auto const at = [&](int row) { return homogeneous.at<double>(row, i); };
      cv::Vec3d const want(at(0) / at(3), at(1) / at(3), at(2) / at(3));
      auto const X = got[s].points[k].cast<double>();
      EXPECT_LT(cv::norm(cv::Vec3d(X.x, X.y, X.z) - want), 1e-4 * cv::norm(want));
      ++compared;
    }
  }
  EXPECT_GT(compared, 150);
}

TEST(TwoViewsAndOpencv, HaveTheSameReconstructions) {
  std::mt19937 random(4);
  std::vector<two_view_scene> scenes;
  for (int round = 0; round < test::effort(6); ++round) {
    scenes.push_back(make_two_views(random, {scene_kind::general, 300, 0.1, 20, 10}));
  }
  auto const got = test::reconstruct(ft::host_exec(), scenes);
  int compared = 0;
  for (std::size_t s = 0; s < scenes.size(); ++s) {
    if (got[s].result.status != ft::two_view_status::reconstructed) { continue; }
    matched const all(scenes[s]);
    cv::Mat const K(camera_of(scenes[s]));
    cv::Mat mask;
    cv::setRNGSeed(7);
    cv::Mat const E = cv::findEssentialMat(all.first, all.second, K, cv::RANSAC, 0.999, 1.0, mask);
    ASSERT_EQ(E.rows, 3);
    cv::Matx33d R;
    cv::Vec3d t;
    cv::recoverPose(E, all.first, all.second, K, R, t, mask);
    // Both are models of samples: eight matches here, five there.
    EXPECT_LT(difference(got[s].result.T_21.cast<double>(), R, t), 0.2) << s;
    ++compared;
  }
  EXPECT_GE(2 * compared, static_cast<int>(scenes.size()));
}

}  // namespace two_view_oracle_test
