// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: finds keyframes that show the same place as a frame, in memory allocated once.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/words/query_database.hpp"
#include "ft/kernels/words/score.hpp"
#include "ft/kernels/words/transform.hpp"

namespace ft {
inline namespace FT_ABI {

struct place_params {
  int keyframes = 5000;  ///< most at a time
  int features = 0;      ///< most descriptors of a frame
  int frames = 1;        ///< of a batch
  int levels_up = 4;     ///< see transform_params
};

/// @throws bad_argument naming the value and the limit
inline void check(place_params const& p) {
  detail::require_range("features of a frame", p.features, 1, 1 << 20);
  detail::require_range("frames of a batch", p.frames, 1, 4096);
  detail::require_range("levels_up", p.levels_up, 0, max_vocabulary_levels);
}

/// A vocabulary, and a database of keyframes in which the places of a batch of frames are looked
/// up. Without knowledge of a map: neighbours of keyframes may be given, or not.
///
///     recognition.describe(exec, extractor.keypoints());
///     recognition.query(exec);
///     keyframe_id const id = recognition.add(exec);
///     for (place_candidate const& c : recognition.download(exec)) { ... }
///
/// The constructor allocates all memory. Calls are asynchronous on the executor unless they say
/// otherwise, allocate nothing, and take effect in the order of the calls, which all go to one
/// executor: a query sees what was added and erased before it, and nothing later. So a keyframe
/// that was erased after a query may be among its candidates; contains() tells. Not thread-safe;
/// instances are independent. Move-only. A moved-from one refuses every call with bad_argument.
template <typename Exec>
class place_recognition {
public:
  static constexpr memory_space space = Exec::space;

  place_recognition() = default;
  /// @param words taken over
  /// @throws bad_argument for a vocabulary that was never made, or parameters out of range;
  ///   std::bad_alloc or cuda_error if memory is short
  place_recognition(Exec const& exec, vocabulary<space>&& words, place_params const& params)
      : place_recognition(exec, words.view(), params) {
    vocabulary_ = std::move(words);
  }
  /// @param words in executor memory, valid as long as this
  /// @throws as the other constructor
  place_recognition(Exec const& exec, vocabulary_view const& words, place_params const& params)
      : words_(words), slots_(checked(words, params).keyframes) {
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      carve(c, m.words, params.frames, params.features);
      carve(c, m.transform, params.frames, params.features);
      m.database.capacity = params.keyframes;
      m.database.row = params.features;
      m.database.vocabulary = max_of(words.words, 1);
      carve(c, m.database);
      carve(c, m.query, params.frames, m.database);
      carve(c, m.candidates, params.frames, params.keyframes);
      m.maps = c.take<int>(static_cast<std::size_t>(params.frames));
      m.transform_with.levels_up = params.levels_up;
    });
    clear(exec, memory_->database);
    auto const counts = static_cast<std::size_t>(params.frames) * sizeof(int);
    fill_bytes(exec, memory_->words.bag.count, 0, counts);
    fill_bytes(exec, memory_->words.groups.count, 0, counts);
    fill_bytes(exec, memory_->candidates.count, 0, counts);
  }

  /// Enqueues the transform of descriptors into bags of words, which are the frames of later calls.
  /// @param frames in executor memory, params().frames of them with at most params().features
  ///   descriptors; keypoints convert to it
  /// @throws bad_argument for another batch, or a larger capacity
  void describe(Exec const& exec, descriptors_view const& frames) {
    require_made();
    transform_to_words(exec, words_, frames, memory_->transform_with, memory_->words,
                       memory_->transform);
  }
  /// Enqueues the look-up of the frames' places, as query_database().
  /// @param maps of each frame, the map that candidates are part of; none: 0 for all. In host
  ///   memory; if that is pinned, it must stay until the call has run
  /// @throws bad_argument for another number of maps
  void query(Exec const& exec, span<int const> maps = {}) {
    require_made();
    int const n = frames();
    auto const count = static_cast<std::size_t>(n);
    if (maps.size == 0) {
      fill_bytes(exec, memory_->maps, 0, count * sizeof(int));
    } else {
      detail::require_range("maps of a query", maps.size, n, n);
      copy(exec, memory_->maps, maps.data, count);
    }
    query_database(exec, {memory_->words.bag, memory_->maps}, memory_->database,
                   words_.header.scoring, memory_->candidates, memory_->query);
  }

  /// Enqueues the insertion of a frame as a keyframe without neighbours.
  /// @param frame of the last describe() @param map which the keyframe is part of
  /// @throws bad_argument for a frame out of range; error if the database is full: then nothing
  ///   has changed
  keyframe_id add(Exec const& exec, int frame = 0, int map = 0) {
    require_made();
    keyframe_id const id = slots_.next();
    insert_keyframe(exec, memory_->words.bag, {id, frame, map}, memory_->database);
    return slots_.take();
  }
  /// Enqueues the removal of a keyframe.
  /// @throws bad_argument for a keyframe that is not there
  void erase(Exec const& exec, keyframe_id id) {
    require_there(id);
    erase_keyframe(exec, id, memory_->database);
    slots_.release(id);
  }
  /// Enqueues the replacement of a keyframe's neighbours. Erased ones among them are ignored.
  /// @throws bad_argument for a keyframe that is not there, or too many neighbours
  void set_neighbours(Exec const& exec, keyframe_id id, keyframe_neighbours const& neighbours) {
    require_there(id);
    ft::set_neighbours(exec, id, neighbours, memory_->database);
  }
  /// Enqueues the change of the map that a keyframe is part of.
  /// @throws bad_argument for a keyframe that is not there
  void move(Exec const& exec, keyframe_id id, int map) {
    require_there(id);
    move_keyframe(exec, id, map, memory_->database);
  }

  /// The candidates of a frame at the last query, in its order. Waits, and allocates.
  /// @throws bad_argument for a frame out of range; std::bad_alloc, cuda_error
  std::vector<place_candidate> download(Exec const& exec, int frame = 0) const {
    require_made();
    detail::require_range("frame of candidates", frame, 0, frames() - 1);
    place_candidates_view const& from = memory_->candidates;
    int count = 0;
    copy(exec, &count, static_cast<int const*>(from.count + frame), 1);
    exec.wait();
    std::vector<place_candidate> to(static_cast<std::size_t>(count));
    copy(exec, to.data(), static_cast<place_candidate const*>(from.of + from.at(frame)), to.size());
    exec.wait();
    return to;
  }

  /// Whether a keyframe was added, and not erased since.
  bool contains(keyframe_id id) const { return slots_.contains(id); }
  int size() const { return slots_.size(); }  ///< keyframes
  int capacity() const { return slots_.capacity(); }
  int frames() const { return memory_->candidates.queries; }
  std::size_t bytes() const { return memory_.bytes(); }  ///< of executor memory, but the vocabulary

  // Views into executor memory, valid as long as this.
  place_candidates_view candidates() const { return memory_->candidates; }
  frame_words_view words() const { return memory_->words; }        ///< of the last describe()
  query_workspace query_counts() const { return memory_->query; }  ///< of the last query

private:
  struct memory {
    transform_params transform_with;
    frame_words_view words;
    transform_workspace transform;
    keyframe_database_view database;
    query_workspace query;
    place_candidates_view candidates;
    int* maps = nullptr;  ///< [frames]
  };

  static place_params const& checked(vocabulary_view const& words, place_params const& p) {
    detail::require(words.nodes > 0, "the vocabulary was never made, or was moved from");
    check(p);
    return p;
  }
  void require_made() const { memory_.require_made("place recognition"); }
  void require_there(keyframe_id id) const {
    require_made();
    slots_.require(id);
  }

  vocabulary<space> vocabulary_;  ///< empty if the caller's is used
  vocabulary_view words_;
  keyframe_slots slots_;
  owner<memory, space> memory_;
};

}  // namespace FT_ABI
}  // namespace ft
