// SPDX-License-Identifier: Apache-2.0
/// @file Vector instructions of the host that a compiler does not find by itself. Each function is
/// the fast form of a loop that its caller keeps for other processors, and gives the same numbers.
#pragma once

#include <cstdint>
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__CUDA_ARCH__)
#include <immintrin.h>
#define FT_HAS_SHUFFLE 1
#else
#define FT_HAS_SHUFFLE 0
#endif

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Eight weighted sums of two bytes each, all within 16 bytes.
struct eight_taps {
  static constexpr std::uint8_t zero = 0x80;  ///< picks 0
  alignas(32) std::uint8_t pick[32];          ///< shuffle: per sum first byte, 0, second byte, 0
  alignas(32) std::int16_t weights[16];       ///< per sum of the first and the second byte
  std::int32_t first;                         ///< place of the 16 bytes in the row
};

#if FT_HAS_SHUFFLE
/// out[8 * i + k] = sum k of taps[i], divided by 16. Needs AVX2.
__attribute__((target("avx2"))) inline void weigh_eights(std::uint8_t const* row,
                                                         eight_taps const* taps, int count,
                                                         std::int16_t* out) {
  for (int i = 0; i < count; ++i) {
    eight_taps const& t = taps[i];
    __m128i const sixteen = _mm_loadu_si128(reinterpret_cast<__m128i const*>(row + t.first));
    __m256i const pairs =
        _mm256_shuffle_epi8(_mm256_broadcastsi128_si256(sixteen),
                            _mm256_load_si256(reinterpret_cast<__m256i const*>(t.pick)));
    __m256i const sums = _mm256_srai_epi32(
        _mm256_madd_epi16(pairs, _mm256_load_si256(reinterpret_cast<__m256i const*>(t.weights))),
        4);
    __m256i const packed = _mm256_permute4x64_epi64(_mm256_packs_epi32(sums, sums), 0x08);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out + 8 * i), _mm256_castsi256_si128(packed));
  }
}
#endif

/// Bit k says whether p[k] >= threshold, for 32 numbers.
FT_HOST_DEVICE FT_INLINE std::uint32_t reached_by_32(std::uint8_t const* p,
                                                     std::uint8_t threshold) {
#if FT_HAS_SHUFFLE
  // SSE2, which every such processor has.
  __m128i const least = _mm_set1_epi8(static_cast<char>(threshold));
  std::uint32_t bits = 0;
  for (int half = 0; half < 2; ++half) {
    __m128i const v = _mm_loadu_si128(reinterpret_cast<__m128i const*>(p + 16 * half));
    auto const reached =
        static_cast<std::uint32_t>(_mm_movemask_epi8(_mm_cmpeq_epi8(_mm_max_epu8(v, least), v)));
    bits |= reached << (16 * half);
  }
  return bits;
#else
  std::uint32_t bits = 0;
  for (int k = 0; k < 32; ++k) { bits |= static_cast<std::uint32_t>(p[k] >= threshold) << k; }
  return bits;
#endif
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
