// SPDX-License-Identifier: Apache-2.0
/// @file Stage: scale pyramid. Each level is the bilinear resize of the one before it,
/// bit-identical to cv::resize(INTER_LINEAR) on 8-bit images. Source: specification section 1.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/column_taps.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline void fill_taps(resize_tap* taps, int from, int to) {
  double const ratio = static_cast<double>(from) / to;
  for (int d = 0; d < to; ++d) {
    float f = static_cast<float>((d + 0.5) * ratio - 0.5);
    int i = static_cast<int>(std::floor(f));
    f -= static_cast<float>(i);
    if (i < 0) {
      i = 0;
      f = 0;
    }
    if (i >= from - 1) {
      i = from - 1;
      f = 0;
    }
    taps[d] = {i, static_cast<std::int16_t>(i + 1 < from ? 1 : 0),
               static_cast<std::int16_t>(std::lrint((1.0f - f) * 2048.0f)),
               static_cast<std::int16_t>(std::lrint(f * 2048.0f)), 0};
  }
}

/// A pixel between two rows and two columns. @param row0,row1 at the left column
FT_HOST_DEVICE inline std::uint8_t resized_pixel(std::uint8_t const* row0, std::uint8_t const* row1,
                                                 resize_tap const& h, resize_tap const& v) {
  int const h0 = row0[0] * h.w0 + row0[h.offset] * h.w1;
  int const h1 = row1[0] * h.w0 + row1[h.offset] * h.w1;
  return static_cast<std::uint8_t>((((v.w0 * (h0 >> 4)) >> 16) + ((v.w1 * (h1 >> 4)) >> 16) + 2) >>
                                   2);
}

}  // namespace detail

/// Fills the tables that build_pyramid reads, on the host. @param taps [geometry.taps]
inline void make_resize_taps(pyramid_geometry const& geometry, resize_tap* taps) {
  for (int l = 1; l < geometry.levels; ++l) {
    resize_tap* const columns = taps + geometry.tap_offset[l];
    detail::fill_taps(columns, geometry.width[l - 1], geometry.width[l]);
    detail::fill_taps(columns + geometry.width[l], geometry.height[l - 1], geometry.height[l]);
  }
}

/// A band of rows of one level of one image.
struct resize_band {
  static constexpr bool wide_on_host = true;
  static constexpr int rows = 32;
  using scratch = no_scratch;

  FT_HOST_DEVICE static int bands(pyramid_geometry const& geometry, int l) {
    return ceil_div(geometry.height[l], rows);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, int l) const {
    int const in_image = bands(pyramid.geometry, l);
    int const image = item / in_image;
    int const first = item % in_image * rows;
    gray_view const from = pyramid.level(image, l - 1);
    auto const to = pyramid.level(image, l);
    int const end = min_of(first + rows, to.height);
    resize_tap const* const taps = all_taps + pyramid.geometry.tap_offset[l];
    if constexpr (Group::max_threads == 1) {
      for (int x = 0; x < to.width; x += strip) {
        resize_strip(from, to, taps, x, min_of(strip, to.width - x), first, end);
      }
    } else {
      for (int y = first; y < end; ++y) {
        resize_tap const v = taps[to.width + y];
        std::uint8_t const* const row0 = from.row(v.first);
        std::uint8_t const* const row1 = from.row(v.first + v.offset);
        std::uint8_t* const out = to.row(y);
        for (int x = g.rank(); x < to.width; x += g.size()) {
          resize_tap const h = taps[x];
          out[x] = detail::resized_pixel(row0 + h.first, row1 + h.first, h, v);
        }
      }
    }
  }

private:
  static constexpr int strip = 256;  ///< columns that a thread alone takes at a time
  static constexpr int run = 32;     ///< columns of a loop that becomes vectors

  /// n columns from x on, rows [first, end), by a single thread. Sums along a row are computed once
  /// for the rows of the level that read it.
  FT_HOST_DEVICE FT_INLINE static void resize_strip(gray_view from, image_view<std::uint8_t> to,
                                                    resize_tap const* taps, int x, int n, int first,
                                                    int end) {
    detail::column_taps<strip> columns(taps + x, n, from.width);
    std::int16_t sums[2][strip] = {};
    int row_of[2] = {-1, -1};
    auto const sums_of = [&](int row, int other) {
      for (int k = 0; k < 2; ++k) {
        if (row_of[k] == row) { return k; }
      }
      int const k = row_of[0] == other ? 1 : 0;
      row_of[k] = row;
      columns.interpolate(from.row(row), sums[k]);
      return k;
    };
    for (int y = first; y < end; ++y) {
      resize_tap const v = taps[to.width + y];
      int const k0 = sums_of(v.first, v.first + v.offset);
      int const k1 = sums_of(v.first + v.offset, v.first);
      std::uint8_t* const out = to.row(y) + x;
      int at = 0;
      for (; at + run <= n; at += run) {
        mix_rows<run>(sums[k0] + at, sums[k1] + at, v, out + at, run);
      }
      mix_rows<run>(sums[k0] + at, sums[k1] + at, v, out + at, n - at);
    }
  }

  template <int Run>
  FT_HOST_DEVICE FT_INLINE static void mix_rows(std::int16_t const* s0, std::int16_t const* s1,
                                                resize_tap const& v, std::uint8_t* out, int n) {
    auto const mixed = [&](int k) {
      return static_cast<std::uint8_t>(((v.w0 * s0[k] >> 16) + (v.w1 * s1[k] >> 16) + 2) >> 2);
    };
    if (n == Run) {
      for (int k = 0; k < Run; ++k) { out[k] = mixed(k); }
    } else {
      for (int k = 0; k < n; ++k) { out[k] = mixed(k); }
    }
  }
};

/// Levels 1.. of every image from its level 0. Asynchronous on `exec`; allocates nothing; one
/// launch per level, whatever the batch. @param taps from make_resize_taps, in the executor's
/// memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps) {
  for (int l = 1; l < pyramid.geometry.levels; ++l) {
    for_each_item<per_block<128>>(exec, pyramid.batch * resize_band::bands(pyramid.geometry, l),
                                  resize_band{}, pyramid, taps, l);
  }
}

}  // namespace FT_ABI
}  // namespace ft
