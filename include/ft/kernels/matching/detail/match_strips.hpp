// SPDX-License-Identifier: Apache-2.0
/// @file Functor: the two nearest rows of a strip for each row of another strip.
///
/// A block of a device compares tiles of 64 by 64 rows. It keeps some parts of them in shared
/// memory at a time, a part of all rows after the other, and each thread the sums of 4 by 4 pairs
/// in registers: a part is read once for four pairs. The host goes through the train rows with
/// four query rows at a time.
#pragma once

#include <cstddef>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline constexpr int match_threads = 256;
/// Query rows, and train rows, of a thread.
inline constexpr int match_own = 4;
/// A thread's rows are that many apart.
inline constexpr int match_step = match_side / match_own;
static_assert(match_step * match_step == match_threads, "a thread for 4 by 4 pairs of a tile");

template <typename D>
struct match_scratch {
  using reader = row_parts<D>;
  using part = typename reader::part;
  /// Parts of a row at a time.
  static constexpr int each =
      min_of(reader::parts, max_of(static_cast<int>(128 / sizeof(part)), 1));

  part rows[2][each][match_side + 1];  ///< one more, against conflicts of banks
  typename reader::sum own[2][reader::uses_own_sums ? match_side : 1];
  nearest_row<descriptor_distance<D>> of_train[match_step][match_side];
};

/// Item: a strip of query rows and a strip of train rows.
template <typename D>
struct match_strips {
  static constexpr bool wide_on_host = true;
  static constexpr int resident_blocks = 2;
  using scratch = match_scratch<D>;
  using distance_type = descriptor_distance<D>;
  using workspace = match_workspace<distance_type>;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, descriptor_rows<D> const& query,
                                 descriptor_rows<D> const& train, bool mutual,
                                 workspace const& work) const {
    int const across = strips_of(train.capacity);
    strip_plan const queries = strip_plan::of(query.size(), strips_of(query.capacity));
    strip_plan const trains = strip_plan::of(train.size(), across);
    int const q = item / across, t = item % across;
    if (q >= queries.used || t >= trains.used) { return; }
    strip const mine{
        query.row,
        train.row,
        queries.begin(q),
        queries.end(q),
        trains.begin(t),
        trains.end(t),
        work.of_query + static_cast<std::ptrdiff_t>(t) * work.queries,
        mutual ? work.of_train + static_cast<std::ptrdiff_t>(q) * work.trains : nullptr};
    if constexpr (Group::max_threads == 1) {
      static_cast<void>(s);
      by_rows(mine);
    } else {
      by_tiles(g, s, mine);
    }
  }

private:
  using reader = row_parts<D>;
  using part = typename reader::part;
  using sum = typename reader::sum;
  using two = two_nearest_rows<distance_type>;
  using one = nearest_row<distance_type>;

  struct strip {
    D const* query;
    D const* train;
    int first_query, last_query;  ///< the latter is past the strip
    int first_train, last_train;
    two* of_query;  ///< of this strip of train rows
    one* of_train;  ///< of this strip of query rows; null = not asked for
  };

  // ---- the host

  /// Query rows that go through the train rows together, by parts.
  struct rows_together {
    part rows[match_own][reader::parts];
    sum own[match_own];
    two best[match_own];
  };

  FT_HOST_DEVICE static void by_rows(strip const& in) {
    for (int j = in.first_train; in.of_train != nullptr && j < in.last_train; ++j) {
      in.of_train[j] = one::none();
    }
    for (int i = in.first_query; i < in.last_query; i += match_own) {
      rows_together mine;
      int const count = min_of(match_own, in.last_query - i);
      for (int r = 0; r < match_own; ++r) {
        mine.own[r] = read_row(in.query[i + min_of(r, count - 1)], mine.rows[r]);
        mine.best[r] = two::none();
      }
      for (int j = in.first_train; j < in.last_train; ++j) { compare_row(in, mine, i, count, j); }
      for (int r = 0; r < count; ++r) { in.of_query[i + r] = mine.best[r]; }
    }
  }
  FT_HOST_DEVICE static void compare_row(strip const& in, rows_together& mine, int i, int count,
                                         int j) {
    part theirs[reader::parts];
    sum const own = read_row(in.train[j], theirs);
    // By name, so that they stay in registers.
    static_assert(match_own == 4, "four rows");
    sum s0{}, s1{}, s2{}, s3{};
    for (int p = 0; p < reader::parts; ++p) {
      part const other = theirs[p];
      reader::add(s0, mine.rows[0][p], other);
      reader::add(s1, mine.rows[1][p], other);
      reader::add(s2, mine.rows[2][p], other);
      reader::add(s3, mine.rows[3][p], other);
    }
    sum const* const sums[match_own] = {&s0, &s1, &s2, &s3};
    for (int r = 0; r < count; ++r) {
      distance_type const d = usable_distance(reader::distance_of(*sums[r], mine.own[r], own));
      mine.best[r].add(d, j);
      if (in.of_train != nullptr) { in.of_train[j].add(d, i + r); }
    }
  }
  /// The parts of a row. @return its sum with itself, if the model uses it
  FT_HOST_DEVICE static sum read_row(D const& row, part (&to)[reader::parts]) {
    sum own{};
    for (int p = 0; p < reader::parts; ++p) {
      to[p] = reader::part_of(row, p);
      if constexpr (reader::uses_own_sums) { reader::add(own, to[p], to[p]); }
    }
    return own;
  }

  // ---- a device

  template <typename Group>
  FT_HOST_DEVICE static void by_tiles(Group g, scratch& s, strip const& in) {
    int const column = g.rank() % match_step, line = g.rank() / match_step;
    for (int q = in.first_query; q < in.last_query; q += match_side) {
      two best[match_own];
      FT_UNROLL
      for (int r = 0; r < match_own; ++r) { best[r] = two::none(); }
      for (int t = in.first_train; t < in.last_train; t += match_side) {
        sum sums[match_own][match_own] = {};
        add_tile(g, s, in, q, t, sums);
        one of_train[match_own];
        FT_UNROLL
        for (int c = 0; c < match_own; ++c) {
          int const j = t + column + c * match_step;
          of_train[c] = one::none();
          FT_UNROLL
          for (int r = 0; r < match_own; ++r) {
            int const i = q + line + r * match_step;
            distance_type const d = usable_distance(
                reader::distance_of(sums[r][c], own_sum(s, 0, i - q), own_sum(s, 1, j - t)));
            best[r].add(j < in.last_train ? d : no_distance<distance_type>, j);
            of_train[c].add(i < in.last_query ? d : no_distance<distance_type>, i);
          }
        }
        if (in.of_train != nullptr) { keep_of_train(g, s, in, q, t, of_train); }
      }
      FT_UNROLL
      for (int r = 0; r < match_own; ++r) {
        two const all = g.template reduce_lanes<match_step>(best[r], merge_nearest{});
        int const i = q + line + r * match_step;
        if (column == 0 && i < in.last_query) { in.of_query[i] = all; }
      }
    }
  }

  /// Sums over all parts of the rows of a tile.
  template <typename Group>
  FT_HOST_DEVICE static void add_tile(Group g, scratch& s, strip const& in, int q, int t,
                                      sum (&sums)[match_own][match_own]) {
    constexpr int each = scratch::each;
    int const column = g.rank() % match_step, line = g.rank() / match_step;
    sum own{};
    for (int first = 0; first < reader::parts; first += each) {
      g.sync();
      load(g, s.rows[0], in.query + q, in.last_query - q, first);
      load(g, s.rows[1], in.train + t, in.last_train - t, first);
      g.sync();
      int const n = reader::parts % each == 0 ? each : min_of(each, reader::parts - first);
      if constexpr (reader::uses_own_sums) {
        for (int p = 0; p < n && g.rank() < 2 * match_side; ++p) {
          part const& mine = s.rows[g.rank() / match_side][p][g.rank() % match_side];
          reader::add(own, mine, mine);
        }
      }
      for (int p = 0; p < n; ++p) {
        part theirs[match_own];
        FT_UNROLL
        for (int c = 0; c < match_own; ++c) { theirs[c] = s.rows[1][p][column + c * match_step]; }
        FT_UNROLL
        for (int r = 0; r < match_own; ++r) {
          part const mine = s.rows[0][p][line + r * match_step];
          FT_UNROLL
          for (int c = 0; c < match_own; ++c) { reader::add(sums[r][c], mine, theirs[c]); }
        }
      }
    }
    if constexpr (reader::uses_own_sums) {
      if (g.rank() < 2 * match_side) { s.own[g.rank() / match_side][g.rank() % match_side] = own; }
      g.sync();
    }
  }
  /// Parts of 64 rows; instead of rows that are not there, the last one.
  template <typename Group>
  FT_HOST_DEVICE static void load(Group g, part (&to)[scratch::each][match_side + 1], D const* rows,
                                  int count, int first) {
    constexpr int each = scratch::each;
    FT_UNROLL
    for (int k = g.rank(); k < match_side * each; k += g.size()) {
      int const row = k / each, p = k % each;
      if (reader::parts % each == 0 || first + p < reader::parts) {
        to[p][row] = reader::part_of(rows[min_of(row, count - 1)], first + p);
      }
    }
  }
  FT_HOST_DEVICE static sum own_sum(scratch const& s, int of, int row) {
    if constexpr (reader::uses_own_sums) {
      return s.own[of][row];
    } else {
      static_cast<void>(s);
      static_cast<void>(of);
      static_cast<void>(row);
      return sum{};
    }
  }
  /// Merges what the train rows of a tile found into what they found in the tiles before.
  template <typename Group>
  FT_HOST_DEVICE static void keep_of_train(Group g, scratch& s, strip const& in, int q, int t,
                                           one const (&found)[match_own]) {
    int const column = g.rank() % match_step, line = g.rank() / match_step;
    FT_UNROLL
    for (int c = 0; c < match_own; ++c) { s.of_train[line][column + c * match_step] = found[c]; }
    g.sync();
    int const j = t + g.rank();
    if (g.rank() >= match_side || j >= in.last_train) { return; }
    one best = q == in.first_query ? one::none() : in.of_train[j];
    for (int k = 0; k < match_step; ++k) {
      one const other = s.of_train[k][g.rank()];
      best = other < best ? other : best;
    }
    in.of_train[j] = best;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
