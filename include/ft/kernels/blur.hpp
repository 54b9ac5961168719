// SPDX-License-Identifier: Apache-2.0
/// @file Stage: blur. 7 x 7 binomial-like kernel in integers, reflected borders, bit-identical to
/// cv::GaussianBlur(7x7, sigma 2, BORDER_REFLECT_101) on 8-bit images. Source: specification
/// section 4.
#pragma once

#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// Tiles of all levels of one image, numbered level by level.
struct blur_layout {
  static constexpr int tile_width = 64;
  static constexpr int tile_height = 16;
  int levels = 0;
  int cols[max_levels] = {};
  int first[max_levels + 1] = {};

  static blur_layout make(pyramid_geometry const& g) {
    blur_layout b;
    b.levels = g.levels;
    for (int l = 0; l < g.levels; ++l) {
      b.cols[l] = ceil_div(g.width[l], tile_width);
      b.first[l + 1] = b.first[l] + b.cols[l] * ceil_div(g.height[l], tile_height);
    }
    return b;
  }
};

namespace detail {

/// Index inside [0, n) of a position outside by reflection that does not repeat the edge; any
/// distance.
FT_HOST_DEVICE inline int reflect_101(int i, int n) {
  if (n == 1) { return 0; }
  while (i < 0 || i >= n) { i = i < 0 ? -i : 2 * n - 2 - i; }
  return i;
}

}  // namespace detail

/// One tile of one level of one image.
struct blur_tile {
  static constexpr int radius = 3;
  struct scratch {
    std::uint16_t sums[(blur_layout::tile_height + 2 * radius) * blur_layout::tile_width];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& from,
                                 image_pyramid_view const& to, blur_layout const& layout) const {
    constexpr int tw = blur_layout::tile_width;
    constexpr int th = blur_layout::tile_height;
    int const tiles = layout.first[layout.levels];
    int const image = item / tiles;
    int const tile = item % tiles;
    int l = 0;
    while (tile >= layout.first[l + 1]) { ++l; }
    auto const in = from.level(image, l);
    auto const out = to.level(image, l);
    int const x0 = (tile - layout.first[l]) % layout.cols[l] * tw;
    int const y0 = (tile - layout.first[l]) / layout.cols[l] * th;
    int const w = min_of(tw, in.width - x0);
    int const h = min_of(th, in.height - y0);
    bool const inner = x0 >= radius && x0 + w + radius <= in.width;

    for (int r = 0; r < h + 2 * radius; ++r) {
      std::uint8_t const* const row = in.row(detail::reflect_101(y0 + r - radius, in.height));
      std::uint16_t* const sum = s.sums + r * tw;
      if (inner) {
        for (int x = g.rank(); x < w; x += g.size()) {
          std::uint8_t const* const p = row + x0 + x;
          sum[x] = static_cast<std::uint16_t>(18 * (p[-3] + p[3]) + 34 * (p[-2] + p[2]) +
                                              48 * (p[-1] + p[1]) + 56 * p[0]);
        }
      } else {
        for (int x = g.rank(); x < w; x += g.size()) {
          constexpr int weights[7] = {18, 34, 48, 56, 48, 34, 18};
          int v = 0;
          for (int k = 0; k < 7; ++k) {
            v += weights[k] * row[detail::reflect_101(x0 + x + k - radius, in.width)];
          }
          sum[x] = static_cast<std::uint16_t>(v);
        }
      }
    }
    g.sync();
    for (int r = 0; r < h; ++r) {
      std::uint8_t* const row = out.row(y0 + r) + x0;
      for (int x = g.rank(); x < w; x += g.size()) {
        std::uint16_t const* const p = s.sums + r * tw + x;
        unsigned const v = 18u * (static_cast<unsigned>(p[0]) + p[6 * tw]) +
                           34u * (static_cast<unsigned>(p[tw]) + p[5 * tw]) +
                           48u * (static_cast<unsigned>(p[2 * tw]) + p[4 * tw]) + 56u * p[3 * tw];
        row[x] = static_cast<std::uint8_t>((v + (1u << 15)) >> 16);
      }
    }
  }
};

/// Every level of every image of `from`, blurred, into `to`. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec>
void blur_pyramid(Exec const& exec, image_pyramid_view const& from, image_pyramid_view const& to,
                  blur_layout const& layout) {
  for_each_item<per_block<64>>(exec, from.batch * layout.first[layout.levels], blur_tile{}, from,
                               to, layout);
}

}  // namespace FT_ABI
}  // namespace ft
