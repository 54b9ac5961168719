// SPDX-License-Identifier: Apache-2.0
/// @file Stage: search by words. Matches the keypoints of a frame to the map points of a keyframe,
/// among keypoints that share a node of the vocabulary. Source: Mur-Artal et al., "ORB-SLAM: a
/// versatile and accurate monocular SLAM system", T-RO 2015, with bags of words as in
/// containers/words.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/search/detail/orientation_check.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

/// A batch of frames as the search by words sees them: rows of `groups.capacity` keypoints. A row
/// may be the two images of a fisheye pair in a keypoints_view, one after the other.
struct word_keypoints_view {
  node_groups_view groups;
  descriptor const* orb = nullptr;  ///< [frames][capacity]
  float const* angle = nullptr;     ///< [frames][capacity] degrees; unused without the check
  /// [frames] first keypoint of the right camera in a row. Null: there is one camera.
  int const* first_right = nullptr;
};

/// Inputs of a search by words. Batch entry p is a pair of a keyframe and a frame, both named by
/// their rows, so that one launch compares a frame with many keyframes.
struct words_search {
  word_keypoints_view keyframes;
  /// [keyframes][capacity] map point of a keyframe's keypoint, -1 = none to be searched
  int const* holder = nullptr;
  word_keypoints_view frames;
  /// [pairs] row of the keyframe; outside the batch, such as -1: no pair. Null: p.
  int const* keyframe = nullptr;
  /// [pairs] row of the frame; likewise.
  int const* frame = nullptr;
};

/// @throws bad_argument naming the value and the limit
inline void check(words_search_params const& p) {
  detail::require_range("max_hamming", p.max_hamming, 0, 255);
}

/// Matches of a batch of pairs.
struct word_matches_view {
  int pairs = 0;
  int capacity = 0;      ///< keypoints of a frame: that of words_search::frames
  int* match = nullptr;  ///< [pairs][capacity] map point of a frame's keypoint, -1 = none
  int* count = nullptr;  ///< [pairs] matched keypoints
};
static_assert(std::is_trivially_copyable<word_matches_view>::value, "passed to kernels");

inline void carve(carver& c, word_matches_view& v, int pairs, int capacity) {
  v.pairs = pairs;
  v.capacity = capacity;
  c.place({pairs, capacity}, v.match);
  c.place({pairs}, v.count);
}

/// Working memory of search_by_words().
struct words_search_workspace {
  /// [pairs][capacity] per place in `frames.groups.keypoint`: the keypoint of the keyframe that it
  /// is matched to, -1 = none.
  int* source = nullptr;
};

inline void carve(carver& c, words_search_workspace& v, int pairs, int capacity) {
  c.place({pairs, capacity}, v.source);
}

namespace detail {

/// The rows of a pair.
struct words_pair {
  int keyframe, frame;
  bool there;  ///< both rows exist

  FT_HOST_DEVICE static words_pair of(words_search const& in, int p) {
    int const k = in.keyframe != nullptr ? in.keyframe[p] : p;
    int const f = in.frame != nullptr ? in.frame[p] : p;
    return {k, f,
            k >= 0 && k < in.keyframes.groups.frames && f >= 0 && f < in.frames.groups.frames};
  }
};

/// A group of keypoints: a range of places in node_groups_view::keypoint.
struct keypoint_range {
  int begin = 0, end = 0;

  FT_HOST_DEVICE static keypoint_range of(node_groups_view const& groups, int frame, int group) {
    int const* const start = groups.start + groups.start_at(frame) + group;
    return {start[0], start[1]};
  }
  /// The group of a node; empty if the frame has none.
  FT_HOST_DEVICE static keypoint_range with(node_groups_view const& groups, int frame,
                                            std::uint32_t node) {
    std::uint32_t const* const nodes = groups.node + groups.at(frame);
    int const count = groups.count[frame];
    int low = 0;
    for (int high = count; low < high;) {
      int const middle = low + (high - low) / 2;
      if (nodes[middle] < node) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    return low < count && nodes[low] == node ? of(groups, frame, low) : keypoint_range{};
  }
};

/// Item: a group of keypoints of a pair's frame. Matches them to the keyframe's keypoints in the
/// group of the same node. Each keypoint is in one group at most, so items are independent.
struct match_node {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, words_search const& in,
                                 words_search_params const& params,
                                 words_search_workspace const& work) const {
    node_groups_view const& groups = in.frames.groups;
    int const p = item / groups.capacity;
    int const group = item % groups.capacity;
    words_pair const pair = words_pair::of(in, p);
    if (!pair.there || group >= groups.count[pair.frame]) { return; }
    auto const range = keypoint_range::of(groups, pair.frame, group);
    std::uint32_t const node = groups.node[groups.at(pair.frame) + group];
    candidates const c(g, in, pair, range, work.source + groups.at(p));
    for (int at = range.begin + g.rank(); at < range.end; at += g.size()) { c.source[at] = -1; }
    each_live(g, in, pair, keypoint_range::with(in.keyframes.groups, pair.keyframe, node),
              [&](int i, descriptor const& wanted) { choose(g, c, params, i, wanted); });
  }

private:
  /// The frame's keypoints in the group. The thread that reads a place is also the one that writes
  /// it.
  struct candidates {
    keypoint_range range;
    int const* keypoint;
    descriptor const* orb;
    int* source;
    int first_right;
    bool two_cameras;
    descriptor first;  ///< of this thread's first place, which is often its only one

    template <typename Group>
    FT_HOST_DEVICE candidates(Group g, words_search const& in, words_pair const& pair,
                              keypoint_range const& of, int* sources)
        : range(of),
          keypoint(in.frames.groups.keypoint + in.frames.groups.at(pair.frame)),
          orb(in.frames.orb + in.frames.groups.at(pair.frame)),
          source(sources),
          first_right(in.frames.first_right != nullptr ? in.frames.first_right[pair.frame]
                                                       : 0x7fffffff),
          two_cameras(in.frames.first_right != nullptr),
          first{} {
      if (range.begin + g.rank() < range.end) { first = orb[keypoint[range.begin + g.rank()]]; }
    }
  };

  /// Calls visit(keypoint, descriptor) for the keyframe's keypoints of a group that have a map
  /// point, in order. All threads make every call.
  template <typename Group, typename Visit>
  FT_HOST_DEVICE static void each_live(Group g, words_search const& in, words_pair const& pair,
                                       keypoint_range const& range, Visit const& visit) {
    node_groups_view const& groups = in.keyframes.groups;
    std::ptrdiff_t const row = groups.at(pair.keyframe);
    for (int base = range.begin; base < range.end; base += g.size()) {
      bool const there = base + g.rank() < range.end;
      int const mine = there ? groups.keypoint[row + base + g.rank()] : 0;
      unsigned live = g.ballot(there && in.holder[row + mine] >= 0);
      for (; live != 0; live &= live - 1) {
        int const i = g.shuffle(mine, trailing_zeros(live));
        visit(i, in.keyframes.orb[row + i]);
      }
    }
  }

  /// Matches keypoint i of the keyframe, in each camera.
  template <typename Group>
  FT_HOST_DEVICE static void choose(Group g, candidates const& c, words_search_params const& params,
                                    int i, descriptor const& wanted) {
    two_nearest left, right;
    for (int at = c.range.begin + g.rank(); at < c.range.end; at += g.size()) {
      if (c.source[at] >= 0) { continue; }
      int const k = c.keypoint[at];
      descriptor other = c.first;
      if (at != c.range.begin + g.rank()) { other = c.orb[k]; }
      int const distance = search_distance(wanted, other);
      if (k < c.first_right) {
        left.add(distance, at);
      } else {
        right.add(distance, at);
      }
    }
    left = left.merged(g);
    if (left.first > params.max_hamming) { return; }
    constexpr int no_second = 256;
    auto const second = static_cast<float>(min_of(left.second, no_second));
    if (static_cast<float>(left.first) < mul(params.ratio, second)) { match(g, c, left.index, i); }
    // The right camera has no ratio test, and needs a near keypoint in the left one.
    if (!c.two_cameras) { return; }
    right = right.merged(g);
    if (right.first <= params.max_hamming) { match(g, c, right.index, i); }
  }
  template <typename Group>
  FT_HOST_DEVICE static void match(Group g, candidates const& c, int at, int i) {
    if ((at - c.range.begin) % g.size() == g.rank()) { c.source[at] = i; }
  }
};

/// Item: a pair. Writes its matches, without those that the orientation check drops.
struct write_word_matches {
  struct scratch {
    int histogram[rotations::bins];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int p, words_search const& in,
                                 words_search_params const& params, word_matches_view const& out,
                                 words_search_workspace const& work) const {
    node_groups_view const& groups = in.frames.groups;
    int* const match = out.match + groups.at(p);
    words_pair const pair = words_pair::of(in, p);
    for (int k = g.rank(); k < out.capacity; k += g.size()) { match[k] = -1; }
    for (int r = g.rank(); r < rotations::bins; r += g.size()) { s.histogram[r] = 0; }
    g.sync();
    if (!pair.there) {
      if (g.rank() == 0) { out.count[p] = 0; }
      return;
    }
    int const places = groups.start[groups.start_at(pair.frame) + groups.count[pair.frame]];
    std::ptrdiff_t const row = in.keyframes.groups.at(pair.keyframe);
    int const* const source = work.source + groups.at(p);
    int const* const keypoint = groups.keypoint + groups.at(pair.frame);
    // Without the check all matches share one bin.
    auto const bin = [&](int at) {
      if (!params.orientation_check) { return 0; }
      return rotations::bin(in.keyframes.angle[row + source[at]],
                            in.frames.angle[groups.at(pair.frame) + keypoint[at]]);
    };
    for (int at = g.rank(); at < places; at += g.size()) {
      if (source[at] >= 0) { atomic_add(s.histogram + bin(at), 1); }
    }
    g.sync();
    auto const most = rotations::of(g.part(), s.histogram);
    for (int at = g.rank(); at < places; at += g.size()) {
      if (source[at] >= 0 && most.has(bin(at))) {
        match[keypoint[at]] = in.holder[row + source[at]];
      }
    }
    if (g.rank() == 0) { out.count[p] = most.matches; }
  }
};

}  // namespace detail

/// Search by words: for each pair, node by node, the keyframe's keypoints that hold a map point
/// take in order the nearest keypoint of the frame in the same node that is not taken yet. In a
/// frame of two cameras a keyframe's keypoint may take one keypoint in each.
///
/// Writes all of `out`. Asynchronous on `exec`; allocates nothing; two launches.
/// @pre nodes and keypoints are as transform stages write them: ascending, within their rows
/// @throws bad_argument if `out` has another capacity than the frames, or max_hamming is out of
///   range
template <typename Exec>
void search_by_words(Exec const& exec, words_search const& search,
                     words_search_params const& params, word_matches_view const& out,
                     words_search_workspace const& work) {
  int const capacity = search.frames.groups.capacity;
  check(params);
  detail::require_range("capacity of the matches", out.capacity, capacity, capacity);
  detail::require_items("pairs times keypoints", static_cast<std::size_t>(out.pairs),
                        static_cast<std::size_t>(capacity));
  for_each_item<per_warp>(exec, out.pairs * capacity, detail::match_node{}, search, params, work);
  for_each_item<per_block<512>>(exec, out.pairs, detail::write_word_matches{}, search, params, out,
                                work);
}

}  // namespace FT_ABI
}  // namespace ft
