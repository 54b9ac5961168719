// SPDX-License-Identifier: Apache-2.0
// Rectification and undistortion against OpenCV: remap and convertMaps bit for bit, maps and points
// from camera models to the accuracy of OpenCV's own arithmetic.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/containers/remap_table.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/images/build_remap.hpp"
#include "ft/kernels/images/depth_association.hpp"
#include "ft/kernels/images/rectify.hpp"
#include "ft/kernels/images/undistort.hpp"
#include "tests/support/backends.hpp"

namespace rectify_oracle_test {

using host_table = ft::remap_table<ft::memory_space::host>;

ft::image_view<ft::remap_position const> position_view(cv::Mat const& m) {
  return {m.ptr<ft::remap_position>(), m.cols, m.rows, static_cast<int>(m.step / 4)};
}
ft::image_view<std::uint16_t const> fraction_view(cv::Mat const& m) {
  return {m.ptr<std::uint16_t>(), m.cols, m.rows, static_cast<int>(m.step / 2)};
}
ft::image_view<float const> float_view(cv::Mat const& m) {
  return {m.ptr<float>(), m.cols, m.rows, static_cast<int>(m.step / 4)};
}
/// A map of the table as OpenCV's, without a copy.
cv::Mat positions(ft::remap_table_view const& t) {
  return {t.sizes.height, t.sizes.width, CV_16SC2, t.position};
}
cv::Mat fractions(ft::remap_table_view const& t) {
  return {t.sizes.height, t.sizes.width, CV_16UC1, t.fraction};
}
int differing(cv::Mat const& a, cv::Mat const& b) {
  if (a.size() != b.size() || a.type() != b.type()) { return -1; }
  int count = 0;
  for (int y = 0; y < a.rows; ++y) {
    for (int x = 0; x < a.cols; ++x) {
      auto const size = static_cast<std::ptrdiff_t>(a.elemSize());
      count += static_cast<int>(
          !std::equal(a.ptr(y) + x * size, a.ptr(y) + (x + 1) * size, b.ptr(y) + x * size));
    }
  }
  return count;
}
/// Noise in a matrix whose rows have `rest` bytes more than the width.
cv::Mat noise(int width, int height, int rest, unsigned seed) {
  std::mt19937 random(seed);
  cv::Mat image(height, width + rest, CV_8U);
  for (int y = 0; y < height; ++y) {
    std::generate_n(image.ptr(y), width + rest,
                    [&] { return static_cast<std::uint8_t>(random()); });
  }
  return image.colRange(0, width);
}
cv::Mat rectified(cv::Mat const& image, ft::remap_table_view const& table, int rest, int border) {
  ft::host_exec const exec(1);
  cv::Mat to(table.sizes.height, table.sizes.width + rest, CV_8U, cv::Scalar(99));
  ft::rectify(exec, {image.data, image.cols, image.rows, static_cast<int>(image.step), 0, 1}, table,
              {to.data, table.sizes.width, table.sizes.height, static_cast<int>(to.step), 0, 1},
              static_cast<std::uint8_t>(border));
  return to.colRange(0, table.sizes.width);
}

struct shape {
  int width, height, source_width, source_height, rest;
};
constexpr shape shapes[] = {{752, 480, 752, 480, 0},    {640, 480, 512, 512, 3},
                            {97, 31, 131, 67, 1},       {333, 257, 19, 23, 7},
                            {1, 1, 64, 48, 0},          {64, 48, 1, 1, 5},
                            {17, 5, 2, 1, 2},           {5, 17, 1, 2, 2},
                            {1241, 376, 1241, 376, 13}, {1023, 3, 3, 300, 1}};

TEST(rectify_oracle, random_fixed_point_maps_give_the_pixels_of_remap) {
  ft::host_exec const exec(1);
  std::mt19937 random(17);
  for (shape const& s : shapes) {
    for (int const border : {0, 1, 255}) {
      cv::Mat position(s.height, s.width + s.rest, CV_16SC2);
      cv::Mat fraction(s.height, s.width + s.rest, CV_16UC1);
      auto const coordinate = [&](int n) {
        auto const r = random();
        int const choices[] = {-1,
                               n - 1,
                               0,
                               -2,
                               n,
                               static_cast<int>(random() % 65536u) - 32768,
                               static_cast<int>(random() % static_cast<unsigned>(n)),
                               static_cast<int>(random() % static_cast<unsigned>(n)),
                               static_cast<int>(random() % static_cast<unsigned>(n)),
                               static_cast<int>(random() % static_cast<unsigned>(n))};
        return static_cast<short>(choices[r % 10]);
      };
      for (int y = 0; y < s.height; ++y) {
        for (int x = 0; x < position.cols; ++x) {
          short const column = coordinate(s.source_width);
          position.at<cv::Vec2s>(y, x) = {column, coordinate(s.source_height)};
          auto const f = random();
          fraction.at<std::uint16_t>(y, x) =
              static_cast<std::uint16_t>(f % 5 == 0   ? 0
                                         : f % 5 == 1 ? 31 * (f / 8 % 33)
                                                      : f / 8 % 1024);
        }
      }
      cv::Mat const p = position.colRange(0, s.width);
      cv::Mat const f = fraction.colRange(0, s.width);
      cv::Mat const image =
          noise(s.source_width, s.source_height, s.rest, static_cast<unsigned>(random()));
      host_table const table({s.width, s.height, s.source_width, s.source_height});
      ft::load_remap(exec, position_view(p), fraction_view(f), table.view());
      cv::Mat want;
      cv::remap(image, want, p, f, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar(border));
      EXPECT_EQ(differing(rectified(image, table.view(), s.rest, border), want), 0)
          << s.width << "x" << s.height << " from " << s.source_width << "x" << s.source_height
          << ", border " << border;
    }
  }
}

TEST(rectify_oracle, all_fractions_give_the_pixels_of_remap) {
  ft::host_exec const exec(1);
  cv::Mat position(32, 32 * 500, CV_16SC2);
  cv::Mat fraction(position.size(), CV_16UC1);
  std::mt19937 random(18);
  for (int y = 0; y < position.rows; ++y) {
    for (int x = 0; x < position.cols; ++x) {
      position.at<cv::Vec2s>(y, x) = {static_cast<short>(random() % 80u),
                                      static_cast<short>(random() % 60u)};
      fraction.at<std::uint16_t>(y, x) = static_cast<std::uint16_t>(32 * y + x % 32);
    }
  }
  cv::Mat const image = noise(81, 61, 0, 19);
  host_table const table({position.cols, position.rows, 81, 61});
  ft::load_remap(exec, position_view(position), fraction_view(fraction), table.view());
  cv::Mat want;
  cv::remap(image, want, position, fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar(0));
  EXPECT_EQ(differing(rectified(image, table.view(), 0, 0), want), 0);
}

TEST(rectify_oracle, float_maps_become_those_of_convert_maps) {
  ft::host_exec const exec(1);
  std::mt19937 random(20);
  std::uniform_real_distribution<float> near(-40.0f, 800.0f);
  std::uniform_real_distribution<float> far(-2e5f, 2e5f);
  float const inf = std::numeric_limits<float>::infinity();
  float const odd[] = {std::numeric_limits<float>::quiet_NaN(),
                       inf,
                       -inf,
                       3e38f,
                       -3e38f,
                       67108864.0f,
                       -67108864.0f,
                       67108860.0f,
                       32767.98f,
                       32767.99f,
                       -32768.0f,
                       -32768.03f,
                       1e-42f,
                       -0.0f};
  for (shape const& s : shapes) {
    cv::Mat x(s.height, s.width + s.rest, CV_32FC1);
    cv::Mat y(s.height, s.width + s.rest, CV_32FC1);
    for (cv::Mat* m : {&x, &y}) {
      for (int i = 0; i < m->rows * m->cols; ++i) {
        float& v = m->at<float>(i / m->cols, i % m->cols);
        switch (random() % 6) {
          case 0:
            v = static_cast<float>(static_cast<int>(random() % 100000u) - 5000) / 64.0f;  // ties
            break;
          case 1:
            v = far(random);
            break;
          case 2:
            v = odd[random() % (sizeof(odd) / sizeof(odd[0]))];
            break;
          default:
            v = near(random);
        }
      }
    }
    x = x.colRange(0, s.width);
    y = y.colRange(0, s.width);
    host_table const table({s.width, s.height, s.source_width, s.source_height}, 2);
    ft::load_remap(exec, float_view(x), float_view(y), table.view(), 1);
    cv::Mat position;
    cv::Mat fraction;
    cv::convertMaps(x, y, position, fraction, CV_16SC2, false);
    auto const map = table.view().slice(1);
    EXPECT_EQ(differing(positions(map), position), 0) << s.width << "x" << s.height;
    EXPECT_EQ(differing(fractions(map), fraction), 0) << s.width << "x" << s.height;
    // And the pixels of remap through the float maps, which converts them itself.
    cv::Mat const image =
        noise(s.source_width, s.source_height, s.rest, static_cast<unsigned>(random()));
    cv::Mat want;
    cv::remap(image, want, position, fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT,
              cv::Scalar(0));
    host_table const single({s.width, s.height, s.source_width, s.source_height});
    ft::load_remap(exec, float_view(x), float_view(y), single.view());
    EXPECT_EQ(differing(rectified(image, single.view(), s.rest, 0), want), 0);
  }
}

cv::Matx33d rotation(double x, double y, double z) {
  cv::Matx33d R;
  cv::Rodrigues(cv::Vec3d(x, y, z), R);
  return R;
}
/// OpenCV's R turns raw rays into the rectified camera.
ft::mat3<double> back(cv::Matx33d const& R) {
  ft::mat3<double> m{};
  for (int i = 0; i < 9; ++i) { m.m[i] = R(i % 3, i / 3); }
  return m;
}
ft::mat3<double> forth(cv::Matx33d const& R) { return back(R).transposed(); }
template <typename Camera>
cv::Matx33d matrix(Camera const& c) {
  return {c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1};
}

/// Entries may differ by a 1/32 where OpenCV's rounding errors cross a limit.
void expect_nearly_the_same_map(ft::remap_table_view const& t, cv::Mat const& position,
                                cv::Mat const& fraction) {
  int unequal = 0;
  for (int y = 0; y < t.sizes.height; ++y) {
    for (int x = 0; x < t.sizes.width; ++x) {
      std::ptrdiff_t const i = static_cast<std::ptrdiff_t>(y) * t.sizes.width + x;
      auto const p = position.at<cv::Vec2s>(y, x);
      int const f = fraction.at<std::uint16_t>(y, x);
      int const dx = 32 * (t.position[i].x - p[0]) + (t.fraction[i] & 31) - (f & 31);
      int const dy = 32 * (t.position[i].y - p[1]) + (t.fraction[i] >> 5) - (f >> 5);
      ASSERT_LE(std::max(std::abs(dx), std::abs(dy)), 1) << x << ", " << y;
      unequal += static_cast<int>(dx != 0 || dy != 0);
    }
  }
  EXPECT_LE(unequal, 2);
}

constexpr ft::pinhole<double> wanted{301.7, 300.9, 370.3, 241.9};

TEST(rectify_oracle, a_map_from_a_fisheye_is_opencvs) {
  ft::host_exec const exec(1);
  ft::kannala_brandt<double> const cam{
      190.97847715128717,    190.9733070521226,     254.93170605935475,     256.8974428996504,
      0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182};
  cv::Matx33d const R = rotation(0.03, -0.05, 0.02);
  host_table const table({752, 480, 512, 512});
  ft::build_remap(exec, cam, back(R), wanted, table.view());
  cv::Mat position;
  cv::Mat fraction;
  cv::fisheye::initUndistortRectifyMap(matrix(cam), cv::Vec4d(cam.k1, cam.k2, cam.k3, cam.k4), R,
                                       matrix(wanted), cv::Size(752, 480), CV_16SC2, position,
                                       fraction);
  expect_nearly_the_same_map(table.view(), position, fraction);
  cv::Mat const image = noise(512, 512, 0, 4);
  cv::Mat want;
  cv::remap(image, want, positions(table.view()), fractions(table.view()), cv::INTER_LINEAR,
            cv::BORDER_CONSTANT, cv::Scalar(0));
  EXPECT_EQ(differing(rectified(image, table.view(), 0, 0), want), 0);
}

TEST(rectify_oracle, a_map_from_a_pinhole_is_opencvs) {
  ft::host_exec const exec(1);
  ft::pinhole<double> const cam{458.654, 457.296, 367.215, 248.375};
  cv::Matx33d const R = rotation(-0.02, 0.04, 0.1);
  host_table const table({752, 480, 752, 480});
  ft::build_remap(exec, cam, back(R), wanted, table.view());
  cv::Mat position;
  cv::Mat fraction;
  cv::initUndistortRectifyMap(matrix(cam), cv::noArray(), R, matrix(wanted), cv::Size(752, 480),
                              CV_16SC2, position, fraction);
  expect_nearly_the_same_map(table.view(), position, fraction);
}

/// Real calibrations: EuRoC's left camera, one with a third radial term, a rational one.
constexpr ft::radtan4<double> lens4{
    458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}};
constexpr ft::radtan5<double> lens5{517.306408,
                                    516.469215,
                                    318.643040,
                                    255.313989,
                                    {0.262383, -0.953104, -0.005358, 0.002628, 1.163314}};
constexpr ft::radtan8<double> lens8{
    600, 601, 380, 241, {0.35, -0.21, 0.0004, -0.0003, 0.011, 0.66, -0.14, -0.02}};

template <typename Camera>
cv::Mat coefficients(Camera const& c) {
  return cv::Mat(1, ft::num_params_v<Camera> - 4, CV_64F, const_cast<double*>(c.distortion))
      .clone();
}

template <typename Camera>
void expect_opencvs_radtan_map(Camera const& cam, ft::pinhole<double> const& target) {
  ft::host_exec const exec(1);
  cv::Matx33d const R = rotation(0.01, -0.02, 0.03);
  host_table const table({752, 480, 752, 480});
  ft::build_remap(exec, cam, back(R), target, table.view());
  cv::Mat position;
  cv::Mat fraction;
  cv::initUndistortRectifyMap(matrix(cam), coefficients(cam), R, matrix(target), cv::Size(752, 480),
                              CV_16SC2, position, fraction);
  expect_nearly_the_same_map(table.view(), position, fraction);
}

TEST(rectify_oracle, maps_from_radial_tangential_lenses_are_opencvs) {
  expect_opencvs_radtan_map(lens4, {420, 421, 360, 250});
  expect_opencvs_radtan_map(lens5, {700, 690, 360, 250});
  expect_opencvs_radtan_map(lens8, {500, 500, 380, 230});
}

struct points {
  std::vector<cv::Point2f> raw, out;
  std::vector<std::uint8_t> valid;
};
template <typename Camera>
points undistorted(Camera const& cam, cv::Matx33d const& R, int width, int height, unsigned seed) {
  constexpr int n = 3000;
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> px(0, static_cast<float>(width));
  std::uniform_real_distribution<float> py(0, static_cast<float>(height));
  ft::pixels<ft::memory_space::host> const p(n);
  points all;
  for (int i = 0; i < n; ++i) {
    float const x = px(random);
    all.raw.emplace_back(x, py(random));
    p.view().x(i) = all.raw.back().x;
    p.view().y(i) = all.raw.back().y;
  }
  *p.view().count = n;
  all.valid.resize(n);
  ft::host_exec const exec(1);
  ft::undistort_keypoints(exec, cam, wanted, forth(R), p.view(),
                          ft::undistorted_view{p.view(), all.valid.data()});
  for (int i = 0; i < n; ++i) { all.out.emplace_back(p.view().x(i), p.view().y(i)); }
  return all;
}
void expect_near(points const& got, std::vector<cv::Point2f> const& want, double tolerance,
                 std::size_t at_least) {
  std::size_t compared = 0;
  for (std::size_t i = 0; i < want.size(); ++i) {
    if (got.valid[i] == 0) { continue; }
    ++compared;
    ASSERT_NEAR(got.out[i].x, want[i].x, tolerance * (1 + std::abs(want[i].x))) << got.raw[i];
    ASSERT_NEAR(got.out[i].y, want[i].y, tolerance * (1 + std::abs(want[i].y))) << got.raw[i];
  }
  EXPECT_GE(compared, at_least);
}

TEST(undistort_oracle, points_of_a_pinhole_are_opencvs) {
  ft::pinhole<double> const cam{458.654, 457.296, 367.215, 248.375};
  cv::Matx33d const R = rotation(-0.02, 0.04, 0.1);
  points const got = undistorted(cam, R, 752, 480, 1);
  std::vector<cv::Point2f> want;
  cv::undistortPoints(got.raw, want, matrix(cam), cv::noArray(), R, matrix(wanted));
  expect_near(got, want, 2e-7, got.raw.size());
}

TEST(undistort_oracle, points_of_a_fisheye_are_opencvs) {
  ft::kannala_brandt<double> const cam{
      190.97847715128717,    190.9733070521226,     254.93170605935475,     256.8974428996504,
      0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182};
  cv::Matx33d const R = rotation(0.03, -0.05, 0.02);
  points got = undistorted(cam, R, 512, 512, 2);
  std::vector<cv::Point2f> want;
  cv::fisheye::undistortPoints(got.raw, want, matrix(cam),
                               cv::Vec4d(cam.k1, cam.k2, cam.k3, cam.k4), R, matrix(wanted));
  // Near 90 degrees the tangent magnifies what is left of either iteration.
  for (std::size_t i = 0; i < got.raw.size(); ++i) {
    if (std::hypot(got.raw[i].x - cam.cx, got.raw[i].y - cam.cy) > 250) { got.valid[i] = 0; }
  }
  expect_near(got, want, 1e-6, 2000);
}

template <typename Camera>
void expect_opencvs_radtan_points(Camera const& cam, int width, int height) {
  cv::Matx33d const R = rotation(0.02, -0.03, 0.01);
  points const got = undistorted(cam, R, width, height, 5);
  std::vector<cv::Point2f> want;
  cv::undistortPoints(
      got.raw, want, matrix(cam), coefficients(cam), R, matrix(wanted),
      cv::TermCriteria(cv::TermCriteria::MAX_ITER + cv::TermCriteria::EPS, 200, 1e-10));
  expect_near(got, want, 1e-6, got.raw.size() * 9 / 10);
}

TEST(undistort_oracle, points_of_radial_tangential_lenses_are_opencvs) {
  expect_opencvs_radtan_points(lens4, 752, 480);
  expect_opencvs_radtan_points(lens5, 640, 480);
  expect_opencvs_radtan_points(lens8, 752, 480);
}

TEST(undistort_oracle, bounds_are_those_of_opencvs_corners) {
  ft::kannala_brandt<double> const cam{250, 251, 170, 130, -0.01, 0.002, 0, 0};
  auto const b = ft::undistorted_bounds(cam, wanted, 340, 250);
  std::vector<cv::Point2f> const corners{{0, 0}, {340, 0}, {0, 250}, {340, 250}};
  std::vector<cv::Point2f> c;
  cv::fisheye::undistortPoints(corners, c, matrix(cam), cv::Vec4d(cam.k1, cam.k2, cam.k3, cam.k4),
                               cv::Matx33d::eye(), matrix(wanted));
  EXPECT_NEAR(b.min_x, std::min(c[0].x, c[2].x), 1e-3);
  EXPECT_NEAR(b.max_x, std::max(c[1].x, c[3].x), 1e-3);
  EXPECT_NEAR(b.min_y, std::min(c[0].y, c[1].y), 1e-3);
  EXPECT_NEAR(b.max_y, std::max(c[2].y, c[3].y), 1e-3);
}

TEST(depth_oracle, sixteen_bit_depths_are_those_of_opencvs_conversion) {
  std::mt19937 random(30);
  cv::Mat raw(1, 4096, CV_16U);
  for (int i = 0; i < raw.cols; ++i) {
    raw.at<std::uint16_t>(0, i) = static_cast<std::uint16_t>(random());
  }
  for (float const scale : {1 / 5000.0f, 0.001f, 1.0f}) {
    cv::Mat metres;
    raw.convertTo(metres, CV_32F, static_cast<double>(scale));
    ft::pixels<ft::memory_space::host> const p(raw.cols);
    for (int i = 0; i < raw.cols; ++i) {
      p.view().x(i) = static_cast<float>(i);
      p.view().y(i) = 0;
    }
    *p.view().count = raw.cols;
    ft::stereo_matches<ft::memory_space::host> const out(raw.cols);
    ft::associate_depth(
        ft::host_exec(1), p.view(), p.view(),
        ft::depth_images_view<std::uint16_t>{raw.ptr<std::uint16_t>(), raw.cols, 1,
                                             static_cast<std::ptrdiff_t>(raw.step), 0, 1},
        {40.0f, scale}, out.view());
    for (int i = 0; i < raw.cols; ++i) {
      float const m = metres.at<float>(0, i);
      EXPECT_EQ(out.view().depth(i), m > 0 ? m : -1.0f) << i;
    }
  }
}

}  // namespace rectify_oracle_test
