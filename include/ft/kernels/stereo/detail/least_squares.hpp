// SPDX-License-Identifier: Apache-2.0
/// @file The column of a left window in the right image by least squares. Source: Lucas and Kanade,
/// "An iterative image registration technique with an application to stereo vision", 1981.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

// Block matching of a left keypoint's window along the right row.

namespace detail {

inline constexpr int window_half = 5;  ///< of the window; also the largest shift
inline constexpr int window_side = 2 * window_half + 1;

/// Sums of absolute differences of the left and the right window, one per shift, by a single
/// thread.
/// @param ul,ur columns of the keypoints @param v row of both
FT_HOST_DEVICE inline void sum_differences(gray_view left, gray_view right, int ul, int ur, int v,
                                           int (&sums)[window_side]) {
  for (int& sum : sums) { sum = 0; }
  for (int p = 0; p < window_side * window_side; ++p) {
    int const dx = p % window_side - window_half;
    int const y = v + p / window_side - window_half;
    int const mine = left(ul + dx, y);
    std::uint8_t const* const theirs = right.row(y) + ur - window_half + dx;
    for (int shift = 0; shift < window_side; ++shift) {
      int const d = mine - theirs[shift];
      sums[shift] += d < 0 ? -d : d;
    }
  }
}

/// The part of the left window that a lane of a warp compares: half a row, six pixels or five.
/// Empty for a single thread.
class window_part {
public:
  template <typename Group>
  FT_HOST_DEVICE window_part(Group g, gray_view left, int u, int v) {
    if constexpr (Group::max_threads > 1) {
      static_assert(Group::max_threads == 32, "two threads for each of 11 rows");
      std::uint8_t const* const at = left.row(row(g, v)) + u - window_half + column(g);
      skew_ = static_cast<int>(reinterpret_cast<std::uintptr_t>(at) & 3u);
      std::uint8_t const* const from = at - skew_;
      words_[0] = load_word(from);
      words_[1] = load_word(from + 4);
      words_[2] = load_word(from + ((skew_ + pixels(g) - 1) & ~3));
    }
  }

  /// The sums, in every lane. @param u column of the right window without shift
  template <typename Group>
  FT_HOST_DEVICE void sum_differences(Group g, gray_view right, int u, int v,
                                      int (&sums)[window_side]) const {
    std::uint32_t theirs[4];
    load_bytes(right.row(row(g, v)) + u - 2 * window_half + column(g), pixels(g) + 2 * window_half,
               theirs);
    bool const compares = g.rank() < 2 * window_side;
    std::uint32_t const mine[2] = {bytes_from(words_[0], words_[1], skew_),
                                   bytes_from(words_[1], words_[2], skew_) & rest(g)};
    auto const difference = [&](int shift) {
      auto const from = [&](int byte) {
        return bytes_from(theirs[byte / 4], theirs[min_of(byte / 4 + 1, 3)], byte % 4);
      };
      return difference_of_4(mine[0], from(shift),
                             difference_of_4(mine[1], from(shift + 4) & rest(g), 0));
    };
    // Reduces two sums a word: 11 x 11 x 255 has 15 bits.
    FT_UNROLL
    for (int shift = 0; shift < window_side; shift += 2) {
      std::uint32_t two = difference(shift);
      if (shift + 1 < window_side) { two |= difference(shift + 1) << 16; }
      two = g.reduce(compares ? two : 0, sum_op{});
      sums[shift] = static_cast<int>(two & 0xffffu);
      if (shift + 1 < window_side) { sums[shift + 1] = static_cast<int>(two >> 16); }
    }
  }

private:
  /// The row of a lane. Surplus lanes load the last row again.
  template <typename Group>
  FT_HOST_DEVICE static int row(Group g, int v) {
    return v - window_half + min_of(g.rank() / 2, window_side - 1);
  }
  template <typename Group>
  FT_HOST_DEVICE static int column(Group g) {
    return g.rank() % 2 * 6;
  }
  template <typename Group>
  FT_HOST_DEVICE static int pixels(Group g) {
    return 6 - g.rank() % 2;
  }
  /// Mask of the bytes of the second word that are pixels.
  template <typename Group>
  FT_HOST_DEVICE static std::uint32_t rest(Group g) {
    return g.rank() % 2 == 0 ? 0xffffu : 0xffu;
  }

  /// The words as loaded. Shifting waits for the loads, so it is done as late as possible.
  std::uint32_t words_[3];
  int skew_;
};

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

  /// Of one pixel of the window, which l and r point to. @param rest parts of a pixel right of r
  struct terms {
    int difference, slope;
  };
  FT_HOST_DEVICE FT_INLINE static terms terms_of(std::uint8_t const* l, std::uint8_t const* r,
                                                 int rest) {
    auto const between = [&](int i) { return (one - rest) * r[i] + rest * r[i + 1]; };
    return {one * l[0] - between(0), one * (l[1] - l[-1]) + between(1) - between(-1)};
  }

  template <typename Group>
  FT_HOST_DEVICE sums sum(Group g, int at) const {
    if constexpr (Group::max_threads == 1) { return sum_alone(at); }
    sums s;
    FT_UNROLL
    for (int k = 0; k < pixels; k += g.size()) {
      int const p = k + g.rank();
      if (p >= pixels) { break; }
      int const row = v + p / window_side - window_half;
      int const dx = p % window_side - window_half;
      terms const t = terms_of(left.row(row) + u + dx, right.row(row) + at / one + dx, at % one);
      s.difference += t.difference;
      s.slope += t.slope;
      s.product += t.difference * t.slope;
      s.square += t.slope * t.slope;
    }
    return {g.reduce(s.difference, sum_op{}), g.reduce(s.slope, sum_op{}),
            g.reduce(s.product, sum_op{}), g.reduce(s.square, sum_op{})};
  }
  /// The same by one thread, in vectors of eight pixels: two a row, of which the second begins with
  /// pixels of the first.
  FT_HOST_DEVICE FT_INLINE sums sum_alone(int at) const {
    constexpr int run = 8;
    constexpr int twice = 2 * run - window_side;
    std::int16_t difference[window_side * 2 * run];
    std::int16_t slope[window_side * 2 * run];
    for (int y = 0; y < window_side; ++y) {
      int const row = v + y - window_half;
      std::uint8_t const* const l = left.row(row) + u - window_half;
      std::uint8_t const* const r = right.row(row) + at / one - window_half;
      std::int16_t* const d = difference + y * 2 * run;
      std::int16_t* const s = slope + y * 2 * run;
      for (int part = 0; part < 2; ++part) {
        int const first = part * (window_side - run);
        for (int k = 0; k < run; ++k) {
          terms const t = terms_of(l + first + k, r + first + k, at % one);
          d[part * run + k] = static_cast<std::int16_t>(t.difference);
          s[part * run + k] = static_cast<std::int16_t>(t.slope);
        }
      }
      for (int k = run; k < run + twice; ++k) { d[k] = s[k] = 0; }
    }
    sums all;
    for (int i = 0; i < window_side * 2 * run; ++i) {
      all.difference += difference[i];
      all.slope += slope[i];
      all.product += difference[i] * slope[i];
      all.square += slope[i] * slope[i];
    }
    return all;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
