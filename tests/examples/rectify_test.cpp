// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/rectify.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <random>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/reader.hpp"
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/unified.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq_test::contains;
using seq_test::message_of;

constexpr double pi = 3.14159265358979323846;

/// Two different, distorted cameras, turned and shifted in all directions.
seq::stereo_rig raw_rig() {
  seq::stereo_rig rig;
  rig.left.model = rig.right.model = seq::lens::radial_tangential;
  rig.left.width = rig.right.width = 752;
  rig.left.height = rig.right.height = 480;
  rig.left.fx = 458.654;
  rig.left.fy = 457.296;
  rig.left.cx = 367.215;
  rig.left.cy = 248.375;
  rig.left.distortion = {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05};
  rig.right.fx = 450.587;
  rig.right.fy = 449.134;
  rig.right.cx = 379.999;
  rig.right.cy = 255.238;
  rig.right.distortion = {-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05, 0.001};
  rig.T_left_right.linear() =
      Eigen::AngleAxisd(0.05, Eigen::Vector3d(0.5, -1, 0.7).normalized()).toRotationMatrix();
  rig.T_left_right.translation() = Eigen::Vector3d(0.11, -0.004, 0.006);
  rig.T_body_left.linear() =
      Eigen::AngleAxisd(1.5, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  rig.T_body_left.translation() = Eigen::Vector3d(0.1, 0.2, 0.3);
  rig.fps = 20;
  return rig;
}

/// OpenCV's published formulas, written out once more.
Eigen::Vector2d reference_projection(seq::camera_intrinsics const& c, Eigen::Vector3d const& p) {
  double x = p.x() / p.z();
  double y = p.y() / p.z();
  if (c.model == seq::lens::radial_tangential) {
    std::vector<double> k = c.distortion;
    k.resize(8, 0.0);
    double const r2 = x * x + y * y;
    double const r4 = r2 * r2;
    double const r6 = r4 * r2;
    double const f =
        (1 + k[0] * r2 + k[1] * r4 + k[4] * r6) / (1 + k[5] * r2 + k[6] * r4 + k[7] * r6);
    double const xd = x * f + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x);
    double const yd = y * f + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y;
    x = xd;
    y = yd;
  } else if (c.model == seq::lens::kannala_brandt) {
    double const r = std::hypot(x, y);
    double const t = std::atan(r);
    double const d = t + c.distortion[0] * std::pow(t, 3) + c.distortion[1] * std::pow(t, 5) +
                     c.distortion[2] * std::pow(t, 7) + c.distortion[3] * std::pow(t, 9);
    x *= r > 0 ? d / r : 1;
    y *= r > 0 ? d / r : 1;
  }
  return {c.fx * x + c.cx, c.fy * y + c.cy};
}

/// For random pixels and whole disparities: the maps at corresponding rectified pixels of one row
/// must show the raw projections of one point in space.
void expect_rows_and_maps_match(seq::stereo_rig const& raw, seq::rectifier const& rectify,
                                double* worst = nullptr) {
  seq::camera_intrinsics const& c = rectify.rig().left;
  ASSERT_TRUE(rectify.rig().rectified());
  std::mt19937 random(7);
  std::uniform_int_distribution<int> column(0, c.width - 1);
  std::uniform_int_distribution<int> row(0, c.height - 1);
  std::uniform_int_distribution<int> disparity(1, 100);
  double largest = 0;
  int tested = 0;
  for (int i = 0; i < 20000; ++i) {
    int const u = column(random);
    int const v = row(random);
    int const d = disparity(random);
    if (u < d) { continue; }
    std::size_t const left = static_cast<std::size_t>(v * c.width + u);
    std::size_t const right = left - static_cast<std::size_t>(d);
    if (rectify.left_map().x[left] < 0 || rectify.right_map().x[right] < 0) { continue; }
    double const z = c.fx * rectify.rig().baseline() / d;
    Eigen::Vector3d const rectified((u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z);
    Eigen::Vector3d const point = rectify.left_rotation().transpose() * rectified;
    Eigen::Vector2d const l = reference_projection(raw.left, point);
    Eigen::Vector2d const r = reference_projection(raw.right, raw.T_left_right.inverse() * point);
    Eigen::Vector2d const map_l(rectify.left_map().x[left], rectify.left_map().y[left]);
    Eigen::Vector2d const map_r(rectify.right_map().x[right], rectify.right_map().y[right]);
    largest = std::max({largest, (l - map_l).norm(), (r - map_r).norm()});
    ++tested;
  }
  EXPECT_GT(tested, 10000);
  EXPECT_LT(largest, 1e-3);
  if (worst != nullptr) { *worst = largest; }
}

/// Compared with ft's model in all directions that the reader's 84 degrees hold, and behind.
template <typename Camera>
void expect_same_lens(seq::camera_intrinsics const& camera, Camera const& expected,
                      int least_unseen = 20) {
  seq::lens_projection const lens(camera);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> side(-1, 1);
  int seen = 0;
  int unseen = 0;
  for (int i = 0; i < 4000; ++i) {
    Eigen::Vector3d const p(side(random), side(random), side(random));
    auto const want = expected.project({p.x(), p.y(), p.z()});
    auto const got = lens(p);
    ASSERT_EQ(got.valid, want.valid != 0) << p.transpose();
    unseen += static_cast<int>(!got.valid);
    if (!got.valid) { continue; }
    ++seen;
    ASSERT_NEAR(got.pixel.x(), want.pixel.x, 1e-6 * (1 + std::fabs(want.pixel.x)));
    ASSERT_NEAR(got.pixel.y(), want.pixel.y, 1e-6 * (1 + std::fabs(want.pixel.y)));
    if (p.z() > 0.2 * p.norm()) {
      auto const back = lens.unproject(got.pixel);
      ASSERT_TRUE(back.valid) << p.transpose();
      ASSERT_LT((back.pixel - p.hnormalized()).norm(), 1e-6);
    } else if (p.z() < 0) {
      ASSERT_FALSE(lens.unproject(got.pixel).valid);
    }
  }
  EXPECT_GT(seen, 2000);
  EXPECT_GE(unseen, least_unseen);
}

seq::camera_intrinsics wide_camera(seq::lens model, std::vector<double> numbers) {
  seq::camera_intrinsics c = raw_rig().left;
  c.model = model;
  c.distortion = std::move(numbers);
  return c;
}

TEST(lens_projection, spheres_agree_with_ft) {
  using seq::lens;
  auto const f = raw_rig().left;
  for (auto const& [xi, alpha] :
       {std::pair(-0.2, 0.59), std::pair(0.3, 0.4), std::pair(0.0, 0.7)}) {
    expect_same_lens(wide_camera(lens::double_sphere, {xi, alpha}),
                     ft::double_sphere<double>{f.fx, f.fy, f.cx, f.cy, xi, alpha});
  }
  for (double const xi : {0.4, 1.0, 1.9}) {
    expect_same_lens(wide_camera(lens::unified, {xi, 0, 0, 0, 0}),
                     ft::unified<double>{f.fx, f.fy, f.cx, f.cy, xi, 0, 0, 0, 0},
                     xi == 1.0 ? 0 : 20);  // with 1 all but the direction straight back is seen
  }
  for (auto const& [alpha, beta] : {std::pair(0.6, 1.1), std::pair(0.4, 0.8)}) {
    expect_same_lens(wide_camera(lens::extended_unified, {alpha, beta}),
                     ft::extended_unified<double>{f.fx, f.fy, f.cx, f.cy, alpha, beta});
  }
}

TEST(lens_projection, field_of_view_agrees_with_ft) {
  for (double const omega : {0.01, 0.9, 1.8}) {
    seq::camera_intrinsics const c = wide_camera(seq::lens::field_of_view, {omega});
    ft::field_of_view<double> const want{c.fx, c.fy, c.cx, c.cy, omega};
    seq::lens_projection const lens(c);
    for (double x = -3; x <= 3; x += 0.25) {
      for (double y = -3; y <= 3; y += 0.25) {
        auto const got = lens({x, y, 1});
        auto const pixel = want.project({x, y, 1.0}).pixel;
        ASSERT_TRUE(got.valid);
        ASSERT_LT((got.pixel - Eigen::Vector2d(pixel.x, pixel.y)).norm(), 1e-9);
        ASSERT_LT((lens.unproject(got.pixel).pixel - Eigen::Vector2d(x, y)).norm(), 1e-9);
      }
    }
    EXPECT_FALSE(lens({1, 1, 0}).valid);
    EXPECT_FALSE(lens.unproject({c.cx + c.fx * 1.6 / omega, c.cy}).valid);  // above 90 degrees
    EXPECT_NEAR(seq::scale_on_axis(c),
                (want.project({1e-6, 0.0, 1.0}).pixel.x - c.cx) / (1e-6 * c.fx), 1e-6);
  }
}

TEST(lens_projection, unified_with_distortion_agrees_with_ft_in_front) {
  seq::camera_intrinsics const c = wide_camera(seq::lens::unified, {1.6, -0.2, 0.1, 0.001, -0.002});
  ft::unified<double> const want{c.fx, c.fy, c.cx, c.cy, 1.6, -0.2, 0.1, 0.001, -0.002};
  seq::lens_projection const lens(c);
  for (double x = -1; x <= 1; x += 0.125) {
    for (double y = -1; y <= 1; y += 0.125) {
      auto const got = lens({x, y, 1});
      auto const pixel = want.project({x, y, 1.0}).pixel;
      ASSERT_TRUE(got.valid);
      ASSERT_LT((got.pixel - Eigen::Vector2d(pixel.x, pixel.y)).norm(), 1e-9);
      ASSERT_LT((lens.unproject(got.pixel).pixel - Eigen::Vector2d(x, y)).norm(), 1e-8);
    }
  }
}

TEST(lens_projection, agrees_with_the_formulas_and_inverts) {
  seq::camera_intrinsics fisheye = raw_rig().left;
  fisheye.model = seq::lens::kannala_brandt;
  fisheye.distortion = {0.0008, 0.031, -0.03, 0.005};
  seq::camera_intrinsics rational = raw_rig().left;
  rational.distortion = {0.5, 0.02, 1e-4, -2e-4, 0.001, 0.8, 0.1, 0.004};
  seq::camera_intrinsics ideal = raw_rig().left;
  ideal.model = seq::lens::pinhole;
  ideal.distortion.clear();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> side(-0.8, 0.8);
  for (seq::camera_intrinsics const& camera : {raw_rig().left, rational, fisheye, ideal}) {
    seq::lens_projection const lens(camera);
    for (int i = 0; i < 500; ++i) {
      Eigen::Vector3d const p = Eigen::Vector3d(side(random), side(random), 1) * 2.5;
      seq::projected_pixel const pixel = lens(p);
      ASSERT_TRUE(pixel.valid);
      EXPECT_LT((pixel.pixel - reference_projection(camera, p)).norm(), 1e-9);
      seq::projected_pixel const back = lens.unproject(pixel.pixel);
      ASSERT_TRUE(back.valid);
      EXPECT_LT((back.pixel - p.hnormalized()).norm(), 1e-8);
    }
    EXPECT_TRUE(lens({0, 0, 1}).valid);
    EXPECT_FALSE(lens({std::nan(""), 0, 1}).valid);
  }
  EXPECT_FALSE(seq::lens_projection(ideal)({0, 0, -1}).valid);
  EXPECT_FALSE(seq::lens_projection(raw_rig().left)({0.1, 0, 0}).valid);
  // r (1 - 0.4 r^2) folds back at r = 0.913.
  seq::camera_intrinsics folding = raw_rig().left;
  folding.distortion = {-0.4, 0, 0, 0};
  EXPECT_TRUE(seq::lens_projection(folding)({0.90, 0, 1}).valid);
  EXPECT_FALSE(seq::lens_projection(folding)({0.93, 0, 1}).valid);
  // A fisheye sees beyond 90 degrees.
  fisheye.distortion = {0, 0, 0, 0};
  seq::projected_pixel const behind = seq::lens_projection(fisheye)({1, 0, -0.1});
  ASSERT_TRUE(behind.valid);
  EXPECT_NEAR(behind.pixel.x(), fisheye.cx + fisheye.fx * (0.5 * pi + std::atan(0.1)), 1e-9);
}

TEST(rectifier, rows_correspond_and_maps_show_the_raw_pixels) {
  seq::stereo_rig const raw = raw_rig();
  seq::rectifier const rectify(raw);
  expect_rows_and_maps_match(raw, rectify);
  seq::stereo_rig const& rig = rectify.rig();
  EXPECT_EQ(rectify.valid_fraction(), 1.0);
  EXPECT_EQ(rig.left.width, 752);
  EXPECT_EQ(rig.left.height, 480);
  EXPECT_EQ(rig.fps, 20);
  EXPECT_GT(rig.left.fx, 0.8 * raw.left.fx);
  EXPECT_LT(rig.left.fx, 1.2 * raw.left.fx);
  EXPECT_NEAR(rig.baseline(), raw.baseline(), 1e-15);
}

TEST(rectifier, turns_half_way_and_moves_the_body_frame) {
  seq::stereo_rig const raw = raw_rig();
  seq::rectifier const rectify(raw);
  // Both raw cameras turn by about the same angle.
  double const left = Eigen::AngleAxisd(rectify.left_rotation()).angle();
  double const right = Eigen::AngleAxisd(rectify.right_rotation()).angle();
  EXPECT_LT(std::max(left, right), 0.09);
  EXPECT_NEAR(rectify.left_rotation().determinant(), 1, 1e-12);
  Eigen::Matrix3d const between = rectify.left_rotation().transpose() * rectify.right_rotation();
  EXPECT_LT((between - raw.T_left_right.linear()).norm(), 1e-12);
  Eigen::Vector3d const point(1, 2, 3);
  Eigen::Vector3d const body = raw.T_body_left * point;
  Eigen::Vector3d const turned = rectify.left_rotation() * point;
  EXPECT_LT((rectify.rig().T_body_left * turned - body).norm(), 1e-12);
}

TEST(rectifier, leaves_a_rectified_pair_as_it_is) {
  seq::stereo_rig rig;
  rig.left.width = 320;
  rig.left.height = 200;
  rig.left.fx = rig.left.fy = 230;
  rig.left.cx = 163.7;
  rig.left.cy = 97.7;
  rig.right = rig.left;
  rig.T_left_right.translation() = Eigen::Vector3d(0.08, 0, 0);
  seq::rectifier const rectify(rig);
  EXPECT_NEAR(rectify.rig().left.fx, 230, 1e-9);
  EXPECT_NEAR(rectify.rig().left.cx, 163.7, 1e-9);
  EXPECT_NEAR(rectify.rig().left.cy, 97.7, 1e-9);
  seq::image picture;
  picture.width = 320;
  picture.height = 200;
  std::mt19937 random(1);
  for (int i = 0; i < 320 * 200; ++i) {
    picture.pixels.push_back(static_cast<std::uint8_t>(random() & 255U));
  }
  EXPECT_EQ(rectify.left(picture).pixels, picture.pixels);
  EXPECT_EQ(rectify.right(picture).pixels, picture.pixels);
}

TEST(rectifier, makes_pinholes_of_wide_fisheyes) {
  seq::stereo_rig rig = raw_rig();
  for (seq::camera_intrinsics* camera : {&rig.left, &rig.right}) {
    camera->model = seq::lens::kannala_brandt;
    camera->width = 848;
    camera->height = 800;
    camera->fx = 284.468;
    camera->fy = 285.51;
    camera->cx = 424.355;
    camera->cy = 393.742;
    camera->distortion = {0.0008, 0.031, -0.03, 0.005};
  }
  seq::rectifier const rectify(rig);
  expect_rows_and_maps_match(rig, rectify);
  EXPECT_EQ(rectify.valid_fraction(), 1.0);
  EXPECT_GT(rectify.rig().left.fx, 0.74 * 284);
  EXPECT_NEAR(rectify.rig().left.cx, 424, 40);
}

TEST(rectifier, refuses_pairs_without_common_rows) {
  seq::stereo_rig swapped = raw_rig();
  swapped.T_left_right = swapped.T_left_right.inverse();
  EXPECT_TRUE(contains(message_of([&] { seq::rectifier r(swapped); }), "swapped"));
  seq::stereo_rig vertical = raw_rig();
  vertical.T_left_right.translation() = Eigen::Vector3d(0, 0.1, 0);
  EXPECT_TRUE(contains(message_of([&] { seq::rectifier r(vertical); }), "45"));
  seq::stereo_rig back_to_back = raw_rig();
  back_to_back.T_left_right.linear() =
      Eigen::AngleAxisd(pi, Eigen::Vector3d::UnitY()).toRotationMatrix();
  EXPECT_TRUE(contains(message_of([&] { seq::rectifier r(back_to_back); }), "at most 60"));
}

TEST(rectifier, widely_turned_views_still_give_numbers) {
  seq::stereo_rig rig = raw_rig();
  rig.T_left_right.linear() = Eigen::AngleAxisd(1.0, Eigen::Vector3d::UnitY()).toRotationMatrix();
  seq::rectifier const rectify(rig);
  EXPECT_TRUE(std::isfinite(rectify.rig().left.cx + rectify.rig().left.cy));
  EXPECT_GT(rectify.rig().left.fx, 0);
  EXPECT_GE(rectify.valid_fraction(), 0);
}

TEST(remap_table, interpolates_within_a_grey_level) {
  seq::image source;
  source.width = 40;
  source.height = 30;
  std::mt19937 random(5);
  for (int i = 0; i < 40 * 30; ++i) {
    source.pixels.push_back(static_cast<std::uint8_t>(random() & 255U));
  }
  seq::pixel_map map;
  map.width = 100;
  map.height = 70;
  std::uniform_int_distribution<int> x32(0, 39 * 32);
  std::uniform_int_distribution<int> y32(0, 29 * 32);
  for (int i = 0; i < 7000; ++i) {
    map.x.push_back(static_cast<float>(x32(random)) / 32);
    map.y.push_back(static_cast<float>(y32(random)) / 32);
  }
  seq::remap_table const table(map, 40, 30);
  EXPECT_EQ(table.valid_fraction(), 1.0);
  seq::image const result = table.apply(source);
  ASSERT_EQ(result.width, 100);
  ASSERT_EQ(result.pixels.size(), 7000U);
  for (std::size_t i = 0; i < 7000; ++i) {
    int const x = std::min(static_cast<int>(map.x[i]), 38);
    int const y = std::min(static_cast<int>(map.y[i]), 28);
    double const fx = static_cast<double>(map.x[i]) - x;
    double const fy = static_cast<double>(map.y[i]) - y;
    double const expected = (1 - fy) * ((1 - fx) * source.row(y)[x] + fx * source.row(y)[x + 1]) +
                            fy * ((1 - fx) * source.row(y + 1)[x] + fx * source.row(y + 1)[x + 1]);
    ASSERT_NEAR(result.pixels[i], expected, 0.5 + 1e-9);
  }
}

TEST(remap_table, borders_and_bad_input) {
  seq::image source;
  source.width = 3;
  source.height = 2;
  source.pixels = {10, 20, 30, 40, 50, 60};
  seq::pixel_map map;
  map.width = 6;
  map.height = 1;
  map.x = {-0.4F, 2.4F, 2.0F, -1.0F, 2.6F, std::nanf("")};
  map.y = {-0.4F, 1.4F, 0.0F, -1.0F, 0.0F, 0.0F};
  seq::remap_table const table(map, 3, 2);
  EXPECT_EQ(table.apply(source).pixels, (std::vector<std::uint8_t>{10, 60, 30, 0, 0, 0}));
  EXPECT_EQ(table.valid_fraction(), 0.5);
  seq::image wrong = source;
  wrong.width = 2;
  EXPECT_TRUE(contains(message_of([&] { table.apply(wrong); }), "2 x 2 pixels, must be 3 x 2"));
  wrong = source;
  wrong.pixels.pop_back();
  EXPECT_THROW(table.apply(wrong), seq::error);
  EXPECT_THROW(seq::remap_table(map, 1, 2), seq::error);
  map.x.pop_back();
  EXPECT_THROW(seq::remap_table(map, 3, 2), seq::error);
}

TEST(rectifier_real, calibrations_of_real_rigs) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  for (char const* name : {"euroc_v101_flight", "kitti_raw_0926", "kb8_overlap", "t265_kb8"}) {
    seq::stereo_rig const raw =
        seq::read_calibration(shared + "/golden/" + name + "/settings.yaml").rig;
    seq::rectifier const rectify(raw);
    double worst = 0;
    expect_rows_and_maps_match(raw, rectify, &worst);
    EXPECT_GT(rectify.valid_fraction(), 0.999) << name;
    seq::camera_intrinsics const& c = rectify.rig().left;
    std::cout << name << ": focal length " << raw.left.fx << " -> " << c.fx << ", centre " << c.cx
              << " " << c.cy << ", valid " << rectify.valid_fraction() << ", worst map error "
              << worst << " px\n";
  }
}

/// Correlation of two 15x15 windows, -1..1, whatever their brightness and contrast.
double correlation(seq::image const& a, int ax, int ay, seq::image const& b, int bx, int by) {
  constexpr int halved = 7;
  int n = 0;
  double sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (int v = -halved; v <= halved; ++v) {
    for (int u = -halved; u <= halved; ++u, ++n) {
      double const p = a.row(ay + v)[ax + u];
      double const q = b.row(by + v)[bx + u];
      sa += p;
      sb += q;
      saa += p * p;
      sbb += q * q;
      sab += p * q;
    }
  }
  double const variance = (saa - sa * sa / n) * (sbb - sb * sb / n);
  return variance > 0 ? (sab - sa * sb / n) / std::sqrt(variance) : -1;
}

/// By how many rows the right image of a left window is off, searched over rows -4..4 and
/// disparities 1..60; NaN where the windows do not match well.
double row_offset(seq::image const& left, seq::image const& right, int x, int y) {
  constexpr int rows = 4;
  double best = 0;
  int best_dy = 0;
  int best_d = 0;
  for (int dy = -rows; dy <= rows; ++dy) {
    for (int d = 1; d <= 60; ++d) {
      double const score = correlation(left, x, y, right, x - d, y + dy);
      if (score > best) {
        best = score;
        best_dy = dy;
        best_d = d;
      }
    }
  }
  if (best < 0.95 || std::abs(best_dy) == rows) { return std::nan(""); }
  double const above = correlation(left, x, y, right, x - best_d, y + best_dy - 1);
  double const below = correlation(left, x, y, right, x - best_d, y + best_dy + 1);
  return best_dy + 0.5 * (below - above) / (2 * best - above - below);  // of the parabola
}

TEST(rectifier_real, rows_of_real_images_correspond) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  seq::sequence const sequence = seq::sequence::open(shared + "/data/euroc_v101_stereo_start");
  std::vector<double> offsets;
  for (int i : {0, 8}) {
    seq::stereo_frame const frame = sequence.load(i);
    for (int y = 30; y < 450; y += 12) {
      for (int x = 100; x < 720; x += 12) {
        int vertical = 0;  // rows can be told apart only where grey values change along y
        int horizontal = 0;
        for (int v = -7; v < 7; ++v) {
          for (int u = -7; u < 7; ++u) {
            vertical += std::abs(frame.left.row(y + v + 1)[x + u] - frame.left.row(y + v)[x + u]);
            horizontal += std::abs(frame.left.row(y + v)[x + u + 1] - frame.left.row(y + v)[x + u]);
          }
        }
        if (std::min(vertical, horizontal) < 196 * 4) { continue; }
        double const offset = row_offset(frame.left, frame.right, x, y);
        if (!std::isnan(offset)) { offsets.push_back(std::fabs(offset)); }
      }
    }
  }
  ASSERT_GT(offsets.size(), 50U);
  std::sort(offsets.begin(), offsets.end());
  double const median = offsets[offsets.size() / 2];
  double const p90 = offsets[offsets.size() * 9 / 10];
  std::cout << "EuRoC rows after rectification: " << offsets.size() << " windows, |dy| median "
            << median << " px, 90 % " << p90 << " px\n";
  EXPECT_LT(median, 0.25);
  EXPECT_LT(p90, 0.75);
}

}  // namespace
