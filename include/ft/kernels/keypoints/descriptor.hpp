// SPDX-License-Identifier: Apache-2.0
/// @file Steered BRIEF descriptor of a keypoint. Source: specification section 4; Rublee et al.,
/// "ORB: an efficient alternative to SIFT or SURF", ICCV 2011.
#pragma once

#include <cstdint>
#include <type_traits>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/keypoints/orientation.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

// The 256 learned point pairs of ORB. Source: Rublee et al., "ORB: an efficient alternative
// to SIFT or SURF", ICCV 2011.

/// A descriptor test: is the blurred image darker at (x0, y0) than at (x1, y1)? Pixels, relative to
/// the keypoint, before rotation.
struct alignas(4) pattern_pair {
  std::int8_t x0, y0, x1, y1;
};

/// The pattern of every ORB descriptor: pair i gives bit i.
// clang-format off
inline constexpr pattern_pair orb_pattern[256] = {
    {8, -3, 9, 5}, {4, 2, 7, -12}, {-11, 9, -8, 2}, {7, -12, 12, -13}, {2, -13, 2, 12},
    {1, -7, 1, 6}, {-2, -10, -2, -4}, {-13, -13, -11, -8}, {-13, -3, -12, -9}, {10, 4, 11, 9},
    {-13, -8, -8, -9}, {-11, 7, -9, 12}, {7, 7, 12, 6}, {-4, -5, -3, 0}, {-13, 2, -12, -3},
    {-9, 0, -7, 5}, {12, -6, 12, -1}, {-3, 6, -2, 12}, {-6, -13, -4, -8}, {11, -13, 12, -8},
    {4, 7, 5, 1}, {5, -3, 10, -3}, {3, -7, 6, 12}, {-8, -7, -6, -2}, {-2, 11, -1, -10},
    {-13, 12, -8, 10}, {-7, 3, -5, -3}, {-4, 2, -3, 7}, {-10, -12, -6, 11}, {5, -12, 6, -7},
    {5, -6, 7, -1}, {1, 0, 4, -5}, {9, 11, 11, -13}, {4, 7, 4, 12}, {2, -1, 4, 4},
    {-4, -12, -2, 7}, {-8, -5, -7, -10}, {4, 11, 9, 12}, {0, -8, 1, -13}, {-13, -2, -8, 2},
    {-3, -2, -2, 3}, {-6, 9, -4, -9}, {8, 12, 10, 7}, {0, 9, 1, 3}, {7, -5, 11, -10},
    {-13, -6, -11, 0}, {10, 7, 12, 1}, {-6, -3, -6, 12}, {10, -9, 12, -4}, {-13, 8, -8, -12},
    {-13, 0, -8, -4}, {3, 3, 7, 8}, {5, 7, 10, -7}, {-1, 7, 1, -12}, {3, -10, 5, 6},
    {2, -4, 3, -10}, {-13, 0, -13, 5}, {-13, -7, -12, 12}, {-13, 3, -11, 8}, {-7, 12, -4, 7},
    {6, -10, 12, 8}, {-9, -1, -7, -6}, {-2, -5, 0, 12}, {-12, 5, -7, 5}, {3, -10, 8, -13},
    {-7, -7, -4, 5}, {-3, -2, -1, -7}, {2, 9, 5, -11}, {-11, -13, -5, -13}, {-1, 6, 0, -1},
    {5, -3, 5, 2}, {-4, -13, -4, 12}, {-9, -6, -9, 6}, {-12, -10, -8, -4}, {10, 2, 12, -3},
    {7, 12, 12, 12}, {-7, -13, -6, 5}, {-4, 9, -3, 4}, {7, -1, 12, 2}, {-7, 6, -5, 1},
    {-13, 11, -12, 5}, {-3, 7, -2, -6}, {7, -8, 12, -7}, {-13, -7, -11, -12}, {1, -3, 12, 12},
    {2, -6, 3, 0}, {-4, 3, -2, -13}, {-1, -13, 1, 9}, {7, 1, 8, -6}, {1, -1, 3, 12},
    {9, 1, 12, 6}, {-1, -9, -1, 3}, {-13, -13, -10, 5}, {7, 7, 10, 12}, {12, -5, 12, 9},
    {6, 3, 7, 11}, {5, -13, 6, 10}, {2, -12, 2, 3}, {3, 8, 4, -6}, {2, 6, 12, -13},
    {9, -12, 10, 3}, {-8, 4, -7, 9}, {-11, 12, -4, -6}, {1, 12, 2, -8}, {6, -9, 7, -4},
    {2, 3, 3, -2}, {6, 3, 11, 0}, {3, -3, 8, -8}, {7, 8, 9, 3}, {-11, -5, -6, -4},
    {-10, 11, -5, 10}, {-5, -8, -3, 12}, {-10, 5, -9, 0}, {8, -1, 12, -6}, {4, -6, 6, -11},
    {-10, 12, -8, 7}, {4, -2, 6, 7}, {-2, 0, -2, 12}, {-5, -8, -5, 2}, {7, -6, 10, 12},
    {-9, -13, -8, -8}, {-5, -13, -5, -2}, {8, -8, 9, -13}, {-9, -11, -9, 0}, {1, -8, 1, -2},
    {7, -4, 9, 1}, {-2, 1, -1, -4}, {11, -6, 12, -11}, {-12, -9, -6, 4}, {3, 7, 7, 12},
    {5, 5, 10, 8}, {0, -4, 2, 8}, {-9, 12, -5, -13}, {0, 7, 2, 12}, {-1, 2, 1, 7}, {5, 11, 7, -9},
    {3, 5, 6, -8}, {-13, -4, -8, 9}, {-5, 9, -3, -3}, {-4, -7, -3, -12}, {6, 5, 8, 0},
    {-7, 6, -6, 12}, {-13, 6, -5, -2}, {1, -10, 3, 10}, {4, 1, 8, -4}, {-2, -2, 2, -13},
    {2, -12, 12, 12}, {-2, -13, 0, -6}, {4, 1, 9, 3}, {-6, -10, -3, -5}, {-3, -13, -1, 1},
    {7, 5, 12, -11}, {4, -2, 5, -7}, {-13, 9, -9, -5}, {7, 1, 8, 6}, {7, -8, 7, 6},
    {-7, -4, -7, 1}, {-8, 11, -7, -8}, {-13, 6, -12, -8}, {2, 4, 3, 9}, {10, -5, 12, 3},
    {-6, -5, -6, 7}, {8, -3, 9, -8}, {2, -12, 2, 8}, {-11, -2, -10, 3}, {-12, -13, -7, -9},
    {-11, 0, -10, -5}, {5, -3, 11, 8}, {-2, -13, -1, 12}, {-1, -8, 0, 9}, {-13, -11, -12, -5},
    {-10, -2, -10, 11}, {-3, 9, -2, -13}, {2, -3, 3, 2}, {-9, -13, -4, 0}, {-4, 6, -3, -10},
    {-4, 12, -2, -7}, {-6, -11, -4, 9}, {6, -3, 6, 11}, {-13, 11, -5, 5}, {11, 11, 12, 6},
    {7, -5, 12, -2}, {-1, 12, 0, 7}, {-4, -8, -3, -2}, {-7, 1, -6, 7}, {-13, -12, -8, -13},
    {-7, -2, -6, -8}, {-8, 5, -6, -9}, {-5, -1, -4, 5}, {-13, 7, -8, 10}, {1, 5, 5, -13},
    {1, 0, 10, -13}, {9, 12, 10, -1}, {5, -8, 10, -9}, {-1, 11, 1, -13}, {-9, -3, -6, 2},
    {-1, -10, 1, 12}, {-13, 1, -8, -10}, {8, -11, 10, -6}, {2, -13, 3, -6}, {7, -13, 12, -9},
    {-10, -10, -5, -7}, {-10, -8, -8, -13}, {4, -6, 8, 5}, {3, 12, 8, -13}, {-4, 2, -3, -3},
    {5, -13, 10, -12}, {4, -13, 5, -1}, {-9, 9, -4, 3}, {0, 3, 3, -9}, {-12, 1, -6, 1},
    {3, 2, 4, -8}, {-10, -10, -10, 9}, {8, -13, 12, 12}, {-8, -12, -6, -5}, {2, 2, 3, 7},
    {10, 6, 11, -8}, {6, 8, 8, -12}, {-7, 10, -6, 5}, {-3, -9, -3, 9}, {-1, -13, -1, 5},
    {-3, -7, -3, 4}, {-8, -2, -8, 3}, {4, 2, 12, 12}, {2, -5, 3, 11}, {6, -9, 11, -13},
    {3, -1, 7, 12}, {11, -1, 12, 4}, {-3, 0, -3, 6}, {4, -11, 4, 12}, {2, -4, 2, 1},
    {-10, -6, -8, 1}, {-13, 7, -11, 1}, {-13, 12, -11, -13}, {6, 0, 11, -13}, {0, -1, 1, 4},
    {-13, 3, -9, -2}, {-9, 8, -6, -3}, {-13, -6, -8, -2}, {5, -9, 8, 10}, {2, 7, 3, -9},
    {-1, -6, -1, -1}, {9, 5, 11, -2}, {11, -3, 12, -8}, {3, 0, 3, 5}, {-1, 4, 0, 10},
    {3, -6, 4, 5}, {-13, 0, -10, 5}, {5, 8, 12, 11}, {8, 9, 9, -6}, {7, -4, 8, -12},
    {-10, 4, -10, 9}, {7, 3, 12, 4}, {9, -7, 10, -2}, {7, 0, 12, -2}, {-1, -6, 0, -11}
};
// clang-format on

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

/// Where ORB's bits of a keypoint go.
template <typename D>
FT_HOST_DEVICE FT_INLINE binary_descriptor<256>& orb_bits(D& row) {
  static_assert(std::is_same<D, binary_descriptor<256>>::value,
                "ft finds ORB's keypoints in images: of another FT_DESCRIPTOR give your own, or "
                "those of an orb_extractor in a unit without FT_DESCRIPTOR");
  return row;
}

/// Descriptor by a warp. @param at(dx, dy) the pixel at an offset from the keypoint
template <typename Group, typename Sample>
FT_HOST_DEVICE void describe_by_warp(Group g, Sample const& at, rotation turn,
                                     lane_tests<Group> const& tests, binary_descriptor<256>& orb) {
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
                                             pattern_pair const* pattern,
                                             binary_descriptor<256>& orb) {
  for (int i = 0; i < 8; ++i) {
    orb.words[i] = descriptor_word(level.row(y) + x, level.stride, turn, pattern, i);
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
