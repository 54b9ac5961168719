// SPDX-License-Identifier: Apache-2.0
/// @file The column of a left window in the right image by least squares. Source: Lucas and Kanade,
/// "An iterative image registration technique with an application to stereo vision", 1981.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/stereo/window_differences.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// The window around a pixel of the left level, and windows of the right one around columns in
/// parts of a pixel. Sums are of integers, so their order does not matter.
struct column_windows {
  gray_view left, right;
  int u, v;  ///< left pixel

  static constexpr int one = 8;  ///< parts of a pixel; with more, sums would not fit into 31 bits
  static constexpr int pixels = window_side * window_side;
  static constexpr int steps = 3;
  static_assert(4ll * one * one * 255 * 255 * pixels < 1ll << 31, "the sum of squares is an int");

  /// The column whose window has the smallest sum of squared differences from the left one, up to a
  /// constant: three Gauss-Newton steps by the mean slope of both images, which are linear between
  /// pixels. `start`, if a step leads out of the levels, or a pixel or more away from it.
  /// @param start pixels of the level
  template <typename Group>
  FT_HOST_DEVICE strict_float best_column(Group g, strict_float start) const {
    constexpr float parts = one;
    constexpr long long n = pixels;
    strict_float column = start;
    FT_NO_UNROLL
    for (int step = 0; step < steps; ++step) {
      int const at = round_away((column * parts).value);
      if (!inside(at)) { return start; }
      sums const s = sum(g, at);
      long long const slope = s.slope;  // without the means: one image may be brighter
      long long const product = n * s.product - slope * s.difference;
      long long const square = n * s.square - slope * slope;
      if (square <= 0) { return start; }
      column = strict_float(static_cast<float>(at)) / parts +
               strict_float(static_cast<float>(4 * product)) / static_cast<float>(square);
      strict_float const away = column - start;
      if (!(away > -1.0f && away < 1.0f)) { return start; }
    }
    return column;
  }

private:
  /// Over the pixels of the window. The difference left - right is in 1 / one grey levels, the
  /// slope, that of both images together, in 1 / (4 one) grey levels a pixel.
  struct sums {
    int difference = 0, slope = 0;
    int product = 0;  ///< of difference and slope
    int square = 0;   ///< of slope
  };

  /// Whether the pixels that the sums read are in the levels. @param at right column, in parts
  FT_HOST_DEVICE bool inside(int at) const {
    constexpr int reach = window_half + 1;
    int const first = at / one;
    return u >= reach && u + reach < left.width && v >= window_half &&
           v + window_half < min_of(left.height, right.height) && at >= 0 && first >= reach &&
           first + reach + 1 < right.width;
  }

  template <typename Group>
  FT_HOST_DEVICE sums sum(Group g, int at) const {
    int const first = at / one;
    int const rest = at % one;
    sums s;
    FT_UNROLL
    for (int k = 0; k < pixels; k += g.size()) {
      int const p = k + g.rank();
      if (p >= pixels) { break; }
      int const row = v + p / window_side - window_half;
      int const dx = p % window_side - window_half;
      std::uint8_t const* const l = left.row(row) + u + dx;
      std::uint8_t const* const r = right.row(row) + first + dx;
      auto const between = [&](int i) { return (one - rest) * r[i] + rest * r[i + 1]; };
      int const difference = one * l[0] - between(0);
      int const slope = one * (l[1] - l[-1]) + between(1) - between(-1);
      s.difference += difference;
      s.slope += slope;
      s.product += difference * slope;
      s.square += slope * slope;
    }
    return {g.reduce(s.difference, sum_op{}), g.reduce(s.slope, sum_op{}),
            g.reduce(s.product, sum_op{}), g.reduce(s.square, sum_op{})};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
