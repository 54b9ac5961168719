// SPDX-License-Identifier: Apache-2.0
/// @file What a query row finds in shortlists: the rows that may be its nearest are compared again.
#pragma once

#include <cstddef>

#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/detail/lower_bound.hpp"
#include "ft/kernels/matching/detail/strips.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The query row and the two train rows that are likely its nearest, and their sums.
template <typename D>
struct rescored_scratch {
  using reader = row_parts<D>;
  static constexpr int each = min_of(32, reader::parts);  ///< parts of a row at a time
  /// One more, so that rows begin in other banks.
  typename reader::part rows[3][each + 1];
  typename reader::sum sums[5];
};

/// The strict distances of a query row, a warp together. Of each strip a lane has the shortlist.
template <typename D>
struct rescored_match {
  static_assert(most_strips <= 32, "a lane for each strip");
  rescored_scratch<D>& scratch;
  descriptor_rows<D> const& query;
  descriptor_rows<D> const& train;
  strip_plan const& queries;
  strip_plan const& trains;
  match_workspace<float> const& work;
  int own;  ///< the query row

  /// The two nearest train rows. The distances of the two that have the least bounds are a limit: a
  /// row whose bound is above it is farther than both. All others are compared.
  template <typename Group>
  FT_HOST_DEVICE two_nearest_rows<float> nearest(Group g) const {
    auto kept = two_nearest_rows<float>::none();
    float rest = no_distance<float>;
    if (g.rank() < trains.used) {
      std::ptrdiff_t const at = static_cast<std::ptrdiff_t>(g.rank()) * work.queries + own;
      kept = work.of_query[at];
      rest = work.rest_of_query[at];
    }
    two_nearest_rows<float> const likely =
        nearest_of_all(g, merge_nearest{}(bounded(kept.first), bounded(kept.second)));
    one first, second;
    compare_likely(g, likely.first.index, likely.second.index, first, second);
    float const limit = max_of(first.distance, second.distance);
    bool const any_of_strip = rest < no_distance<float> && rest <= limit;

    auto const may_be_nearer = [&](one item) {
      return item.index != no_row && item.distance <= limit && item.index != likely.first.index &&
             item.index != likely.second.index;
    };
    bool const has_more = any_of_strip || may_be_nearer(kept.first) || may_be_nearer(kept.second);
    using two = two_nearest_rows<float>;
    two best = merge_nearest{}(two{first, one::none()}, two{second, one::none()});
    if (!g.any(has_more)) { return best; }

    if (g.rank() != 0) { best = two::none(); }
    FT_NO_UNROLL
    for (int k = 0; k < 2 && !any_of_strip; ++k) {
      one const item = k == 0 ? kept.first : kept.second;
      if (!may_be_nearer(item)) { continue; }
      best = merge_nearest{}(best, {compared(own, item.index, true), one::none()});
    }
    for (unsigned left = g.ballot(any_of_strip); left != 0; left &= left - 1) {
      int const strip = trailing_zeros(left);
      FT_NO_UNROLL
      for (int j = trains.begin(strip) + g.rank(); j < trains.end(strip); j += g.size()) {
        if (j == likely.first.index || j == likely.second.index) { continue; }
        best = merge_nearest{}(best, {compared(own, j, true), one::none()});
      }
    }
    return nearest_of_all(g, best);
  }

  /// Whether no other query row is nearer to a train row than this one, or as near and lower.
  template <typename Group>
  FT_HOST_DEVICE bool is_nearest_of(Group g, nearest_row<float> of_train) const {
    one const mine{of_train.distance, own};
    auto kept = one::none();
    float rest = no_distance<float>;
    if (g.rank() < queries.used) {
      std::ptrdiff_t const at =
          static_cast<std::ptrdiff_t>(g.rank()) * work.trains + of_train.index;
      kept = work.of_train[at];
      rest = work.rest_of_train[at];
    }
    bool const any_of_strip = rest < no_distance<float> && rest <= mine.distance;
    bool nearer = false;
    if (!any_of_strip && kept.index != own && kept.distance <= mine.distance) {
      nearer = compared(kept.index, of_train.index, false) < mine;
    }
    for (unsigned left = g.ballot(any_of_strip); left != 0; left &= left - 1) {
      int const strip = trailing_zeros(left);
      FT_NO_UNROLL
      for (int i = queries.begin(strip) + g.rank(); i < queries.end(strip); i += g.size()) {
        nearer = compared(i, of_train.index, false) < mine || nearer;
      }
    }
    return !g.any(nearer);
  }

private:
  using one = nearest_row<float>;
  using reader = row_parts<D>;

  FT_HOST_DEVICE static two_nearest_rows<float> bounded(one item) {
    bool const has_bound = item.distance > no_bound;
    return {has_bound ? item : one::none(), one::none()};
  }
  /// The distances to two train rows, as distance_by_parts(): rows are loaded by the warp, and four
  /// lanes add up a sum of four.
  template <typename Group>
  FT_HOST_DEVICE void compare_likely(Group g, int first, int second, one& to_first,
                                     one& to_second) const {
    constexpr int each = rescored_scratch<D>::each;
    D const& mine = query.row[own];
    D const& nearest = first == no_row ? mine : train.row[first];
    D const& next = second == no_row ? mine : train.row[second];
    // Own with first, own with second, and, where the model uses them, each with itself. Four lanes
    // add up the four sums of each.
    int const rank = g.rank(), which = rank / 4, term = rank % 4;
    int const a = which < 3 ? 0 : which - 2;
    int const b = which < 2 ? which + 1 : which - 2;
    bool const adds = which < (reader::uses_own_sums ? 5 : 2);
    typename reader::sum sum{};  // the first of its numbers
    constexpr int together = 8;  // parts that are read at the same time
    constexpr bool is_whole = each % together == 0 && reader::parts % each == 0;
    FT_NO_UNROLL
    for (int p = 0; p < reader::parts; p += each) {
      g.sync();
      if (rank < each && p + rank < reader::parts) {
        typename reader::part const parts[3] = {reader::part_of(mine, p + rank),
                                                reader::part_of(nearest, p + rank),
                                                reader::part_of(next, p + rank)};
        FT_UNROLL
        for (int k = 0; k < 3; ++k) { scratch.rows[k][rank] = parts[k]; }
      }
      g.sync();
      int const n = adds ? min_of(each, reader::parts - p) : 0;
      FT_NO_UNROLL
      for (int from = 0; from < n; from += together) {
        FT_UNROLL
        for (int k = from; k < from + together; ++k) {
          if (!is_whole && k >= n) { continue; }
          reader::add(sum, {{scratch.rows[a][k].of[term]}}, {{scratch.rows[b][k].of[term]}});
        }
      }
    }
    if (adds) { scratch.sums[which].of[term] = sum.of[0]; }
    g.sync();
    auto const usable = [&](int k, int index) {
      bool const own_sums = reader::uses_own_sums;
      float const d = usable_distance(reader::distance_of(
          scratch.sums[k], scratch.sums[own_sums ? 2 : 0], scratch.sums[own_sums ? 3 + k : 0]));
      return index != no_row && d < no_distance<float> ? one{d, index} : one::none();
    };
    to_first = usable(0, first);
    to_second = usable(1, second);
  }
  /// The distance of two rows, as distance_by_parts(), with the index of one of them. Several parts
  /// are loaded at a time.
  FT_HOST_DEVICE one compared(int i, int j, bool to_train) const {
    if (i == no_row || j == no_row) { return one::none(); }
    constexpr int each = min_of(8, reader::parts);
    D const& a = query.row[i];
    D const& b = train.row[j];
    typename reader::sum ab{}, aa{}, bb{};
    FT_NO_UNROLL
    for (int p = 0; p < reader::parts; p += each) {
      typename reader::part of_a[each], of_b[each];
      FT_UNROLL
      for (int k = 0; k < each; ++k) {
        bool const there = reader::parts % each == 0 || p + k < reader::parts;
        of_a[k] = there ? reader::part_of(a, p + k) : typename reader::part{};
        of_b[k] = there ? reader::part_of(b, p + k) : typename reader::part{};
      }
      FT_UNROLL
      for (int k = 0; k < each; ++k) {
        if (reader::parts % each != 0 && p + k >= reader::parts) { continue; }
        reader::add(ab, of_a[k], of_b[k]);
        if constexpr (reader::uses_own_sums) {
          reader::add(aa, of_a[k], of_a[k]);
          reader::add(bb, of_b[k], of_b[k]);
        }
      }
    }
    float const d = usable_distance(reader::distance_of(ab, aa, bb));
    return d < no_distance<float> ? one{d, to_train ? j : i} : one::none();
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
