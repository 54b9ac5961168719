// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints with their descriptors, structure of arrays; one batch entry per image.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/containers/soa.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// 256 bits; bit i of byte j is test 8j+i.
struct alignas(16) descriptor {
  std::uint32_t words[8];
};

/// Number of differing bits, 0..256.
FT_HOST_DEVICE inline int hamming(descriptor const& a, descriptor const& b) {
  int distance = 0;
#if defined(__CUDA_ARCH__)
  FT_UNROLL
  for (int i = 0; i < 8; ++i) { distance += popcount(a.words[i] ^ b.words[i]); }
#else
  for (int i = 0; i < 8; i += 2) {
    std::uint64_t x, y;
    std::memcpy(&x, a.words + i, sizeof x);
    std::memcpy(&y, b.words + i, sizeof y);
    distance += __builtin_popcountll(x ^ y);
  }
#endif
  return distance;
}

namespace field {
FT_FIELD(x, float);             ///< column in the input image, pixels
FT_FIELD(y, float);             ///< row in the input image, pixels
FT_FIELD(angle, float);         ///< degrees, [0, 360)
FT_FIELD(response, float);      ///< corner score
FT_FIELD(octave, int);          ///< pyramid level
FT_FIELD(orb, ft::descriptor);  ///< descriptor
}  // namespace field

using keypoints_view =
    soa_view<field::x, field::y, field::angle, field::response, field::octave, field::orb>;
template <memory_space Space>
using keypoints =
    soa<Space, field::x, field::y, field::angle, field::response, field::octave, field::orb>;

}  // namespace FT_ABI
}  // namespace ft
