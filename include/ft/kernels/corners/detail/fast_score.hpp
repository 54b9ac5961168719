// SPDX-License-Identifier: Apache-2.0
/// @file FAST-9/16 scores of single pixels, from pairs of 16-bit numbers. Source: Rosten and
/// Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Offsets of the circle of 16 pixels, starting below the centre, for one row stride.
struct fast_circle {
  int offset[16];
  FT_HOST_DEVICE explicit constexpr fast_circle(int stride)
      : offset{3 * stride,  3 * stride + 1,  2 * stride + 2,  stride + 3,
               3,           -stride + 3,     -2 * stride + 2, -3 * stride + 1,
               -3 * stride, -3 * stride - 1, -2 * stride - 2, -stride - 3,
               -3,          stride - 3,      2 * stride - 2,  3 * stride - 1} {}
};

/// The largest threshold at which the pixel is a corner; 0 if that is below `threshold`.
///
/// It is the smallest difference of the best of the 16 arcs of 9 pixels, minus one. Computed with
/// packed 16-bit minima and maxima, for which a device has instructions.
/// @param threshold >= 0
FT_HOST_DEVICE inline int fast_score_of_pairs(std::uint8_t const* center, fast_circle const& circle,
                                              int threshold) {
  std::uint32_t p[8];  // opposite pixels of the circle: k, and k + 8 in the high half
  FT_UNROLL
  for (int k = 0; k < 8; ++k) {
    p[k] = center[circle.offset[k]] | static_cast<std::uint32_t>(center[circle.offset[k + 8]])
                                          << 16;
  }
  // Reduce runs of 2, 4 and 8 pixels from every second pixel on. A run of 8 is part of two arcs,
  // one pixel longer at either end; the better of these two pixels counts.
  std::uint32_t low[4];
  std::uint32_t high[4];
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    low[i] = min_pairs(p[2 * i], p[2 * i + 1]);
    high[i] = max_pairs(p[2 * i], p[2 * i + 1]);
  }
  std::uint32_t low4[4];
  std::uint32_t high4[4];
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    low4[i] = min_pairs(low[i], i < 3 ? low[(i + 1) & 3] : swap_pair(low[0]));
    high4[i] = max_pairs(high[i], i < 3 ? high[(i + 1) & 3] : swap_pair(high[0]));
  }
  std::uint32_t brightest = 0;          // largest over the arcs of the smallest pixel
  std::uint32_t darkest = 0x00ff00ffu;  // smallest of the largest
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    std::uint32_t const low8 =
        min_pairs(low4[i], i < 2 ? low4[(i + 2) & 3] : swap_pair(low4[(i + 2) & 3]));
    std::uint32_t const high8 =
        max_pairs(high4[i], i < 2 ? high4[(i + 2) & 3] : swap_pair(high4[(i + 2) & 3]));
    std::uint32_t const after = swap_pair(p[2 * i]);
    std::uint32_t const before = i > 0 ? p[(2 * i + 7) & 7] : swap_pair(p[7]);
    brightest = max_pairs(brightest, min_pairs(low8, max_pairs(before, after)));
    darkest = min_pairs(darkest, max_pairs(high8, min_pairs(before, after)));
  }
  int const v = center[0];
  int const bright = static_cast<int>(max_of(brightest & 0xffffu, brightest >> 16)) - v;
  int const dark = v - static_cast<int>(min_of(darkest & 0xffffu, darkest >> 16));
  int const best = max_of(bright, dark);
  return best > threshold ? best - 1 : 0;
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
