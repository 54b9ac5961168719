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
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

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
  /// The rows of batch entry b.
  keyframe_words_view slice(int b) const {
    keyframe_words_view v = *this;
    int const first = row(b, 0);
    v.batch = 1;
    v.database.capacity = positions;
    v.database.number += first;
    v.database.map += first;
    v.database.score += first;
    v.database.neighbours += first;
    v.database.words += first;
    v.database.word += database.at(first);
    v.database.value += database.at(first);
    v.groups = groups.slice(first, positions);
    v.orb += at(b, 0);
    v.angle += at(b, 0);
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
  auto const all = detail::checked_mul(static_cast<std::size_t>(v.database.capacity),
                                       static_cast<std::size_t>(v.numbers));
  v.orb = c.take<descriptor>(all);
  v.angle = c.take<float>(all);
}

}  // namespace FT_ABI
}  // namespace ft
