// SPDX-License-Identifier: Apache-2.0
// Camera models against OpenCV's projections.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"

namespace {

/// In front of the camera, up to `angle` radians off the axis, from 0.2 to 60 m away.
std::vector<cv::Point3d> points_within(double angle, int n, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  std::vector<cv::Point3d> all;
  for (int i = 0; i < n; ++i) {
    double const theta = angle * unit(random);
    double const psi = 2 * CV_PI * unit(random);
    double const r = 0.2 + 60 * unit(random) * unit(random);
    all.emplace_back(r * std::sin(theta) * std::cos(psi), r * std::sin(theta) * std::sin(psi),
                     r * std::cos(theta));
  }
  all.emplace_back(0, 0, 3);
  return all;
}

cv::Matx33d matrix_of(double fx, double fy, double cx, double cy) {
  return {fx, 0, cx, 0, fy, cy, 0, 0, 1};
}

/// Projections in double and float, and rays back, against the pixels that OpenCV gives.
template <typename Camera>
void compare(Camera const& camera, std::vector<cv::Point3d> const& points,
             std::vector<cv::Point2d> const& want) {
  auto const narrow = camera.template cast<float>();
  auto const strict = camera.template cast<ft::strict_float>();
  ASSERT_EQ(points.size(), want.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    auto const& p = points[i];
    auto const got = camera.project({p.x, p.y, p.z});
    EXPECT_TRUE(got.valid);
    EXPECT_NEAR(got.pixel.x, want[i].x, 1e-9);
    EXPECT_NEAR(got.pixel.y, want[i].y, 1e-9);
    float const x = static_cast<float>(p.x);
    float const y = static_cast<float>(p.y);
    float const z = static_cast<float>(p.z);
    // Three or four roundings of numbers up to some thousand pixels.
    double const tolerance = 4e-7 * std::max({1000.0, std::abs(want[i].x), std::abs(want[i].y)});
    EXPECT_NEAR(narrow.project({x, y, z}).pixel.x, want[i].x, tolerance);
    EXPECT_NEAR(narrow.project({x, y, z}).pixel.y, want[i].y, tolerance);
    EXPECT_NEAR(strict.project({x, y, z}).pixel.x.value, want[i].x, tolerance);
    EXPECT_NEAR(strict.project({x, y, z}).pixel.y.value, want[i].y, tolerance);
    auto const ray = camera.unproject({want[i].x, want[i].y});
    EXPECT_TRUE(ray.valid);
    double const size = std::max(1.0, (p.x * p.x + p.y * p.y) / (p.z * p.z));
    EXPECT_NEAR(ray.direction.x, p.x / p.z, 1e-9 * size);
    EXPECT_NEAR(ray.direction.y, p.y / p.z, 1e-9 * size);
  }
}

TEST(pinhole_oracle, is_opencvs_projection) {
  ft::pinhole<double> const camera{458.654, 457.296, 367.215, 248.375};
  auto const points = points_within(1.2, 2000, 1);
  std::vector<cv::Point2d> want;
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(),
                    matrix_of(camera.fx, camera.fy, camera.cx, camera.cy), cv::noArray(), want);
  compare(camera, points, want);
}

TEST(kannala_brandt_oracle, is_opencvs_fisheye_projection) {
  ft::kannala_brandt<double> const camera{
      190.97847715128717,    190.9733070521226,     254.93170605935475,     256.8974428996504,
      0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182};
  auto const points = points_within(1.4, 2000, 2);  // OpenCV divides by z: less than 90 degrees
  std::vector<cv::Point2d> want;
  cv::fisheye::projectPoints(points, want, cv::Vec3d(), cv::Vec3d(),
                             matrix_of(camera.fx, camera.fy, camera.cx, camera.cy),
                             cv::Vec4d(camera.k1, camera.k2, camera.k3, camera.k4));
  compare(camera, points, want);
}

TEST(kannala_brandt_oracle, the_jacobian_is_the_derivative_of_opencvs_projection) {
  ft::kannala_brandt<double> const camera{300, 310, 320, 240, -0.01, 0.02, -0.005, 0.001};
  auto const points = points_within(1.3, 200, 3);
  auto const k = matrix_of(camera.fx, camera.fy, camera.cx, camera.cy);
  cv::Vec4d const distortion(camera.k1, camera.k2, camera.k3, camera.k4);
  for (auto const& p : points) {
    auto const jacobian = camera.project_jacobian({p.x, p.y, p.z});
    double const size = cv::norm(p);
    double const h = 1e-6 * size;
    for (int axis = 0; axis < 3; ++axis) {
      cv::Point3d const step(axis == 0 ? h : 0, axis == 1 ? h : 0, axis == 2 ? h : 0);
      std::vector<cv::Point3d> const pair{p + step, p - step};
      std::vector<cv::Point2d> pixels;
      cv::fisheye::projectPoints(pair, pixels, cv::Vec3d(), cv::Vec3d(), k, distortion);
      cv::Point2d const slope = (pixels[0] - pixels[1]) / (2 * h);
      EXPECT_NEAR(jacobian.m[axis], slope.x, 1e-5 * 300 / std::abs(p.z));
      EXPECT_NEAR(jacobian.m[3 + axis], slope.y, 1e-5 * 300 / std::abs(p.z));
    }
  }
}

}  // namespace
