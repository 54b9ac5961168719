// SPDX-License-Identifier: Apache-2.0
/// @file The bags of words of many keyframes, in which places are looked up.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/containers/columns.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// A keyframe of a database. Slots are used again, numbers are not: an id is never another
/// keyframe's.
struct keyframe_id {
  int slot = -1;
  std::uint32_t number = 0;  ///< counts insertions, from 1; 0: none

  friend FT_HOST_DEVICE bool operator==(keyframe_id a, keyframe_id b) {
    return a.slot == b.slot && a.number == b.number;
  }
  friend FT_HOST_DEVICE bool operator!=(keyframe_id a, keyframe_id b) { return !(a == b); }
};
static_assert(std::is_trivially_copyable<keyframe_id>::value, "copied between memory spaces");

/// The keyframes that a keyframe shares most map points with, best first. Those that were erased
/// count as absent.
struct keyframe_neighbours {
  static constexpr int most = 10;
  int count = 0;
  keyframe_id of[most] = {};
};

/// A row of each array for each slot. A row of words is read by a warp, which is why the database
/// is not an inverted index: insertion and erasure are copies.
struct keyframe_database_view {
  int capacity = 0;    ///< slots
  int row = 0;         ///< words that a keyframe can have
  int vocabulary = 0;  ///< words are below it; larger ones are shared by no keyframe

  std::uint32_t* number = nullptr;            ///< [capacity] 0: empty
  int* map = nullptr;                         ///< [capacity]
  float* score = nullptr;                     ///< [capacity] from the last query that scored it
  keyframe_neighbours* neighbours = nullptr;  ///< [capacity]
  int* words = nullptr;                       ///< [capacity] in the row; 0 if empty
  std::uint32_t* word = nullptr;              ///< [capacity][row] ascending
  double* value = nullptr;                    ///< [capacity][row]

  template <typename Visit>
  void columns(Visit&& each) {
    each({capacity}, number, map, score, neighbours, words);
    each({capacity, row}, word, value);
  }
  FT_HOST_DEVICE std::ptrdiff_t at(int slot) const {
    return static_cast<std::ptrdiff_t>(slot) * row;
  }
  /// Whether a keyframe is there.
  FT_HOST_DEVICE bool holds(keyframe_id id) const {
    return id.slot >= 0 && id.slot < capacity && id.number != 0 && number[id.slot] == id.number;
  }
};
static_assert(std::is_trivially_copyable<keyframe_database_view>::value, "passed to kernels");

/// @param v its capacity, row and vocabulary are set
/// @throws bad_argument for sizes out of range
inline void carve(carver& c, keyframe_database_view& v) {
  constexpr int most = std::numeric_limits<int>::max() / 64;
  detail::require_range("keyframes of a database", v.capacity, 1, most);
  detail::require_range("words of a keyframe", v.row, 1, most);
  detail::require_range("words of the vocabulary", v.vocabulary, 1,
                        std::numeric_limits<int>::max());
  detail::place_columns(c, v);
}

/// Which slots of a database are in use. The host's part of it: insertion needs no answer of a
/// device.
class keyframe_slots {
public:
  keyframe_slots() = default;
  /// Allocates. @throws bad_argument below 1 slot
  explicit keyframe_slots(int capacity) {
    detail::require_range("keyframes of a database", capacity, 1, std::numeric_limits<int>::max());
    numbers_.resize(static_cast<std::size_t>(capacity));
    free_.reserve(numbers_.size());
    for (int slot = capacity - 1; slot >= 0; --slot) { free_.push_back(slot); }
  }

  /// The id that take() returns. @throws error if the database is full, or if 2^32 - 1 keyframes
  ///   were inserted
  keyframe_id next() const {
    if (free_.empty()) {
      throw error("ft: the keyframe database is full: it has " + std::to_string(capacity()) +
                  " keyframes, its capacity");
    }
    if (last_ == std::numeric_limits<std::uint32_t>::max()) {
      throw error("ft: the keyframe database has no numbers left: " + std::to_string(last_) +
                  " keyframes were inserted");
    }
    return {free_.back(), last_ + 1};
  }
  /// @throws error as next()
  keyframe_id take() {
    keyframe_id const id = next();
    free_.pop_back();
    last_ = id.number;
    numbers_[static_cast<std::size_t>(id.slot)] = id.number;
    return id;
  }
  /// @throws bad_argument for a keyframe that is not there
  void release(keyframe_id id) {
    require(id);
    numbers_[static_cast<std::size_t>(id.slot)] = 0;
    free_.push_back(id.slot);
  }
  bool contains(keyframe_id id) const {
    return id.slot >= 0 && id.slot < capacity() && id.number != 0 &&
           numbers_[static_cast<std::size_t>(id.slot)] == id.number;
  }
  /// @throws bad_argument for a keyframe that is not there
  void require(keyframe_id id) const {
    if (!contains(id)) {
      throw bad_argument("ft: keyframe " + std::to_string(id.number) + " of slot " +
                         std::to_string(id.slot) + " is not in the database");
    }
  }
  int size() const { return capacity() - static_cast<int>(free_.size()); }
  int capacity() const { return static_cast<int>(numbers_.size()); }

private:
  std::vector<std::uint32_t> numbers_;  ///< of each slot; 0: free
  std::vector<int> free_;               ///< the next one last
  std::uint32_t last_ = 0;
};

}  // namespace FT_ABI
}  // namespace ft
