// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints with their descriptors, structure of arrays; one batch entry per image.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/containers/soa.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/descriptors/binary_descriptor.hpp"

namespace ft {
inline namespace FT_ABI {

/// ORB's 256 bits; bit i of byte j is test 8j+i.
using descriptor = binary_descriptor<256>;

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

// The two nearest of many descriptors.

namespace detail {

/// The nearest candidate so far, the lowest of equals, and the distance of the second nearest.
struct two_nearest {
  static constexpr int none = 1 << 16;  ///< above any distance
  int first = none;
  int index = 0x7fffffff;
  int second = none;

  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE void add(int distance, int at) {
    second = min_of(second, max_of(first, distance));
    index = distance < first ? at : index;
    first = min_of(first, distance);
  }
  /// Merges all threads' candidates; the result is in every thread.
  template <typename Group>
  FT_HOST_DEVICE two_nearest merged(Group g) const {
    two_nearest all;
    all.first = g.reduce(first, min_op{});
    all.index = g.reduce(first == all.first ? index : 0x7fffffff, min_op{});
    all.second = g.reduce(index == all.index ? second : first, min_op{});
    return all;
  }
};

/// hamming() for loops that do little else.
FT_HOST_DEVICE inline int hamming_by_adders(descriptor const& a, descriptor const& b) {
#if defined(__CUDA_ARCH__)
  std::uint32_t d[8];
  FT_UNROLL
  for (int i = 0; i < 8; ++i) { d[i] = a.words[i] ^ b.words[i]; }
  return ones_by_adders(d);
#else
  return hamming(a, b);
#endif
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
