// SPDX-License-Identifier: Apache-2.0
/// @file Stage: from the descriptors of frames to bags of words, and to groups of keypoints that
/// share a node of the vocabulary. Source: Gálvez-López and Tardós, "Bags of binary words for fast
/// place recognition in image sequences", T-RO 2012.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// Descriptors of a batch of frames. Keypoints convert to it. A frame of two cameras has the left
/// descriptors, then the right ones.
using descriptors_view = soa_view<field::orb>;

struct transform_params {
  /// Levels of the vocabulary, counted from the deepest, that keypoints of a group may differ in,
  /// 0 to 10. As many as there are, or more: one group.
  int levels_up = 4;
};

/// @throws bad_argument naming the value and the limit
inline void check(transform_params const& p) {
  detail::require_range("levels up of a transform", p.levels_up, 0, max_vocabulary_levels);
}

/// What transform_to_words() writes about a batch of frames.
struct frame_words_view {
  feature_words_view features;
  word_list_view bag;
  node_groups_view groups;
};
static_assert(std::is_trivially_copyable<frame_words_view>::value, "passed to kernels");

inline void carve(carver& c, frame_words_view& v, int frames, int capacity) {
  carve(c, v.features, frames, capacity);
  carve(c, v.bag, frames, capacity);
  carve(c, v.groups, frames, capacity);
}

struct transform_workspace {
  int frames = 0;
  int capacity = 0;
  unsigned long long* keys = nullptr;  ///< [frames][2][capacity]
};
static_assert(std::is_trivially_copyable<transform_workspace>::value, "passed to kernels");

inline void carve(carver& c, transform_workspace& w, int frames, int capacity) {
  w.frames = frames;
  w.capacity = capacity;
  c.place({2, frames, capacity}, w.keys);
}

namespace detail {

/// Descriptors of a frame, whatever its count says.
FT_HOST_DEVICE inline int held(descriptors_view const& in, int frame) {
  return clamp(in.count[frame], 0, in.capacity);
}

/// Item: a descriptor. Goes from the root to the nearest child, the first of equals, until there is
/// none. A thread a child; each loads its child's children, too, so that a level costs the latency
/// of one load.
struct find_word {
  using scratch = no_scratch;
  static constexpr bool wide_on_host = true;
  int group_depth;  ///< of the nodes that keypoints are grouped by; not positive: the root

  template <typename Group>
  FT_HOST_DEVICE FT_INLINE void operator()(Group g, scratch&, int item, vocabulary_view const& v,
                                           descriptors_view const& in,
                                           feature_words_view const& out) const {
    int const frame = item / in.capacity;
    int const i = item - frame * in.capacity;
    if (i >= held(in, frame)) { return; }
    descriptor const mine = in.orb(item);
    int at = 0;
    int group = 0;
    node_children below = v.nodes > 0 ? v.children[0] : node_children{0, 0};
    FT_NO_UNROLL
    for (int depth = 1; below.count > 0; ++depth) {
      at = nearest_child(g, mine, v, below);
      if (depth <= group_depth) { group = at; }
    }
    if (g.rank() == 0) {
      std::uint32_t word = no_word;
      std::uint32_t node = 0;
      double weight = 0;
      if (at > 0) {  // three loads in flight together
        word = v.word[at];
        node = v.node[group];
        weight = v.weight[at];
      }
      auto const to = out.at(frame) + i;
      out.word[to] = word;
      out.node[to] = node;
      out.weight[to] = weight;
    }
  }

private:
  /// The first of the nearest children. @param below in: the children; out: the nearest one's
  template <typename Group>
  FT_HOST_DEVICE FT_INLINE static int nearest_child(Group g, descriptor const& mine,
                                                    vocabulary_view const& v,
                                                    node_children& below) {
    if constexpr (Group::max_threads > 1) {
      static_assert(max_branching <= 32 && Group::max_threads == 32, "a lane a child");
      // Lanes without a child load the first one, so that no load depends on a branch.
      bool const there = g.rank() < below.count;
      int const child = below.first + (there ? g.rank() : 0);
      descriptor const of_child = v.orb[child];
      node_children const below_child = v.children[child];
      auto const key =
          static_cast<unsigned>(search_distance_by_adders(mine, of_child) * 32 + g.rank());
      int const nearest = static_cast<int>(g.reduce(there ? key : ~0u, min_op{}) % 32);
      int const at = below.first + nearest;
      below = {g.shuffle(below_child.first, nearest), g.shuffle(below_child.count, nearest)};
      return at;
    } else {
      int at = below.first;
      int nearest = search_distance(mine, v.orb[at]);
      for (int child = at + 1; child < below.first + below.count; ++child) {
        int const distance = search_distance(mine, v.orb[child]);
        if (distance < nearest) {
          nearest = distance;
          at = child;
        }
      }
      below = v.children[at];
      return at;
    }
  }
};

/// Item: half of a frame's lists, of even items the words, of odd ones the groups. Sorts the
/// features by word or node and then by number, and lists the runs.
struct list_words {
  using key_type = unsigned long long;
  struct scratch {
    double norm;
  };
  vocabulary_header header;
  std::size_t extra;  ///< bytes of shared memory for keys; too few for all of them: not used

  std::size_t extra_bytes() const { return extra; }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, descriptors_view const& in,
                                 frame_words_view const& out,
                                 transform_workspace const& work) const {
    int const frame = item / 2;
    int const n = held(in, frame);
    bool const fits = static_cast<std::size_t>(n) * sizeof(key_type) <= extra;
    key_type* const keys = fits && g.extra() != nullptr
                               ? reinterpret_cast<key_type*>(g.extra())
                               : work.keys + static_cast<std::ptrdiff_t>(item) * work.capacity;
    auto const first = out.features.at(frame);
    double const* const weight = out.features.weight + first;
    if (item % 2 == 0) {
      int const kept = sort_kept(g, keys, out.features.word + first, weight, n);
      list_bag(g, s, keys, kept, weight, out.bag, frame);
    } else {
      int const kept = sort_kept(g, keys, out.features.node + first, weight, n);
      list_groups(g, keys, kept, out.groups, frame);
    }
  }

private:
  FT_HOST_DEVICE static std::uint32_t owner_of(key_type key) {
    return static_cast<std::uint32_t>(key >> 32);
  }
  FT_HOST_DEVICE static int feature_of(key_type key) { return static_cast<int>(key & 0x7fffffff); }
  FT_HOST_DEVICE static bool begins_run(key_type const* keys, int i) {
    return i == 0 || owner_of(keys[i - 1]) != owner_of(keys[i]);
  }

  /// Keys of the features whose word is not stopped, ascending. @return their number
  template <typename Group>
  FT_HOST_DEVICE static int sort_kept(Group g, key_type* keys, std::uint32_t const* owner,
                                      double const* weight, int n) {
    int kept = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      bool const keep = i < n && weight[i] > 0;
      int total = 0;
      int const to = kept + g.exclusive_count(keep, total);
      if (keep) { keys[to] = static_cast<key_type>(owner[i]) << 32 | static_cast<unsigned>(i); }
      kept += total;
    }
    g.sort(keys, kept);
    return kept;
  }

  template <typename Group>
  FT_HOST_DEVICE void list_bag(Group g, scratch& s, key_type const* keys, int kept,
                               double const* weight, word_list_view const& out, int frame) const {
    std::uint32_t* const word = out.word + out.at(frame);
    double* const value = out.value + out.at(frame);
    int words = 0;
    for (int base = 0; base < kept; base += g.size()) {
      int const i = base + g.rank();
      bool const begins = i < kept && begins_run(keys, i);
      int total = 0;
      int const to = words + g.exclusive_count(begins, total);
      if (begins) {
        word[to] = owner_of(keys[i]);
        value[to] = value_of_run(keys, i, kept, weight[feature_of(keys[i])]);
      }
      words += total;
    }
    g.sync();
    if (g.part_index() == 0) {
      double const norm = norm_of(g.part(), value, words);
      if (g.rank() == 0) {
        s.norm = norm;
        out.count[frame] = words;
      }
    }
    g.sync();
    strict_double const norm = s.norm;
    if (norm.value > 0) {
      for (int i = g.rank(); i < words; i += g.size()) {
        value[i] = (strict_double(value[i]) / norm).value;
      }
    }
  }

  /// The weight of the word that begins at key i, once or once a feature. All of its features have
  /// that weight; their sum is one addition after the other.
  FT_HOST_DEVICE double value_of_run(key_type const* keys, int i, int kept, double weight) const {
    double sum = weight;
    if (counts_features()) {
      for (int j = i + 1; j < kept && !begins_run(keys, j); ++j) { sum += weight; }
    }
    return sum;
  }
  FT_HOST_DEVICE bool counts_features() const {
    return header.weighting == word_weighting::tf_idf || header.weighting == word_weighting::tf;
  }

  /// What values are divided by where it is positive. The sum is of one value after the other; the
  /// lanes of a warp load and square them.
  template <typename Warp>
  FT_HOST_DEVICE double norm_of(Warp warp, double const* value, int words) const {
    if (header.scoring == word_scoring::dot_product) {
      return counts_features() ? static_cast<double>(words) : 0.0;
    }
    bool const squares = header.scoring == word_scoring::l2;
    auto const term_of = [&](int i) {
      strict_double const v = i < words ? value[i] : 0.0;
      return squares ? (v * v).value : ::fabs(v.value);
    };
    double sum = 0;
    double next = term_of(warp.rank());
    for (int base = 0; base < words; base += warp.size()) {
      double const term = next;
      next = term_of(base + warp.size() + warp.rank());  // loaded while this one is summed
      FT_UNROLL
      for (int k = 0; k < warp.size(); ++k) { sum += warp.shuffle(term, k); }
    }
    return squares ? square_root(sum) : sum;
  }

  template <typename Group>
  FT_HOST_DEVICE static void list_groups(Group g, key_type const* keys, int kept,
                                         node_groups_view const& out, int frame) {
    std::uint32_t* const node = out.node + out.at(frame);
    int* const start = out.start + out.start_at(frame);
    int* const keypoint = out.keypoint + out.at(frame);
    int groups = 0;
    for (int base = 0; base < kept; base += g.size()) {
      int const i = base + g.rank();
      bool const begins = i < kept && begins_run(keys, i);
      int total = 0;
      int const to = groups + g.exclusive_count(begins, total);
      if (begins) {
        node[to] = owner_of(keys[i]);
        start[to] = i;
      }
      if (i < kept) { keypoint[i] = feature_of(keys[i]); }
      groups += total;
    }
    if (g.rank() == 0) {
      start[groups] = kept;
      out.count[frame] = groups;
    }
  }
};

}  // namespace detail

/// Finds the word of each descriptor of a batch of frames, and from these the bag of words and the
/// groups of each frame. Asynchronous on `exec`; allocates nothing; two launches. Equal bits on
/// every executor.
///
/// A descriptor goes from the root to the child of the smallest Hamming distance, the first of
/// equals, until a node has none: that is its word. Its group is the node passed `levels_up` levels
/// above the deepest, the word itself where that is higher. A word whose weight is not positive is
/// stopped: its features are in neither list.
///
/// The value of a word is its weight, times its features in the frame for tf_idf and tf, added one
/// by one. Values are divided by the sum of their absolute values, for l2 by the root of the sum of
/// their squares, summed by ascending words; for dot_product with tf_idf or tf by the number of
/// words, otherwise by nothing.
///
/// What is past a frame's counts is not written. A vocabulary without words finds none: features
/// get no_word, node 0 and weight 0, lists are empty.
/// @param in counts out of range count as the nearest in range
/// @throws bad_argument for shapes that do not fit together, and levels_up out of range
template <typename Exec>
void transform_to_words(Exec const& exec, vocabulary_view const& vocabulary,
                        descriptors_view const& in, transform_params const& params,
                        frame_words_view const& out, transform_workspace const& work) {
  check(params);
  auto const fits = [&](int frames, int capacity) {
    return frames == in.batch && capacity >= in.capacity;
  };
  detail::require(fits(out.features.frames, out.features.capacity) &&
                      fits(out.bag.frames, out.bag.capacity) &&
                      fits(out.groups.frames, out.groups.capacity),
                  "lists of words have the frames of their descriptors, and room for all of them");
  detail::require(fits(work.frames, work.capacity),
                  "a transform's workspace has the frames and the room of its descriptors");
  detail::require_items("descriptors of a transform", static_cast<std::size_t>(in.batch),
                        static_cast<std::size_t>(max_of(in.capacity, 2)));
  for_each_item<per_warp>(exec, in.batch * in.capacity,
                          detail::find_word{vocabulary.header.levels - params.levels_up},
                          vocabulary, in, out.features);
  constexpr int threads = 1024;
  std::size_t const keys = static_cast<std::size_t>(in.capacity) * sizeof(unsigned long long);
  std::size_t const extra =
      min_of(keys, extra_scratch<threads, detail::list_words>(exec, 2 * in.batch));
  for_each_item<per_block<threads>>(exec, 2 * in.batch,
                                    detail::list_words{vocabulary.header, extra}, in, out, work);
}

}  // namespace FT_ABI
}  // namespace ft
