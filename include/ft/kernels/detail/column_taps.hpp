// SPDX-License-Identifier: Apache-2.0
/// @file A row's interpolation between columns for a thread that works alone: eight columns by one
/// shuffle where a processor has AVX2, else one after the other.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/math.hpp"
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__CUDA_ARCH__)
#include <immintrin.h>
#define FT_HAS_SHUFFLE 1
#else
#define FT_HAS_SHUFFLE 0
#endif

namespace ft {
inline namespace FT_ABI {

/// Where one destination column (or row) reads from: two neighbours and their weights of 2048.
struct resize_tap {
  std::int32_t first;
  std::int16_t offset;  ///< of the second neighbour: 1, or 0 at the far edge
  std::int16_t w0, w1;
  std::int16_t unused;
};

namespace detail {

/// Eight neighbouring columns that lie within 16 pixels of the source row.
struct eight_taps {
  alignas(32) std::uint8_t pick[32];     ///< per column the first pixel, none, the second, none
  alignas(32) std::int16_t weights[16];  ///< per column of the first and the second
  std::int32_t first;                    ///< of the 16 pixels
};

#if FT_HAS_SHUFFLE
/// (first pixel * weight + second pixel * weight) >> 4 of 8 * count columns.
__attribute__((target("avx2"))) inline void interpolate_eights(std::uint8_t const* row,
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

/// Sums along rows for up to N columns.
template <int N>
class column_taps {
public:
  /// @param taps of n columns @param width of the rows
  FT_HOST_DEVICE column_taps(resize_tap const* taps, int n, int width) : taps_(taps), n_(n) {
#if FT_HAS_SHUFFLE
    if (!has_wide_vectors() || width < 16) { return; }
    for (; 8 * (count_ + 1) <= n; ++count_) {
      resize_tap const* const t = taps + 8 * count_;
      eight_taps& e = eights_[count_];
      e.first = min_of(t[0].first, width - 16);
      if (t[7].first + t[7].offset - e.first > 15) { return; }  // a large step: all go one by one
      for (int k = 0; k < 8; ++k) {
        auto const place = static_cast<std::uint8_t>(t[k].first - e.first);
        e.pick[4 * k] = place;
        e.pick[4 * k + 1] = none;
        e.pick[4 * k + 2] = static_cast<std::uint8_t>(place + t[k].offset);
        e.pick[4 * k + 3] = none;
        e.weights[2 * k] = t[k].w0;
        e.weights[2 * k + 1] = t[k].w1;
      }
    }
#else
    static_cast<void>(width);
#endif
  }

  /// out[x] = (pixel * weight + next pixel * weight) >> 4. @param out [N]
  FT_HOST_DEVICE void interpolate(std::uint8_t const* row, std::int16_t* out) const {
#if FT_HAS_SHUFFLE
    if (count_ > 0) { interpolate_eights(row, eights_, count_, out); }
#endif
    for (int x = 8 * count_; x < n_; ++x) {
      resize_tap const& t = taps_[x];
      std::uint8_t const* const p = row + t.first;
      out[x] = static_cast<std::int16_t>((p[0] * t.w0 + p[t.offset] * t.w1) >> 4);
    }
  }

private:
  resize_tap const* taps_;
  int n_;
  static constexpr std::uint8_t none = 0x80;  ///< picks a zero
  int count_ = 0;                             ///< of eights that one shuffle does
  eight_taps eights_[N / 8];
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
