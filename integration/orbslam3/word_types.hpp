// SPDX-License-Identifier: Apache-2.0
/// @file Bags of words as plain structures, the same for every compiler.
#pragma once

#include <cstddef>
#include <cstdint>

#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// Descriptors of a frame: rows of 32 bytes.
struct descriptor_rows {
  unsigned char const* data = nullptr;
  std::size_t step = 0;  ///< bytes from row to row
  int count = 0;
};

/// What a vocabulary says about a frame: BowVector and FeatureVector of DBoW2 as arrays, which stay
/// until the next transform.
struct word_lists {
  int words = 0;
  std::uint32_t const* word = nullptr;  ///< [words] ascending
  double const* value = nullptr;        ///< [words]
  int groups = 0;
  std::uint32_t const* node = nullptr;  ///< [groups] ascending
  int const* start = nullptr;           ///< [groups + 1] first of a group in `keypoint`
  int const* keypoint = nullptr;
  device_times times;
};

/// The two sides of a search by words.
enum class word_side { keyframe, frame };

/// Arrays of one side in host memory, to be filled in by the caller. Of two cameras the left
/// keypoints come first.
struct word_arrays {
  int capacity = 0;   ///< keypoints
  int keypoints = 0;  ///< at most capacity
  /// First keypoint of the right camera, -1 = there is one camera. Of the frame.
  int first_right = -1;
  int groups = 0;                       ///< at most capacity
  std::uint32_t* descriptor = nullptr;  ///< [keypoints][8]
  float* angle = nullptr;               ///< [keypoints] degrees
  int* holder = nullptr;          ///< [keypoints] of the keyframe: -1 = not to be searched, or what
                                  ///< a match is to say, such as the keypoint's own number
  std::uint32_t* node = nullptr;  ///< [groups] ascending
  int* start = nullptr;           ///< [groups + 1] first of a group in `keypoint`; start[0] is 0
  int* keypoint = nullptr;        ///< each at most once
};

struct word_search_request {
  float ratio = 0.75f;  ///< limit of the best distance over the second best one, left camera
  bool orientation_check = true;
};

struct word_matches {
  int count = 0;               ///< keypoints of the frame that are matched
  int const* match = nullptr;  ///< [keypoints of the frame] the keyframe's holder, -1 = none
  device_times times;
};

}  // namespace orbslam3
}  // namespace ft
