// SPDX-License-Identifier: Apache-2.0
/// @file Bags of words of frames: which words of a vocabulary their descriptors are, and which
/// descriptors share a node of it. Source: Gálvez-López and Tardós, "Bags of binary words for fast
/// place recognition in image sequences", T-RO 2012.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// How alike two bags of words are.
enum class word_scoring { l1, l2, chi_square, kl, bhattacharyya, dot_product };

/// What a word of a frame counts: its frequency in the frame, its rarity, both, or 1.
enum class word_weighting { tf_idf, tf, idf, binary };

/// The distinct words of a batch of frames, each with its value.
struct word_list_view {
  int frames = 0;
  int capacity = 0;               ///< words of a frame
  int* count = nullptr;           ///< [frames]
  std::uint32_t* word = nullptr;  ///< [frames][capacity] ascending
  double* value = nullptr;        ///< [frames][capacity]

  FT_HOST_DEVICE std::ptrdiff_t at(int frame) const {
    return static_cast<std::ptrdiff_t>(frame) * capacity;
  }
  template <typename Visit>
  void columns(Visit&& each) {
    each({frames}, count);
    each({frames, capacity}, word, value);
  }
  /// Some of the frames.
  word_list_view slice(int first, int number) const {
    word_list_view v = detail::skip_entries(*this, first);
    v.frames = number;
    return v;
  }
};
static_assert(std::is_trivially_copyable<word_list_view>::value, "passed to kernels");

inline void carve(carver& c, word_list_view& v, int frames, int capacity) {
  v.frames = frames;
  v.capacity = capacity;
  detail::place_columns(c, v);
}

/// The keypoints of a batch of frames, grouped by the node of the vocabulary that their descriptors
/// pass. A frame of two cameras has the left keypoints, then the right ones.
struct node_groups_view {
  int frames = 0;
  int capacity = 0;               ///< keypoints of a frame
  int* count = nullptr;           ///< [frames] groups
  std::uint32_t* node = nullptr;  ///< [frames][capacity] ascending
  int* start = nullptr;           ///< [frames][capacity + 1] first of a group in `keypoint`
  int* keypoint = nullptr;        ///< [frames][capacity] ascending within a group

  FT_HOST_DEVICE std::ptrdiff_t at(int frame) const {
    return static_cast<std::ptrdiff_t>(frame) * capacity;
  }
  FT_HOST_DEVICE std::ptrdiff_t start_at(int frame) const {
    return static_cast<std::ptrdiff_t>(frame) * (capacity + 1);
  }
  template <typename Visit>
  void columns(Visit&& each) {
    each({frames}, count);
    each({frames, capacity}, node);
    each({frames, capacity + 1}, start);
    each({frames, capacity}, keypoint);
  }
  /// Some of the frames.
  node_groups_view slice(int first, int number) const {
    node_groups_view v = detail::skip_entries(*this, first);
    v.frames = number;
    return v;
  }
};
static_assert(std::is_trivially_copyable<node_groups_view>::value, "passed to kernels");

inline void carve(carver& c, node_groups_view& v, int frames, int capacity) {
  v.frames = frames;
  v.capacity = capacity;
  detail::place_columns(c, v);
}

/// A keypoint or a node that has no word.
inline constexpr std::uint32_t no_word = 0xffffffffu;

/// What a vocabulary says about each descriptor of a batch of frames.
struct feature_words_view {
  int frames = 0;
  int capacity = 0;               ///< descriptors of a frame
  std::uint32_t* word = nullptr;  ///< [frames][capacity] the word, also one that is stopped
  std::uint32_t* node = nullptr;  ///< [frames][capacity] node of its group
  double* weight = nullptr;       ///< [frames][capacity] of the word; not positive: stopped

  FT_HOST_DEVICE std::ptrdiff_t at(int frame) const {
    return static_cast<std::ptrdiff_t>(frame) * capacity;
  }
};
static_assert(std::is_trivially_copyable<feature_words_view>::value, "passed to kernels");

inline void carve(carver& c, feature_words_view& v, int frames, int capacity) {
  v.frames = frames;
  v.capacity = capacity;
  c.place({frames, capacity}, v.word, v.node, v.weight);
}

}  // namespace FT_ABI
}  // namespace ft
