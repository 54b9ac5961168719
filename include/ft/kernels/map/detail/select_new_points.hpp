// SPDX-License-Identifier: Apache-2.0
/// @file Which stereo keypoints of a new keyframe become map points.
#pragma once

#include <cstring>
#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr int any_depth = std::numeric_limits<int>::max();

/// The nearest stereo keypoints: those with a smaller depth than `depth`, and of those with exactly
/// that depth the first `ties`. Positive floats are compared by their bits.
struct depth_limit {
  int depth = 0;
  int ties = 0;
};

/// The bits of a positive finite depth; 0 for any other.
FT_HOST_DEVICE inline int depth_bits(float depth) {
  if (!(depth > 0 && scalar::is_finite(depth))) { return 0; }
  int bits;
  memcpy(&bits, &depth, sizeof bits);
  return bits;
}

/// The limit of the stereo keypoints that a keyframe takes: all near ones, at least `wanted`.
/// @param depth [n] metres @param near metres
template <typename Group>
FT_HOST_DEVICE depth_limit nearest_depths(Group g, float const* depth, int n, float near,
                                          int wanted) {
  auto const up_to = [&](int limit) {
    int count = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      int const bits = depth_bits(depth[i]);
      count += static_cast<int>(bits != 0 && bits <= limit);
    }
    return g.reduce(count, sum_op{});
  };
  if (up_to(depth_bits(near)) >= wanted) { return {depth_bits(near), any_depth}; }
  if (up_to(any_depth) <= wanted) { return {any_depth, any_depth}; }
  int low = 1;  // the smallest limit with enough keypoints is in [low, high]
  int high = any_depth;
  while (low < high) {
    int const middle = low + (high - low) / 2;
    if (up_to(middle) >= wanted) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  return {low, wanted - up_to(low - 1)};
}

/// The left keypoints of a camera, and the list of those that are to become points.
struct stereo_keypoints {
  float const* depth;  ///< [count] metres
  int count;
  int first_number;  ///< keypoint number of the first one
  int* holder;       ///< [count] slots, -1 = none
  int* listed;       ///< keypoint numbers
};

/// Lists the keypoints within the limit that hold nothing, and gives them the holder `mark`.
/// @param before length of the list @return its new length
template <typename Group>
FT_HOST_DEVICE int list_free(Group g, stereo_keypoints const& of, depth_limit limit, int mark,
                             int before) {
  int ties = 0;
  for (int first = 0; first < of.count; first += g.size()) {
    int const i = first + g.rank();
    int const bits = i < of.count ? depth_bits(of.depth[i]) : 0;
    bool const tie = bits != 0 && bits == limit.depth;
    int ties_here = 0;
    bool const early = ties + g.exclusive_count(tie, ties_here) < limit.ties;
    ties += ties_here;
    bool const near = bits != 0 && (bits < limit.depth || (tie && early));
    bool const is_new = near && of.holder[i] < 0;
    int here = 0;
    int const place = before + g.exclusive_count(is_new, here);
    before += here;
    if (is_new) {
      of.listed[place] = of.first_number + i;
      of.holder[i] = mark;
    }
  }
  return before;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
