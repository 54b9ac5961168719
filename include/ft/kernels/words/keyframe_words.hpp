// SPDX-License-Identifier: Apache-2.0
/// @file Stages: the words of an odometry's keyframes, kept beside their ring.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/frame.hpp"
#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/keyframe_input.hpp"
#include "ft/kernels/words/transform.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

// What a vocabulary says about the keyframes of an odometry: rows beside the keyframe ring.

/// Words, groups and keypoints of keyframes in executor memory. Row `b * positions + p` is that of
/// position p of batch entry b's ring. Keypoints have the numbers that they have there.
///
/// `database.number` is the number of the keyframe that a row was written for, 0 = none. That one
/// may have left the ring since; see list_live_keyframes().
struct keyframe_words_view {
  int positions = 0;
  int numbers = 0;  ///< keypoints of a keyframe
  int batch = 0;
  keyframe_database_view database;  ///< a slot for each row
  node_groups_view groups;
  descriptor* orb = nullptr;  ///< [batch][positions][numbers]
  float* angle = nullptr;     ///< [batch][positions][numbers] degrees

  FT_HOST_DEVICE int row(int b, int position) const { return b * positions + position; }
  /// Index of the first keypoint of a row.
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int position) const {
    return static_cast<std::ptrdiff_t>(row(b, position)) * numbers;
  }
  template <typename Visit>
  void columns(Visit&& each) {
    database.columns(each);
    groups.columns(each);
    each({database.capacity, numbers}, orb, angle);
  }
  /// The rows of batch entry b.
  keyframe_words_view slice(int b) const {
    keyframe_words_view v = detail::skip_entries(*this, row(b, 0));
    v.batch = 1;
    v.database.capacity = v.groups.frames = positions;
    return v;
  }
};
static_assert(std::is_trivially_copyable<keyframe_words_view>::value, "passed to kernels");

/// Places the arrays into an arena. clear() of the database comes before the first use.
/// @param vocabulary words that there are
/// @throws bad_argument for sizes out of range
inline void carve(carver& c, keyframe_words_view& v, keyframes_capacity const& size, int vocabulary,
                  int batch) {
  detail::require_range("keyframes", size.positions, 2, max_keyframes);
  detail::require_range("rows of words", batch, 1, (1 << 24) / size.positions);
  v.positions = size.positions;
  v.numbers = size.cameras * size.keypoints;
  v.batch = batch;
  v.database.capacity = batch * size.positions;
  v.database.row = v.numbers;
  v.database.vocabulary = vocabulary;
  carve(c, v.database);
  carve(c, v.groups, v.database.capacity, v.numbers);
  c.place({v.database.capacity, v.numbers}, v.orb, v.angle);
}

namespace detail {

/// Item: a keypoint number of a batch entry.
struct gather_descriptor {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 int const* wanted, descriptors_view const& to) const {
    int const b = item / frame.numbers();
    int const number = item % frame.numbers();
    int const c = number / frame.capacity();
    int const k = number % frame.capacity();
    int before = 0;
    int all = 0;
    for (int i = 0; i < frame.cameras; ++i) {
      int const count = wanted[b] != 0 ? *frame.camera(b, i).count : 0;
      before += i < c ? count : 0;
      all += count;
    }
    if (number == 0) { to.count[b] = all; }
    if (wanted[b] == 0 || k >= *frame.camera(b, c).count) { return; }
    to.orb(b * to.capacity + before + k) = get<field::orb>(frame.camera(b, c), k);
  }
};

/// Item: a place among the grouped keypoints of a batch entry.
struct number_keypoint {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 node_groups_view const& groups) const {
    int const b = item / groups.capacity;
    int const place = item % groups.capacity;
    if (place >= groups.start[groups.start_at(b) + groups.count[b]]) { return; }
    int& keypoint = groups.keypoint[groups.at(b) + place];
    int k = keypoint;
    int c = 0;
    for (; c + 1 < frame.cameras && k >= *frame.camera(b, c).count; ++c) {
      k -= *frame.camera(b, c).count;
    }
    keypoint = c * frame.capacity() + k;
  }
};

/// Item: a keypoint number of a batch entry. Its index is that of the words and groups that it
/// copies, too.
struct keep_keyframe_word {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_view const& frame,
                                 keyframe_order const* order, keyframes_view const& ring,
                                 frame_words_view const& from,
                                 keyframe_words_view const& to) const {
    int const b = item / frame.numbers();
    int const i = item % frame.numbers();
    if (order[b] == keyframe_order::none) { return; }
    int const row = to.row(b, ring.position(ring.made[b]));
    copy_bag(from.bag, b, i, static_cast<std::uint32_t>(ring.made[b]), to.database, row);
    copy_groups(from.groups, b, i, to.groups, row);
    int const c = i / frame.capacity();
    int const k = i % frame.capacity();
    keypoints_view const keypoints = frame.camera(b, c);
    if (k >= *keypoints.count) { return; }
    auto const at = static_cast<std::ptrdiff_t>(row) * to.numbers + i;
    to.orb[at] = get<field::orb>(keypoints, k);
    to.angle[at] = get<field::angle>(keypoints, k);
  }

private:
  FT_HOST_DEVICE static void copy_bag(word_list_view const& from, int frame, int i,
                                      std::uint32_t number, keyframe_database_view const& to,
                                      int row) {
    int const count = from.count[frame];
    if (i == 0) {
      to.number[row] = number;
      to.map[row] = 0;
      to.score[row] = 0;
      to.neighbours[row].count = 0;
      to.words[row] = count;
    }
    if (i >= count) { return; }
    to.word[to.at(row) + i] = from.word[from.at(frame) + i];
    to.value[to.at(row) + i] = from.value[from.at(frame) + i];
  }
  FT_HOST_DEVICE static void copy_groups(node_groups_view const& from, int frame, int i,
                                         node_groups_view const& to, int row) {
    int const count = from.count[frame];
    int const* const start = from.start + from.start_at(frame);
    if (i == 0) {
      to.count[row] = count;
      to.start[to.start_at(row) + count] = start[count];
    }
    if (i < count) {
      to.node[to.at(row) + i] = from.node[from.at(frame) + i];
      to.start[to.start_at(row) + i] = start[i];
    }
    if (i < start[count]) { to.keypoint[to.at(row) + i] = from.keypoint[from.at(frame) + i]; }
  }
};

/// Item: a position of the ring.
struct list_live_keyframe {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int p, odometry_map_view const& map, int b,
                                 keyframe_words_view const& words, int* holder) const {
    keyframes_view const& ring = map.keyframes;
    int const row = words.row(b, p);
    std::uint32_t const number = words.database.number[row];
    bool const live = number != 0 && ring.holds(b, static_cast<int>(number));
    g.sync();
    if (!live && g.rank() == 0) {
      words.database.number[row] = 0;
      words.database.words[row] = 0;
    }
    int* const to = holder + static_cast<std::ptrdiff_t>(p) * words.numbers;
    for (int i = g.rank(); i < words.numbers; i += g.size()) {
      int const c = i / ring.capacity;
      bool const there =
          live && i - c * ring.capacity < ring.keypoints[ring.at(b, p) * ring.cameras + c];
      std::ptrdiff_t const at = ring.at(b, p, i);
      int const slot = there ? ring.holder[at] : -1;
      bool const holds = map.records.holds_point(b, slot) &&
                         map.records.number[map.records.at(b, slot)] == ring.holder_number[at];
      to[i] = holds ? slot : -1;
    }
  }
};

}  // namespace detail

/// Writes the descriptors of frames side by side, those of the first camera first, as
/// transform_to_words() reads them. Asynchronous on `exec`; allocates nothing; one launch.
/// @param wanted [batch] 0 = the frame gets no descriptors. Memory that the executor's threads read
/// @throws bad_argument for fewer rows, or rows shorter than a frame
template <typename Exec>
void gather_descriptors(Exec const& exec, frame_view const& frame, int const* wanted,
                        descriptors_view const& to) {
  detail::require(wanted != nullptr, "the wanted frames are null");
  detail::require(to.batch == frame.batch && to.capacity >= frame.numbers(),
                  "descriptors have a row for each frame, with room for all of its keypoints");
  for_each_item<per_thread>(exec, frame.batch * frame.numbers(), detail::gather_descriptor{}, frame,
                            wanted, to);
}

/// Replaces, in the groups of gathered frames, places among the gathered descriptors by the numbers
/// of their keypoints. Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for another number of frames
template <typename Exec>
void number_keypoints(Exec const& exec, frame_view const& frame, node_groups_view const& groups) {
  detail::require(groups.frames == frame.batch, "groups have another batch than the frames");
  for_each_item<per_thread>(exec, groups.frames * groups.capacity, detail::number_keypoint{}, frame,
                            groups);
}

/// Keeps the words and keypoints of frames that insert_keyframe() made keyframes of. Asynchronous
/// on `exec`; allocates nothing; one launch.
/// @param order [batch] as insert_keyframe() read it @param ring the keyframes, these included
/// @param from words and groups, whose keypoints have their numbers
/// @throws bad_argument for rows of another shape
template <typename Exec>
void keep_keyframe_words(Exec const& exec, frame_view const& frame, keyframe_order const* order,
                         keyframes_view const& ring, frame_words_view const& from,
                         keyframe_words_view const& to) {
  detail::require(order != nullptr, "the order of keyframes is null");
  detail::require(to.batch == frame.batch && to.numbers == frame.numbers() &&
                      to.positions == ring.positions && from.bag.frames == frame.batch &&
                      from.bag.capacity == to.numbers && from.groups.capacity == to.numbers,
                  "rows of words have another shape than frames or keyframes");
  for_each_item<per_thread>(exec, frame.batch * frame.numbers(), detail::keep_keyframe_word{},
                            frame, order, ring, from, to);
}

/// Forgets the words of camera b's keyframes that have left the map, and lists the map points that
/// keypoints of the others still hold. Asynchronous on `exec`; allocates nothing; one launch.
/// @param holder [positions][numbers] -1 = none
/// @throws bad_argument for rows of another shape
template <typename Exec>
void list_live_keyframes(Exec const& exec, odometry_map_view const& map, int b,
                         keyframe_words_view const& words, int* holder) {
  detail::require(holder != nullptr, "the holders are null");
  detail::require_range("camera pair", b, 0, words.batch - 1);
  detail::require(words.positions == map.keyframes.positions &&
                      words.numbers == map.keyframes.numbers() &&
                      words.batch == map.keyframes.batch,
                  "rows of words have another shape than the keyframes");
  for_each_item<per_block<256>>(exec, words.positions, detail::list_live_keyframe{}, map, b, words,
                                holder);
}

}  // namespace FT_ABI
}  // namespace ft
