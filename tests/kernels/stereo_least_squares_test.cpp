// SPDX-License-Identifier: Apache-2.0
// Columns of rectified matches by least squares, against pairs of images whose disparity is known
// and against the parabola through sums of absolute differences.
#include "ft/kernels/stereo/rectified.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "tests/support/backends.hpp"

namespace stereo_least_squares_test {

constexpr int width = 240;
constexpr int height = 160;
constexpr int levels = 3;
constexpr float bf = 50;
constexpr auto parabola = ft::column_rule::parabola;
constexpr auto least_squares = ft::column_rule::least_squares;

/// A left keypoint, and the column of the right one; pixels of their level.
struct match {
  double x, y;
  int octave;
  double right;
};
struct found {
  float right_x, depth;
};

/// Something with structure everywhere: waves of six pixels and more.
double texture(double x, double y) {
  return 120 + 40 * std::sin(0.9 * x + 0.3 * y) + 30 * std::sin(0.5 * x - 1.1 * y + 1) +
         25 * std::sin(0.23 * x + 0.7 * y + 2);
}

template <typename Backend>
class stereo_least_squares : public test::on_backend<Backend> {
protected:
  Backend backend;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);

  /// Both slabs of a pair; at each level the right image shows what is `disparity` pixels of that
  /// level further right in the left one, brighter by `offset`.
  std::vector<std::uint8_t> pair(double disparity, double offset = 0) const {
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(2 * geometry.bytes));
    for (int image = 0; image < 2; ++image) {
      for (int l = 0; l < levels; ++l) {
        for (int y = 0; y < geometry.height[l]; ++y) {
          for (int x = 0; x < geometry.width[l]; ++x) {
            double const grey = image == 0 ? texture(x, y) : texture(x + disparity, y) + offset;
            bytes[static_cast<std::size_t>(image * geometry.bytes + geometry.offset[l] +
                                           y * geometry.stride[l] + x)] =
                static_cast<std::uint8_t>(std::lrint(grey));
          }
        }
      }
    }
    return bytes;
  }

  /// Left keypoint i has a descriptor of its own, which right keypoint i shares.
  template <ft::column_rule Rule, typename Exec>
  std::vector<found> run_on(Exec const& exec, std::vector<std::uint8_t> const& bytes,
                            std::vector<match> const& of) const {
    constexpr auto space = Exec::space;
    int const n = static_cast<int>(of.size());
    ft::image_pyramid<space> const pyramid(geometry, 2);
    ft::copy(exec, pyramid.view().data, bytes.data(), bytes.size());
    ft::keypoints<ft::staging_space<Exec>> const given(n, 2);
    std::mt19937 random(5);
    for (int i = 0; i < n; ++i) {
      match const& m = of[static_cast<std::size_t>(i)];
      auto const scale = static_cast<double>(geometry.scale[m.octave]);
      ft::descriptor orb{};
      for (auto& word : orb.words) { word = static_cast<std::uint32_t>(random()); }
      for (int image = 0; image < 2; ++image) {
        ft::keypoints_view const v = given.view().slice(image);
        *v.count = n;
        v.x(i) = static_cast<float>((image == 0 ? m.x : m.right) * scale);
        v.y(i) = static_cast<float>(m.y * scale);
        v.octave(i) = m.octave;
        v.orb(i) = orb;
      }
    }
    ft::keypoints<space> const keypoints(n, 2);
    ft::copy(exec, keypoints.view(), given.view());
    ft::stereo_matches<space> const matches(n);
    ft::grid_geometry rows;
    rows.cols = 1;
    rows.rows = height;
    ft::feature_grid<space> const grid(rows, n, 1);
    ft::stereo_params params;
    params.bf = bf;
    params.max_disparity = 100;
    ft::match_stereo_rectified<Rule>(exec, pyramid.view(), keypoints.view(), params, matches.view(),
                                     grid.view());
    auto const result = ft::download(exec, matches.view());
    std::vector<found> out;
    for (int i = 0; i < n; ++i) {
      out.push_back({result.view().right_x(i), result.view().depth(i)});
    }
    return out;
  }
  template <ft::column_rule Rule = least_squares>
  std::vector<found> run(std::vector<std::uint8_t> const& bytes,
                         std::vector<match> const& of) const {
    return run_on<Rule>(backend.exec, bytes, of);
  }
  /// Error of a result's disparity, pixels of its level.
  double error_of(match const& m, found const& r, double truth) const {
    return m.x - static_cast<double>(r.right_x) / static_cast<double>(geometry.scale[m.octave]) -
           truth;
  }
};
TYPED_TEST_SUITE(stereo_least_squares, test::backends);

TYPED_TEST(stereo_least_squares, finds_disparities_between_pixels) {
  double worst_by_parabola = 0;
  for (double const shift : {7.05, 7.2, 7.45, 7.8, 12.37}) {
    auto const bytes = this->pair(shift);
    std::vector<match> of;
    for (int octave = 0; octave < levels; ++octave) {
      for (int const x : {70, 83, 101, 124}) {
        for (int const off : {-2, 0, 3}) {
          of.push_back(
              {static_cast<double>(x), 40.0 + 6 * off, octave, std::round(x - shift) + off});
        }
      }
    }
    auto const got = this->run(bytes, of);
    auto const by_parabola = this->template run<parabola>(bytes, of);
    for (std::size_t i = 0; i < of.size(); ++i) {
      EXPECT_NEAR(this->error_of(of[i], got[i], shift), 0, 0.02) << shift << ", match " << i;
      double const pixels = shift * static_cast<double>(this->geometry.scale[of[i].octave]);
      EXPECT_NEAR(static_cast<double>(got[i].depth) * pixels, static_cast<double>(bf), 0.2);
      worst_by_parabola =
          std::fmax(worst_by_parabola, std::abs(this->error_of(of[i], by_parabola[i], shift)));
    }
  }
  EXPECT_GT(worst_by_parabola, 0.08);  // what it is for
}

TYPED_TEST(stereo_least_squares, does_not_depend_on_the_brightness) {
  std::vector<match> const of = {{70, 60, 0, 61}, {90, 50, 1, 81}};
  auto const got = this->run(this->pair(9.3, -25), of);
  for (std::size_t i = 0; i < of.size(); ++i) {
    EXPECT_NEAR(this->error_of(of[i], got[i], 9.3), 0, 0.02);
  }
}

TYPED_TEST(stereo_least_squares, gives_keypoints_between_pixels_the_disparity_of_their_pixel) {
  auto const bytes = this->pair(8.6);
  std::vector<match> const pixels = {{70, 60, 0, 61}, {90, 50, 1, 81}};
  std::vector<match> between = pixels;
  for (auto& m : between) {
    m.x += 0.375;
    m.y -= 0.25;
  }
  auto const at_pixels = this->run(bytes, pixels);
  auto const got = this->run(bytes, between);
  for (std::size_t i = 0; i < between.size(); ++i) {
    EXPECT_NEAR(this->error_of(between[i], got[i], 8.6), 0, 0.02);
    EXPECT_EQ(got[i].depth, at_pixels[i].depth);
  }
}

TYPED_TEST(stereo_least_squares, keeps_the_column_of_a_window_at_the_border) {
  auto const bytes = this->pair(8.6);
  std::vector<match> const of = {{width - 6, 60, 0, width - 15}, {width - 7, 60, 0, width - 16}};
  auto const got = this->run(bytes, of);
  auto const by_parabola = this->template run<parabola>(bytes, of);
  EXPECT_GT(by_parabola[0].right_x, 0);
  EXPECT_EQ(got[0].right_x, by_parabola[0].right_x);
  EXPECT_NE(got[1].right_x, by_parabola[1].right_x);
}

TYPED_TEST(stereo_least_squares, has_the_bits_of_the_host) {
  std::mt19937 random(91);
  auto bytes = this->pair(6.4);
  for (auto& b : bytes) { b = static_cast<std::uint8_t>((b * 3 + random() % 256) / 4); }
  std::vector<match> of;
  for (int i = 0; i < 400; ++i) {
    int const octave = static_cast<int>(random() % levels);
    double const x = static_cast<double>(random() % 10000) * 1e-4 * this->geometry.width[octave];
    double const y = static_cast<double>(random() % 10000) * 1e-4 * this->geometry.height[octave];
    of.push_back({x, y, octave, std::fmax(std::round(x - 6.4), 0)});
  }
  auto const got = this->run(bytes, of);
  auto const expected = this->template run_on<least_squares>(ft::host_exec(1), bytes, of);
  int matched = 0;
  for (std::size_t i = 0; i < of.size(); ++i) {
    ASSERT_EQ(got[i].right_x, expected[i].right_x) << i;
    ASSERT_EQ(got[i].depth, expected[i].depth) << i;
    matched += static_cast<int>(got[i].depth > 0);
  }
  EXPECT_GT(matched, 100);
}

}  // namespace stereo_least_squares_test
