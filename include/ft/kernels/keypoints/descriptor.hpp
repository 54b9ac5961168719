// SPDX-License-Identifier: Apache-2.0
/// @file Steered BRIEF descriptor of a keypoint. Source: specification section 4; Rublee et al.,
/// "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
#pragma once

#include <cstdint>

#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/keypoints/orientation.hpp"
#include "ft/kernels/keypoints/pattern.hpp"

namespace ft {
inline namespace FT_ABI {

/// Points of a descriptor's pattern lie so far from the keypoint at most, rotated and rounded.
inline constexpr int pattern_radius = 18;

namespace detail {

/// Bit of a descriptor's test, rotated. @param at the pixel at an offset from the keypoint
template <typename Pixel>
FT_HOST_DEVICE bool is_darker(pattern_pair p, rotation turn, Pixel const& at) {
  strict_float const ca = turn.cosine;
  strict_float const sb = turn.sine;
  auto const sample = [&](int px, int py) {
    strict_float const fx = static_cast<float>(px);
    strict_float const fy = static_cast<float>(py);
    int const dx = round_to_even((fx * ca - fy * sb).value);
    int const dy = round_to_even((fx * sb + fy * ca).value);
    return at(dx, dy);
  };
  return sample(p.x0, p.y0) < sample(p.x1, p.y1);
}

/// Keeps the products in an array apart from the sums that follow, as keep_apart() does.
template <int N>
FT_HOST_DEVICE FT_INLINE void keep_all_apart(float (&values)[N]) {
#if !defined(__CUDA_ARCH__) && ((defined(__FMA__) && defined(__x86_64__)) || defined(__aarch64__))
  asm("" : "+m"(values));
#else
  static_cast<void>(values);
#endif
}

/// Word `index` of the steered BRIEF descriptor at `centre`, by a single thread: the 64 points of
/// its tests are turned in loops that become vectors. @param stride of the level, below 2^15
FT_HOST_DEVICE FT_INLINE std::uint32_t descriptor_word(std::uint8_t const* centre, int stride,
                                                       rotation turn, pattern_pair const* pattern,
                                                       int index) {
  float const a = turn.cosine;
  float const b = turn.sine;
  constexpr int points = 64;
  static_assert(sizeof(pattern_pair) == 4, "nothing but the points");
  auto const* const tests = reinterpret_cast<std::int8_t const*>(pattern + 32 * index);
  float xa[points], xb[points], ya[points], yb[points];
  for (int i = 0; i < points; ++i) {
    auto const x = static_cast<float>(tests[2 * i]);
    auto const y = static_cast<float>(tests[2 * i + 1]);
    xa[i] = x * a;
    xb[i] = x * b;
    ya[i] = y * a;
    yb[i] = y * b;
  }
  keep_all_apart(xa);
  keep_all_apart(xb);
  keep_all_apart(ya);
  keep_all_apart(yb);
  // Adding this leaves no bits below 1: the nearest integer, halves to even, as round_to_even().
  constexpr float whole = 12582912.0f;
  auto const pitch = static_cast<float>(stride);
  std::int32_t at[points];
  for (int i = 0; i < points; ++i) {
    float const dx = (xa[i] - yb[i] + whole) - whole;
    float const dy = (xb[i] + ya[i] + whole) - whole;
    at[i] = static_cast<std::int32_t>(dy * pitch + dx);  // whole numbers below 2^24
  }
  std::uint32_t word = 0;
  for (int k = 31; k >= 0; --k) {
    word += word + static_cast<std::uint32_t>(centre[at[2 * k]] < centre[at[2 * k + 1]]);
  }
  return word;
}

/// The tests of a descriptor that a thread does where several work together: of each word one,
/// where they are 32, so that neighbouring bits are of neighbouring threads; else bytes.
template <typename Group>
struct own_tests {
  pattern_pair const* all;
  FT_HOST_DEVICE own_tests(Group, pattern_pair const* pattern) : all(pattern) {}
};
#if defined(__CUDACC__)
template <>
struct own_tests<warp_group> {
  static constexpr int words = 8;
  pattern_pair of_word[words];
  __device__ own_tests(warp_group g, pattern_pair const* pattern) {
    FT_UNROLL
    for (int k = 0; k < words; ++k) { of_word[k] = pattern[32 * k + g.rank()]; }
  }
};
#endif

/// Steered BRIEF descriptor by several threads. @param at(dx, dy) a pixel beside the keypoint
template <typename Group, typename Sample>
FT_HOST_DEVICE void describe_together(Group g, Sample const& at, rotation turn,
                                      own_tests<Group> const& tests, descriptor& orb) {
  if constexpr (Group::max_threads == 32) {
#if defined(__CUDA_ARCH__)
    constexpr int words = own_tests<Group>::words;
    std::uint32_t mine = 0;  // thread k keeps word k
    FT_UNROLL
    for (int k = 0; k < words; ++k) {
      std::uint32_t const word = g.ballot(is_darker(tests.of_word[k], turn, at));
      mine = g.rank() == k ? word : mine;
    }
    if (g.rank() < words) { orb.words[g.rank()] = mine; }
#endif
  } else {
    auto* const bytes = reinterpret_cast<unsigned char*>(&orb);
    for (int i = g.rank(); i < 32; i += g.size()) {
      unsigned byte = 0;
      for (int bit = 0; bit < 8; ++bit) {
        byte |= static_cast<unsigned>(is_darker(tests.all[8 * i + bit], turn, at)) << bit;
      }
      bytes[i] = static_cast<unsigned char>(byte);
    }
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
