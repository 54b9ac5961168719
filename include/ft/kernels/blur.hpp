// SPDX-License-Identifier: Apache-2.0
/// @file Stage: blur. A separable 7 x 7 kernel in integers with reflected borders, bit-identical to
/// cv::GaussianBlur(7x7, sigma 2, BORDER_REFLECT_101) on 8-bit images. Source: specification
/// section 4.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

/// Tiles of all levels of one image, numbered level by level.
struct blur_layout {
  static constexpr int tile_width = 64;
  static constexpr int tile_height = 32;
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

/// Reflects a position at any distance into [0, n), without repeating the edge.
FT_HOST_DEVICE inline int reflect_101(int i, int n) {
  if (n == 1) { return 0; }
  while (i < 0 || i >= n) { i = i < 0 ? -i : 2 * n - 2 - i; }
  return i;
}

/// Item: a tile of a level of an image.
///
/// On the host a single thread goes through the rows in scratch. On a device each thread blurs
/// strips of 4 columns in registers; blur_rows() is for images that strips cannot handle.
struct blur_tile {
  static constexpr bool wide_on_host = true;
  static constexpr int radius = 3;
  static constexpr int strip_rows = 8;
  /// In smaller images both borders could fall into one strip.
  static constexpr int least_width = 8;
  static constexpr int least_height = 4;
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
    if (from.absent.has(image)) { return; }
    int const tile = item % tiles;
    int l = 0;
    while (tile >= layout.first[l + 1]) { ++l; }
    auto const in = from.level(image, l);
    auto const out = to.level(image, l);
    int const x0 = (tile - layout.first[l]) % layout.cols[l] * tw;
    int const y0 = (tile - layout.first[l]) / layout.cols[l] * th;
    if (g.size() > 1 && can_use_strips(in, out)) {
      constexpr int columns = tw / 4;
      static_assert(32 % columns == 0, "a warp's strips lie in one tile");
      constexpr int warp_rows = 32 / columns * strip_rows;
      for (int i = g.rank(); i < columns * (th / strip_rows); i += g.size()) {
        int const x = x0 + 4 * (i % columns);
        int const y = y0 + i / columns * strip_rows;
        int const warp_y = y0 + i / 32 * warp_rows;  // uniform in a warp
        bool const border = x0 == 0 || x0 + tw + 4 > in.width || warp_y < radius ||
                            warp_y + warp_rows + radius > in.height;
        if (x >= in.width || y >= in.height) { continue; }
        if (border) {
          blur_strip<true>(in, out, x, y);
        } else {
          blur_strip<false>(in, out, x, y);
        }
      }
    } else {
      pixel_rectangle const part{x0, y0, min_of(tw, in.width - x0), min_of(th, in.height - y0)};
      if constexpr (Group::max_threads == 1) {
        blur_alone(s, in, out, part);
      } else {
        blur_rows(g, s, in, out, part);
      }
    }
  }

  FT_HOST_DEVICE static bool can_use_strips(gray_view in, gray_view out) {
    return in.width >= least_width && in.height >= least_height && has_word_rows(in) &&
           has_word_rows(out);
  }

  /// Blurs the pixels [x, x + 4) x [y, y + strip_rows) that lie in the image. The sum along a row
  /// needs three words: that of the pixel and its two neighbours.
  /// @tparam Border whether words or rows may lie outside the image @param x a multiple of 4
  template <bool Border>
  FT_HOST_DEVICE static void blur_strip(gray_view in, image_view<std::uint8_t> out, int x, int y) {
    constexpr int rows = strip_rows + 2 * radius;
    // Pixels outside the image are mirrored: bytes of the words inside are permuted.
    int left_x = x - 4;
    int right_x = x + 4;
    int const rest = in.width - x;  // columns from x on
    std::uint32_t own = 0x7654;     // selects the middle word from left and middle
    std::uint32_t beyond = 0x7654;  // selects the right word from middle and right; in the last
                                    // strip from left and middle
    if (Border) {
      left_x = max_of(left_x, 0);
      right_x = rest > 4 ? right_x : x;
      if (rest < 8) { mirror(rest, own, beyond); }
    }
    std::uint32_t left[rows];
    std::uint32_t middle[rows];
    std::uint32_t right[rows];
    FT_UNROLL
    for (int r = 0; r < rows; ++r) {
      std::uint8_t const* const row = row_of<Border>(in, y + r - radius);
      left[r] = load_word(row + left_x);
      middle[r] = load_word(row + x);
      right[r] = load_word(row + right_x);
    }
    // Low half: sum of row 2 k; high half: sum of row 2 k + 1.
    std::uint32_t pairs[4][rows / 2];
    FT_UNROLL
    for (int r = 0; r < rows; ++r) {
      std::uint32_t a = left[r];
      std::uint32_t b = middle[r];
      std::uint32_t c = right[r];
      if (Border) {
        a = x == 0 ? permute_bytes(b, c, 0x1234) : a;
        std::uint32_t const from = rest > 4 ? b : a;
        c = permute_bytes(from, rest > 4 ? c : b, beyond);
        b = permute_bytes(a, b, own);
      }
      std::uint32_t sum[4];
      sum_along_row(a, b, c, sum);
      FT_UNROLL
      for (int k = 0; k < 4; ++k) {
        if (r % 2 == 0) {
          pairs[k][r / 2] = sum[k];
        } else {
          pairs[k][r / 2] |= sum[k] << 16;
        }
      }
    }
    FT_UNROLL
    for (int r = 0; r < strip_rows; ++r) {
      std::uint32_t const word = blurred_word(pairs, r);
      if (Border && y + r >= out.height) { return; }
      store_pixels<Border>(out.row(y + r) + x, word, rest);
    }
  }

private:
  /// Row y of an image, mirrored if it lies outside.
  template <bool Border>
  FT_HOST_DEVICE static std::uint8_t const* row_of(gray_view in, int y) {
    if (Border) {
      y = y < 0 ? -y : y;
      y = max_of(min_of(y, 2 * in.height - 2 - y), 0);
    }
    return in.data + y * in.stride;
  }

  /// Stores the first `rest` pixels of a word, at most four.
  template <bool Border>
  FT_HOST_DEVICE static void store_pixels(std::uint8_t* to, std::uint32_t word, int rest) {
    if (!Border || rest >= 4) {
      store_word(to, word);
    } else {
      FT_UNROLL
      for (int k = 0; k < 3; ++k) {
        if (k < rest) { to[k] = static_cast<std::uint8_t>(word >> (8 * k)); }
      }
    }
  }

  /// Sums of the four pixels of word b along a row, with the words before and after it. The weights
  /// are 18 34 48 56 48 34 18, the first one in the lowest byte.
  FT_HOST_DEVICE static void sum_along_row(std::uint32_t a, std::uint32_t b, std::uint32_t c,
                                           std::uint32_t (&sum)[4]) {
    sum[0] = dot_of_4(b, 0x12223038u, dot_of_4(a, 0x30221200u, 0));
    sum[1] = dot_of_4(c, 0x00000012u, dot_of_4(b, 0x22303830u, dot_of_4(a, 0x22120000u, 0)));
    sum[2] = dot_of_4(c, 0x00001222u, dot_of_4(b, 0x30383022u, dot_of_4(a, 0x12000000u, 0)));
    sum[3] = dot_of_4(c, 0x00122230u, dot_of_4(b, 0x38302212u, 0));
  }

  /// The four pixels of row r of a strip. @param pairs sums along rows, two rows a word
  template <int Pairs>
  FT_HOST_DEVICE static std::uint32_t blurred_word(std::uint32_t const (&pairs)[4][Pairs], int r) {
    std::uint32_t pixel[4];
    FT_UNROLL
    for (int k = 0; k < 4; ++k) {
      std::uint32_t const* const p = pairs[k] + r / 2;
      std::uint32_t v = 1u << 15;
      if (r % 2 == 0) {
        v = dot_of_2(p[0], 0x2212u, v);
        v = dot_of_2(p[1], 0x3830u, v);
        v = dot_of_2(p[2], 0x2230u, v);
        v = dot_of_2(p[3], 0x0012u, v);
      } else {
        v = dot_of_2(p[0], 0x1200u, v);
        v = dot_of_2(p[1], 0x3022u, v);
        v = dot_of_2(p[2], 0x3038u, v);
        v = dot_of_2(p[3], 0x1222u, v);
      }
      pixel[k] = v;
    }
    return permute_bytes(permute_bytes(pixel[0], pixel[1], 0x0062),
                         permute_bytes(pixel[2], pixel[3], 0x0062), 0x5410);
  }

  /// Selectors of a strip with fewer than 8 columns of the image left. The mirror image of column
  /// rest - 1 + k is rest - 1 - k.
  /// @param own selects the strip's columns
  /// @param beyond selects the 4 columns after them
  FT_HOST_DEVICE static void mirror(int rest, std::uint32_t& own, std::uint32_t& beyond) {
    int const origin =
        rest > 4 ? 0 : 4;  // byte of column 0 in the words that `beyond` selects from
    own = 0;
    beyond = 0;
    for (int i = 0; i < 4; ++i) {
      int const column = i < rest ? i : 2 * rest - 2 - i;
      own |= static_cast<std::uint32_t>(column + 4) << (4 * i);
      int const next = i + 4 < rest ? i + 4 : 2 * rest - 6 - i;
      beyond |= static_cast<std::uint32_t>(max_of(next + origin, 0)) << (4 * i);
    }
  }

  /// By a single thread. Loops run over the whole width of a tile: a constant length vectorises.
  FT_HOST_DEVICE FT_INLINE static void blur_alone(scratch& s, gray_view in,
                                                  image_view<std::uint8_t> out,
                                                  pixel_rectangle const& part) {
    constexpr int tw = blur_layout::tile_width;
    int const x0 = part.x;
    int const y0 = part.y;
    int const w = part.w;
    int const h = part.h;
    int const first = x0 - radius;  // column of pixels[0]
    bool const inner = first >= 0 && w == tw && x0 + tw + radius <= in.width;
    if (inner) {
      sum_rows(s, h,
               [&](int r) { return in.row(reflect_101(y0 + r - radius, in.height)) + first; });
    } else {
      // All rows are copied before the first is summed: a load that spans recent stores stalls.
      constexpr int pitch = tw + 2 * radius;
      std::uint8_t mirrored[(blur_layout::tile_height + 2 * radius) * pitch];
      for (int r = 0; r < h + 2 * radius; ++r) {
        copy_mirrored(in.row(reflect_101(y0 + r - radius, in.height)), in.width, first,
                      x0 + w + radius, mirrored + r * pitch, pitch);
      }
      sum_rows(s, h, [&](int r) { return mirrored + r * pitch; });
    }
    for (int r = 0; r < h; ++r) {
      std::uint16_t const* const sums = s.sums + r * tw;
      std::uint8_t* const to = out.row(y0 + r) + x0;
      if (w == tw) {
        for (int x = 0; x < tw; ++x) { to[x] = blurred_pixel(sums + x); }
      } else {
        for (int x = 0; x < w; ++x) { to[x] = blurred_pixel(sums + x); }
      }
    }
  }

  /// Sums along the rows that the h rows of a tile need. @param row row(r): its first pixel
  template <typename Row>
  FT_HOST_DEVICE FT_INLINE static void sum_rows(scratch& s, int h, Row const& row) {
    constexpr int tw = blur_layout::tile_width;
    for (int r = 0; r < h + 2 * radius; ++r) {
      std::uint8_t const* const pixels = row(r);
      std::uint16_t* const sums = s.sums + r * tw;
      for (int x = 0; x < tw; ++x) {
        std::uint8_t const* const p = pixels + x;
        sums[x] = static_cast<std::uint16_t>(18 * (p[0] + p[6]) + 34 * (p[1] + p[5]) +
                                             48 * (p[2] + p[4]) + 56 * p[3]);
      }
    }
  }

  /// Copies columns [first, end) of a row, mirrored where they lie outside of it; zeros follow.
  /// @param size of `to`
  FT_HOST_DEVICE FT_INLINE static void copy_mirrored(std::uint8_t const* row, int width, int first,
                                                     int end, std::uint8_t* to, int size) {
    int const inside = max_of(first, 0);
    int const outside = min_of(end, width);
    std::memcpy(to + (inside - first), row + inside, static_cast<std::size_t>(outside - inside));
    for (int x = first; x < inside; ++x) { to[x - first] = row[reflect_101(x, width)]; }
    for (int x = outside; x < end; ++x) { to[x - first] = row[reflect_101(x, width)]; }
    std::memset(to + (end - first), 0, static_cast<std::size_t>(size - (end - first)));
  }

  /// Weighted sum of 7 sums along rows, rounded to a pixel, in 16-bit arithmetic. Each sum is split
  /// into 256 * high + low, where low = 0 if high = 255, so that no step overflows. This is exact,
  /// because only multiples of 256 of the sum of the low parts count.
  FT_HOST_DEVICE FT_INLINE static std::uint8_t blurred_pixel(std::uint16_t const* p) {
    constexpr int tw = blur_layout::tile_width;
    auto const weighted = [&](auto const& part) {
      return static_cast<std::uint16_t>(
          18 * (part(p[0]) + part(p[6 * tw])) + 34 * (part(p[tw]) + part(p[5 * tw])) +
          48 * (part(p[2 * tw]) + part(p[4 * tw])) + 56 * part(p[3 * tw]));
    };
    auto const high = weighted([](std::uint16_t v) { return v >> 8; });
    auto const low = weighted([](std::uint16_t v) { return v & 255; });
    return static_cast<std::uint8_t>(static_cast<std::uint16_t>(high + (low >> 8) + 128) >> 8);
  }

  /// By several threads, row by row in scratch: for images that are small or not aligned to words.
  template <typename Group>
  FT_HOST_DEVICE static void blur_rows(Group g, scratch& s, gray_view in,
                                       image_view<std::uint8_t> out, pixel_rectangle const& part) {
    constexpr int tw = blur_layout::tile_width;
    int const x0 = part.x;
    int const y0 = part.y;
    int const w = part.w;
    int const h = part.h;
    bool const inner = x0 >= radius && x0 + w + radius <= in.width;

    for (int r = 0; r < h + 2 * radius; ++r) {
      std::uint8_t const* const row = in.row(reflect_101(y0 + r - radius, in.height));
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
            v += weights[k] * row[reflect_101(x0 + x + k - radius, in.width)];
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

}  // namespace detail

/// Blurs every level of every image of `from` into `to`. Asynchronous on `exec`; allocates nothing;
/// one launch.
template <typename Exec>
void blur_pyramid(Exec const& exec, image_pyramid_view const& from, image_pyramid_view const& to,
                  blur_layout const& layout) {
  for_each_item<per_block<64>>(exec, from.batch * layout.first[layout.levels], detail::blur_tile{},
                               from, to, layout);
}

}  // namespace FT_ABI
}  // namespace ft
