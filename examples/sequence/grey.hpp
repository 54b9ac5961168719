// SPDX-License-Identifier: Apache-2.0
/// @file Conversion of colour to grey, as in OpenCV.
#pragma once

#include <cstddef>
#include <cstdint>

namespace seq {

/// The luma of ITU-R BT.601 in 15-bit fixed point, rounded to nearest: bit-identical to OpenCV 4's
/// cv::cvtColor of 8-bit RGB with COLOR_RGB2GRAY (checked for all 2^24 colours). The weights are
/// 0.299, 0.587 and 0.114 times 2^15. Their sum is 2^15, so grey pixels do not change.
constexpr std::uint8_t grey_of(std::uint8_t red, std::uint8_t green, std::uint8_t blue) {
  return static_cast<std::uint8_t>((9798u * red + 19235u * green + 3735u * blue + 16384u) >> 15);
}

/// `count` pixels of three bytes, red first, to one byte each. @p rgb and @p grey may not overlap.
inline void grey_of_rgb(std::uint8_t const* rgb, std::size_t count, std::uint8_t* grey) {
  for (std::size_t i = 0; i < count; ++i) {
    grey[i] = grey_of(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]);
  }
}

}  // namespace seq
