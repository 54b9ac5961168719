// SPDX-License-Identifier: Apache-2.0
/// @file Random draws that depend on a seed and a number alone, so that threads draw concurrently
/// and host and GPU draw the same.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// The finaliser of SplitMix64: Steele, Lea, Flood, "Fast splittable pseudorandom number
/// generators", OOPSLA 2014.
FT_HOST_DEVICE constexpr std::uint64_t mixed_bits(std::uint64_t z) {
  z ^= z >> 30;
  z *= 0xBF58476D1CE4E5B9ull;
  z ^= z >> 27;
  z *= 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

/// Draws of one sequence, in rounds of at most 64 draws.
struct counter_draws {
  static constexpr std::uint64_t step = 0x9E3779B97F4A7C15ull;  ///< 2^64 / golden ratio

  std::uint64_t seed = 0;

  /// 64 random bits. @param k 0 to 63, within the round
  FT_HOST_DEVICE constexpr std::uint64_t bits(std::uint64_t round, int k) const {
    return mixed_bits(seed + (64 * round + static_cast<std::uint64_t>(k) + 1) * step);
  }
  /// A number of 0 to n - 1. @pre n >= 1
  FT_HOST_DEVICE constexpr int below(int n, std::uint64_t round, int k) const {
    return static_cast<int>(((bits(round, k) >> 32) * static_cast<std::uint64_t>(n)) >> 32);
  }
  /// K different numbers of 0 to n - 1: draw k takes one from a pool, whose last number then stands
  /// in its place. @pre n >= K
  template <int K>
  FT_HOST_DEVICE constexpr void distinct(int n, std::uint64_t round, int (&taken)[K]) const {
    int place[K] = {};   // of the pool that does not hold its own number any more
    int number[K] = {};  // what it holds
    for (int k = 0; k < K; ++k) {
      int const at = below(n - k, round, k);
      int const last = n - 1 - k;
      taken[k] = at;
      number[k] = last;
      for (int i = 0; i < k; ++i) {  // the latest change of a place counts
        if (place[i] == at) { taken[k] = number[i]; }
        if (place[i] == last) { number[k] = number[i]; }
      }
      place[k] = at;
    }
  }
};

}  // namespace FT_ABI
}  // namespace ft
