// SPDX-License-Identifier: Apache-2.0
/// @file Stage: keyframes of a database that may show the same place as a frame. Source:
/// Gálvez-López and Tardós, "Bags of binary words for fast place recognition in image sequences",
/// T-RO 2012; Mur-Artal, Montiel, Tardós, "ORB-SLAM: a versatile and accurate monocular SLAM
/// system", T-RO 2015, section V.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/detail/slot_rows.hpp"
#include "ft/kernels/words/score.hpp"

namespace ft {
inline namespace FT_ABI {

/// What is looked up: a place for each frame.
struct place_queries {
  word_list_view lists;
  int const* map = nullptr;  ///< [lists.frames] candidates are part of it
};
static_assert(std::is_trivially_copyable<place_queries>::value, "passed to kernels");

/// A keyframe that may show the place of a frame.
struct place_candidate {
  keyframe_id keyframe;
  float score;        ///< of the keyframe and the frame; see query_database()
  float group_score;  ///< of the keyframe through which it was found, with its neighbours
};

/// The answers to a batch of queries. As many fit as the database has slots.
struct place_candidates_view {
  int queries = 0;
  int capacity = 0;
  int* count = nullptr;           ///< [queries]
  place_candidate* of = nullptr;  ///< [queries][capacity] in the order of query_database()

  FT_HOST_DEVICE std::ptrdiff_t at(int query) const {
    return static_cast<std::ptrdiff_t>(query) * capacity;
  }
};
static_assert(std::is_trivially_copyable<place_candidates_view>::value, "passed to kernels");

inline void carve(carver& c, place_candidates_view& v, int queries, int capacity) {
  v.queries = queries;
  v.capacity = capacity;
  c.place({queries}, v.count);
  c.place({queries, capacity}, v.of);
}

namespace detail {

/// An answer with its place in the order. Keys are distinct.
struct ordered_place {
  unsigned long long key;
  int slot;
  int found_through;
};
FT_HOST_DEVICE inline bool operator<(ordered_place const& a, ordered_place const& b) {
  return a.key < b.key;
}

}  // namespace detail

/// Memory of query_database(), for a batch of queries to a database. After a query, what it counted
/// and scored.
struct query_workspace {
  int queries = 0;
  int capacity = 0;  ///< slots of the database
  int rows = 0;      ///< of 32 words of the vocabulary

  unsigned* wanted = nullptr;  ///< [queries][rows] a bit for each word of the query
  int* most = nullptr;         ///< [queries] words that a keyframe shares with the query
  int* common = nullptr;       ///< [queries][capacity] words that the keyframe shares
  unsigned* first = nullptr;   ///< [queries][capacity] the smallest one
  float* score = nullptr;      ///< [queries][capacity] as of this query
  float* group = nullptr;      ///< [queries][capacity] score with the neighbours' scores
  int* best = nullptr;         ///< [queries][capacity] slot: best of a keyframe and its neighbours
  unsigned long long* earliest = nullptr;  ///< [queries][capacity] key of the first with that best
  detail::ordered_place* found = nullptr;  ///< [queries][capacity]

  FT_HOST_DEVICE std::ptrdiff_t at(int query) const {
    return static_cast<std::ptrdiff_t>(query) * capacity;
  }
  /// A keyframe's score is computed if it shares more words than this.
  FT_HOST_DEVICE int enough(int query) const {
    return static_cast<int>((strict_float(static_cast<float>(most[query])) * 0.8f).value);
  }
};
static_assert(std::is_trivially_copyable<query_workspace>::value, "passed to kernels");

/// @throws bad_argument for sizes out of range
inline void carve(carver& c, query_workspace& v, int queries, keyframe_database_view const& of) {
  detail::require_range("queries of a batch", queries, 1, 1 << 20);
  detail::require_items("keyframes of a batch of queries", static_cast<std::size_t>(queries),
                        static_cast<std::size_t>(of.capacity));
  v.queries = queries;
  v.capacity = of.capacity;
  v.rows = of.vocabulary / 32 + 1;
  c.place({queries, v.rows}, v.wanted);
  c.place({queries}, v.most);
  c.place({queries, of.capacity}, v.common, v.first, v.score, v.group, v.best, v.earliest, v.found);
}

namespace detail {

/// Item: a word of a query. The first of those in a row of bits writes the row.
struct mark_wanted_words {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, word_list_view const& lists,
                                 keyframe_database_view const& in,
                                 query_workspace const& work) const {
    int const query = item / lists.capacity;
    int const i = item % lists.capacity;
    if (i == 0) { work.most[query] = 0; }
    words_of_frame const of = words_of_frame::in(lists, query);
    if (i >= of.count || of.word[i] >= static_cast<unsigned>(in.vocabulary)) { return; }
    std::uint32_t const row = of.word[i] / 32;
    if (i > 0 && of.word[i - 1] / 32 == row) { return; }
    unsigned bits = 0;
    for (int k = i; k < of.count && of.word[k] / 32 == row; ++k) {
      if (of.word[k] < static_cast<unsigned>(in.vocabulary)) { bits |= 1u << of.word[k] % 32; }
    }
    work.wanted[static_cast<std::ptrdiff_t>(query) * work.rows + row] = bits;
  }
};

/// Item: a slot, for a query.
struct count_common_words {
  using scratch = no_scratch;

  struct looked_up {
    std::uint32_t word;
    bool wanted;
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, keyframe_database_view const& in,
                                 query_workspace const& work) const {
    int const query = item / in.capacity;
    int const slot = item % in.capacity;
    unsigned const* const wanted = work.wanted + static_cast<std::ptrdiff_t>(query) * work.rows;
    std::uint32_t const* const row = in.word + in.at(slot);
    auto const end = static_cast<std::uint32_t>(in.vocabulary);
    int common = 0;
    std::uint32_t first = 0xffffffffu;
    each_slot(
        g, 0, in.words[slot],
        [&](int i) -> looked_up {
          std::uint32_t const word = row[i];
          return {word, word < end && (wanted[word / 32] >> word % 32 & 1u) != 0};
        },
        [&](int, looked_up const& at) {
          common += static_cast<int>(at.wanted);
          if (at.wanted) { first = min_of(first, at.word); }
        });
    common = g.reduce(common, sum_op{});
    first = g.reduce(first, min_op{});
    if (g.rank() == 0) {
      work.common[item] = common;
      work.first[item] = first;
      if (common > 0) { atomic_max(&work.most[query], common); }
    }
  }
};

/// Item: a slot, for a query. Those that share many words get a score.
template <word_scoring Scoring>
struct score_keyframe {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, word_list_view const& lists,
                                 keyframe_database_view const& in,
                                 query_workspace const& work) const {
    int const query = item / in.capacity;
    int const slot = item % in.capacity;
    if (work.common[item] <= work.enough(query)) { return; }
    words_of_frame const row{in.word + in.at(slot), in.value + in.at(slot), in.words[slot]};
    auto const score =
        static_cast<float>(score_of<Scoring>(g, words_of_frame::in(lists, query), row));
    if (g.rank() == 0) { work.score[item] = score; }
  }
};

/// Item: a slot. A query that did not score it finds the score of an earlier one.
struct keep_scores {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int slot, keyframe_database_view const& in,
                                 query_workspace const& work) const {
    if (in.number[slot] == 0) { return; }
    float last = in.score[slot];
    for (int query = 0; query < work.queries; ++query) {
      std::ptrdiff_t const at = work.at(query) + slot;
      if (work.common[at] > work.enough(query)) {
        last = work.score[at];
      } else {
        work.score[at] = last;
      }
    }
    in.score[slot] = last;
  }
};

/// Item: a query.
struct choose_places {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int query, int const* maps,
                                 keyframe_database_view const& in, query_workspace const& all,
                                 place_candidates_view const& out) const {
    query_workspace const work = of_query(all, query);
    int const enough = all.enough(query);
    float highest = 0;  // no group of a lower score is chosen
    for (int slot = g.rank(); slot < in.capacity; slot += g.size()) {
      work.earliest[slot] = ~0ull;
      if (work.common[slot] > enough) { highest = max_of(highest, sum_group(in, work, slot)); }
    }
    highest = g.reduce(highest, max_op{});
    strict_float const least = strict_float(0.75f) * highest;
    g.sync();
    auto const chosen = [&](int slot) {
      return work.common[slot] > enough && strict_float(work.group[slot]) > least &&
             in.map[work.best[slot]] == maps[query];
    };
    for (int slot = g.rank(); slot < in.capacity; slot += g.size()) {
      if (chosen(slot)) { atomic_min(&work.earliest[work.best[slot]], key_of(in, work, slot)); }
    }
    g.sync();
    int count = 0;
    for (int first = 0; first < in.capacity; first += g.size()) {
      int const slot = first + g.rank();
      bool const named = slot < in.capacity && chosen(slot) &&
                         work.earliest[work.best[slot]] == key_of(in, work, slot);
      int total = 0;
      int const before = g.exclusive_count(named, total);
      if (named) { work.found[count + before] = {key_of(in, work, slot), work.best[slot], slot}; }
      count += total;
    }
    g.sync();
    g.sort(work.found, count);
    for (int i = g.rank(); i < count; i += g.size()) {
      ordered_place const& place = work.found[i];
      out.of[out.at(query) + i] = {{place.slot, in.number[place.slot]},
                                   work.score[place.slot],
                                   work.group[place.found_through]};
    }
    if (g.rank() == 0) { out.count[query] = count; }
  }

private:
  /// The arrays of one query.
  FT_HOST_DEVICE static query_workspace of_query(query_workspace work, int query) {
    std::ptrdiff_t const at = work.at(query);
    work.common += at;
    work.first += at;
    work.score += at;
    work.group += at;
    work.best += at;
    work.earliest += at;
    work.found += at;
    return work;
  }
  /// The order in which lists of keyframes by word, in order of insertion, name a keyframe first.
  FT_HOST_DEVICE static unsigned long long key_of(keyframe_database_view const& in,
                                                  query_workspace const& work, int slot) {
    return static_cast<unsigned long long>(work.first[slot]) << 32 | in.number[slot];
  }
  /// Adds the scores of a keyframe and its neighbours, and finds the best of them.
  FT_HOST_DEVICE static float sum_group(keyframe_database_view const& in,
                                        query_workspace const& work, int slot) {
    strict_float sum = work.score[slot];
    strict_float highest = sum;
    int best = slot;
    keyframe_neighbours const& neighbours = in.neighbours[slot];
    for (int k = 0; k < neighbours.count; ++k) {
      keyframe_id const other = neighbours.of[k];
      if (!in.holds(other) || work.common[other.slot] == 0) { continue; }
      strict_float const score = work.score[other.slot];
      sum += score;
      if (score > highest) {
        highest = score;
        best = other.slot;
      }
    }
    work.group[slot] = sum.value;
    work.best[slot] = best;
    return sum.value;
  }
};

/// @throws bad_argument for what query_database() refuses, but for the scoring
inline void require_queries(place_queries const& queries, keyframe_database_view const& database,
                            place_candidates_view const& found, query_workspace const& work) {
  require_database(database);
  require_word_lists("the bags of words of the queries are null", queries.lists);
  require(queries.map != nullptr, "the maps of the queries are null");
  require(found.count != nullptr && found.of != nullptr, "the place candidates are null");
  require(work.wanted != nullptr && work.found != nullptr, "the query workspace is null");
  require_items("words of a batch of queries", static_cast<std::size_t>(queries.lists.frames),
                static_cast<std::size_t>(queries.lists.capacity));
  require_range("queries of the place candidates", found.queries, queries.lists.frames,
                queries.lists.frames);
  require_range("queries of the workspace", work.queries, queries.lists.frames,
                queries.lists.frames);
  require_range("capacity of the place candidates", found.capacity, database.capacity,
                database.capacity);
  require_range("capacity of the query workspace", work.capacity, database.capacity,
                database.capacity);
  require_range("vocabulary rows of the query workspace", work.rows, database.vocabulary / 32 + 1,
                database.vocabulary / 32 + 1);
}

}  // namespace detail

/// Looks up keyframes that may show the place of each frame of a batch, as if the frames were
/// looked up one after the other. Asynchronous on `exec`; allocates nothing; five launches.
/// Equal bits on every executor.
///
/// 1. A keyframe is scored if it shares more than 0.8 of the words that any one shares, rounded
///    down. Others keep the score of an earlier query, 0 if there was none.
/// 2. The group score of a scored keyframe is its score plus those of its neighbours that share a
///    word. As in ORB-SLAM, that may be an earlier query's score.
/// 3. Keyframes whose group score is above 0.75 of the highest name the best of their group, the
///    first of equals. Those that are part of the wanted map are the answer, each once.
///
/// The order is that of an inverted index: by the smallest word that the naming keyframe shares,
/// then by insertion. Words at or above the database's `vocabulary` are shared by none. Changes of
/// the database that were enqueued earlier count; later ones do not.
/// @param scoring l1, l2, chi_square, bhattacharyya or dot_product; with kl, as in ORB-SLAM, large
///   divergences win
/// @param found for as many queries, of the database's capacity
/// @throws bad_argument for null views, other sizes, or a scoring that does not exist
template <typename Exec>
void query_database(Exec const& exec, place_queries const& queries,
                    keyframe_database_view const& database, word_scoring scoring,
                    place_candidates_view const& found, query_workspace const& work) {
  detail::require_queries(queries, database, found, work);
  word_list_view const& lists = queries.lists;
  fill_bytes(exec, work.wanted, 0,
             static_cast<std::size_t>(work.queries) * static_cast<std::size_t>(work.rows) *
                 sizeof *work.wanted);
  for_each_item<per_thread>(exec, lists.frames * lists.capacity, detail::mark_wanted_words{}, lists,
                            database, work);
  int const rows = lists.frames * database.capacity;
  for_each_item<per_warp>(exec, rows, detail::count_common_words{}, database, work);
  detail::with_scoring(scoring, [&](auto constant) {
    for_each_item<per_warp>(exec, rows, detail::score_keyframe<constant()>{}, lists, database,
                            work);
  });
  for_each_item<per_thread>(exec, database.capacity, detail::keep_scores{}, database, work);
  for_each_item<per_block<512>>(exec, lists.frames, detail::choose_places{}, queries.map, database,
                                work, found);
}

}  // namespace FT_ABI
}  // namespace ft
