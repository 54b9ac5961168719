// SPDX-License-Identifier: Apache-2.0
/// @file Bags of words as plain structures, the same for every compiler.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// What tells one vocabulary from another: its header, and all its words. The inner nodes are left
/// out, since DBoW2 shows none of them.
struct vocabulary_facts {
  int branching = 0;
  int levels = 0;
  int scoring = 0;
  int weighting = 0;
  std::size_t words = 0;
  std::uint64_t descriptors = 0;  ///< vocabulary_hash of 32 bytes of each word, in their order
  std::uint64_t weights = 0;      ///< vocabulary_hash of a double of each word, in their order
};

/// Hash of Fowler, Noll and Vo (FNV-1a, 64 bits) over words of eight bytes.
class vocabulary_hash {
public:
  /// @param bytes a multiple of 8
  void add(void const* data, std::size_t bytes) {
    auto const* const from = static_cast<unsigned char const*>(data);
    for (std::size_t at = 0; at < bytes; at += 8) {
      std::uint64_t word = 0;
      std::memcpy(&word, from + at, 8);
      value_ = (value_ ^ word) * 0x100000001b3u;
      value_ ^= value_ >> 32;
    }
  }
  std::uint64_t value() const { return value_; }

private:
  std::uint64_t value_ = 0xcbf29ce484222325u;
};

/// `facts` with the hashes of its words, but for those of weight 0 at the end.
/// @param weight,descriptor of a word: a double; 32 bytes, any type without padding
template <typename Weight, typename Descriptor>
vocabulary_facts facts_of(vocabulary_facts facts, Weight const& weight,
                          Descriptor const& descriptor) {
  while (facts.words > 0 && weight(facts.words - 1) == 0) { --facts.words; }
  vocabulary_hash weights;
  vocabulary_hash descriptors;
  for (std::size_t w = 0; w < facts.words; ++w) {
    double const value = weight(w);
    weights.add(&value, sizeof value);
    auto const& bits = descriptor(w);
    descriptors.add(&bits, 32);
  }
  facts.weights = weights.value();
  facts.descriptors = descriptors.value();
  return facts;
}

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
