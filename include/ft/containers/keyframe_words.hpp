// SPDX-License-Identifier: Apache-2.0
/// @file What a vocabulary says about the keyframes of an odometry: rows beside the keyframe ring.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/keyframes.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// Words, groups and keypoints of keyframes in executor memory. Row `b * positions + p` is that of
/// position p of batch entry b's ring, and keypoints have the numbers that they have there.
///
/// A row is that of the keyframe whose number `database.number` has, 0 = none. That keyframe may
/// have left the ring since; see list_live_keyframes().
struct keyframe_words_view {
  int positions = 0;
  int numbers = 0;  ///< keypoints of a keyframe
  int batch = 0;
  keyframe_database_view database;  ///< a slot for each row
  node_groups_view groups;
  descriptor* orb = nullptr;  ///< [batch][positions][numbers]
  float* angle = nullptr;     ///< [batch][positions][numbers] degrees

  FT_HOST_DEVICE int row(int b, int position) const { return b * positions + position; }
  /// The rows of batch entry b, as a database of its own.
  FT_HOST_DEVICE keyframe_database_view database_of(int b) const {
    keyframe_database_view v = database;
    std::ptrdiff_t const first = row(b, 0);
    v.capacity = positions;
    v.number += first;
    v.map += first;
    v.score += first;
    v.neighbours += first;
    v.words += first;
    v.word += database.at(row(b, 0));
    v.value += database.at(row(b, 0));
    return v;
  }
  /// The groups of batch entry b's rows.
  FT_HOST_DEVICE node_groups_view groups_of(int b) const {
    node_groups_view v = groups;
    v.frames = positions;
    v.count += row(b, 0);
    v.node += groups.at(row(b, 0));
    v.start += groups.start_at(row(b, 0));
    v.keypoint += groups.at(row(b, 0));
    return v;
  }
  /// Index of the first keypoint of a row.
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int position) const {
    return static_cast<std::ptrdiff_t>(row(b, position)) * numbers;
  }
};
static_assert(std::is_trivially_copyable<keyframe_words_view>::value, "passed to kernels");

/// Places the arrays into an arena. clear() comes before the first use.
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
  auto const all = detail::checked_mul(static_cast<std::size_t>(v.database.capacity),
                                       static_cast<std::size_t>(v.numbers));
  v.orb = c.take<descriptor>(all);
  v.angle = c.take<float>(all);
}

/// Forgets the keyframes of batch entry b. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void forget_keyframe_words(Exec const& exec, keyframe_words_view const& v, int b) {
  keyframe_database_view const rows = v.database_of(b);
  auto const n = static_cast<std::size_t>(v.positions);
  fill_bytes(exec, rows.number, 0, n * sizeof *rows.number);
  fill_bytes(exec, rows.words, 0, n * sizeof *rows.words);
}

/// Forgets all keyframes. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, keyframe_words_view const& v) {
  for (int b = 0; b < v.batch; ++b) { forget_keyframe_words(exec, v, b); }
}

}  // namespace FT_ABI
}  // namespace ft
