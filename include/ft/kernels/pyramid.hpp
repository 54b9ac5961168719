// SPDX-License-Identifier: Apache-2.0
/// @file Stage: scale pyramid. Each level is the bilinear resize of the one before it,
/// bit-identical to cv::resize(INTER_LINEAR) on 8-bit images. Source: specification section 1.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// Where one destination column (or row) reads from: two neighbours and their weights of 2048.
struct resize_tap {
  std::int32_t first;
  std::int16_t offset;  ///< of the second neighbour: 1, or 0 at the far edge
  std::int16_t w0, w1;
  std::int16_t unused;
};

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

/// One row of one level of one image.
struct resize_row {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, int l) const {
    int const height = pyramid.geometry.height[l];
    int const image = item / height;
    int const y = item % height;
    auto const from = pyramid.level(image, l - 1);
    auto const to = pyramid.level(image, l);
    resize_tap const* const taps = all_taps + pyramid.geometry.tap_offset[l];
    resize_tap const v = taps[to.width + y];
    std::uint8_t const* const row0 = from.row(v.first);
    std::uint8_t const* const row1 = from.row(v.first + v.offset);
    std::uint8_t* const out = to.row(y);
    for (int x = g.rank(); x < to.width; x += g.size()) {
      resize_tap const h = taps[x];
      out[x] = detail::resized_pixel(row0 + h.first, row1 + h.first, h, v);
    }
  }
};

/// Levels 1.. of every image from its level 0. Asynchronous on `exec`; allocates nothing; one
/// launch per level, whatever the batch. @param taps from make_resize_taps, in the executor's
/// memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps) {
  for (int l = 1; l < pyramid.geometry.levels; ++l) {
    for_each_item<per_block<128>>(exec, pyramid.batch * pyramid.geometry.height[l], resize_row{},
                                  pyramid, taps, l);
  }
}

}  // namespace FT_ABI
}  // namespace ft
