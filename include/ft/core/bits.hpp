// SPDX-License-Identifier: Apache-2.0
/// @file Bit counts of 32-bit and 64-bit words.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

FT_HOST_DEVICE inline int popcount(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
  return __popc(v);
#else
  return __builtin_popcount(v);
#endif
}

FT_HOST_DEVICE inline int popcount(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
  return __popcll(v);
#else
  return __builtin_popcountll(v);
#endif
}

/// Index of the lowest set bit. @pre v is not 0
FT_HOST_DEVICE inline int trailing_zeros(std::uint32_t v) {
#if defined(__CUDA_ARCH__)
  return __ffs(static_cast<int>(v)) - 1;
#else
  return __builtin_ctz(v);
#endif
}

FT_HOST_DEVICE inline int trailing_zeros(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
  return __ffsll(static_cast<long long>(v)) - 1;
#else
  return __builtin_ctzll(v);
#endif
}

/// Index of the highest set bit. @pre v is not 0
FT_HOST_DEVICE inline int highest_bit(std::uint64_t v) {
#if defined(__CUDA_ARCH__)
  return 63 - __clzll(static_cast<long long>(v));
#else
  return 63 - __builtin_clzll(v);
#endif
}

}  // namespace FT_ABI
}  // namespace ft
