// SPDX-License-Identifier: Apache-2.0
/// @file Descriptors of bits, compared by the number of bits that differ.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Number of bits set in eight words. On a device a population count costs four logic operations:
/// full adders combine the words first, which leaves four counts instead of eight.
FT_HOST_DEVICE FT_INLINE int ones_by_adders(std::uint32_t const (&d)[8]) {
  auto const carry = [](std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    return (x & y) | (x & z) | (y & z);
  };
  std::uint32_t const ones_a = d[0] ^ d[1] ^ d[2];
  std::uint32_t const ones_b = d[3] ^ d[4] ^ d[5];
  std::uint32_t const ones = ones_a ^ ones_b ^ d[6];
  std::uint32_t const twos_a = carry(d[0], d[1], d[2]);
  std::uint32_t const twos_b = carry(d[3], d[4], d[5]);
  std::uint32_t const twos_c = carry(ones_a, ones_b, d[6]);
  std::uint32_t const twos = twos_a ^ twos_b ^ twos_c;
  std::uint32_t const fours = carry(twos_a, twos_b, twos_c);
  return popcount(ones) + popcount(d[7]) + 2 * popcount(twos) + 4 * popcount(fours);
}

/// The same of four words.
FT_HOST_DEVICE FT_INLINE int ones_by_adders(std::uint32_t const (&d)[4]) {
  std::uint32_t const twos = (d[0] & d[1]) | (d[0] & d[2]) | (d[1] & d[2]);
  return popcount(d[0] ^ d[1] ^ d[2]) + popcount(d[3]) + 2 * popcount(twos);
}

/// Number of bits in which four words differ, for the host. No loop: compilers keep a short one
/// below -O3, which took three times as long.
FT_HOST_DEVICE FT_INLINE int differing_bits(std::uint32_t const* a, std::uint32_t const* b) {
  std::uint64_t x[2], y[2];
  std::memcpy(x, a, sizeof x);
  std::memcpy(y, b, sizeof y);
  return popcount(x[0] ^ y[0]) + popcount(x[1] ^ y[1]);
}

}  // namespace detail

/// Bits, compared by Hamming's distance. Bit i of byte j is bit 8 (j % 4) + i of word j / 4. Bits
/// of the last word past the last one do not count. ORB's is binary_descriptor<256>.
/// @tparam Bits any multiple of 8
template <int Bits>
struct alignas(detail::row_alignment((Bits + 31) / 32 * 4, 4)) binary_descriptor {
  static_assert(Bits > 0 && Bits % 8 == 0 && Bits <= 1 << 16, "whole bytes");
  static constexpr char const* name = "binary_descriptor";
  static constexpr descriptor_rules<int> rules{0, Bits, Bits / 4, 9, 10};
  static constexpr int size = (Bits + 31) / 32;  ///< words
  std::uint32_t words[size];

  /// From Bits / 8 bytes, as OpenCV has them in a row.
  static binary_descriptor from_bytes(unsigned char const* bytes) {
    binary_descriptor d{};
    std::memcpy(d.words, bytes, Bits / 8);
    return d;
  }
  /// Number of bits that differ.
  FT_HOST_DEVICE static int distance(binary_descriptor const& a, binary_descriptor const& b) {
    return distance_by_parts(a, b);
  }

  struct alignas(16) part {
    std::uint32_t words[Bits <= 128 ? 4 : 8];
  };
  using sum = int;
  static constexpr int part_size = sizeof(part) / 4;
  static constexpr int parts = (size + part_size - 1) / part_size;
  static constexpr bool uses_own_sums = false;

  FT_HOST_DEVICE FT_INLINE static part part_of(binary_descriptor const& row, int i) {
    part p;
    if constexpr (size % part_size == 0) {
      p = detail::part_at<part>(row.words, i);
    } else {
      FT_UNROLL
      for (int k = 0; k < part_size; ++k) {
        int const at = i * part_size + k;
        p.words[k] = at < size ? row.words[at] : 0;
      }
    }
    if constexpr (Bits % 32 != 0) {
      if (i == parts - 1) { p.words[(size - 1) % part_size] &= (1u << Bits % 32) - 1; }
    }
    return p;
  }
  FT_HOST_DEVICE FT_INLINE static void add(sum& s, part const& a, part const& b) {
#if defined(__CUDA_ARCH__)
    std::uint32_t d[part_size];
    FT_UNROLL
    for (int k = 0; k < part_size; ++k) { d[k] = a.words[k] ^ b.words[k]; }
    s += detail::ones_by_adders(d);
#else
    s += detail::differing_bits(a.words, b.words);
    if constexpr (part_size == 8) { s += detail::differing_bits(a.words + 4, b.words + 4); }
#endif
  }
  FT_HOST_DEVICE FT_INLINE static int distance_of(sum const& ab, sum const&, sum const&) {
    return ab;
  }
};

static_assert(assert_descriptor_model<binary_descriptor<256>>::value,
              "binary_descriptor keeps the contract of descriptors");
static_assert(sizeof(binary_descriptor<256>) == 32 && alignof(binary_descriptor<256>) == 16,
              "as ORB's rows are stored");

}  // namespace FT_ABI
}  // namespace ft
