// SPDX-License-Identifier: Apache-2.0
/// @file Stage: how alike two bags of words are. Source: Gálvez-López and Tardós, "Bags of binary
/// words for fast place recognition in image sequences", T-RO 2012, section IV; Nistér and
/// Stewénius, "Scalable recognition with a vocabulary tree", CVPR 2006.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/math/log.hpp"

namespace ft {
inline namespace FT_ABI {

/// Frame `a` of one batch of bags of words, frame `b` of another.
struct word_list_pair {
  int a;
  int b;
};

namespace detail {

/// The distinct words of a frame, ascending.
struct words_of_frame {
  std::uint32_t const* word;
  double const* value;
  int count;

  FT_HOST_DEVICE static words_of_frame in(word_list_view const& lists, int frame) {
    return {lists.word + lists.at(frame), lists.value + lists.at(frame), lists.count[frame]};
  }
  /// Place of the first of the words from `from` on that is not below `wanted`; `count` if there is
  /// none. Quick where the place is near `from`.
  FT_HOST_DEVICE int first_not_below(std::uint32_t wanted, int from) const {
    int end = from;
    for (int step = 1; end < count && word[end] < wanted; step *= 2) {
      from = end + 1;
      end += min_of(step, count - end);
    }
    while (from < end) {
      int const middle = from + (end - from) / 2;
      if (word[middle] < wanted) {
        from = middle + 1;
      } else {
        end = middle;
      }
    }
    return from;
  }
};

/// What a word in both frames adds to the score.
template <word_scoring Scoring>
FT_HOST_DEVICE strict_double shared_word_term(strict_double v, strict_double w) {
  if constexpr (Scoring == word_scoring::l1) {
    return strict_double(::fabs((v - w).value)) - strict_double(::fabs(v.value)) -
           strict_double(::fabs(w.value));
  } else if constexpr (Scoring == word_scoring::chi_square) {
    return v * w / (v + w);
  } else if constexpr (Scoring == word_scoring::kl) {
    return v * strict_log(v / w);
  } else if constexpr (Scoring == word_scoring::bhattacharyya) {
    return scalar::sqrt(v * w);
  } else {
    return v * w;
  }
}
/// What a word of the first frame alone adds: as if the second had it with the smallest value, the
/// distance from 1 to the next double.
FT_HOST_DEVICE inline strict_double lone_word_term(strict_double v) {
  return v * (strict_log(v) - strict_double(-36.04365338911715));
}
template <word_scoring Scoring>
FT_HOST_DEVICE double score_of_sum(strict_double sum) {
  if constexpr (Scoring == word_scoring::l1) {
    return (-sum / strict_double(2.0)).value;
  } else if constexpr (Scoring == word_scoring::l2) {
    strict_double const one = 1.0;
    return sum >= one ? 1.0 : (one - scalar::sqrt(one - sum)).value;
  } else if constexpr (Scoring == word_scoring::chi_square) {
    return (strict_double(2.0) * sum).value;
  } else {
    return sum.value;
  }
}

/// The score of two bags of words, by all threads of a warp or one thread. The terms are added in
/// the order of the words.
template <word_scoring Scoring, typename Group>
FT_HOST_DEVICE double score_of(Group g, words_of_frame const& v, words_of_frame const& w) {
  strict_double sum = 0.0;
  int from = 0;
  for (int first = 0; first < v.count; first += g.size()) {
    int const i = first + g.rank();
    bool const there = i < v.count;
    int const at = there ? w.first_not_below(v.word[i], from) : w.count;
    bool const shared = there && at < w.count && w.word[at] == v.word[i];
    bool const counts = Scoring == word_scoring::kl ? there : shared;
    strict_double term = 0.0;
    if (shared) {
      term = shared_word_term<Scoring>(v.value[i], w.value[at]);
    } else if (counts) {
      term = lone_word_term(v.value[i]);
    }
    for (unsigned rest = g.ballot(counts); rest != 0; rest &= rest - 1) {
      sum += strict_double(g.shuffle(term.value, trailing_zeros(rest)));
    }
    from = g.shuffle(at, g.size() - 1);
  }
  return score_of_sum<Scoring>(sum);
}

template <word_scoring Scoring>
using scoring_constant = std::integral_constant<word_scoring, Scoring>;

/// Calls act(scoring_constant) for the scoring. @throws bad_argument for one that does not exist
template <typename Act>
void with_scoring(word_scoring scoring, Act const& act) {
  switch (scoring) {
    case word_scoring::l1:
      return act(scoring_constant<word_scoring::l1>{});
    case word_scoring::l2:
      return act(scoring_constant<word_scoring::l2>{});
    case word_scoring::chi_square:
      return act(scoring_constant<word_scoring::chi_square>{});
    case word_scoring::kl:
      return act(scoring_constant<word_scoring::kl>{});
    case word_scoring::bhattacharyya:
      return act(scoring_constant<word_scoring::bhattacharyya>{});
    case word_scoring::dot_product:
      return act(scoring_constant<word_scoring::dot_product>{});
  }
  require_range("scoring", static_cast<int>(scoring), 0, 5);
}

/// @throws bad_argument for null arrays or sizes below 1
inline void require_word_lists(char const* name, word_list_view const& lists) {
  require(lists.count != nullptr && lists.word != nullptr && lists.value != nullptr, name);
  require_range("frames of bags of words", lists.frames, 1, std::numeric_limits<int>::max());
  require_range("capacity of bags of words", lists.capacity, 1,
                std::numeric_limits<int>::max() / 64);
}

/// Item: a pair.
template <word_scoring Scoring>
struct score_pair {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, word_list_view const& a,
                                 word_list_view const& b, word_list_pair const* pairs,
                                 double* scores) const {
    word_list_pair const pair = pairs[item];
    double const score =
        score_of<Scoring>(g, words_of_frame::in(a, pair.a), words_of_frame::in(b, pair.b));
    if (g.rank() == 0) { scores[item] = score; }
  }
};

}  // namespace detail

/// Scores pairs of bags of words; larger is more alike, but for kl, a divergence of a from b.
/// Asynchronous on `exec`; allocates nothing; one launch, a warp a pair. Equal bits on every
/// executor, sums in the order of the words.
///
/// With common words of values v and w: l1 is -sum(|v - w| - |v| - |w|) / 2; l2 is 1 - sqrt(1 - sum
/// v w), at most 1; chi_square is 2 sum(v w / (v + w)); kl is sum(v log(v / w)), where w is 2^-52
/// for words that b lacks; bhattacharyya is sum(sqrt(v w)); dot_product is sum(v w). Values are
/// positive, in l1, chi_square, kl and bhattacharyya with sum 1, in l2 with a sum of squares of 1.
/// @param pairs [any] frames of `a` and of `b`, in executor memory
/// @param scores [pairs]
/// @throws bad_argument for null views, or a scoring that does not exist
template <typename Exec>
void score_words(Exec const& exec, word_list_view const& a, word_list_view const& b,
                 span<word_list_pair const> pairs, word_scoring scoring, double* scores) {
  detail::require_word_lists("the first bags of words are null", a);
  detail::require_word_lists("the second bags of words are null", b);
  detail::require(pairs.size == 0 || (pairs.data != nullptr && scores != nullptr),
                  "the pairs or scores are null");
  detail::with_scoring(scoring, [&](auto constant) {
    for_each_item<per_warp>(exec, pairs.size, detail::score_pair<constant()>{}, a, b, pairs.data,
                            scores);
  });
}

// Stages: changes of a database of keyframes.

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
