// SPDX-License-Identifier: Apache-2.0
/// @file Arithmetic on packed pixels: words of four bytes and pairs of 16-bit numbers, and copies
/// of rectangles into scratch by words. The leftmost pixel of a word is the lowest byte.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

// ---- packed arithmetic: one or two instructions on a device; the host gets the same values ------

/// Minima of the low and of the high halves, unsigned.
FT_HOST_DEVICE inline std::uint32_t min_pairs(std::uint32_t a, std::uint32_t b) {
#if defined(__CUDA_ARCH__)
  return __vminu2(a, b);
#else
  return min_of(a & 0xffffu, b & 0xffffu) | min_of(a >> 16, b >> 16) << 16;
#endif
}
/// Maxima of the low and of the high halves, unsigned.
FT_HOST_DEVICE inline std::uint32_t max_pairs(std::uint32_t a, std::uint32_t b) {
#if defined(__CUDA_ARCH__)
  return __vmaxu2(a, b);
#else
  return max_of(a & 0xffffu, b & 0xffffu) | max_of(a >> 16, b >> 16) << 16;
#endif
}
FT_HOST_DEVICE inline std::uint32_t swap_pair(std::uint32_t a) { return a >> 16 | a << 16; }

/// Byte i of the result is the byte of a (0 to 3) or b (4 to 7) that digit i of `selector` names.
FT_HOST_DEVICE inline std::uint32_t permute_bytes(std::uint32_t a, std::uint32_t b,
                                                  std::uint32_t selector) {
#if defined(__CUDA_ARCH__)
  return __byte_perm(a, b, selector);
#else
  std::uint64_t const both = static_cast<std::uint64_t>(b) << 32 | a;
  std::uint32_t result = 0;
  for (int i = 0; i < 4; ++i) {
    auto const byte = static_cast<std::uint32_t>(both >> (8 * (selector >> (4 * i) & 7u)) & 0xffu);
    result |= byte << (8 * i);
  }
  return result;
#endif
}

/// permute_bytes() for a selector known at run time whose digits are below 8, so a device need not
/// mask them.
FT_HOST_DEVICE inline std::uint32_t select_bytes(std::uint32_t a, std::uint32_t b,
                                                 std::uint32_t selector) {
#if defined(__CUDA_ARCH__)
  std::uint32_t result;
  asm("prmt.b32 %0, %1, %2, %3;" : "=r"(result) : "r"(a), "r"(b), "r"(selector));
  return result;
#else
  return permute_bytes(a, b, selector);
#endif
}

/// `sum` plus the dot product of the four bytes of a and b.
FT_HOST_DEVICE inline std::uint32_t dot_of_4(std::uint32_t a, std::uint32_t b, std::uint32_t sum) {
#if defined(__CUDA_ARCH__)
  return __dp4a(a, b, sum);
#else
  for (int i = 0; i < 32; i += 8) { sum += (a >> i & 0xffu) * (b >> i & 0xffu); }
  return sum;
#endif
}
/// `sum` plus the dot product of the halves of a and the two lowest bytes of b.
FT_HOST_DEVICE inline std::uint32_t dot_of_2(std::uint32_t a, std::uint32_t b, std::uint32_t sum) {
#if defined(__CUDA_ARCH__)
  return __dp2a_lo(a, b, sum);
#else
  return sum + (a & 0xffffu) * (b & 0xffu) + (a >> 16) * (b >> 8 & 0xffu);
#endif
}
/// `sum` plus the absolute differences of the four bytes of a and b.
FT_HOST_DEVICE inline std::uint32_t difference_of_4(std::uint32_t a, std::uint32_t b,
                                                    std::uint32_t sum) {
#if defined(__CUDA_ARCH__)
  return sum + __vsadu4(a, b);
#else
  for (int i = 0; i < 32; i += 8) {
    std::uint32_t const p = a >> i & 0xffu;
    std::uint32_t const q = b >> i & 0xffu;
    sum += p < q ? q - p : p - q;
  }
  return sum;
#endif
}
/// The absolute differences of the four bytes of a and b.
FT_HOST_DEVICE inline std::uint32_t differences_of_4(std::uint32_t a, std::uint32_t b) {
#if defined(__CUDA_ARCH__)
  return __vabsdiffu4(a, b);
#else
  std::uint32_t result = 0;
  for (int i = 0; i < 32; i += 8) {
    std::uint32_t const p = a >> i & 0xffu;
    std::uint32_t const q = b >> i & 0xffu;
    result |= (p < q ? q - p : p - q) << i;
  }
  return result;
#endif
}
/// Bytes `first` to `first` + 3 of the eight bytes of a and b. @param first 0 to 3
FT_HOST_DEVICE inline std::uint32_t bytes_from(std::uint32_t a, std::uint32_t b, int first) {
#if defined(__CUDA_ARCH__)
  return __funnelshift_r(a, b, static_cast<unsigned>(8 * first));
#else
  std::uint64_t const both = static_cast<std::uint64_t>(b) << 32 | a;
  return static_cast<std::uint32_t>(both >> (8 * first));
#endif
}

// ---- words of an image --------------------------------------------------------------------------

/// @param p aligned to 4 bytes
FT_HOST_DEVICE inline std::uint32_t load_word(std::uint8_t const* p) {
#if defined(__CUDA_ARCH__)
  return *reinterpret_cast<std::uint32_t const*>(p);
#else
  std::uint32_t word;
  std::memcpy(&word, p, sizeof word);
  return word;
#endif
}
FT_HOST_DEVICE inline void store_word(std::uint8_t* p, std::uint32_t word) {
#if defined(__CUDA_ARCH__)
  *reinterpret_cast<std::uint32_t*>(p) = word;
#else
  std::memcpy(p, &word, sizeof word);
#endif
}

/// Loads `bytes` bytes at any address into words. Only aligned words that contain some of them are
/// read. The rest of the last word is undefined. @param bytes more than N - 1 words, at most N
template <int N>
FT_HOST_DEVICE void load_bytes(std::uint8_t const* p, int bytes, std::uint32_t (&words)[N]) {
  int const skew = static_cast<int>(reinterpret_cast<std::uintptr_t>(p) & 3u);
  std::uint8_t const* const from = p - skew;
  std::uint32_t const last = load_word(from + ((skew + bytes - 1) & ~3));
  FT_UNROLL
  for (int k = 0; k < N; ++k) { words[k] = load_word(from + 4 * k); }
  FT_UNROLL
  for (int k = 0; k < N; ++k) {
    words[k] = bytes_from(words[k], k + 1 < N ? words[k + 1] : last, skew);
  }
}

/// Whether every row is aligned to 4 bytes and padded to whole words, so that rows can be read by
/// words, including the padding.
template <typename T>
FT_HOST_DEVICE bool has_word_rows(image_view<T> const& image) {
  return ((reinterpret_cast<std::uintptr_t>(image.data) | static_cast<unsigned>(image.stride)) &
          3u) == 0;
}

/// The pixels [x, x + w) x [y, y + h) of an image.
struct pixel_rectangle {
  int x, y, w, h;
};

/// stage_rectangle() of aligned rows of whole words, by several threads.
template <int InFlight, typename Group>
FT_HOST_DEVICE void stage_words(Group g, gray_view from, std::uint32_t* words, int pitch) {
  int const n = from.width / 4;
  int const h = from.height;
  if (g.size() >= 128 && n <= 32) {
    // A power of two of threads per row; some of them are idle.
    int const lanes = n <= 16 ? 4 : 5;
    int const c = g.rank() & ((1 << lanes) - 1);
    int const rows = g.size() >> lanes;
    int r = g.rank() >> lanes;
    if (c >= n) { return; }
    std::uint8_t const* at = from.data + r * from.stride + 4 * c;
    std::uint32_t* to = words + r * pitch + c;
    for (; r < h; r += InFlight * rows) {
      std::uint32_t word[InFlight];
      FT_UNROLL
      for (int k = 0; k < InFlight; ++k) {
        if (r + k * rows < h) { word[k] = load_word(at + k * rows * from.stride); }
      }
      FT_UNROLL
      for (int k = 0; k < InFlight; ++k) {
        if (r + k * rows < h) { to[k * rows * pitch] = word[k]; }
      }
      at += InFlight * rows * from.stride;
      to += InFlight * rows * pitch;
    }
    return;
  }
  small_divider const row_of(n);
  for (int base = g.rank(); base < n * h; base += InFlight * g.size()) {
    std::uint32_t word[InFlight];
    int to[InFlight];
    FT_UNROLL
    for (int k = 0; k < InFlight; ++k) {
      int const i = base + k * g.size();
      int const r = row_of(i);
      int const c = i - r * n;
      to[k] = r * pitch + c;
      if (i < n * h) { word[k] = load_word(from.data + r * from.stride + 4 * c); }
    }
    FT_UNROLL
    for (int k = 0; k < InFlight; ++k) {
      if (base + k * g.size() < n * h) { words[to[k]] = word[k]; }
    }
  }
}

/// Copies a rectangle of an image into words of scratch. Call sync() afterwards. Pixel
/// (from.x + i, from.y + r) becomes byte (from.x & 3) + i of the row that starts at word r * pitch.
/// Other bytes of the touched words are undefined.
/// @tparam InFlight loads of a thread before its first store
/// @param pitch words from row to row, enough for (from.x & 3) + from.w bytes
template <int InFlight = 4, typename Group>
FT_HOST_DEVICE void stage_rectangle(Group g, gray_view image, pixel_rectangle const& from,
                                    std::uint32_t* words, int pitch) {
  int const w = from.w;
  int const h = from.h;
  if (w <= 0 || h <= 0) { return; }
  int const skew = from.x & 3;
  if (g.size() > 1 && has_word_rows(image)) {
    int const n = (skew + w + 3) / 4;
    gray_view const rows{image.row(from.y) + (from.x - skew), 4 * n, h, image.stride};
    stage_words<InFlight>(g, rows, words, pitch);
    return;
  }
  auto* const bytes = reinterpret_cast<std::uint8_t*>(words) + skew;
  if (g.size() == 1) {
    for (int r = 0; r < h; ++r) {
      std::memcpy(bytes + static_cast<std::ptrdiff_t>(r) * 4 * pitch,
                  image.row(from.y + r) + from.x, static_cast<std::size_t>(w));
    }
    return;
  }
  small_divider const row_of(w);
  for (int i = g.rank(); i < w * h; i += g.size()) {
    int const r = row_of(i);
    bytes[r * 4 * pitch + (i - r * w)] = image.row(from.y + r)[from.x + i - r * w];
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
