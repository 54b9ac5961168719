// SPDX-License-Identifier: Apache-2.0
/// @file How sharp an image is in either direction.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// How sharp an image is along its rows and its columns: squared differences of pixels that are 2
/// and 8 apart. Of an edge that a motion has smeared over L pixels the former is 4 / L and the
/// latter 8 - L / 3, for L from 2 to 8; of a sharp one they are 2 and 8.
struct image_slopes {
  int near_x = 0, near_y = 0, far_x = 0, far_y = 0;
  static constexpr int near = 1, far = 4;  ///< pixels to either side

  FT_HOST_DEVICE void add(image_view<std::uint8_t> const& image, int x, int y) {
    if (min_of(image.width, image.height) <= 2 * far) { return; }
    x = clamp(x, far, image.width - 1 - far);
    y = clamp(y, far, image.height - 1 - far);
    auto const squared = [&](int dx, int dy) {
      int const d = int{image.row(y + dy)[x + dx]} - int{image.row(y - dy)[x - dx]};
      return d * d;
    };
    near_x += squared(near, 0);
    near_y += squared(0, near);
    far_x += squared(far, 0);
    far_y += squared(0, far);
  }
  /// Whether near differences are a part of the far ones that is half as large in one direction as
  /// in the other: a streak of 5 pixels. Not where one direction has no edges, only noise.
  FT_HOST_DEVICE bool is_streaked() const {
    auto const across = std::int64_t{near_x} * far_y, down = std::int64_t{near_y} * far_x;
    bool const both = 8 * std::int64_t{far_x} > far_y && 8 * std::int64_t{far_y} > far_x;
    return both && (2 * across < down || 2 * down < across);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
