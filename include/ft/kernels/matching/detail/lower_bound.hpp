// SPDX-License-Identifier: Apache-2.0
/// @file A bound that no distance of two rows of float or float16 is below, by tensor cores.
///
/// Tensor cores multiply numbers of 16 bits: of `float16` rows the numbers themselves, of `float`
/// rows the nearest bfloat16. The order of their sums is not documented. So they only bound the
/// distance from below, and who could be among the nearest is compared again in strict arithmetic.
///
/// **The bound.** Rows a and b of N numbers are multiplied as a' and b'. Per row there are
///
///     s = a.a        l = 1.01 sqrt(s) + 2^-50        e = 1.01 |a - a'| + 2^-50
///
/// and with p, the product a'.b' that tensor cores give, and k = (N + 8) / 2^21, the bound is
///
///     squared distance:  s_a + s_b - 2 p - 2 E - k (s_a + s_b)
///     dot product:         1       -   p -   E - k (s_a + s_b + 1)      E = e_a l_b + (l_a + e_a)
///     e_b
///
/// **Its proof.** Write u = 2^-22, S = |a|^2 + |b|^2, and take the squared distance; all terms of
/// the other one are at most half as large, but for the 1.
/// - a.b - a'.b' = a.(b - b') + (a - a').b' is at most E, by Cauchy and Schwarz: that is 2 E.
/// - p: PTX says that sums have single precision at least, and nothing of their rounding.
/// Truncation
///   errs by u / 2 of the magnitudes of what is added; u is allowed, twice as much. There are N + 3
///   additions, and one more for each 8. The magnitudes are at most |a'| |b'| <= 1.01 S / 2:
///   2 * 1.125 * 1.01 (N + 3) u S / 2 < (1.14 N + 4) u S. Where a number that is not normal counts
///   as 0, it is in e.
/// - s_a + s_b: sums of N products in floats, N u / 4 * S.
/// - The strict distance has four sums of N / 4 + 1 terms. Of `float`: (N / 4 + 6) u / 4 of the
///   distance, which is at most 2 S. Of `float16`, of three such sums, no more. (N / 8 + 3) u S.
/// - The bound's own roundings: four of u / 4 * 2.1 S, 2.1 u S.
///
/// Together less than (1.52 N + 9.2) u S, and k S = (2 N + 16) u S. What second orders add is below
/// N u < 0.4 % of each, and the squares s are as exact; the 1.01 hold that, too. 2^-50: squares
/// that underflow change l and e by less than 2^-66, and products that underflow change a sum by
/// less than 2^-111, while E is 2^-99 at least.
///
/// Rows with a number that is none, or with s of 2^120 or more, have no bound: it is the lowest
/// float. Below that nothing overflows.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/vector_descriptor.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// What lower_bound takes of a row.
struct alignas(16) row_bound {
  float base;    ///< s, or 1 / 2, without its share of what is taken off
  float length;  ///< l
  float error;   ///< e
};

/// The bound of rows that have none.
inline constexpr float no_bound = std::numeric_limits<float>::lowest();
inline constexpr float unlimited = std::numeric_limits<float>::infinity();

/// Eight numbers as tensor cores take them, in each word the first in the lower bits.
struct alignas(16) rounded_numbers {
  std::uint32_t words[4];
};

template <typename D, typename Base>
struct lower_bound;

/// @tparam D a descriptor that is, or derives from, a vector_descriptor<T, N, Metric>
template <typename D, typename T, int N, typename Metric>
struct lower_bound<D, vector_descriptor<T, N, Metric>> {
  static constexpr bool of_halves = std::is_same<T, float16>::value;
  static constexpr bool is_squared = std::is_same<Metric, squared_distance>::value;
  static constexpr float weight = is_squared ? 2 : 1;
  static constexpr float share = static_cast<float>(N + 8) / (1 << 21);

  /// Two numbers as tensor cores take them, the first in the lower bits.
  FT_HOST_DEVICE FT_INLINE static std::uint32_t rounded(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
    std::uint32_t both;
    if constexpr (of_halves) {
      asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(b), "f"(a));
    } else {
      asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(b), "f"(a));
    }
    return both;
#else
    return number_of(a) | number_of(b) << 16;
#endif
  }
  /// Numbers 8 i to 8 i + 7 of a row. Past the last number they are 0.
  FT_HOST_DEVICE FT_INLINE static rounded_numbers read(D const& row, int i, float (&numbers)[8]) {
    rounded_numbers to;
    if constexpr (of_halves && N % 8 == 0) {  // as they are stored
      struct alignas(16) stored {
        T of[8];
      };
      vector_descriptor<T, N, Metric> const& base = row;  // D may have an `of` of its own
      auto const mine = part_at<stored>(base.of, i);
      memcpy(to.words, mine.of, sizeof to.words);
      FT_UNROLL
      for (int k = 0; k < 8; ++k) { numbers[k] = static_cast<float>(mine.of[k]); }
    } else {
      FT_UNROLL
      for (int half = 0; half < 2; ++half) {
        int const p = 2 * i + half;
        four_floats const v = p < D::parts ? D::part_of(row, p) : four_floats{};
        FT_UNROLL
        for (int k = 0; k < 4; ++k) { numbers[4 * half + k] = v.of[k]; }
      }
      FT_UNROLL
      for (int w = 0; w < 4; ++w) { to.words[w] = rounded(numbers[2 * w], numbers[2 * w + 1]); }
    }
    return to;
  }
  /// Adds a number to s and its error to |a - a'|^2. @param rounded the number, in the lower bits
  FT_HOST_DEVICE FT_INLINE static void add(float& squares, float& errors, float v,
                                           std::uint32_t rounded) {
    squares += v * v;
    float lost = 0;
    if constexpr (of_halves) {
      lost = ::fabsf(v) < 0x1p-14f ? v : 0.0f;
    } else {
      std::uint32_t const bits = rounded << 16;
      memcpy(&lost, &bits, sizeof lost);
      lost = v - lost;
    }
    errors += lost * lost;
  }
  FT_HOST_DEVICE FT_INLINE static row_bound of(float squares, float errors) {
    if (!(squares < 0x1p120f)) { return {0, unlimited, unlimited}; }
    float const base = (is_squared ? squares : 0.5f * (1 - share)) - share * squares;
    return {base, 1.01f * detail::square_root(squares) + 0x1p-50f,
            1.01f * detail::square_root(errors) + 0x1p-50f};
  }
  /// @param product of the rows, by tensor cores
  FT_HOST_DEVICE FT_INLINE static float below(float product, row_bound a, row_bound b) {
    float const error = a.error * b.length + (a.length + a.error) * b.error;
    float const d = a.base + b.base - weight * product - weight * error;
    return ::fmaxf(d, no_bound);  // also of what is not a number
  }

private:
  FT_HOST_DEVICE static std::uint32_t number_of(float v) {
    if constexpr (of_halves) { return float16::nearest(v).bits; }
    std::uint32_t u;
    memcpy(&u, &v, sizeof u);
    if ((u & 0x7fffffffu) > 0x7f800000u) { return 0x7fffu; }
    return (u + 0x7fffu + (u >> 16 & 1u)) >> 16;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
