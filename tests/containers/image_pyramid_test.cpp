// SPDX-License-Identifier: Apache-2.0
// Sizes of pyramid levels, resize tables, and the pyramid stage against a plain reading of the
// specification.
#include "ft/containers/image_pyramid.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/blur.hpp"
#include "ft/kernels/pyramid/build_pyramid.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"
#include "ft/kernels/upload.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace image_pyramid_test {

using image = std::vector<std::uint8_t>;

inline std::vector<int> widths(int w, int levels, float factor) {
  auto const g = ft::pyramid_geometry::make(w, 100, levels, factor);
  return {g.width, g.width + levels};
}

TEST(pyramid_geometry_unit, level_sizes_of_common_cameras) {
  EXPECT_EQ(widths(752, 8, 1.2f), (std::vector<int>{752, 627, 522, 435, 363, 302, 252, 210}));
  EXPECT_EQ(widths(480, 8, 1.2f), (std::vector<int>{480, 400, 333, 278, 231, 193, 161, 134}));
  EXPECT_EQ(widths(1241, 8, 1.2f), (std::vector<int>{1241, 1034, 862, 718, 598, 499, 416, 346}));
  EXPECT_EQ(widths(640, 4, 2.0f), (std::vector<int>{640, 320, 160, 80}));
}

TEST(pyramid_geometry_unit, a_tie_is_rounded_in_float_to_even) {
  EXPECT_EQ(widths(375, 2, 1.2f)[1], 312);  // 312.5 once rounded to float, slightly less before
  EXPECT_EQ(widths(5, 2, 2.0f)[1], 2);
  EXPECT_EQ(widths(7, 2, 2.0f)[1], 4);
}

TEST(pyramid_geometry_unit, scales_are_products_in_float) {
  auto const g = ft::pyramid_geometry::make(1000, 700, 16, 1.2f);
  float scale = 1;
  for (int l = 0; l < 16; ++l) {
    EXPECT_EQ(g.scale[l], scale);
    EXPECT_EQ(g.inv_scale[l], 1.0f / scale);
    EXPECT_EQ(g.sigma2[l], scale * scale);
    EXPECT_EQ(g.inv_sigma2[l], 1.0f / (scale * scale));
    EXPECT_EQ(g.patch_size(l), static_cast<int>(31.0f * scale));
    scale *= 1.2f;
  }
}

TEST(pyramid_geometry_unit, levels_lie_side_by_side) {
  auto const g = ft::pyramid_geometry::make(333, 257, 8, 1.2f);
  std::ptrdiff_t end = 0;
  int taps = 0;
  for (int l = 0; l < 8; ++l) {
    EXPECT_EQ(g.offset[l], end);
    EXPECT_GE(g.stride[l], g.width[l]);
    EXPECT_LT(g.stride[l], g.width[l] + 64);
    EXPECT_EQ(g.stride[l] % 64, 0);
    end += static_cast<std::ptrdiff_t>(g.stride[l]) * g.height[l];
    EXPECT_EQ(g.tap_offset[l], taps);
    if (l > 0) { taps += g.width[l] + g.height[l]; }
  }
  EXPECT_EQ(g.bytes, end);
  EXPECT_EQ(g.taps, taps);
}

TEST(pyramid_geometry_unit, arguments_out_of_range_throw) {
  auto const make = [](int w, int h, int levels, float factor) {
    return ft::pyramid_geometry::make(w, h, levels, factor);
  };
  EXPECT_NO_THROW(make(1, 1, 1, 1.2f));
  EXPECT_NO_THROW(make(16384, 16384, 16, 1.01f));
  EXPECT_NO_THROW(make(1 << 14, 1 << 14, 8, 4.0f)) << "the last level is a single pixel";
  EXPECT_THROW(make(0, 10, 1, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(10, 0, 1, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(-5, 10, 1, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(16385, 10, 1, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(10, 16385, 1, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 0, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 17, 1.2f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 4, 1.0f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 4, 4.01f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 4, -1.2f), ft::bad_argument);
  EXPECT_THROW(make(100, 100, 4, std::numeric_limits<float>::quiet_NaN()), ft::bad_argument);
  EXPECT_THROW(make(1, 1, 8, 1.2f), ft::bad_argument) << "a level without a pixel";
  EXPECT_THROW(make(1000, 1, 8, 1.2f), ft::bad_argument);
}

TEST(resize_taps_unit, weights_sum_to_one_and_stay_inside) {
  for (int w : {2, 3, 17, 64, 375, 1241}) {
    for (float factor : {1.1f, 1.2f, 1.5f, 2.0f}) {
      auto const g = ft::pyramid_geometry::make(w, w, 2, factor);
      std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
      ft::make_resize_taps(g, taps.data());
      int before = 0;
      for (int x = 0; x < g.width[1]; ++x) {
        auto const& t = taps[static_cast<std::size_t>(x)];
        EXPECT_EQ(t.w0 + t.w1, 2048);
        EXPECT_GE(t.w0, 0);
        EXPECT_GE(t.w1, 0);
        EXPECT_GE(t.first, before);
        EXPECT_LT(t.first + t.offset, w);
        EXPECT_TRUE(t.offset == 1 || (t.offset == 0 && t.first == w - 1 && t.w1 == 0));
        before = t.first;
      }
    }
  }
}

/// Section 1 of the specification, word by word.
inline image resized(image const& from, int sw, int sh, int dw, int dh) {
  auto const tap = [](int d, int src, int dst, int& i, int& w0, int& w1) {
    auto f = static_cast<float>((d + 0.5) * (static_cast<double>(src) / dst) - 0.5);
    i = static_cast<int>(std::floor(f));
    f -= static_cast<float>(i);
    if (i < 0) {
      i = 0;
      f = 0;
    }
    if (i >= src - 1) {
      i = src - 1;
      f = 0;
    }
    w0 = static_cast<int>(std::nearbyint((1 - f) * 2048));
    w1 = static_cast<int>(std::nearbyint(f * 2048));
  };
  image to;
  for (int y = 0; y < dh; ++y) {
    int iy = 0;
    int b0 = 0;
    int b1 = 0;
    tap(y, sh, dh, iy, b0, b1);
    for (int x = 0; x < dw; ++x) {
      int ix = 0;
      int a0 = 0;
      int a1 = 0;
      tap(x, sw, dw, ix, a0, a1);
      auto const pixel = [&](int px, int py) {
        return static_cast<int>(
            from[static_cast<std::size_t>(std::min(py, sh - 1) * sw + std::min(px, sw - 1))]);
      };
      int const h0 = pixel(ix, iy) * a0 + pixel(ix + 1, iy) * a1;
      int const h1 = pixel(ix, iy + 1) * a0 + pixel(ix + 1, iy + 1) * a1;
      to.push_back(static_cast<std::uint8_t>(
          (((b0 * (h0 >> 4)) >> 16) + ((b1 * (h1 >> 4)) >> 16) + 2) >> 2));
    }
  }
  return to;
}

/// The 7 x 7 kernel of section 4 over a level, sample by sample.
inline image blurred(image const& from, int w, int h) {
  constexpr int weights[7] = {18, 34, 48, 56, 48, 34, 18};
  auto const inside = [](int i, int n) {
    while (n > 1 && (i < 0 || i >= n)) { i = i < 0 ? -i : 2 * (n - 1) - i; }
    return n == 1 ? 0 : i;
  };
  image to;
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      int sum = 0;
      for (int dy = -3; dy <= 3; ++dy) {
        for (int dx = -3; dx <= 3; ++dx) {
          sum += weights[dy + 3] * weights[dx + 3] *
                 from[static_cast<std::size_t>(inside(y + dy, h) * w + inside(x + dx, w))];
        }
      }
      to.push_back(static_cast<std::uint8_t>((sum + (1 << 15)) >> 16));
    }
  }
  return to;
}

template <typename Backend>
class image_pyramid_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  using pyramid = ft::image_pyramid<Backend::exec_type::space>;

  void set_level_0(pyramid const& p, int b, image const& pixels) {
    auto const to = p.view().level(b, 0);
    ft::copy_image(backend.exec, to, {pixels.data(), to.width, to.height, to.width});
    backend.exec.wait();
  }
  image level_of(pyramid const& p, int b, int l) {
    auto const from = p.view().level(b, l);
    auto const rows = test::from_exec(
        backend.exec, static_cast<std::uint8_t const*>(from.data),
        static_cast<std::size_t>(from.stride) * static_cast<std::size_t>(from.height - 1) +
            static_cast<std::size_t>(from.width));
    image pixels;
    for (int y = 0; y < from.height; ++y) {
      auto const first = rows.begin() + static_cast<std::ptrdiff_t>(y) * from.stride;
      pixels.insert(pixels.end(), first, first + from.width);
    }
    return pixels;
  }
};
TYPED_TEST_SUITE(image_pyramid_unit, test::backends);

TYPED_TEST(image_pyramid_unit, every_image_of_a_batch_is_resized_and_blurred) {
  auto const& exec = this->backend.exec;
  struct shape {
    int w, h, levels;
    float factor;
  };
  for (shape const s : {shape{160, 120, 8, 1.2f},
                        {375, 97, 3, 1.2f},
                        {67, 131, 4, 1.5f},
                        {64, 64, 3, 2.0f},
                        {9, 5, 2, 1.1f},
                        {3, 2, 1, 1.2f},
                        {1, 1, 3, 1.2f}}) {
    auto const g = ft::pyramid_geometry::make(s.w, s.h, s.levels, s.factor);
    constexpr int batch = 3;
    typename TestFixture::pyramid const from(g, batch);
    typename TestFixture::pyramid const to(g, batch);
    std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
    ft::make_resize_taps(g, taps.data());
    auto const d_taps = test::to_exec(exec, taps);
    for (int b = 0; b < batch; ++b) {
      this->set_level_0(from, b,
                        test::random_image(s.w, s.h, static_cast<unsigned>(100 * s.w + b)));
    }
    ft::build_pyramid(exec, from.view(), d_taps.data());
    ft::blur_pyramid(exec, from.view(), to.view(), ft::blur_layout::make(g));
    for (int b = 0; b < batch; ++b) {
      image want = test::random_image(s.w, s.h, static_cast<unsigned>(100 * s.w + b));
      for (int l = 0; l < s.levels; ++l) {
        if (l > 0) {
          want = resized(want, g.width[l - 1], g.height[l - 1], g.width[l], g.height[l]);
        }
        EXPECT_EQ(this->level_of(from, b, l), want)
            << s.w << "x" << s.h << " image " << b << " level " << l;
        EXPECT_EQ(this->level_of(to, b, l), blurred(want, g.width[l], g.height[l]))
            << s.w << "x" << s.h << " image " << b << " level " << l;
      }
    }
  }
}

TYPED_TEST(image_pyramid_unit, tiles_give_the_same_pixels_as_rows) {
  auto const& exec = this->backend.exec;
  struct shape {
    int w, h, levels;
    float factor;
    int side;
  };
  int several_groups = 0;
  for (shape const s : {shape{752, 480, 8, 1.2f, 72},
                        {331, 257, 8, 1.2f, 72},
                        {331, 257, 8, 1.2f, 16},
                        {640, 400, 16, 1.2f, 72},
                        {640, 400, 16, 1.2f, 9},
                        {700, 450, 4, 4.0f, 72},
                        {500, 70, 6, 1.7f, 500},
                        {75, 80, 4, 1.01f, 72},
                        {2, 3, 2, 1.2f, 72},
                        {5, 4, 1, 1.2f, 72}}) {
    auto const g = ft::pyramid_geometry::make(s.w, s.h, s.levels, s.factor);
    constexpr int batch = 2;
    typename TestFixture::pyramid const by_rows(g, batch);
    typename TestFixture::pyramid const by_tiles(g, batch);
    std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
    ft::make_resize_taps(g, taps.data());
    std::vector<ft::tile_span> spans;
    ft::pyramid_tiles tiles = ft::make_pyramid_tiles(g, taps.data(), spans, s.side);
    several_groups += static_cast<int>(tiles.groups > 1);
    auto const d_taps = test::to_exec(exec, taps);
    auto const d_spans = test::to_exec(exec, spans);
    tiles.spans = d_spans.data();
    for (int b = 0; b < batch; ++b) {
      auto const pixels = test::random_image(s.w, s.h, static_cast<unsigned>(s.w + b));
      this->set_level_0(by_rows, b, pixels);
      this->set_level_0(by_tiles, b, pixels);
    }
    ft::build_pyramid(exec, by_rows.view(), d_taps.data());
    ft::build_pyramid(exec, by_tiles.view(), d_taps.data(), tiles);
    for (int b = 0; b < batch; ++b) {
      for (int l = 0; l < s.levels; ++l) {
        EXPECT_EQ(this->level_of(by_tiles, b, l), this->level_of(by_rows, b, l))
            << s.w << "x" << s.h << " side " << s.side << " image " << b << " level " << l;
      }
    }
  }
  EXPECT_GT(several_groups, 0) << "some geometry must need more than one launch";
}

TYPED_TEST(image_pyramid_unit, tiles_of_images_that_are_still_fetched_give_the_same_pixels) {
  using exec_type = typename TypeParam::exec_type;
  auto const& exec = this->backend.exec;
  struct shape {
    int w, h, levels, batch, side;
  };
  // More parts than are on their way at a time, and fewer; more tiles than multiprocessors.
  for (shape const s :
       {shape{752, 480, 8, 2, 56}, shape{752, 480, 8, 5, 80}, shape{331, 257, 8, 3, 56},
        shape{640, 400, 8, 1, 24}, shape{64, 48, 3, 2, 56}, shape{1241, 376, 8, 1, 56}}) {
    auto const g = ft::pyramid_geometry::make(s.w, s.h, s.levels, 1.2f);
    typename TestFixture::pyramid const by_rows(g, s.batch);
    typename TestFixture::pyramid const by_tiles(g, s.batch);
    std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
    ft::make_resize_taps(g, taps.data());
    std::vector<ft::tile_span> spans;
    ft::pyramid_tiles tiles = ft::make_pyramid_tiles(g, taps.data(), spans, s.side);
    ASSERT_EQ(tiles.groups, 1);
    auto const d_taps = test::to_exec(exec, taps);
    auto const d_spans = test::to_exec(exec, spans);
    tiles.spans = d_spans.data();
    ft::frame_arrivals arrivals;
    ft::arena<exec_type::space> const memory(
        [&](ft::carver& c) { carve(c, arrivals, g, s.batch); });
    auto const parts = static_cast<std::size_t>(arrivals.batch * arrivals.parts);
    // As an earlier frame leaves them: the upload has to reset them.
    ft::fill_bytes(exec, arrivals.received, 1, parts * sizeof(unsigned));
    int const stride = (s.w + 15) / 16 * 16;
    auto const bytes = static_cast<std::size_t>(stride) * static_cast<std::size_t>(s.h);
    auto const batch = static_cast<std::size_t>(s.batch);
    ft::buffer<std::uint8_t, ft::staging_space<exec_type>> const images(bytes * batch);
    ft::buffer<ft::image_source, ft::staging_space<exec_type>> const sources(batch);
    exec.wait();
    auto const queue = [&](exec_type const& e) {
      ft::receive_images(e, sources.data(), by_tiles.view(), {}, {}, arrivals);
      ft::build_pyramid(ft::detail::with_order(e, ft::detail::launch_order::concurrent),
                        by_tiles.view(), d_taps.data(), tiles, arrivals);
    };
    ft::recording<exec_type> recorded;
    recorded.record(exec, queue);
    for (unsigned round = 0; round < 4; ++round) {
      for (int b = 0; b < s.batch; ++b) {
        auto const pixels =
            test::random_image(s.w, s.h, 100 * round + static_cast<unsigned>(s.w + b));
        this->set_level_0(by_rows, b, pixels);
        std::uint8_t* const to = images.data() + static_cast<std::size_t>(b) * bytes;
        for (int y = 0; y < s.h; ++y) {
          std::copy_n(pixels.data() + static_cast<std::ptrdiff_t>(y) * s.w, s.w,
                      to + static_cast<std::ptrdiff_t>(y) * stride);
        }
        sources.data()[b] = {static_cast<std::uint8_t const*>(exec_type::host_address(to)), stride};
      }
      ft::build_pyramid(exec, by_rows.view(), d_taps.data());
      if (round == 0) {
        queue(exec);
      } else {
        recorded.replay(exec, queue);
      }
      auto const received =
          test::from_exec(exec, static_cast<unsigned const*>(arrivals.received), parts);
      EXPECT_EQ(static_cast<std::size_t>(std::count(received.begin(), received.end(), 1u)),
                received.size());
      for (int b = 0; b < s.batch; ++b) {
        for (int l = 0; l < s.levels; ++l) {
          ASSERT_EQ(this->level_of(by_tiles, b, l), this->level_of(by_rows, b, l))
              << s.w << "x" << s.h << " round " << round << " image " << b << " level " << l;
        }
      }
    }
  }
}

TYPED_TEST(image_pyramid_unit, flat_images_stay_flat) {
  auto const& exec = this->backend.exec;
  auto const g = ft::pyramid_geometry::make(100, 70, 5, 1.2f);
  typename TestFixture::pyramid const from(g, 1);
  typename TestFixture::pyramid const to(g, 1);
  std::vector<ft::resize_tap> taps(static_cast<std::size_t>(g.taps));
  ft::make_resize_taps(g, taps.data());
  auto const d_taps = test::to_exec(exec, taps);
  for (int grey : {0, 1, 127, 255}) {
    this->set_level_0(from, 0, image(100 * 70, static_cast<std::uint8_t>(grey)));
    ft::build_pyramid(exec, from.view(), d_taps.data());
    ft::blur_pyramid(exec, from.view(), to.view(), ft::blur_layout::make(g));
    for (int l = 0; l < 5; ++l) {
      image const want(static_cast<std::size_t>(g.width[l] * g.height[l]),
                       static_cast<std::uint8_t>(grey));
      EXPECT_EQ(this->level_of(from, 0, l), want);
      EXPECT_EQ(this->level_of(to, 0, l), want);
    }
  }
}

TYPED_TEST(image_pyramid_unit, a_batch_below_one_throws) {
  auto const g = ft::pyramid_geometry::make(32, 32, 2, 1.2f);
  using owner = ft::image_pyramid<TypeParam::exec_type::space>;
  EXPECT_THROW(owner(g, 0), ft::bad_argument);
  EXPECT_THROW(owner(g, -1), ft::bad_argument);
  EXPECT_EQ(owner(g, 2).view().batch, 2);
}

}  // namespace image_pyramid_test
