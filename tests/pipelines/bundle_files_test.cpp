// SPDX-License-Identifier: Apache-2.0
// Bundles in the format of "Bundle adjustment in the large": pixels as its formula has them, what
// is written reads back, damaged files are refused.
#include "ft/pipelines/bundle_files.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/bundles.hpp"
#include "tests/support/refusals.hpp"

namespace bundle_files_test {

using lens = ft::radtan4<double>;

inline ft::bundle<lens> read(std::string const& text) {
  std::istringstream in(text);
  return ft::read_bal(in);
}

inline std::string good() {
  return "2 1 2\n"
         "0 0 -20.5 3e1\n"
         "1 0 7 8\n"
         "0.1 -0.2 0.3 1 2 -30 500 -0.01 0.002\n"
         "0 0 0 4 5 -6\n400 0 0\n"
         "0.5 0.25 -2\n";
}

TEST(BundleFiles, PixelsAreThoseOfTheFormula) {
  auto const map = read(good());
  ASSERT_EQ(map.T_cw.size(), 2u);
  ASSERT_EQ(map.position.size(), 1u);
  ASSERT_EQ(map.pixel.size(), 2u);
  EXPECT_EQ(map.observing_view[1], 1);
  EXPECT_EQ(map.pixel[0].x, -20.5);
  EXPECT_EQ(map.pixel[0].y, -30);
  // P = R X + t, p = -P / P.z, f (1 + k1 |p|^2 + k2 |p|^4) p, R by its axis and angle.
  ft::vec3<double> const X{0.5, 0.25, -2};
  ft::vec3<double> const P = test::turned_by({0.1, -0.2, 0.3}) * X + ft::vec3<double>{1, 2, -30};
  double const x = -P.x / P.z;
  double const y = -P.y / P.z;
  double const r2 = x * x + y * y;
  double const scale = 500 * (1 - 0.01 * r2 + 0.002 * r2 * r2);
  auto const image = map.cameras[0].project(map.T_cw[0] * map.position[0]);
  EXPECT_TRUE(image.valid);
  EXPECT_NEAR(image.pixel.x, scale * x, 1e-10);
  EXPECT_NEAR(image.pixel.y, -scale * y, 1e-10);
}

TEST(BundleFiles, RoundTripsKeepNumbers) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    std::vector<lens> const cameras{{400, 400, 0, 0, {-0.05, 0.01, 0, 0}},
                                    {500, 500, 0, 0, {0.02, 0, 0, 0}}};
    auto map = test::make_bundle({12, 40}, cameras, seed).map;
    test::random_motions any(seed);
    for (auto& T : map.T_cw) { T = any(2, 100).orthonormalized(); }  // also beyond half a turn
    std::stringstream file;
    ft::write_bal(file, map);
    auto const back = ft::read_bal(file);
    ASSERT_EQ(back.T_cw.size(), map.T_cw.size());
    ASSERT_EQ(back.position.size(), map.position.size());
    EXPECT_EQ(back.observing_view, map.observing_view);
    EXPECT_EQ(back.observed_point, map.observed_point);
    for (std::size_t o = 0; o < map.pixel.size(); ++o) {
      EXPECT_EQ(back.pixel[o].x, map.pixel[o].x);
      EXPECT_EQ(back.pixel[o].y, map.pixel[o].y);
    }
    for (std::size_t v = 0; v < map.T_cw.size(); ++v) {
      EXPECT_EQ(back.T_cw[v].t.z, map.T_cw[v].t.z);
      for (int k = 0; k < 9; ++k) { EXPECT_NEAR(back.T_cw[v].R.m[k], map.T_cw[v].R.m[k], 1e-13); }
      EXPECT_EQ(back.cameras[v].fy, cameras[v % 2].fx);
      EXPECT_EQ(back.cameras[v].distortion[1], cameras[v % 2].distortion[1]);
    }
    for (std::size_t p = 0; p < map.position.size(); ++p) {
      EXPECT_EQ(back.position[p].y, map.position[p].y);
    }
  }
}

TEST(BundleFiles, DamagedOnesAreRefused) {
  auto const refused = [](std::string const& from, std::string const& to, std::string const& part) {
    std::string text = good();
    text.replace(text.find(from), from.size(), to);
    test::expect_refused<ft::error>([&] { read(text); }, part);
  };
  refused("0.1 -0.2 0.3 1", "1e200 0 0 1", "view 0: the rotation's vector is longer");
  refused("2 1 2", "-2 1 2", "first line: the number of views is '-2'");
  refused("2 1 2", "2 1.5 2", "first line: the number of points is '1.5'");
  refused("2 1 2", "2 1 999999999999", "the number of observations is '999999999999'");
  refused("1 0 7 8", "2 0 7 8", "observation 1: the view is '2', not a whole number from 0 to 1");
  refused("1 0 7 8", "1 1 7 8", "observation 1: the point is '1'");
  refused("1 0 7 8", "1 0 nan 8", "observation 1: the pixel is 'nan'");
  refused("500", "5x0", "view 0: a number of the view is '5x0'");
  refused("500", "-500", "view 0: ft: camera fx is -500");
  refused("0.5 0.25 -2", "0.5 0.25", "point 0: z is missing");
  refused("0.5 0.25 -2", "0.5 0.25 -2 9", "the end: there is '9' after the last number");
  refused("2 1 2", "2 0 2", "observation 0: the point is '0'");
  EXPECT_THROW(ft::read_bal("/nowhere/at/all.txt"), ft::error);
}

TEST(BundleFiles, WhatTheFormatCannotHoldIsRefused) {
  auto map = test::make_bundle<lens>({4, 5}, {{400, 400, 0, 0, {0, 0, 0, 0}}}, 1).map;
  std::stringstream file;
  map.cameras[0].cx = 1;
  EXPECT_THROW(ft::write_bal(file, map), ft::bad_argument);
  map.cameras[0].cx = 0;
  map.cameras[0].distortion[3] = 0.1;
  EXPECT_THROW(ft::write_bal(file, map), ft::bad_argument);
  map.cameras[0].distortion[3] = 0;
  EXPECT_NO_THROW(ft::write_bal(file, map));
}

}  // namespace bundle_files_test
