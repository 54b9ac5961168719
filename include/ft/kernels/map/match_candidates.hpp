// SPDX-License-Identifier: Apache-2.0
/// @file Which of a keypoint's matches with several keyframes makes its new point.
///
/// Any match along an epipolar line makes a point that both its views agree with, so a wrong one
/// looks as good as a right one, and wrong ones with a wide angle are near. Points of right matches
/// are the same point. (Consensus of samples: Fischler and Bolles, "Random sample consensus",
/// 1981.)
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// A match with a keyframe, and its point.
struct match_candidate {
  int keyframe = 0;            ///< number; 0 = none
  int keypoint = -1;           ///< of the keyframe
  int distance = 0;            ///< Hamming
  strict_double cosine = 2.0;  ///< of the angle between both rays
  vec3<float> point{0, 0, 0};  ///< in the camera's frame
};

/// Other matches that a point must agree with, where a keypoint is compared with so many keyframes:
/// none with one or two, one with up to five, else two.
FT_HOST_DEVICE constexpr int least_support(int keyframes) {
  return keyframes < 3 ? 0 : keyframes < 6 ? 1 : 2;
}

/// The candidate whose point agrees with most other matches; of equals the one with the widest
/// angle, then the first. Every thread of the group gets it.
/// @param least matches that it agrees with besides its own
/// @param agrees agrees(k, j): whether the point of candidate k is seen where candidate j matched
/// @return its number; -1 = none has that support
template <typename Group, typename Agrees>
FT_HOST_DEVICE int most_supported(Group g, match_candidate const* all, int count, int least,
                                  Agrees const& agrees) {
  int most = -1;
  int own = -1;
  for (int k = g.rank(); k < count; k += g.size()) {
    int support = 0;
    for (int j = 0; j < count; ++j) { support += static_cast<int>(j != k && agrees(k, j)); }
    if (support > most || (support == most && all[k].cosine < all[own].cosine)) {
      most = support;
      own = k;
    }
  }
  int const best = g.reduce(most, max_op{});
  if (best < 0 || best < least) { return -1; }
  double const angle = most == best ? all[own].cosine.value : 2.0;
  double const widest = g.reduce(angle, min_op{});
  return g.reduce(most == best && angle == widest ? own : count, min_op{});
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
