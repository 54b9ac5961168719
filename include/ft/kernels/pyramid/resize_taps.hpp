// SPDX-License-Identifier: Apache-2.0
/// @file Tables of bilinear resizing: the source pixels of each column and row of a level, and
/// their weights. Source: specification section 1.
#pragma once

#include <cmath>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// The two source columns (or rows) of a destination column (or row), and their weights, which sum
/// to 2048.
struct resize_tap {
  std::int32_t first;
  std::int16_t offset;  ///< from the first to the second: 1, or 0 at the far edge
  std::int16_t w0, w1;
  std::int16_t unused;
};

namespace detail {

/// Taps along one axis, for a resize from `from` to `to` pixels. @param taps [to]
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

}  // namespace detail

/// Computes the tables of build_pyramid(), on the host. @param taps [geometry.taps]
inline void make_resize_taps(pyramid_geometry const& geometry, resize_tap* taps) {
  for (int l = 1; l < geometry.levels; ++l) {
    resize_tap* const columns = taps + geometry.tap_offset[l];
    detail::fill_taps(columns, geometry.width[l - 1], geometry.width[l]);
    detail::fill_taps(columns + geometry.width[l], geometry.height[l - 1], geometry.height[l]);
  }
}

}  // namespace FT_ABI
}  // namespace ft
