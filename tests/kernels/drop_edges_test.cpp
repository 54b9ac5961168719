// SPDX-License-Identifier: Apache-2.0
// Corners on edges, against eigenvalues in double and against edges and corners that are drawn.
#include "ft/kernels/keypoints/drop_edges.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/distribution/layout.hpp"
#include "ft/types/orb_params.hpp"
#include "tests/support/backends.hpp"

namespace drop_edges_test {

constexpr int width = 311, height = 229, levels = 4, images = 3;

/// Corners of each level of each image.
using corner_lists = std::vector<std::vector<ft::corner>>;

/// The ratio of the eigenvalues of the structure tensor over 7 x 7 pixels around a corner.
double plain_ratio(std::uint8_t const* image, int stride, ft::corner c) {
  double xx = 0, xy = 0, yy = 0;
  for (int j = -3; j <= 3; ++j) {
    for (int i = -3; i <= 3; ++i) {
      std::uint8_t const* const at = image + (c.y + 16 + j) * stride + c.x + 16 + i;
      double const gx = at[1] - at[-1], gy = at[stride] - at[-stride];
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  double const middle = (xx + yy) / 2, apart = std::hypot((xx - yy) / 2, xy);
  return middle + apart > 0 ? (middle - apart) / (middle + apart) : 0;
}

template <typename Backend>
class drop_edges : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  Backend backend;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);
  ft::distribution_layout layout = ft::distribution_layout::make(geometry, 2000);

  /// What is left of corners of a pyramid with these bytes.
  corner_lists run(std::vector<std::uint8_t> const& bytes, corner_lists const& of, float ratio) {
    exec_type const& exec = backend.exec;
    ft::image_pyramid<exec_type::space> const pyramid(geometry, images);
    ft::copy(exec, pyramid.view().data, bytes.data(), bytes.size());
    std::vector<ft::corner> kept(static_cast<std::size_t>(images * layout.total));
    std::vector<int> counts(of.size());
    for (std::size_t i = 0; i < of.size(); ++i) {
      counts[i] = static_cast<int>(of[i].size());
      std::copy(of[i].begin(), of[i].end(), kept.begin() + first_of(i));
    }
    auto const on_exec = test::to_exec(exec, kept);
    auto const counts_on_exec = test::to_exec(exec, counts);
    ft::distribution_view view;
    view.layout = layout;
    view.batch = images;
    view.kept = on_exec.data();
    view.kept_count = counts_on_exec.data();
    ft::drop_edges(exec, pyramid.view(), ratio, view);
    kept = test::from_exec(exec, view.kept, kept.size());
    counts = test::from_exec(exec, view.kept_count, counts.size());
    corner_lists left(of.size());
    for (std::size_t i = 0; i < of.size(); ++i) {
      auto const from = kept.begin() + first_of(i);
      left[i].assign(from, from + counts[i]);
    }
    return left;
  }
  std::ptrdiff_t first_of(std::size_t level_of_image) const {
    int const i = static_cast<int>(level_of_image);
    return i / levels * layout.total + layout.first[i % levels];
  }
  /// Up to as many as fit, anywhere. The second level of the second image has none.
  corner_lists random_corners(unsigned seed) const {
    std::mt19937 random(seed);
    corner_lists all;
    for (int i = 0; i < images * levels; ++i) {
      int const l = i % levels;
      auto const below = [&](int n) {
        return static_cast<std::uint16_t>(random() % static_cast<unsigned>(n));
      };
      std::vector<ft::corner> of;
      int const n = i == levels + 1 ? 0 : layout.capacity[l] - below(20);
      for (int k = 0; k < n; ++k) {
        of.push_back({below(geometry.width[l] - 32), below(geometry.height[l] - 32), k});
      }
      all.push_back(of);
    }
    return all;
  }
  /// Smooth in one direction, so that eigenvalues of all ratios occur.
  std::vector<std::uint8_t> random_images(unsigned seed) const {
    std::mt19937 random(seed);
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(geometry.bytes) * images);
    for (int b = 0; b < images; ++b) {
      for (int l = 0; l < levels; ++l) {
        for (int y = 0; y < geometry.height[l]; ++y) {
          int const step = y / 20 * 3 % 31;  // bands, from stripes to noise
          std::uint8_t* const row =
              bytes.data() + b * geometry.bytes + geometry.offset[l] + y * geometry.stride[l];
          for (int x = 0; x < geometry.width[l]; ++x) {
            int const noise =
                static_cast<int>(random() % static_cast<unsigned>(2 * step + 1)) - step;
            row[x] = static_cast<std::uint8_t>(std::clamp(128 + (x / 4 % 2) * 60 + noise, 0, 255));
          }
        }
      }
    }
    return bytes;
  }
  std::uint8_t const* level(std::vector<std::uint8_t> const& bytes, std::size_t i) const {
    auto const n = static_cast<std::ptrdiff_t>(i);
    return bytes.data() + n / levels * geometry.bytes + geometry.offset[n % levels];
  }
};
TYPED_TEST_SUITE(drop_edges, test::backends);

bool equal(ft::corner const& a, ft::corner const& b) {
  return a.x == b.x && a.y == b.y && a.response == b.response;
}

TYPED_TEST(drop_edges, keeps_those_of_the_ratio_in_their_order) {
  for (float const ratio : {0.02f, 1.0f / 16, 0.2f}) {
    auto const bytes = this->random_images(81);
    auto const all = this->random_corners(82);
    auto const left = this->run(bytes, all, ratio);
    std::size_t dropped = 0, kept = 0;
    for (std::size_t i = 0; i < all.size(); ++i) {
      std::size_t next = 0;
      for (ft::corner const& c : all[i]) {
        double const r = plain_ratio(this->level(bytes, i),
                                     this->geometry.stride[static_cast<int>(i) % levels], c);
        bool const is = next < left[i].size() && equal(left[i][next], c);
        if (std::abs(r - static_cast<double>(ratio)) > 1e-6) {
          EXPECT_EQ(is, r > static_cast<double>(ratio)) << i << ": " << r;
        }
        next += is ? 1 : 0;
        dropped += is ? 0 : 1;
      }
      EXPECT_EQ(next, left[i].size()) << i;
      kept += next;
    }
    EXPECT_GT(dropped, 100u) << ratio;
    EXPECT_GT(kept, 100u) << ratio;
  }
}

TYPED_TEST(drop_edges, has_the_answers_of_the_host) {
  auto const bytes = this->random_images(83);
  auto const all = this->random_corners(84);
  auto const left = this->run(bytes, all, ft::odometry_corner_ratio);
  ft::host_exec const host;
  corner_lists expected = all;
  for (std::size_t i = 0; i < all.size(); ++i) {
    int const l = static_cast<int>(i) % levels;
    ft::gray_view const image{this->level(bytes, i), this->geometry.width[l],
                              this->geometry.height[l], this->geometry.stride[l]};
    auto const r = static_cast<double>(ft::odometry_corner_ratio);
    auto const on_edge = [&](ft::corner const& c) {
      return !ft::detail::structure_tensor::at(image, c.x + 16, c.y + 16)
                  .is_corner(r / ((1 + r) * (1 + r)));
    };
    auto& of = expected[i];
    of.erase(std::remove_if(of.begin(), of.end(), on_edge), of.end());
    ASSERT_EQ(left[i].size(), of.size()) << i;
    EXPECT_TRUE(std::equal(of.begin(), of.end(), left[i].begin(), equal)) << i;
  }
}

TYPED_TEST(drop_edges, keeps_all_with_a_ratio_of_0) {
  auto const all = this->random_corners(85);
  auto const left = this->run(this->random_images(86), all, 0);
  for (std::size_t i = 0; i < all.size(); ++i) {
    ASSERT_EQ(left[i].size(), all[i].size());
    EXPECT_TRUE(std::equal(all[i].begin(), all[i].end(), left[i].begin(), equal)) << i;
  }
}

/// A slanted edge, as a camera sees it, and corners of a square.
TYPED_TEST(drop_edges, drops_the_steps_of_an_edge_and_keeps_corners) {
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(this->geometry.bytes) * images);
  ft::pyramid_geometry const& g = this->geometry;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      double const below = std::clamp(y - 100 - 0.3 * x + 0.5, 0.0, 1.0);
      bool const in_square = x >= 200 && x < 240 && y >= 60 && y < 100;
      bytes[static_cast<std::size_t>(g.offset[0] + y * g.stride[0] + x)] =
          in_square ? 200 : static_cast<std::uint8_t>(60 + 140 * below);
    }
  }
  corner_lists all(images * levels);
  auto const corner_at = [](int x, int y) {
    return ft::corner{static_cast<std::uint16_t>(x - 16), static_cast<std::uint16_t>(y - 16), 1};
  };
  for (int x = 40; x < 180; x += 7) { all[0].push_back(corner_at(x, 100 + 3 * x / 10)); }
  ft::corner const real[] = {corner_at(200, 60), corner_at(239, 60), corner_at(200, 99)};
  for (ft::corner const& c : real) { all[0].push_back(c); }
  auto const left = this->run(bytes, all, ft::odometry_corner_ratio);
  ASSERT_EQ(left[0].size(), 3u);
  EXPECT_TRUE(std::equal(left[0].begin(), left[0].end(), real, equal));
}

TYPED_TEST(drop_edges, refuses_other_ratios_and_images) {
  ft::image_pyramid<TestFixture::exec_type::space> const pyramid(this->geometry, images);
  ft::distribution_view view;
  view.layout = this->layout;
  view.batch = images;
  for (float const ratio : {-0.1f, 1.1f, std::nanf("")}) {
    EXPECT_THROW(ft::drop_edges(this->backend.exec, pyramid.view(), ratio, view), ft::bad_argument);
  }
  view.batch = images - 1;
  EXPECT_THROW(ft::drop_edges(this->backend.exec, pyramid.view(), 0.1f, view), ft::bad_argument);
}

}  // namespace drop_edges_test
