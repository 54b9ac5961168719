// SPDX-License-Identifier: Apache-2.0
// Partners of two cameras by least squares, against a pair of images of a plane whose motion from
// one to the other is known.
#include "ft/kernels/stereo/refine_partners.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/error.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"

namespace refine_partners_test {

constexpr int width = 240;
constexpr int height = 160;
constexpr int levels = 3;
constexpr float focal = 200;
constexpr float baseline = 0.1f;
using camera = ft::pinhole<float>;
using rig_type = ft::stereo_rig<camera, camera>;

/// A left keypoint and its partner, pixels of the input image.
struct match {
  double x, y;
  int octave;
  double right_x, right_y;
  int right_octave;
};
struct found {
  float x, y, depth;  ///< of the right keypoint, pixels of the input image
};

/// Waves of seven pixels and more.
double texture(double x, double y) {
  return 120 + 40 * std::sin(0.7 * x + 0.3 * y) + 30 * std::sin(0.5 * x - 0.8 * y + 1) +
         25 * std::sin(0.23 * x + 0.7 * y + 2);
}

template <typename Backend>
class refine_partners : public test::on_backend<Backend> {
protected:
  Backend backend;
  ft::pyramid_geometry geometry = exact_geometry();
  rig_type rig{{focal, focal, 120, 80}, {focal, focal, 120, 80}, {}};

  refine_partners() {
    rig.T_rl = ft::pose::identity();
    rig.T_rl.t.x = -baseline;
  }
  static ft::pyramid_geometry exact_geometry() {
    auto g = ft::pyramid_geometry::make(width, height, levels, 1.2f);
    g.exact = true;
    return g;
  }

  /// The right image shows what is (dx, dy) further right and down in the left one, brighter by
  /// `offset`. Levels show the input image where pyramid_geometry::column() says that they do.
  std::vector<std::uint8_t> pair(double dx, double dy, double offset = 0) const {
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(2 * geometry.bytes));
    for (int image = 0; image < 2; ++image) {
      for (int l = 0; l < levels; ++l) {
        double const wide = static_cast<double>(width) / geometry.width[l];
        double const high = static_cast<double>(height) / geometry.height[l];
        for (int y = 0; y < geometry.height[l]; ++y) {
          for (int x = 0; x < geometry.width[l]; ++x) {
            double const u = (x + 0.5) * wide - 0.5;
            double const v = (y + 0.5) * high - 0.5;
            double const grey = image == 0 ? texture(u, v) : texture(u + dx, v + dy) + offset;
            bytes[static_cast<std::size_t>(image * geometry.bytes + geometry.offset[l] +
                                           y * geometry.stride[l] + x)] =
                static_cast<std::uint8_t>(std::lrint(grey));
          }
        }
      }
    }
    return bytes;
  }

  /// The position of a keypoint as extractors write it.
  float raw(double x, int octave, int const (&size)[ft::max_levels]) const {
    double const at = (x + 0.5) * size[octave] / size[0] - 0.5;
    return static_cast<float>(at * static_cast<double>(geometry.scale[octave]));
  }

  /// @param depth of the matches before
  template <typename Exec>
  std::vector<found> run_on(Exec const& exec, std::vector<std::uint8_t> const& bytes,
                            std::vector<match> const& of, float depth) const {
    constexpr auto space = Exec::space;
    int const n = static_cast<int>(of.size());
    ft::image_pyramid<space> const pyramid(geometry, 2);
    ft::copy(exec, pyramid.view().data, bytes.data(), bytes.size());
    ft::keypoints<ft::staging_space<Exec>> const given(n, 2);
    std::vector<int> partner(static_cast<std::size_t>(2 * n));
    std::vector<float> depths(static_cast<std::size_t>(n), depth);
    std::vector<ft::vec3<float>> points(static_cast<std::size_t>(n), {0, 0, depth});
    for (int i = 0; i < n; ++i) {
      match const& m = of[static_cast<std::size_t>(i)];
      for (int image = 0; image < 2; ++image) {
        ft::keypoints_view const v = given.view().slice(image);
        int const octave = image == 0 ? m.octave : m.right_octave;
        *v.count = n;
        v.x(i) = raw(image == 0 ? m.x : m.right_x, octave, geometry.width);
        v.y(i) = raw(image == 0 ? m.y : m.right_y, octave, geometry.height);
        v.octave(i) = octave;
      }
      partner[static_cast<std::size_t>(i)] = n + i;
      partner[static_cast<std::size_t>(n + i)] = i;
    }
    ft::keypoints<space> const keypoints(n, 2);
    ft::copy(exec, keypoints.view(), given.view());
    ft::owner<ft::fisheye_matches_view, space> const memory(
        [&](ft::carver& c, ft::fisheye_matches_view& v) { ft::carve(c, v, n, 1); });
    ft::fisheye_matches_view const& matches = memory.view();
    ft::copy(exec, matches.partner, partner.data(), partner.size());
    ft::copy(exec, matches.depth, depths.data(), depths.size());
    ft::copy(exec, matches.point, points.data(), points.size());
    ft::refine_partners(exec, rig, pyramid.view(), keypoints.view(), matches);
    depths = test::from_exec(exec, static_cast<float const*>(matches.depth), depths.size());
    auto const result = ft::download(exec, keypoints.view());
    ft::keypoints_view const right = result.view().slice(1);
    std::vector<found> out;
    for (int i = 0; i < n; ++i) {
      out.push_back({geometry.column(right.x(i), right.octave(i)),
                     geometry.row(right.y(i), right.octave(i)),
                     depths[static_cast<std::size_t>(i)]});
    }
    return out;
  }
  std::vector<found> run(std::vector<std::uint8_t> const& bytes, std::vector<match> const& of,
                         float depth) const {
    return run_on(backend.exec, bytes, of, depth);
  }
};
TYPED_TEST_SUITE(refine_partners, test::backends);

TYPED_TEST(refine_partners, finds_them_between_pixels) {
  for (double const dx : {7.3, 9.05, 11.5}) {
    constexpr double dy = -0.4;
    auto const bytes = this->pair(dx, dy);
    std::vector<match> of;
    for (int octave = 0; octave < levels; ++octave) {
      for (int right_octave = 0; right_octave < levels; ++right_octave) {
        of.push_back({70.4, 60.2, octave, 70.4 - dx + 0.7, 60.2 - dy - 0.6, right_octave});
        of.push_back({131, 77.7, octave, 131 - dx - 0.3, 77.7 - dy + 0.8, right_octave});
      }
    }
    double const depth = static_cast<double>(focal * baseline) / dx;
    auto const got = this->run(bytes, of, static_cast<float>(0.8 * depth));
    for (std::size_t i = 0; i < of.size(); ++i) {
      double const most = 0.04 * static_cast<double>(this->geometry.scale[of[i].octave]);
      EXPECT_NEAR(static_cast<double>(got[i].x), of[i].x - dx, most) << dx << ", match " << i;
      EXPECT_NEAR(static_cast<double>(got[i].y), of[i].y - dy, most) << dx << ", match " << i;
      EXPECT_NEAR(static_cast<double>(got[i].depth), depth, 0.01 * depth);
    }
  }
}

TYPED_TEST(refine_partners, does_not_depend_on_the_brightness) {
  auto const got = this->run(this->pair(8.2, 0.3, 25), {{70, 60, 0, 62, 60, 0}}, 2.4f);
  EXPECT_NEAR(static_cast<double>(got[0].x), 61.8, 0.03);
  EXPECT_NEAR(static_cast<double>(got[0].y), 59.7, 0.03);
}

TYPED_TEST(refine_partners, stay_where_nothing_better_is_known) {
  auto const bytes = this->pair(8.2, 0.3);
  // A window over the border; and a depth that would change to less than half.
  std::vector<match> const of = {{70, 5, 0, 62, 5, 0}};
  auto const at_border = this->run(bytes, of, 2.4f);
  EXPECT_NEAR(static_cast<double>(at_border[0].x), 62, 1e-4);
  EXPECT_EQ(at_border[0].depth, 2.4f);
  auto const far = this->run(bytes, {{70, 60, 0, 62, 60, 0}}, 5.0f);
  EXPECT_NEAR(static_cast<double>(far[0].x), 62, 1e-4);
  EXPECT_EQ(far[0].depth, 5.0f);
  std::vector<std::uint8_t> const flat(bytes.size(), 77);
  EXPECT_NEAR(static_cast<double>(this->run(flat, {{70, 60, 0, 62, 60, 0}}, 2.4f)[0].x), 62, 1e-4);
}

TYPED_TEST(refine_partners, have_the_bits_of_the_host) {
  std::mt19937 random(92);
  auto bytes = this->pair(6.4, 0.2);
  for (auto& b : bytes) { b = static_cast<std::uint8_t>((b * 7 + random() % 256) / 8); }
  std::vector<match> of;
  auto const octave = [&] { return static_cast<int>(random() % levels); };
  auto const upto = [&](int n) { return static_cast<double>(random() % 10000) * 1e-4 * n; };
  for (int i = 0; i < 400; ++i) {
    double const x = upto(width);
    double const y = upto(height);
    of.push_back({x, y, octave(), x - 6.4 + upto(2) - 1, y - 0.2 + upto(2) - 1, octave()});
  }
  auto const got = this->run(bytes, of, 3.0f);
  auto const expected = this->run_on(ft::host_exec(1), bytes, of, 3.0f);
  int moved = 0;
  for (std::size_t i = 0; i < of.size(); ++i) {
    ASSERT_EQ(got[i].x, expected[i].x) << i;
    ASSERT_EQ(got[i].y, expected[i].y) << i;
    ASSERT_EQ(got[i].depth, expected[i].depth) << i;
    moved += static_cast<int>(got[i].depth != 3.0f);
  }
  EXPECT_GT(moved, 100);
}

TYPED_TEST(refine_partners, of_other_images_are_refused) {
  constexpr auto space = TypeParam::exec_type::space;
  ft::owner<ft::fisheye_matches_view, space> const matches(
      [&](ft::carver& c, ft::fisheye_matches_view& v) { ft::carve(c, v, 4, 1); });
  auto const refine = [&](int images, ft::pyramid_geometry const& levels_of) {
    ft::image_pyramid<space> const pyramid(levels_of, images);
    ft::keypoints<space> const keypoints(4, 2);
    ft::refine_partners(this->backend.exec, this->rig, pyramid.view(), keypoints.view(),
                        matches.view());
  };
  auto rounded = this->geometry;
  rounded.exact = false;
  EXPECT_THROW(refine(4, this->geometry), ft::bad_argument);
  EXPECT_THROW(refine(2, rounded), ft::bad_argument);
}

}  // namespace refine_partners_test
