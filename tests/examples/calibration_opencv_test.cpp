// SPDX-License-Identifier: Apache-2.0
// Calibrations that OpenCV's own FileStorage writes, read and projected as OpenCV does.
#include "examples/sequence/calibration.hpp"

#include <gtest/gtest.h>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <random>
#include <string>
#include <vector>

#include "examples/sequence/rectify.hpp"
#include "tests/support/sequence.hpp"

namespace {

struct opencv_pair {
  cv::Mat K1, D1, K2, D2, R, T;
};

opencv_pair random_pair(std::mt19937& random, int coefficients) {
  std::uniform_real_distribution<double> unit(-1, 1);
  auto const matrix = [&] {
    return cv::Mat(cv::Matx33d(450 + unit(random), 0, 320 + unit(random), 0, 451 + unit(random),
                               240 + unit(random), 0, 0, 1));
  };
  auto const distortion = [&] {
    cv::Mat d(1, coefficients, CV_64F, cv::Scalar(0));
    for (int i = 0; i < std::min(coefficients, 8); ++i) { d.at<double>(i) = 0.01 * unit(random); }
    return d;
  };
  opencv_pair p{matrix(), distortion(), matrix(), distortion(), {}, {}};
  cv::Rodrigues(cv::Vec3d(0.1 * unit(random), 0.1 * unit(random), 0.1 * unit(random)), p.R);
  p.T = cv::Mat(cv::Vec3d(-0.2, 0.01 * unit(random), 0.01 * unit(random)));
  return p;
}

void write(std::string const& path, opencv_pair const& p) {
  cv::FileStorage file(path, cv::FileStorage::WRITE);
  file << "calibrationDate"
       << "today, 12:00"
       << "nr_of_frames" << 20;
  file << "imageSize" << cv::Size(640, 480);
  file << "M1" << p.K1 << "D1" << p.D1 << "M2" << p.K2 << "D2" << p.D2 << "R" << p.R << "T" << p.T;
  file << "errors"
       << "[" << 0.5 << 0.25 << "]";
}

/// Both cameras' pixels of points of the left camera, as cv::projectPoints has them.
void expect_projects_as_opencv(seq::stereo_rig const& rig, opencv_pair const& p,
                               std::mt19937& random) {
  std::uniform_real_distribution<double> side(-0.5, 0.5);
  std::vector<cv::Point3d> points;
  for (int i = 0; i < 100; ++i) { points.emplace_back(2 * side(random), 2 * side(random), 2); }
  std::vector<cv::Point2d> left;
  std::vector<cv::Point2d> right;
  cv::projectPoints(points, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0), p.K1, p.D1, left);
  cv::projectPoints(points, p.R, p.T, p.K2, p.D2, right);
  seq::lens_projection const ours_left(rig.left);
  seq::lens_projection const ours_right(rig.right);
  for (std::size_t i = 0; i < points.size(); ++i) {
    Eigen::Vector3d const x(points[i].x, points[i].y, points[i].z);
    auto const l = ours_left(x);
    auto const r = ours_right(rig.T_left_right.inverse() * x);
    ASSERT_TRUE(l.valid && r.valid);
    ASSERT_LT((l.pixel - Eigen::Vector2d(left[i].x, left[i].y)).norm(), 1e-9);
    ASSERT_LT((r.pixel - Eigen::Vector2d(right[i].x, right[i].y)).norm(), 1e-9);
  }
}

TEST(calibration_oracle, files_of_opencv_are_read_as_by_opencv) {
  std::mt19937 random(11);
  seq_test::temp_folder const folder;
  for (char const* name : {"a.yml", "a.yaml", "a.xml", "a.json"}) {
    for (int const coefficients : {4, 5, 8, 12, 14}) {
      opencv_pair const p = random_pair(random, coefficients);
      write(folder.path(name), p);
      seq::calibration const c = seq::read_calibration(folder.path(name));
      EXPECT_EQ(c.rig.left.width, 640);
      EXPECT_EQ(c.rig.right.height, 480);
      expect_projects_as_opencv(c.rig, p, random);
    }
  }
}

TEST(calibration_oracle, camera_info_of_a_rectification_gives_the_pair_back) {
  std::mt19937 random(12);
  seq_test::temp_folder const folder;
  opencv_pair const p = random_pair(random, 5);
  cv::Mat R1, R2, P1, P2, Q;
  cv::stereoRectify(p.K1, p.D1, p.K2, p.D2, cv::Size(640, 480), p.R, p.T, R1, R2, P1, P2, Q);
  auto const camera = [&](char const* name, cv::Mat const& K, cv::Mat const& D, cv::Mat const& R,
                          cv::Mat const& P) {
    cv::FileStorage file(folder.path(name), cv::FileStorage::WRITE);
    file << "image_width" << 640 << "image_height" << 480 << "camera_matrix" << K
         << "distortion_model"
         << "plumb_bob"
         << "distortion_coefficients" << D << "rectification_matrix" << R << "projection_matrix"
         << P;
  };
  camera("left.yaml", p.K1, p.D1, R1, P1);
  camera("right.yaml", p.K2, p.D2, R2, P2);
  expect_projects_as_opencv(seq::read_calibration(folder.path("right.yaml")).rig, p, random);
}

}  // namespace
