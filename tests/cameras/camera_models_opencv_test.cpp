// SPDX-License-Identifier: Apache-2.0
// Camera models against OpenCV's projections, and against their geometric definitions where OpenCV
// does not have them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#if __has_include(<opencv2/ccalib/omnidir.hpp>)
#include <opencv2/ccalib/omnidir.hpp>
#define FT_TEST_HAS_OMNIDIR 1
#else
#define FT_TEST_HAS_OMNIDIR 0
#endif
#include <random>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"

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
    cv::Vec3d const d(ray.direction.x, ray.direction.y, ray.direction.z);
    cv::Vec3d const off = d / cv::norm(d) - cv::Vec3d(p) / cv::norm(p);
    EXPECT_LT(cv::norm(off), 1e-9) << "looking along " << d << " for " << p;
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
    auto const jacobian = camera.project_with_jacobian({p.x, p.y, p.z}).jacobian;
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

// ---- radial-tangential distortion -----------------------------------------------------------

template <int Coefficients>
void compare_with_opencv(ft::radtan<double, Coefficients> const& camera, double angle,
                         unsigned seed) {
  auto const k = matrix_of(camera.fx, camera.fy, camera.cx, camera.cy);
  std::vector<double> const distortion(camera.distortion, camera.distortion + Coefficients);
  auto const points = points_within(angle, 2000, seed);
  std::vector<cv::Point2d> pixels;
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k, distortion, pixels);
  compare(camera, points, pixels);

  std::vector<cv::Point2d> rays;
  cv::undistortPoints(
      pixels, rays, k, distortion, cv::noArray(), cv::noArray(),
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 1000, 1e-14));
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    auto const ray = camera.unproject({pixels[i].x, pixels[i].y});
    EXPECT_EQ(ray.direction.z, 1);
    EXPECT_NEAR(ray.direction.x, rays[i].x, 1e-8);
    EXPECT_NEAR(ray.direction.y, rays[i].y, 1e-8);
  }
}

TEST(radtan_oracle, is_opencvs_with_4_coefficients) {  // EuRoC's left camera
  compare_with_opencv<4>(
      {458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}},
      0.8, 4);
}

TEST(radtan_oracle, is_opencvs_with_5_coefficients) {
  compare_with_opencv<5>({520.9, 521.0, 325.1, 249.7, {0.2312, -0.7849, -0.0033, -0.0001, 0.9172}},
                         0.7, 5);
}

TEST(radtan_oracle, is_opencvs_with_8_coefficients) {
  compare_with_opencv<8>(
      {608.1, 608.0, 638.3, 367.4, {0.52, -2.71, 0.0008, -0.0002, 1.57, 0.40, -2.53, 1.50}}, 0.8,
      6);
  compare_with_opencv<8>({400, 410, 320, 240, {0.5, 0.02, 1e-4, -2e-4, 0.001, 0.8, 0.1, 0.004}},
                         1.0, 7);
}

// ---- omnidirectional --------------------------------------------------------------------------

#if FT_TEST_HAS_OMNIDIR
TEST(unified_oracle, is_opencvs_omnidirectional_projection) {
  for (ft::unified<double> const& camera :
       {ft::unified<double>{1336.3, 1335.8, 716.9, 705.8, 2.2134, {0.0168, 1.6549, 4e-4, -3e-4}},
        ft::unified<double>{620, 625, 320, 240, 0.9, {-0.1, 0.02, -1e-3, 2e-3}},
        ft::unified<double>{460, 461, 365, 249, 0.0, {-0.1, 0.02, 1e-3, 1e-3}},
        ft::unified<double>{500, 510, 365, 249, 1.0, {0, 0, 0, 0}}}) {
    // Points behind the camera too, where the model has them.
    double const angle = camera.xi > 0 ? 1.65 : 1.0;
    auto const points = points_within(angle, 2000, 8);
    cv::Mat const objects(1, static_cast<int>(points.size()), CV_64FC3,
                          const_cast<cv::Point3d*>(points.data()));
    cv::Mat pixels;
    cv::omnidir::projectPoints(objects, pixels, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0),
                               cv::Mat(matrix_of(camera.fx, camera.fy, camera.cx, camera.cy)),
                               camera.xi,
                               cv::Mat(cv::Vec4d(camera.distortion[0], camera.distortion[1],
                                                 camera.distortion[2], camera.distortion[3])));
    std::vector<cv::Point2d> want;
    for (int i = 0; i < static_cast<int>(points.size()); ++i) {
      auto const p = pixels.at<cv::Vec2d>(i);
      want.emplace_back(p[0], p[1]);
    }
    compare(camera, points, want);
  }
}
#endif

// ---- models that OpenCV does not have: their definitions, step by step --------------------------

/// Pinhole at distance `s` behind the origin, whose image of the origin's unit plane has size 1 +
/// s.
cv::Point2d shifted_pinhole(cv::Vec3d const& p, double alpha, double fx, double fy, double cx,
                            double cy) {
  cv::Vec3d const centre(0, 0, -alpha / (1 - alpha));
  cv::Vec3d const ray = p - centre;
  return {fx / (1 - alpha) * ray[0] / ray[2] + cx, fy / (1 - alpha) * ray[1] / ray[2] + cy};
}

template <typename Camera, typename Definition>
void compare_with_definition(Camera const& camera, double angle, Definition const& definition) {
  auto const points = points_within(angle, 2000, 9);
  std::vector<cv::Point2d> want;
  for (auto const& p : points) { want.push_back(definition(cv::Vec3d(p))); }
  compare(camera, points, want);
}

TEST(double_sphere_oracle, is_two_spheres_and_a_shifted_pinhole) {
  for (ft::double_sphere<double> const& c :
       {ft::double_sphere<double>{351.037283, 350.007456, 365.888097, 249.345738, -0.238531282,
                                  0.567869485},
        ft::double_sphere<double>{150, 152, 320, 240, 0.3, 0.62},
        ft::double_sphere<double>{150, 152, 320, 240, 0.1, 0.4}}) {
    compare_with_definition(c, 1.75, [&](cv::Vec3d const& p) {
      cv::Vec3d const on_first = p / cv::norm(p);
      cv::Vec3d const second_centre(0, 0, -c.xi);
      cv::Vec3d const from_second = on_first - second_centre;
      return shifted_pinhole(from_second / cv::norm(from_second), c.alpha, c.fx, c.fy, c.cx, c.cy);
    });
  }
}

TEST(extended_unified_oracle, is_an_ellipsoid_and_a_shifted_pinhole) {
  for (ft::extended_unified<double> const& c :
       {ft::extended_unified<double>{460.979499, 459.626510, 365.886749, 249.346486, 0.591664810,
                                     1.124112540},
        ft::extended_unified<double>{200, 202, 320, 240, 0.7, 0.8},
        ft::extended_unified<double>{200, 202, 320, 240, 0.45, 1.6}}) {
    compare_with_definition(c, 1.75, [&](cv::Vec3d const& p) {
      // Where the ray meets beta (x^2 + y^2) + z^2 = 1, by bisection.
      cv::Vec3d const d = p / cv::norm(p);
      double low = 0;
      double high = 10;
      for (int i = 0; i < 200; ++i) {
        double const t = 0.5 * (low + high);
        cv::Vec3d const q = t * d;
        (c.beta * (q[0] * q[0] + q[1] * q[1]) + q[2] * q[2] < 1 ? low : high) = t;
      }
      return shifted_pinhole(low * d, c.alpha, c.fx, c.fy, c.cx, c.cy);
    });
  }
}

TEST(field_of_view_oracle, is_the_arc_tangent_of_the_undistorted_radius) {
  for (double const omega : {0.3, 0.93, 1.5}) {
    ft::field_of_view<double> const c{250, 251, 320, 240, omega};
    compare_with_definition(c, 1.4, [&](cv::Vec3d const& p) {
      double const undistorted = std::hypot(p[0], p[1]) / p[2];
      double const azimuth = std::atan2(p[1], p[0]);
      double const distorted = std::atan(2 * undistorted * std::tan(omega / 2)) / omega;
      return cv::Point2d(c.fx * distorted * std::cos(azimuth) + c.cx,
                         c.fy * distorted * std::sin(azimuth) + c.cy);
    });
  }
}

TEST(camera_models_oracle, calibrations_of_one_lens_with_three_models_see_the_same_directions) {
  // EuRoC's left camera, calibrated with each model from the same images.
  ft::double_sphere<double> const a{351.037283, 350.007456,   365.888097,
                                    249.345738, -0.238531282, 0.567869485};
  ft::extended_unified<double> const b{460.979499, 459.626510,  365.886749,
                                       249.346486, 0.591664810, 1.124112540};
  ft::kannala_brandt<double> const c{461.158190,     459.808029,  365.897239,   249.354923,
                                     -0.00459305253, 0.027532432, -0.036977672, 0.018610217};
  auto const angle = [](ft::vec3<double> p, ft::vec3<double> q) {
    cv::Vec3d const x(p.x, p.y, p.z);
    cv::Vec3d const y(q.x, q.y, q.z);
    return std::atan2(cv::norm(x.cross(y)), x.dot(y));
  };
  double largest = 0;
  for (int v = 0; v < 480; v += 20) {
    for (int u = 0; u < 752; u += 20) {
      ft::vec2<double> const pixel{static_cast<double>(u), static_cast<double>(v)};
      auto const d = a.unproject(pixel);
      ASSERT_TRUE(d.valid);
      largest = std::max({largest, angle(d.direction, b.unproject(pixel).direction),
                          angle(d.direction, c.unproject(pixel).direction)});
    }
  }
  EXPECT_LT(largest, 1.0 / 460) << "more than a pixel apart";
  EXPECT_GT(largest, 0) << "they are different models";
}

}  // namespace
