// SPDX-License-Identifier: Apache-2.0
// Keypoints between the pixels of their levels, against a plain loop and against blobs whose places
// are known.
#include "ft/kernels/keypoints/refine_positions.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/error.hpp"
#include "tests/support/backends.hpp"

namespace refine_positions_test {

constexpr int width = 211;
constexpr int height = 149;
constexpr int levels = 4;
constexpr int images = 3;

struct place {
  int x, y, octave;
};
struct moved {
  float x, y;
};

/// The largest threshold at which a pixel is a corner, from its definition.
int plain_score(std::uint8_t const* at, int stride) {
  constexpr int circle[16][2] = {{0, 3},  {1, 3},  {2, 2},  {3, 1},   {3, 0},   {3, -1},
                                 {2, -2}, {1, -3}, {0, -3}, {-1, -3}, {-2, -2}, {-3, -1},
                                 {-3, 0}, {-3, 1}, {-2, 2}, {-1, 3}};
  int best = 0;
  for (int first = 0; first < 16; ++first) {
    int bright = 255;
    int dark = 255;
    for (int k = 0; k < 9; ++k) {
      auto const& c = circle[(first + k) % 16];
      int const difference = at[c[1] * stride + c[0]] - at[0];
      bright = std::min(bright, difference);
      dark = std::min(dark, -difference);
    }
    best = std::max({best, bright, dark});
  }
  return best > 0 ? best - 1 : 0;
}

double plain_top(int before, int middle, int after) {
  int const bend = before - 2 * middle + after;
  if (bend >= 0) { return 0; }
  return std::clamp(0.5 * (before - after) / bend, -0.5, 0.5);
}

template <typename Backend>
class refine_positions : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  Backend backend;
  ft::pyramid_geometry geometry = ft::pyramid_geometry::make(width, height, levels, 1.2f);

  /// Moves keypoints, given per image, in a pyramid with these bytes.
  std::vector<std::vector<moved>> run(std::vector<std::uint8_t> const& bytes,
                                      std::vector<std::vector<place>> const& of) {
    constexpr auto space = exec_type::space;
    constexpr auto staging = ft::staging_space<exec_type>;
    exec_type const& exec = backend.exec;
    std::size_t most = 1;
    for (auto const& o : of) { most = std::max(most, o.size()); }
    int const capacity = static_cast<int>(most) + 3;
    int const batch = static_cast<int>(of.size());
    ft::image_pyramid<space> const pyramid(geometry, batch);
    ft::copy(exec, pyramid.view().data, bytes.data(), bytes.size());
    ft::keypoints<staging> const given(capacity, batch);
    for (int b = 0; b < batch; ++b) {
      auto const& own = of[static_cast<std::size_t>(b)];
      ft::keypoints_view const v = given.view().slice(b);
      *v.count = static_cast<int>(own.size());
      for (int i = 0; i < capacity; ++i) {
        bool const there = i < *v.count;
        place const p = there ? own[static_cast<std::size_t>(i)] : place{50, 50, 0};
        v.x(i) = static_cast<float>(p.x) * geometry.scale[p.octave];
        v.y(i) = static_cast<float>(p.y) * geometry.scale[p.octave];
        v.octave(i) = p.octave;
      }
    }
    ft::keypoints<space> const keypoints(capacity, batch);
    ft::copy(exec, keypoints.view(), given.view());
    ft::refine_positions(exec, pyramid.view(), keypoints.view());
    auto const result = ft::download(exec, keypoints.view());
    std::vector<std::vector<moved>> out(of.size());
    for (int b = 0; b < batch; ++b) {
      auto const v = result.view().slice(b);
      for (int i = 0; i < *v.count; ++i) {
        out[static_cast<std::size_t>(b)].push_back({v.x(i), v.y(i)});
      }
      EXPECT_EQ(v.x(capacity - 1), 50.0f) << "past the count";
    }
    return out;
  }
  std::vector<std::uint8_t> random_bytes(unsigned seed) const {
    std::mt19937 random(seed);
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(geometry.bytes) * images);
    int grey = 128;  // near pixels are alike
    for (auto& b : bytes) {
      grey = std::clamp(grey + static_cast<int>(random() % 61) - 30, 0, 255);
      b = static_cast<std::uint8_t>(grey);
    }
    return bytes;
  }
  std::vector<std::vector<place>> random_places(unsigned seed) const {
    std::mt19937 random(seed);
    std::vector<std::vector<place>> all;
    for (int b = 0; b < images; ++b) {
      std::vector<place> of;
      int const n = b == 1 ? 0 : 300;
      for (int i = 0; i < n; ++i) {
        int const l = static_cast<int>(random() % levels);
        of.push_back({static_cast<int>(random() % static_cast<unsigned>(geometry.width[l])),
                      static_cast<int>(random() % static_cast<unsigned>(geometry.height[l])), l});
      }
      all.push_back(of);
    }
    return all;
  }
};
TYPED_TEST_SUITE(refine_positions, test::backends);

TYPED_TEST(refine_positions, are_those_of_a_plain_loop) {
  auto const bytes = this->random_bytes(71);
  auto const places = this->random_places(72);
  auto const got = this->run(bytes, places);
  ft::pyramid_geometry const& g = this->geometry;
  int moves = 0;
  for (std::size_t b = 0; b < places.size(); ++b) {
    for (std::size_t i = 0; i < places[b].size(); ++i) {
      place const p = places[b][i];
      std::uint8_t const* const level =
          bytes.data() + static_cast<std::ptrdiff_t>(b) * g.bytes + g.offset[p.octave];
      int const stride = g.stride[p.octave];
      auto const score = [&](int x, int y) { return plain_score(level + y * stride + x, stride); };
      double x = p.x;
      double y = p.y;
      if (p.x >= 4 && p.x + 4 < g.width[p.octave] && p.y >= 4 && p.y + 4 < g.height[p.octave]) {
        x += plain_top(score(p.x - 1, p.y), score(p.x, p.y), score(p.x + 1, p.y));
        y += plain_top(score(p.x, p.y - 1), score(p.x, p.y), score(p.x, p.y + 1));
      }
      auto const scale = static_cast<double>(g.scale[p.octave]);
      EXPECT_NEAR(static_cast<double>(got[b][i].x), scale * x, 1e-4);
      EXPECT_NEAR(static_cast<double>(got[b][i].y), scale * y, 1e-4);
      moves += static_cast<int>(x != p.x || y != p.y);
    }
  }
  EXPECT_GT(moves, 100);
}

TYPED_TEST(refine_positions, have_the_bits_of_the_host) {
  auto const bytes = this->random_bytes(73);
  auto const places = this->random_places(74);
  auto const got = this->run(bytes, places);
  ft::pyramid_geometry const& g = this->geometry;
  for (std::size_t b = 0; b < places.size(); ++b) {
    ft::host_exec const exec(1);
    ft::image_pyramid<ft::memory_space::host> const pyramid(g);
    std::copy_n(bytes.begin() + static_cast<std::ptrdiff_t>(b) * g.bytes, g.bytes,
                pyramid.view().data);
    ft::keypoints<ft::memory_space::host> const k(static_cast<int>(places[b].size()) + 1);
    ft::keypoints_view const v = k.view();
    *v.count = static_cast<int>(places[b].size());
    for (int i = 0; i < *v.count; ++i) {
      place const p = places[b][static_cast<std::size_t>(i)];
      v.x(i) = static_cast<float>(p.x) * g.scale[p.octave];
      v.y(i) = static_cast<float>(p.y) * g.scale[p.octave];
      v.octave(i) = p.octave;
    }
    ft::refine_positions(exec, pyramid.view(), v);
    for (int i = 0; i < *v.count; ++i) {
      ASSERT_EQ(v.x(i), got[b][static_cast<std::size_t>(i)].x);
      ASSERT_EQ(v.y(i), got[b][static_cast<std::size_t>(i)].y);
    }
  }
}

TYPED_TEST(refine_positions, find_the_middle_of_a_blob) {
  ft::pyramid_geometry const& g = this->geometry;
  for (double const x : {-0.4, -0.2, 0.0, 0.3, 0.45}) {
    for (double const y : {-0.45, 0.0, 0.25}) {
      std::vector<std::uint8_t> bytes(static_cast<std::size_t>(g.bytes), 30);
      constexpr int cx = 60;
      constexpr int cy = 70;
      for (int v = cy - 15; v <= cy + 15; ++v) {
        for (int u = cx - 15; u <= cx + 15; ++u) {
          double const r2 = (u - cx - x) * (u - cx - x) + (v - cy - y) * (v - cy - y);
          bytes[static_cast<std::size_t>(v * g.stride[0] + u)] =
              static_cast<std::uint8_t>(std::lrint(30 + 200 * std::exp(-r2 / 2.4)));
        }
      }
      auto const got = this->run(bytes, {{{cx, cy, 0}}});
      EXPECT_NEAR(static_cast<double>(got[0][0].x), cx + x, 0.15) << x << ", " << y;
      EXPECT_NEAR(static_cast<double>(got[0][0].y), cy + y, 0.15) << x << ", " << y;
    }
  }
}

TYPED_TEST(refine_positions, of_other_images_are_refused) {
  constexpr auto space = TypeParam::exec_type::space;
  ft::image_pyramid<space> const pyramid(this->geometry, 2);
  ft::keypoints<space> const keypoints(5, 3);
  EXPECT_THROW(ft::refine_positions(this->backend.exec, pyramid.view(), keypoints.view()),
               ft::bad_argument);
}

}  // namespace refine_positions_test
