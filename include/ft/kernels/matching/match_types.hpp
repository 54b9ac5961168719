// SPDX-License-Identifier: Apache-2.0
/// @file What descriptors are matched: rows, tests, results and working memory.
#pragma once

#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/descriptors/descriptor_model.hpp"

namespace ft {
inline namespace FT_ABI {

/// Descriptors, in executor memory. @tparam D a descriptor
template <typename D>
struct descriptor_rows {
  D const* row = nullptr;      ///< [capacity], aligned to alignof(D)
  int capacity = 0;            ///< rows that there may be
  int const* count = nullptr;  ///< how many there are, executor memory; null = capacity

  /// Of a count above the capacity the capacity is taken.
  FT_HOST_DEVICE int size() const {
    return count == nullptr ? capacity : clamp(*count, 0, capacity);
  }
};

/// Which matches are accepted; by default all.
template <typename Distance>
struct match_tests {
  Distance most = std::numeric_limits<Distance>::max();  ///< greatest distance
  int ratio_num = 0;    ///< the distance must be below ratio_num / ratio_den of the second best;
  int ratio_den = 0;    ///< 0 and 0: no such test. A row without a second best passes. Distances
                        ///< below 0 are taken for 0.
  bool mutual = false;  ///< the train row's best, of equals the lowest, must be the query row

  /// The tests of a descriptor's rules.
  static match_tests by(descriptor_rules<Distance> const& rules, bool mutual = false) {
    return {rules.near, rules.ratio_num, rules.ratio_den, mutual};
  }
};

/// What a query row found among the train rows.
template <typename Distance>
struct descriptor_match {
  int index;          ///< the nearest row if the match is accepted, else -1
  int nearest;        ///< the nearest row, of equals the lowest; -1 = there is none
  int second;         ///< the nearest of the others, of equals the lowest; -1 = there is none
  Distance distance;  ///< of the nearest; undefined if there is none
  Distance second_distance;  ///< of the second; undefined if there is none
};

namespace detail {

/// Above any distance of a match.
template <typename Distance>
inline constexpr Distance no_distance = std::numeric_limits<Distance>::has_infinity
                                            ? std::numeric_limits<Distance>::infinity()
                                            : std::numeric_limits<Distance>::max();
inline constexpr int no_row = 0x7fffffff;

/// The distance, or none for one that is not a number, or infinite.
template <typename Distance>
FT_HOST_DEVICE FT_INLINE Distance usable_distance(Distance d) {
  if constexpr (std::is_floating_point<Distance>::value) {
    return d - d == 0 ? d : no_distance<Distance>;
  } else {
    return d;
  }
}

/// The nearest row so far, of equals the lowest.
template <typename Distance>
struct nearest_row {
  Distance distance;
  int index;

  FT_HOST_DEVICE FT_INLINE static nearest_row none() { return {no_distance<Distance>, no_row}; }
  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE FT_INLINE void add(Distance d, int at) {
    bool const nearer = d < distance;
    distance = nearer ? d : distance;
    index = nearer ? at : index;
  }
  friend FT_HOST_DEVICE FT_INLINE bool operator<(nearest_row a, nearest_row b) {
    return a.distance < b.distance || (a.distance == b.distance && a.index < b.index);
  }
};

/// The two nearest rows so far.
template <typename Distance>
struct two_nearest_rows {
  nearest_row<Distance> first, second;

  FT_HOST_DEVICE FT_INLINE static two_nearest_rows none() {
    return {nearest_row<Distance>::none(), nearest_row<Distance>::none()};
  }
  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE FT_INLINE void add(Distance d, int at) {
    bool const nearer = d < first.distance;
    bool const nearer_than_second = d < second.distance;
    second.distance = nearer ? first.distance : nearer_than_second ? d : second.distance;
    second.index = nearer ? first.index : nearer_than_second ? at : second.index;
    first.distance = nearer ? d : first.distance;
    first.index = nearer ? at : first.index;
  }
};

/// The two nearest of two pairs.
struct merge_nearest {
  template <typename Distance>
  FT_HOST_DEVICE two_nearest_rows<Distance> operator()(two_nearest_rows<Distance> const& a,
                                                       two_nearest_rows<Distance> const& b) const {
    bool const of_b = b.first < a.first;
    nearest_row<Distance> const behind = of_b ? b.second : a.second;
    nearest_row<Distance> const loser = of_b ? a.first : b.first;
    return {of_b ? b.first : a.first, loser < behind ? loser : behind};
  }
};

/// An unsigned number that is the less, the less a distance is; of 0 and -0 the same.
FT_HOST_DEVICE FT_INLINE std::uint32_t order_of(int d) {
  return static_cast<std::uint32_t>(d) ^ 0x80000000u;
}
FT_HOST_DEVICE FT_INLINE std::uint32_t order_of(float d) {
  float const no_sign_of_zero = d + 0.0f;
  std::uint32_t bits;
  memcpy(&bits, &no_sign_of_zero, sizeof bits);
  return bits ^ ((bits >> 31) != 0 ? 0xffffffffu : 0x80000000u);
}
/// The nearest of what the threads of a group have, for each of them. The group is a warp or a
/// thread.
template <typename Distance, typename Group>
FT_HOST_DEVICE FT_INLINE nearest_row<Distance> nearest_of_all(Group g, nearest_row<Distance> mine) {
  if constexpr (Group::max_threads == 1) { return mine; }
  std::uint32_t const order = order_of(mine.distance);
  bool const is_least = order == g.reduce(order, min_op{});
  int const index = g.reduce(is_least ? mine.index : no_row, min_op{});
  int const from = trailing_zeros(g.ballot(is_least && mine.index == index));
  return {g.shuffle(mine.distance, from), index};
}
/// The two nearest. A row is in the pair of one thread only: it is known again by its index.
template <typename Distance, typename Group>
FT_HOST_DEVICE FT_INLINE two_nearest_rows<Distance> nearest_of_all(
    Group g, two_nearest_rows<Distance> mine) {
  if constexpr (Group::max_threads == 1) { return mine; }
  nearest_row<Distance> const first = nearest_of_all(g, mine.first);
  if (mine.first.index == first.index) { mine.first = mine.second; }
  return {first, nearest_of_all(g, mine.first)};
}

/// Rows are compared in tiles of that many.
inline constexpr int match_side = 64;
/// And tiles in so many strips at most.
inline constexpr int most_strips = 32;

FT_HOST_DEVICE constexpr int strips_of(int rows) {
  return min_of(most_strips, (rows - 1) / match_side + 1);
}

/// How rows are divided into strips of whole tiles.
struct strip_plan {
  int rows;
  int length;  ///< rows of a strip
  int used;    ///< strips that have rows

  /// @param strips that there may be
  FT_HOST_DEVICE static strip_plan of(int rows, int strips) {
    if (rows <= 0) { return {0, match_side, 0}; }
    int const tiles = (rows - 1) / match_side + 1;
    if (tiles <= strips) { return {rows, match_side, tiles}; }
    int const each = ceil_div(tiles, strips);
    return {rows, each * match_side, ceil_div(tiles, each)};
  }
  FT_HOST_DEVICE int begin(int strip) const { return strip * length; }
  FT_HOST_DEVICE int end(int strip) const {
    return min_of(length, rows - begin(strip)) + begin(strip);
  }
};

}  // namespace detail

/// Working memory of match_descriptors(), in executor memory. Nothing has to be initialised.
template <typename Distance>
struct match_workspace {
  int queries = 0;                                         ///< capacity
  int trains = 0;                                          ///< capacity
  detail::two_nearest_rows<Distance>* of_query = nullptr;  ///< [strips of trains][queries]
  detail::nearest_row<Distance>* of_train = nullptr;       ///< [strips of queries][trains]
  /// As of_query and of_train, of shortlists: a bound below all other distances. Null for ints.
  float* rest_of_query = nullptr;
  float* rest_of_train = nullptr;
};

/// @throws bad_argument for a negative number of rows
template <typename Distance>
void carve(carver& c, match_workspace<Distance>& v, int queries, int trains) {
  constexpr int most = std::numeric_limits<int>::max();
  detail::require_range("query rows", queries, 0, most);
  detail::require_range("train rows", trains, 0, most);
  v.queries = queries;
  v.trains = trains;
  detail::extent const of_query{queries > 0 ? detail::strips_of(trains) : 0, queries};
  detail::extent const of_train{trains > 0 ? detail::strips_of(queries) : 0, trains};
  c.place(of_query, v.of_query);
  c.place(of_train, v.of_train);
  if constexpr (std::is_floating_point<Distance>::value) {
    c.place(of_query, v.rest_of_query);
    c.place(of_train, v.rest_of_train);
  }
}

}  // namespace FT_ABI
}  // namespace ft
