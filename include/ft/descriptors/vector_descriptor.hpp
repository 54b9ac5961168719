// SPDX-License-Identifier: Apache-2.0
/// @file Descriptors of numbers, compared by their squared distance or their dot product.
#pragma once

#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"

namespace ft {
inline namespace FT_ABI {

/// A number of 16 bits, IEEE 754's binary16, as CUDA's __half: arrays of one may be read as the
/// other.
struct float16 {
  std::uint16_t bits;

  /// The nearest one, of two the even one; infinity from 65520.
  FT_HOST_DEVICE static float16 nearest(float v) {
#if defined(__CUDA_ARCH__)
    std::uint16_t bits;
    asm("cvt.rn.f16.f32 %0, %1;" : "=h"(bits) : "f"(v));
    return {bits};
#else
    std::uint32_t u;
    std::memcpy(&u, &v, sizeof u);
    auto const sign = static_cast<std::uint32_t>(u >> 16 & 0x8000u);
    u &= 0x7fffffffu;
    std::uint32_t h;
    if (u > 0x7f800000u) {
      h = 0x7fffu;  // not a number
    } else if (u >= 0x477ff000u) {
      h = 0x7c00u;
    } else if (u < 0x38800000u) {
      // Below 2^-14: units of 2^-24, which are the last place of a float near 0.5.
      float t;
      std::memcpy(&t, &u, sizeof t);
      t += 0.5f;
      std::memcpy(&h, &t, sizeof h);
      h -= 0x3f000000u;
    } else {
      h = (u - 0x38000000u + 0xfffu + (u >> 13 & 1u)) >> 13;
    }
    return {static_cast<std::uint16_t>(sign | h)};
#endif
  }
  /// Exact.
  FT_HOST_DEVICE FT_INLINE explicit operator float() const {
    float v;
#if defined(__CUDA_ARCH__)
    asm("cvt.f32.f16 %0, %1;" : "=f"(v) : "h"(bits));
#else
    // The exponent's bias is 112 less.
    std::uint32_t u = static_cast<std::uint32_t>(bits & 0x7fffu) << 13;
    std::memcpy(&v, &u, sizeof v);
    v *= 5.192296858534828e33f;  // 2^112
    std::memcpy(&u, &v, sizeof u);
    u |= (bits & 0x7c00u) == 0x7c00u ? 0x7f800000u : 0u;
    u |= static_cast<std::uint32_t>(bits & 0x8000u) << 16;
    std::memcpy(&v, &u, sizeof v);
#endif
    return v;
  }
};
static_assert(sizeof(float16) == 2, "as CUDA's __half");

/// Policy: |a - b|^2.
struct squared_distance {};
/// Policy: what the dot product of two rows of length 1 lacks to 1, half their squared distance. Of
/// int8, rows have the length 127 and the product lacks to 127^2.
struct dot_product {};

namespace detail {

/// Four numbers, and sums of four: term i goes to sum i mod 4.
struct alignas(16) four_floats {
  float of[4];

  /// (0 + 2) + (1 + 3)
  FT_HOST_DEVICE FT_INLINE float total() const { return (of[0] + of[2]) + (of[1] + of[3]); }
};
/// Sixteen numbers of int8. Parts of this type say that sums are those of products, which may be
/// added in any order.
struct alignas(16) four_words {
  std::int32_t of[4];
};

#if defined(__GNUC__) && !defined(__CUDA_ARCH__)
#define FT_HOST_LANES 1
/// As the host's compiler computes with four numbers at a time, which it does not find by itself.
template <typename T, int N>
struct host_lanes {
  typedef T type __attribute__((vector_size(N * sizeof(T))));
};
using float_lanes = host_lanes<float, 4>::type;

template <typename Lanes, typename From>
FT_INLINE Lanes lanes_of(From const& v) {
  static_assert(sizeof(Lanes) == sizeof v, "the same numbers");
  Lanes lanes;
  std::memcpy(&lanes, &v, sizeof v);
  return lanes;
}
/// As rounded::keep_apart().
FT_INLINE float_lanes keep_apart(float_lanes v) {
#if defined(__FMA__) && defined(__x86_64__)
  asm("" : "+x"(v));
#elif defined(__aarch64__)
  asm("" : "+w"(v));
#endif
  return v;
}
#else
#define FT_HOST_LANES 0
#endif

template <typename T>
inline constexpr bool is_int8 = std::is_same<T, std::int8_t>::value;

/// Adds the four products of bytes in each of four words. Exact.
FT_HOST_DEVICE FT_INLINE void add_products(int& sum, four_words const& a, four_words const& b) {
#if defined(__CUDA_ARCH__)
  FT_UNROLL
  for (int k = 0; k < 4; ++k) { sum = __dp4a(a.of[k], b.of[k], sum); }
#elif FT_HOST_LANES
  using bytes = host_lanes<signed char, 16>::type;
  using words = host_lanes<std::int16_t, 16>::type;
  using ints = host_lanes<std::int32_t, 16>::type;
  // Products fit 16 bits.
  words const p = __builtin_convertvector(lanes_of<bytes>(a), words) *
                  __builtin_convertvector(lanes_of<bytes>(b), words);
  ints const all = __builtin_convertvector(p, ints);
  int here = 0;
  for (int k = 0; k < 16; ++k) { here += all[k]; }
  sum += here;
#else
  std::int8_t x[16], y[16];
  std::memcpy(x, a.of, sizeof x);
  std::memcpy(y, b.of, sizeof y);
  for (int k = 0; k < 16; ++k) { sum += x[k] * y[k]; }
#endif
}
/// Adds products, each rounded on its own.
FT_HOST_DEVICE FT_INLINE void add_products(four_floats& sum, four_floats const& a,
                                           four_floats const& b) {
#if FT_HOST_LANES
  auto const all =
      lanes_of<float_lanes>(sum) + keep_apart(lanes_of<float_lanes>(a) * lanes_of<float_lanes>(b));
  std::memcpy(sum.of, &all, sizeof all);
#else
  FT_UNROLL
  for (int k = 0; k < 4; ++k) { sum.of[k] = sum.of[k] + mul(a.of[k], b.of[k]); }
#endif
}
/// The same bits for numbers that were float16: their products are exact floats, so that a fused
/// product changes nothing.
FT_HOST_DEVICE FT_INLINE void add_exact_products(four_floats& sum, four_floats const& a,
                                                 four_floats const& b) {
#if defined(__CUDA_ARCH__)
  FT_UNROLL
  for (int k = 0; k < 4; ++k) { sum.of[k] = __fmaf_rn(a.of[k], b.of[k], sum.of[k]); }
#else
  add_products(sum, a, b);
#endif
}
FT_HOST_DEVICE FT_INLINE void add_squares(four_floats& sum, four_floats const& a,
                                          four_floats const& b) {
#if FT_HOST_LANES
  auto const d = lanes_of<float_lanes>(a) - lanes_of<float_lanes>(b);
  auto const all = lanes_of<float_lanes>(sum) + keep_apart(d * d);
  std::memcpy(sum.of, &all, sizeof all);
#else
  FT_UNROLL
  for (int k = 0; k < 4; ++k) {
    float const d = a.of[k] - b.of[k];
    sum.of[k] = sum.of[k] + mul(d, d);
  }
#endif
}

/// Rules for rows of length 1, or 127: near is 0.7 apart, clear is 0.8 of the second's distance.
template <typename T, int N, typename Metric>
constexpr auto vector_rules() {
  constexpr bool squared = std::is_same<Metric, squared_distance>::value;
  if constexpr (is_int8<T>) {
    constexpr int one = 127 * 127;
    return squared ? descriptor_rules<int>{0, N * 255 * 255, one * 49 / 100, 16, 25}
                   : descriptor_rules<int>{one - N * 128 * 128, one + N * 128 * 127, one * 49 / 200,
                                           16, 25};
  } else {
    constexpr float any = std::numeric_limits<float>::infinity();
    return squared ? descriptor_rules<float>{0, any, 0.49f, 16, 25}
                   : descriptor_rules<float>{-any, any, 0.245f, 16, 25};
  }
}

}  // namespace detail

/// Numbers, compared by a policy. The same bits on every executor:
///
/// | numbers  | squared distance                                | dot product               |
/// |----------|-------------------------------------------------|---------------------------|
/// | float    | of the differences, in strict arithmetic        | in strict arithmetic      |
/// | float16  | a.a + b.b - 2 a.b, at least 0, products exact   | products exact            |
/// | int8     | exact                                           | exact                     |
///
/// Floats are added in four sums: term i goes to sum i mod 4; then (0 + 2) + (1 + 3). Integers
/// below 2^24 are therefore exact in any of them. The squared distance of float16 has the error of
/// a.a, also where the distance is small. `rules` are for rows of length 1 (int8: 127); for others
/// derive and hide them.
/// match_descriptors() uses tensor cores where there are, with the same bits; for a model that
/// derives from one and hides part_of(), add() or distance_of() it does not.
/// @tparam T float, float16 or std::int8_t @tparam N numbers @tparam Metric squared_distance or
///   dot_product
template <typename T, int N, typename Metric = squared_distance>
struct alignas(detail::row_alignment(N * sizeof(T), sizeof(T))) vector_descriptor {
  static_assert(std::is_same<T, float>::value || std::is_same<T, float16>::value ||
                    detail::is_int8<T>,
                "numbers are float, ft::float16 or std::int8_t");
  static_assert(std::is_same<Metric, squared_distance>::value ||
                    std::is_same<Metric, dot_product>::value,
                "the policy is squared_distance or dot_product");
  static_assert(N > 0 && N <= 1 << 14, "so that sums of int8 fit an int");
  static constexpr char const* name = "vector_descriptor";
  static constexpr auto rules = detail::vector_rules<T, N, Metric>();
  static constexpr int size = N;
  T of[N];

  FT_HOST_DEVICE static auto distance(vector_descriptor const& a, vector_descriptor const& b) {
    return distance_by_parts(a, b);
  }

  using part = std::conditional_t<detail::is_int8<T>, detail::four_words, detail::four_floats>;
  using sum = std::conditional_t<detail::is_int8<T>, int, detail::four_floats>;
  static constexpr int part_size = detail::is_int8<T> ? 16 : 4;
  static constexpr int parts = (N + part_size - 1) / part_size;
  static constexpr bool is_squared = std::is_same<Metric, squared_distance>::value;
  static constexpr bool uses_own_sums = is_squared && !std::is_same<T, float>::value;

  /// What lies past the last number is 0.
  FT_HOST_DEVICE FT_INLINE static part part_of(vector_descriptor const& row, int i) {
    if constexpr (detail::is_int8<T> && N % part_size == 0) {
      return detail::part_at<part>(row.of, i);
    }
    struct alignas(part_size * sizeof(T)) loaded {
      T of[part_size];
    };
    loaded mine;
    if constexpr (N % part_size == 0) {
      mine = detail::part_at<loaded>(row.of, i);
    } else {
      FT_UNROLL
      for (int k = 0; k < part_size; ++k) {
        mine.of[k] = i * part_size + k < N ? row.of[i * part_size + k] : T{};
      }
    }
    part p;
    if constexpr (detail::is_int8<T>) {
      memcpy(p.of, mine.of, sizeof p.of);
    } else {
      FT_UNROLL
      for (int k = 0; k < part_size; ++k) { p.of[k] = static_cast<float>(mine.of[k]); }
    }
    return p;
  }
  FT_HOST_DEVICE FT_INLINE static void add(sum& s, part const& a, part const& b) {
    if constexpr (std::is_same<T, float16>::value) {
      detail::add_exact_products(s, a, b);
    } else if constexpr (is_squared && std::is_same<T, float>::value) {
      detail::add_squares(s, a, b);
    } else {
      detail::add_products(s, a, b);
    }
  }
  FT_HOST_DEVICE FT_INLINE static auto distance_of(sum const& ab, sum const& aa, sum const& bb) {
    if constexpr (detail::is_int8<T>) {
      return is_squared ? aa + bb - 2 * ab : 127 * 127 - ab;
    } else if constexpr (!uses_own_sums) {
      return is_squared ? ab.total() : 1.0f - ab.total();
    } else {
      float const product = ab.total();
      float const d = (aa.total() + bb.total()) - (product + product);
      return d < 0 ? 0.0f : d;
    }
  }
};

static_assert(assert_descriptor_model<vector_descriptor<float, 128>>::value,
              "vector_descriptor keeps the contract of descriptors");

}  // namespace FT_ABI
}  // namespace ft
