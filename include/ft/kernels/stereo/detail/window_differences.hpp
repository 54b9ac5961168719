// SPDX-License-Identifier: Apache-2.0
/// @file Block matching of a left keypoint's window along the right row.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {
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

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
