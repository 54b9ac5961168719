// SPDX-License-Identifier: Apache-2.0
/// @file Steered BRIEF descriptor of a keypoint. Source: specification section 4; Rublee et al.,
/// "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
#pragma once

#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/keypoints/orientation.hpp"
#include "ft/kernels/keypoints/pattern.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

/// Largest distance of a pattern point from the keypoint along an axis, rotated and rounded.
inline constexpr int pattern_radius = 18;

/// The images in which keypoints are described, and the pattern; all in executor memory.
struct description_source {
  image_pyramid_view pyramid;             ///< for the angles
  image_pyramid_view blurred;             ///< of `pyramid`, for the descriptors
  pattern_pair const* pattern = nullptr;  ///< [256] points within `pattern_radius`
};

namespace detail {

/// Result of one rotated test. @param at(dx, dy) the pixel at an offset from the keypoint
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

/// keep_apart() for all products in an array.
template <int N>
FT_HOST_DEVICE FT_INLINE void keep_all_apart(float (&values)[N]) {
#if !defined(__CUDA_ARCH__) && ((defined(__FMA__) && defined(__x86_64__)) || defined(__aarch64__))
  asm("" : "+m"(values));
#else
  static_cast<void>(values);
#endif
}

/// Word `index` of the descriptor at `centre`, by a single thread. The 64 points of its tests are
/// rotated in loops that vectorise. @param stride of the level, below 2^15
FT_HOST_DEVICE FT_INLINE std::uint32_t descriptor_word(std::uint8_t const* centre, int stride,
                                                       rotation turn, pattern_pair const* pattern,
                                                       int index) {
  float const a = turn.cosine;
  float const b = turn.sine;
  constexpr int points = 64;
  static_assert(sizeof(pattern_pair) == 4, "a pair is four coordinates");
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
  // Adding 1.5 * 2^23 leaves no fraction bits: the nearest integer, halves to even.
  constexpr float whole = 12582912.0f;
  auto const pitch = static_cast<float>(stride);
  std::int32_t at[points];
  for (int i = 0; i < points; ++i) {
    float const dx = (xa[i] - yb[i] + whole) - whole;
    float const dy = (xb[i] + ya[i] + whole) - whole;
    at[i] = static_cast<std::int32_t>(dy * pitch + dx);  // integers below 2^24
  }
  std::uint32_t word = 0;
  for (int k = 31; k >= 0; --k) {
    word += word + static_cast<std::uint32_t>(centre[at[2 * k]] < centre[at[2 * k + 1]]);
  }
  return word;
}

/// The tests of one lane of a warp: one of each word, so that lane i yields bit i of all words.
template <typename Group>
struct lane_tests;
#if defined(__CUDACC__)
template <>
struct lane_tests<warp_group> {
  static constexpr int words = 8;
  pattern_pair of_word[words];
  __device__ lane_tests(warp_group g, pattern_pair const* pattern) {
    FT_UNROLL
    for (int k = 0; k < words; ++k) { of_word[k] = pattern[32 * k + g.rank()]; }
  }
};
#endif

/// Descriptor by a warp. @param at(dx, dy) the pixel at an offset from the keypoint
template <typename Group, typename Sample>
FT_HOST_DEVICE void describe_by_warp(Group g, Sample const& at, rotation turn,
                                     lane_tests<Group> const& tests, descriptor& orb) {
  constexpr int words = lane_tests<Group>::words;
  std::uint32_t mine = 0;  // lane k keeps word k
  FT_UNROLL
  for (int k = 0; k < words; ++k) {
    std::uint32_t const word = g.ballot(is_darker(tests.of_word[k], turn, at));
    mine = g.rank() == k ? word : mine;
  }
  if (g.rank() < words) { orb.words[g.rank()] = mine; }
}

/// Descriptor by a single thread.
FT_HOST_DEVICE FT_INLINE void describe_alone(gray_view level, int x, int y, rotation turn,
                                             pattern_pair const* pattern, descriptor& orb) {
  for (int i = 0; i < 8; ++i) {
    orb.words[i] = descriptor_word(level.row(y) + x, level.stride, turn, pattern, i);
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
