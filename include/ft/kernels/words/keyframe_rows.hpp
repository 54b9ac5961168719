// SPDX-License-Identifier: Apache-2.0
/// @file Stages: changes of a database of keyframes.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/words/score.hpp"

namespace ft {
inline namespace FT_ABI {

/// A keyframe that comes into a database.
struct new_keyframe {
  keyframe_id id;  ///< of keyframe_slots::take()
  int frame = 0;   ///< whose words it gets
  int map = 0;     ///< which it is part of
};

namespace detail {

inline void require_database(keyframe_database_view const& database) {
  require(database.number != nullptr && database.word != nullptr && database.value != nullptr,
          "the keyframe database is null");
}
inline void require_id(keyframe_database_view const& database, keyframe_id id) {
  require_range("slot of a keyframe", id.slot, 0, database.capacity - 1);
  require(id.number != 0, "the keyframe's number is 0");
}

/// Item: a place in the row.
struct copy_keyframe_word {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, word_list_view const& lists,
                                 new_keyframe const& keyframe,
                                 keyframe_database_view const& to) const {
    words_of_frame const from = words_of_frame::in(lists, keyframe.frame);
    int const slot = keyframe.id.slot;
    if (i == 0) {
      to.number[slot] = keyframe.id.number;
      to.map[slot] = keyframe.map;
      to.score[slot] = 0;
      to.neighbours[slot].count = 0;
      to.words[slot] = from.count;
    }
    if (i < from.count) {
      to.word[to.at(slot) + i] = from.word[i];
      to.value[to.at(slot) + i] = from.value[i];
    }
  }
};

/// Item: the only one.
struct empty_slot {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, keyframe_id id,
                                 keyframe_database_view const& of) const {
    if (of.holds(id)) {
      of.number[id.slot] = 0;
      of.words[id.slot] = 0;
    }
  }
};

/// Item: the only one.
struct change_keyframe_map {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, keyframe_id id, int map,
                                 keyframe_database_view const& of) const {
    if (of.holds(id)) { of.map[id.slot] = map; }
  }
};

/// Item: the only one.
struct change_neighbours {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int, keyframe_id id,
                                 keyframe_neighbours const& neighbours,
                                 keyframe_database_view const& of) const {
    if (of.holds(id)) { of.neighbours[id.slot] = neighbours; }
  }
};

}  // namespace detail

/// Empties a database; before its first use, too. Asynchronous on `exec`; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, keyframe_database_view const& database) {
  detail::require_database(database);
  auto const slots = static_cast<std::size_t>(database.capacity);
  fill_bytes(exec, database.number, 0, slots * sizeof *database.number);
  fill_bytes(exec, database.words, 0, slots * sizeof *database.words);
}

/// Puts a keyframe into a slot, with the words of a frame, a score of 0 and no neighbours.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for null views, an id or a frame out of range, or bags of words of a
///   larger capacity than the database's rows
template <typename Exec>
void insert_keyframe(Exec const& exec, word_list_view const& lists, new_keyframe const& keyframe,
                     keyframe_database_view const& database) {
  detail::require_database(database);
  detail::require_word_lists("the bags of words are null", lists);
  detail::require_id(database, keyframe.id);
  detail::require_range("frame of a keyframe", keyframe.frame, 0, lists.frames - 1);
  detail::require_range("capacity of the bags of words", lists.capacity, 1, database.row);
  for_each_item<per_thread>(exec, lists.capacity, detail::copy_keyframe_word{}, lists, keyframe,
                            database);
}

/// Empties the slot of a keyframe: later queries do not find it, nor count it as a neighbour. Does
/// nothing if it is not there. Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for a null view, or an id out of range
template <typename Exec>
void erase_keyframe(Exec const& exec, keyframe_id id, keyframe_database_view const& database) {
  detail::require_database(database);
  detail::require_id(database, id);
  for_each_item<per_thread>(exec, 1, detail::empty_slot{}, id, database);
}

/// Says which map a keyframe is part of, as when maps are merged. Does nothing if it is not there.
/// Asynchronous on `exec`; allocates nothing; one launch.
/// @throws bad_argument for a null view, or an id out of range
template <typename Exec>
void move_keyframe(Exec const& exec, keyframe_id id, int map,
                   keyframe_database_view const& database) {
  detail::require_database(database);
  detail::require_id(database, id);
  for_each_item<per_thread>(exec, 1, detail::change_keyframe_map{}, id, map, database);
}

/// Replaces the neighbours of a keyframe. Does nothing if it is not there. Asynchronous on `exec`;
/// allocates nothing; one launch.
/// @param neighbours each in the database, or erased from it
/// @throws bad_argument for a null view, an id out of range, or a count out of range
template <typename Exec>
void set_neighbours(Exec const& exec, keyframe_id id, keyframe_neighbours const& neighbours,
                    keyframe_database_view const& database) {
  detail::require_database(database);
  detail::require_id(database, id);
  detail::require_range("neighbours of a keyframe", neighbours.count, 0, keyframe_neighbours::most);
  for_each_item<per_thread>(exec, 1, detail::change_neighbours{}, id, neighbours, database);
}

}  // namespace FT_ABI
}  // namespace ft
