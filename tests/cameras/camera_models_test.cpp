// SPDX-License-Identifier: Apache-2.0
// Facts of single camera models: special cases, domains, ranges; and the inspection of an image.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/field_of_view.hpp"
#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/unified.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/refusals.hpp"

namespace camera_models_test {

constexpr double pi = 3.14159265358979323846;
double const nan = std::numeric_limits<double>::quiet_NaN();
double const infinity = std::numeric_limits<double>::infinity();

/// EuRoC's left camera, 752 x 480.
ft::radtan4<double> euroc() {
  return {
      458.654, 457.296, 367.215, 248.375, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}};
}
ft::double_sphere<double> euroc_double_sphere() {
  return {351.037283, 350.007456, 365.888097, 249.345738, -0.238531282, 0.567869485};
}
ft::extended_unified<double> euroc_extended_unified() {
  return {460.979499, 459.626510, 365.886749, 249.346486, 0.591664810, 1.124112540};
}
ft::radtan5<double> five() {
  return {520.9, 521.0, 325.1, 249.7, {0.2312, -0.7849, -0.0033, -0.0001, 0.9172}};
}
ft::radtan8<double> eight() {
  return {608.1, 608.0, 638.3, 367.4, {0.52, -2.71, 0.0008, -0.0002, 1.57, 0.40, -2.53, 1.50}};
}
/// A lens of 180 degrees, 1400 x 1400.
ft::unified<double> wide() {
  return {1336.3, 1335.8, 716.9, 705.8, 2.2134, {0.0168, 1.6549, 0.00042, 0.00042}};
}
ft::field_of_view<double> fov() { return {250.0, 251.0, 320.0, 240.0, 0.93}; }

/// Largest distance of projections of two cameras over points with depths of both signs.
template <typename A, typename B>
double largest_difference(A const& a, B const& b, bool behind) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> side(-3, 3);
  double largest = 0;
  int compared = 0;
  for (int i = 0; i < 2000; ++i) {
    ft::vec3<double> const p{side(random), side(random),
                             behind ? side(random) : 0.1 + std::abs(side(random))};
    auto const x = a.project(p);
    auto const y = b.project(p);
    EXPECT_EQ(x.valid, y.valid) << p.x << " " << p.y << " " << p.z;
    if (!x.valid || !y.valid) { continue; }
    ++compared;
    largest = std::max(largest, std::hypot(x.pixel.x - y.pixel.x, x.pixel.y - y.pixel.y) /
                                    (1 + std::hypot(x.pixel.x, x.pixel.y)));
  }
  EXPECT_GT(compared, 500);
  return largest;
}

// ---- special cases ----------------------------------------------------------------------------

TEST(radtan_unit, without_distortion_is_the_pinhole) {
  ft::pinhole<double> const plain{400, 410, 320, 240};
  EXPECT_LT(largest_difference(plain, ft::radtan4<double>{400, 410, 320, 240, {}}, true), 1e-14);
  EXPECT_LT(largest_difference(plain, ft::radtan5<double>{400, 410, 320, 240, {}}, true), 1e-14);
  EXPECT_LT(largest_difference(plain, ft::radtan8<double>{400, 410, 320, 240, {}}, true), 1e-14);
}

TEST(radtan_unit, more_coefficients_at_zero_change_nothing) {
  auto const c = euroc();
  ft::radtan5<double> a{c.fx, c.fy, c.cx, c.cy, {}};
  ft::radtan8<double> b{c.fx, c.fy, c.cx, c.cy, {}};
  std::copy(c.distortion, c.distortion + 4, a.distortion);
  std::copy(c.distortion, c.distortion + 4, b.distortion);
  EXPECT_LT(largest_difference(c, a, false), 1e-14);
  EXPECT_LT(largest_difference(c, b, false), 1e-14);
}

TEST(unified_unit, without_shift_is_radtan4_and_without_distortion_the_pinhole) {
  auto const c = euroc();
  ft::unified<double> u{c.fx, c.fy, c.cx, c.cy, 0, {}};
  EXPECT_LT(largest_difference(ft::pinhole<double>{c.fx, c.fy, c.cx, c.cy}, u, true), 1e-13);
  std::copy(c.distortion, c.distortion + 4, u.distortion);
  EXPECT_LT(largest_difference(c, u, false), 1e-13);
}

TEST(double_sphere_unit, with_one_sphere_is_the_unified_camera_and_extended_unified) {
  // alpha = xi' / (1 + xi') and focal lengths times 1 + xi'.
  for (double const shift : {0.0, 0.3, 1.0, 1.8}) {
    double const alpha = shift / (1 + shift);
    ft::unified<double> const u{300 * (1 + shift), 310 * (1 + shift), 320, 240, shift, {}};
    ft::double_sphere<double> const d{300, 310, 320, 240, 0, alpha};
    ft::extended_unified<double> const e{300, 310, 320, 240, alpha, 1};
    EXPECT_LT(largest_difference(u, d, true), 1e-11) << shift;
    EXPECT_LT(largest_difference(u, e, true), 1e-11) << shift;
  }
}

TEST(field_of_view_unit, reaches_the_pinhole_as_omega_vanishes) {
  ft::pinhole<double> const plain{400, 410, 320, 240};
  ft::field_of_view<double> c{400, 410, 320, 240, 0};
  EXPECT_LT(largest_difference(plain, c, true), 1e-14);
  EXPECT_NO_THROW(c.check());
  for (double const omega : {0.9e-8, 1.1e-8, 1e-7}) {
    c.omega = omega;
    auto const p = c.project({0.4, -0.7, 1});
    EXPECT_NEAR(p.pixel.x, 480, 1e-9);
    EXPECT_NEAR(p.pixel.y, -47, 1e-9);
    auto const r = c.unproject({480, -47});
    EXPECT_TRUE(r.valid);
    EXPECT_NEAR(r.direction.x, 0.4, 1e-12);
    EXPECT_NEAR(r.direction.y, -0.7, 1e-12);
  }
}

TEST(field_of_view_unit, a_point_at_half_of_omega_is_undistorted_at_the_ideal_radius) {
  // tan(omega / 2) is the one radius whose image is atan(2 tan^2(omega / 2)) / omega.
  auto const c = fov();
  double const r = std::tan(c.omega / 2);
  EXPECT_NEAR(c.project({r, 0, 1}).pixel.x, c.cx + c.fx * std::atan(2 * r * r) / c.omega, 1e-10);
}

TEST(field_of_view_unit, the_image_ends_where_the_ray_is_sideways) {
  auto const c = fov();
  double const edge = pi / 2 / c.omega * c.fx;
  auto const inside = c.unproject({c.cx + edge * (1 - 1e-9), c.cy});
  EXPECT_TRUE(inside.valid);
  EXPECT_GT(inside.direction.x, 1e8);
  EXPECT_FALSE(c.unproject({c.cx + edge * (1 + 1e-9), c.cy}).valid);
  EXPECT_NEAR(c.project({1e9, 0, 1}).pixel.x, c.cx + edge, 1e-6);
  EXPECT_FALSE(c.project({1, 0, 0}).valid);
  EXPECT_FALSE(c.project({1, 0, -1}).valid);
}

TEST(field_of_view_unit, next_to_the_axis_the_jacobian_is_that_of_the_axis) {
  auto const c = fov().cast<float>();
  auto const at = c.project_with_jacobian({0, 0, 2}).jacobian;
  for (float const x : {1e-25f, 1e-20f, 1e-15f, 1e-8f}) {
    auto const near = c.project_with_jacobian({x, -x, 2}).jacobian;
    for (int i = 0; i < 6; ++i) { EXPECT_NEAR(near.m[i], at.m[i], 1e-3) << x; }
  }
}

// ---- domains ------------------------------------------------------------------------------------

/// r (1 + k1 r^2): folds at r = sqrt(-1 / (3 k1)), where it is 2 r / 3.
TEST(radtan_unit, beyond_the_fold_there_is_no_pixel) {
  ft::radtan4<double> const c{100, 100, 0, 0, {-0.4, 0, 0, 0}};
  double const fold = std::sqrt(1 / 1.2);
  EXPECT_TRUE(c.project({fold * (1 - 1e-9), 0, 1}).valid);
  EXPECT_TRUE(c.project({0, -fold * (1 - 1e-9), 1}).valid);
  EXPECT_FALSE(c.project({fold * (1 + 1e-9), 0, 1}).valid);
  EXPECT_FALSE(c.project({1.5, 0, 1}).valid) << "a ghost: 1.5 (1 - 0.9) = 0.15";
  EXPECT_TRUE(c.unproject({200 * fold / 3 * (1 - 1e-9), 0}).valid);
  EXPECT_FALSE(c.unproject({200 * fold / 3 * (1 + 1e-9), 0}).valid);
  EXPECT_FALSE(c.unproject({0, 90}).valid);
}

TEST(radtan_unit, a_second_rise_after_the_fold_is_not_believed) {
  // Derivative (1 - s)(1 - s / 2), s = r^2: falls between r = 1 and sqrt(2), rises again after.
  ft::radtan4<double> const c{100, 100, 0, 0, {-1.5 / 3, 0.5 / 5, 0, 0}};
  EXPECT_TRUE(c.project({0.999, 0, 1}).valid);
  EXPECT_FALSE(c.project({1.2, 0, 1}).valid);
  EXPECT_FALSE(c.project({2.0, 0, 1}).valid);
  // (1 - s)^2 (1 + s) touches zero, then rises again; nothing folds, and it is given up at 1.
  ft::radtan5<double> const touching{100, 100, 0, 0, {-1.0 / 3, -1.0 / 5, 0, 0, 1.0 / 7}};
  EXPECT_TRUE(touching.project({0.99, 0, 1}).valid);
  EXPECT_FALSE(touching.project({1.5, 0, 1}).valid);
}

TEST(radtan_unit, beyond_a_pole_of_the_denominator_there_is_no_pixel) {
  ft::radtan8<double> const c{100, 100, 0, 0, {0, 0, 0, 0, 0, -0.5, 0, 0}};  // pole at sqrt(2)
  EXPECT_TRUE(c.project({1.41, 0, 1}).valid);
  EXPECT_FALSE(c.project({1.42, 0, 1}).valid);
  EXPECT_FALSE(c.project({5, 0, 1}).valid);
}

TEST(radtan_unit, a_start_outside_the_domain_finds_its_ray) {
  // r + 0.5 r^3 - 0.3 r^5 folds at r = 1.207, where it is 1.318: the pixel at 1.3 starts beyond.
  ft::radtan4<double> const c{100, 100, 0, 0, {0.5, -0.3, 0, 0}};
  auto const r = c.unproject({78, 104});
  ASSERT_TRUE(r.valid);
  EXPECT_LT(std::hypot(r.direction.x, r.direction.y), 1.2072);
  auto const back = c.project(r.direction);
  EXPECT_TRUE(back.valid);
  EXPECT_NEAR(back.pixel.x, 78, 1e-9);
  EXPECT_NEAR(back.pixel.y, 104, 1e-9);
}

/// The radial part of the distortion in long double, and where it first stops growing.
struct radial {
  std::vector<long double> k;  // as in radtan, 8 of them
  long double operator()(long double r) const {
    long double const s = r * r;
    return r * (1 + s * (k[0] + s * (k[1] + s * k[4]))) / (1 + s * (k[5] + s * (k[6] + s * k[7])));
  }
  long double end(long double limit) const {
    long double const step = limit / 20000;
    long double before = 0;
    for (long double r = step; r < limit; r += step) {
      long double const s = r * r;
      long double const now = (*this)(r);
      if (!(now > before) || !(1 + s * (k[5] + s * (k[6] + s * k[7])) > 0)) { return r; }
      before = now;
    }
    return limit;
  }
};

template <int Coefficients>
void compare_domain_with_a_scan(unsigned seed, double size) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> coefficient(-size, size);
  int folding = 0;
  int whole = 0;
  for (int i = 0; i < 400; ++i) {
    ft::radtan<double, Coefficients> c{100, 100, 0, 0, {}};
    radial scan{std::vector<long double>(8, 0)};
    for (int j = 0; j < Coefficients; ++j) {
      if (j == 2 || j == 3) { continue; }
      c.distortion[j] = coefficient(random);
      scan.k[static_cast<std::size_t>(j)] = c.distortion[j];
    }
    auto const end = static_cast<double>(scan.end(3));
    ++(end < 3 ? folding : whole);
    for (int j = 1; j <= 60; ++j) {
      double const r = 3.0 * j / 60;
      if (std::abs(r - end) < 1e-3) { continue; }
      EXPECT_EQ(c.project({0.6 * r, 0.8 * r, 1}).valid, r < end)
          << "r = " << r << ", growing up to " << end;
    }
  }
  EXPECT_GT(folding, 20);
  EXPECT_GT(whole, 20);
}

TEST(radtan_unit, the_domain_ends_where_the_radius_stops_growing) {
  compare_domain_with_a_scan<4>(1, 0.1);
  compare_domain_with_a_scan<5>(2, 0.1);
  compare_domain_with_a_scan<8>(3, 0.3);
}

TEST(radtan_unit, with_tangential_terms_the_domain_is_one_to_one_and_hardly_smaller) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> k(-0.4, -0.05);
  std::uniform_real_distribution<double> p(-0.02, 0.02);
  for (int i = 0; i < test::effort(100); ++i) {
    ft::radtan4<double> const c{1, 1, 0, 0, {k(random), 0, p(random), p(random)}};
    double const fold = std::sqrt(-1 / (3 * c.distortion[0]));
    double smallest = infinity;  // radius where a direction's determinant turns, by differences
    double largest_valid = 0;
    for (int d = 0; d < 48; ++d) {
      double const cs = std::cos(2 * pi * d / 48);
      double const sn = std::sin(2 * pi * d / 48);
      auto const map = [&](double x, double y) {
        double const s = x * x + y * y;
        double const f = 1 + c.distortion[0] * s;
        double const p1 = c.distortion[2];
        double const p2 = c.distortion[3];
        return ft::vec2<double>{x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x),
                                y * f + p1 * (s + 2 * y * y) + 2 * p2 * x * y};
      };
      for (double r = 0; r < 1.2 * fold; r += fold / 200) {
        double const h = 1e-5;
        double const x = r * cs;
        double const y = r * sn;
        auto const a = map(x + h, y);
        auto const b = map(x - h, y);
        auto const e = map(x, y + h);
        auto const f = map(x, y - h);
        double const det = (a.x - b.x) * (e.y - f.y) - (a.y - b.y) * (e.x - f.x);
        if (!(det > 0)) { smallest = std::min(smallest, r); }
        if (c.project({x, y, 1}).valid) { largest_valid = std::max(largest_valid, r); }
      }
    }
    EXPECT_LT(largest_valid, smallest);
    EXPECT_GT(largest_valid, 0.9 * smallest - fold / 100);
  }
}

TEST(radtan_unit, rays_of_random_calibrations_return_to_their_pixel) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1, 1);
  int valid = 0;
  int lost = 0;
  for (int i = 0; i < test::effort(300); ++i) {
    ft::radtan8<double> c{400, 400, 320, 240, {}};
    for (int j = 0; j < 8; ++j) {
      c.distortion[j] = (j == 2 || j == 3 ? 0.01 : 0.5) * unit(random);
    }
    for (int j = 0; j < 40; ++j) {
      // A pixel that certainly has a ray, since a point was projected there.
      ft::vec3<double> const p{1.2 * unit(random), 1.2 * unit(random), 1};
      auto const seen = c.project(p);
      if (!seen.valid || std::hypot(seen.pixel.x - 320, seen.pixel.y - 240) > 800) { continue; }
      ++valid;
      auto const r = c.unproject(seen.pixel);
      lost += r.valid ? 0 : 1;
      if (!r.valid) { continue; }
      EXPECT_NEAR(c.project(r.direction).pixel.x, seen.pixel.x, 1e-9);
      EXPECT_NEAR(c.project(r.direction).pixel.y, seen.pixel.y, 1e-9);
    }
  }
  EXPECT_GT(valid, test::effort(300) * 10);
  EXPECT_EQ(lost, 0) << "of " << valid;
}

/// Where the radius of the image of a direction, by angle off the axis, stops growing or ends.
template <typename Radius>
double end_of_growth(Radius const& radius) {
  double before = 0;
  int const steps = 20000;
  for (int i = 1; i < steps; ++i) {
    double const angle = pi * i / steps;
    double const now = radius(angle);
    if (!(now > before)) { return angle; }
    before = now;
  }
  return pi;
}

template <typename Camera, typename Radius>
void compare_reach(Camera const& c, Radius const& radius, std::string const& which) {
  double const end = end_of_growth(radius);
  for (double angle = 0.01; angle < pi; angle += 0.013) {
    if (std::abs(angle - end) < 2e-3) { continue; }
    EXPECT_EQ(c.project({2 * std::sin(angle), 0, 2 * std::cos(angle)}).valid, angle < end)
        << which << ": " << angle << " rad, " << end;
  }
}

TEST(double_sphere_unit, the_domain_ends_where_the_image_stops_growing) {
  for (double const xi : {-0.9, -0.5, -0.2, 0.0, 0.3, 0.8, 1.0}) {
    for (double const alpha : {0.0, 0.1, 0.3, 0.5, 0.57, 0.8, 1.0}) {
      ft::double_sphere<double> const c{100, 100, 0, 0, xi, alpha};
      compare_reach(
          c,
          [&](double angle) {
            double const q = xi + std::cos(angle);
            double const r = std::sin(angle);
            return r / (alpha * std::hypot(r, q) + (1 - alpha) * q);
          },
          std::to_string(xi) + " " + std::to_string(alpha));
    }
  }
}

TEST(extended_unified_unit, the_domain_ends_where_the_image_stops_growing) {
  for (double const beta : {0.4, 1.0, 2.5}) {
    for (double const alpha : {0.0, 0.1, 0.3, 0.5, 0.59, 0.8, 1.0}) {
      ft::extended_unified<double> const c{100, 100, 0, 0, alpha, beta};
      compare_reach(
          c,
          [&](double angle) {
            double const z = std::cos(angle);
            double const r = std::sin(angle);
            return r / (alpha * std::sqrt(beta * r * r + z * z) + (1 - alpha) * z);
          },
          std::to_string(alpha) + " " + std::to_string(beta));
    }
  }
}

TEST(unified_unit, the_domain_ends_where_the_image_stops_growing) {
  for (double const xi : {0.0, 0.4, 1.0, 1.5, 3.0}) {
    for (double const k1 : {0.0, -0.1}) {
      ft::unified<double> const c{100, 100, 0, 0, xi, {k1, 0, 0, 0}};
      compare_reach(
          c,
          [&](double angle) {
            double const m = std::sin(angle) / (xi + std::cos(angle));
            return m * (1 + k1 * m * m);
          },
          std::to_string(xi) + " " + std::to_string(k1));
    }
  }
}

/// Pixels inside the domain have rays that return, up to its edge; outside there are none.
template <typename Camera>
void check_edge(Camera const& c, double edge) {
  for (double const share : {0.5, 0.9, 0.99, 0.9999, 0.999999}) {
    auto const r = c.unproject({c.cx + edge * share * c.fx, c.cy});
    ASSERT_TRUE(r.valid) << share;
    EXPECT_NEAR(ft::dot(r.direction, r.direction), 1, 1e-12);
    auto const seen = c.project(r.direction);
    EXPECT_TRUE(seen.valid) << share;
    EXPECT_NEAR(seen.pixel.x, c.cx + edge * share * c.fx, 1e-9);
    EXPECT_NEAR(seen.pixel.y, c.cy, 1e-9);
  }
  EXPECT_LT(c.unproject({c.cx + edge * 0.9999 * c.fx, c.cy}).direction.z, 0) << "looks back";
  EXPECT_FALSE(c.unproject({c.cx + edge * 1.000001 * c.fx, c.cy}).valid);
  EXPECT_FALSE(c.unproject({c.cx, c.cy - edge * 1.1 * c.fy}).valid);
}

TEST(double_sphere_unit, rays_reach_behind_up_to_the_edge_of_the_image) {
  check_edge(ft::double_sphere<double>{150, 152, 320, 240, 0.2, 0.65}, std::sqrt(1 / 0.3));
  check_edge(ft::double_sphere<double>{150, 152, 320, 240, -0.2, 0.6}, std::sqrt(1 / 0.2));
}
TEST(extended_unified_unit, rays_reach_behind_up_to_the_edge_of_the_image) {
  check_edge(ft::extended_unified<double>{150, 152, 320, 240, 0.65, 1.3},
             std::sqrt(1 / (0.3 * 1.3)));
}
TEST(unified_unit, rays_reach_behind_up_to_the_edge_of_the_image) {
  check_edge(ft::unified<double>{400, 402, 320, 240, 1.7, {}}, std::sqrt(1 / (1.7 * 1.7 - 1)));
}

TEST(camera_models_unit, in_float_the_edge_of_the_image_returns_as_well) {
  // Every float between 0.999 of the edge and the edge, along x.
  auto const check = [](auto const& c, float edge) {
    int valid = 0;
    for (float u = 0.999f * edge; u < 1.001f * edge; u = std::nextafter(u, 2 * edge)) {
      auto const r = c.unproject({u, 0});
      if (!r.valid) { continue; }
      ++valid;
      auto const seen = c.project(r.direction);
      EXPECT_TRUE(seen.valid) << u;
      EXPECT_NEAR(seen.pixel.x, u, 1e-3);
      if (::testing::Test::HasFailure()) { return; }
    }
    EXPECT_GT(valid, 100);
  };
  check(ft::double_sphere<float>{150, 152, 0, 0, 0.2f, 0.65f}, 150 * std::sqrt(1 / 0.3f));
  check(ft::double_sphere<float>{150, 152, 0, 0, -0.2f, 0.6f}, 150 * std::sqrt(1 / 0.2f));
  check(ft::extended_unified<float>{150, 152, 0, 0, 0.65f, 1.3f}, 150 * std::sqrt(1 / 0.39f));
  check(ft::unified<float>{400, 402, 0, 0, 1.7f, {}}, 400 * std::sqrt(1 / 1.89f));
  check(ft::radtan4<float>{400, 402, 0, 0, {-0.4f, 0, 0, 0}}, 400 * 0.6085806f);
  check(ft::field_of_view<float>{250, 250, 0, 0, 0.93f}, 250 * 1.5707963f / 0.93f);
}

// ---- ranges ---------------------------------------------------------------------------------

template <typename Camera>
void refused(Camera camera, double Camera::*parameter, std::initializer_list<double> values) {
  EXPECT_NO_THROW(camera.check());
  for (double const v : values) {
    Camera c = camera;
    c.*parameter = v;
    EXPECT_THROW(c.check(), ft::bad_argument) << Camera::name << " " << v;
  }
}
template <typename Camera>
void accepted(Camera camera, double Camera::*parameter, std::initializer_list<double> values) {
  for (double const v : values) {
    camera.*parameter = v;
    EXPECT_NO_THROW(camera.check()) << Camera::name << " " << v;
  }
}

TEST(camera_models_unit, parameters_out_of_their_range_are_refused) {
  using ds = ft::double_sphere<double>;
  using eu = ft::extended_unified<double>;
  using un = ft::unified<double>;
  using fv = ft::field_of_view<double>;
  refused(euroc_double_sphere(), &ds::alpha, {-0.01, 1.01, nan, infinity});
  refused(euroc_double_sphere(), &ds::xi, {-1.0, -1.5, 1.01, nan, -infinity});
  accepted(euroc_double_sphere(), &ds::alpha, {0, 0.5, 1});
  accepted(euroc_double_sphere(), &ds::xi, {-0.99, 0, 1});
  refused(euroc_extended_unified(), &eu::alpha, {-0.01, 1.01, nan});
  refused(euroc_extended_unified(), &eu::beta, {0.0, -1.0, nan, infinity});
  accepted(euroc_extended_unified(), &eu::beta, {0.1, 1, 10});
  refused(wide(), &un::xi, {-0.1, 1e4, nan, infinity});
  accepted(wide(), &un::xi, {0, 1, 3});
  refused(fov(), &fv::omega, {-0.1, 3.2, nan, infinity});
  accepted(fov(), &fv::omega, {0, 1e-9, 1, 3});
  for (double const bad : {nan, infinity, -infinity}) {
    for (int i = 0; i < 8; ++i) {
      auto c = eight();
      c.distortion[i] = bad;
      EXPECT_THROW(c.check(), ft::bad_argument);
    }
    for (int i = 0; i < 4; ++i) {
      auto c = wide();
      c.distortion[i] = bad;
      EXPECT_THROW(c.check(), ft::bad_argument);
    }
  }
}

TEST(camera_models_unit, names_and_parameter_counts) {
  EXPECT_EQ(std::string(ft::radtan4<float>::name), "radtan4");
  EXPECT_EQ(std::string(ft::radtan5<float>::name), "radtan5");
  EXPECT_EQ(std::string(ft::radtan8<float>::name), "radtan8");
  EXPECT_EQ(ft::num_params_v<ft::radtan4<float>>, 8);
  EXPECT_EQ(ft::num_params_v<ft::radtan5<float>>, 9);
  EXPECT_EQ(ft::num_params_v<ft::radtan8<float>>, 12);
  EXPECT_EQ(sizeof(ft::radtan8<double>), 12 * sizeof(double));
  EXPECT_EQ(sizeof(ft::unified<double>), 9 * sizeof(double));
}

TEST(camera_models_unit, no_valid_projection_of_a_point_that_is_not_finite) {
  auto const check = [](auto const& c) {
    for (double const bad : {nan, infinity, -infinity}) {
      for (ft::vec3<double> const p : {ft::vec3<double>{bad, 0, 1},
                                       {0, bad, 1},
                                       {0, 0, bad},
                                       {0.1, 0.2, bad},
                                       {bad, bad, bad}}) {
        auto const seen = c.project(p);
        EXPECT_FALSE(seen.valid) << c.name << " " << p.x << " " << p.y << " " << p.z;
        EXPECT_EQ(seen.pixel.x, c.cx);
        EXPECT_EQ(seen.pixel.y, c.cy);
      }
      EXPECT_FALSE(c.unproject({bad, 1}).valid) << c.name;
      EXPECT_FALSE(c.unproject({1, bad}).valid) << c.name;
    }
  };
  check(euroc());
  check(five());
  check(eight());
  check(euroc_double_sphere());
  check(euroc_extended_unified());
  check(wide());
  check(fov());
}

// ---- the image --------------------------------------------------------------------------------

TEST(image_domain_unit, real_calibrations_pass) {
  ft::kannala_brandt<double> const tumvi{
      190.97847715128717,    190.9733070521226,     254.93170605935475,     256.8974428996504,
      0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202, 0.00020293673591811182};
  EXPECT_NO_THROW(ft::require_invertible(ft::pinhole<double>{400, 400, 320, 240}, 640, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(euroc(), 752, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(euroc().cast<ft::strict_float>(), 752, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(five(), 640, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(eight(), 1280, 720, 1));
  EXPECT_NO_THROW(ft::require_invertible(euroc_double_sphere(), 752, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(euroc_extended_unified(), 752, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(fov(), 640, 480, 1));
  EXPECT_NO_THROW(ft::require_invertible(tumvi, 512, 512));
  EXPECT_NO_THROW(ft::require_invertible(wide(), 1400, 1400));
  EXPECT_LT(ft::inspect_image_domain(euroc(), 752, 480).worst_error, 1e-9);
  EXPECT_LT(ft::inspect_image_domain(wide(), 1400, 1400).worst_error, 1e-9);
}

TEST(image_domain_unit, counts_the_pixels_that_have_rays) {
  // (2 alpha - 1) |m|^2 < 1: a disc of radius 200 round the middle of the image.
  ft::double_sphere<double> const c{100, 100, 320, 240, 0, 0.625};
  auto const found = ft::inspect_image_domain(c, 641, 481);
  EXPECT_EQ(found.pixels, 65 * 65);
  EXPECT_EQ(found.returned, found.with_ray);
  EXPECT_NEAR(found.share_with_ray(), pi * 200 * 200 / (641.0 * 481.0), 0.02);
  EXPECT_LT(found.worst_error, 1e-9);
  EXPECT_THROW(ft::require_invertible(c, 641, 481), ft::bad_argument);
  EXPECT_NO_THROW(ft::require_invertible(c, 641, 481, 0.35));
  EXPECT_EQ(ft::inspect_image_domain(c, 1, 1).pixels, 1);
  EXPECT_EQ(ft::inspect_image_domain(c, 3, 100).pixels, 3 * 65);
}

TEST(image_domain_unit, a_distortion_that_folds_inside_the_image_is_refused) {
  // Largest radius 2 / 3 sqrt(1 / 3) = 0.385 of the focal length: 154 pixels.
  ft::radtan4<double> const strong{400, 400, 320, 240, {-1, 0, 0, 0}};
  auto const message = test::refusal([&] { ft::require_invertible(strong, 640, 480); });
  EXPECT_NE(message.find("radtan4"), std::string::npos) << message;
  EXPECT_NE(message.find("640 x 480"), std::string::npos) << message;
  EXPECT_NE(message.find("0.5"), std::string::npos) << message;
  // 0.385 / sqrt(0.4 / 1) of 400: 243 pixels, the corners alone are lost.
  ft::radtan4<double> const mild{400, 400, 320, 240, {-0.4, 0, 0, 0}};
  EXPECT_NO_THROW(ft::require_invertible(mild, 640, 480));
  EXPECT_THROW(ft::require_invertible(mild, 640, 480, 1), ft::bad_argument);
}

/// A model that says valid and answers wrongly.
template <typename Scalar>
struct liar : ft::pinhole<Scalar> {
  static constexpr char const* name = "liar";
  FT_HOST_DEVICE ft::ray<Scalar> unproject(ft::vec2<Scalar> pixel) const {
    auto r = ft::pinhole<Scalar>::unproject(pixel);
    if (pixel.x > Scalar(600)) { r.direction.x = r.direction.x + Scalar(0.01); }
    if (pixel.y > Scalar(400)) { r.direction.z = -r.direction.z; }
    return r;
  }
  template <typename U>
  FT_HOST_DEVICE liar<U> cast() const {
    return {ft::pinhole<Scalar>::template cast<U>()};
  }
};

TEST(image_domain_unit, a_ray_that_does_not_return_is_refused) {
  liar<double> const c{{400, 400, 320, 240}};
  auto const found = ft::inspect_image_domain(c, 640, 400);
  EXPECT_EQ(found.with_ray, found.pixels);
  EXPECT_LT(found.returned, found.with_ray);
  EXPECT_NEAR(found.worst_error, 4, 1e-9);
  EXPECT_GT(found.worst_x, 600);
  EXPECT_THROW(ft::require_invertible(c, 640, 400), ft::bad_argument);
  EXPECT_NO_THROW(ft::require_invertible(c, 600, 400));
  EXPECT_EQ(ft::inspect_image_domain(c, 600, 480).worst_error, infinity);
  EXPECT_THROW(ft::require_invertible(c, 600, 480), ft::bad_argument);
}

TEST(image_domain_unit, sizes_shares_and_calibrations_that_cannot_be_throw) {
  auto c = euroc();
  EXPECT_THROW(ft::inspect_image_domain(c, 0, 480), ft::bad_argument);
  EXPECT_THROW(ft::inspect_image_domain(c, 752, 16385), ft::bad_argument);
  EXPECT_THROW(ft::require_invertible(c, 752, 480, 1.5), ft::bad_argument);
  EXPECT_THROW(ft::require_invertible(c, 752, 480, nan), ft::bad_argument);
  c.fx = -1;
  EXPECT_THROW(ft::inspect_image_domain(c, 752, 480), ft::bad_argument);
}

}  // namespace camera_models_test
