// SPDX-License-Identifier: Apache-2.0
/// @file Functor: the two nearest rows of a strip for each row of another strip.
///
/// A block of a device compares tiles of 64 by 64 rows. It keeps some parts of them in shared
/// memory at a time, a part of all rows after the other, and each thread the sums of 16 pairs in
/// registers: a part is read once for several pairs. Bytes are multiplied by tensor cores where
/// there are (compute capability 8.0), and numbers give a shortlist (shortlist_tiles.hpp). The host
/// goes through the train rows with four query rows at a time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/kernels/matching/detail/shortlist_tiles.hpp"
#include "ft/kernels/matching/detail/strips.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Query rows that the host takes at a time.
inline constexpr int match_own = 4;

/// The pairs of a tile that a thread compares: 4 query rows, 16 apart, with 4 train rows.
struct pairs_apart {
  static constexpr int rows = 4, columns = 4;
  static constexpr int lanes = 16;  ///< consecutive threads that have the same query rows
  static constexpr int shares = 1;  ///< such runs of threads
  static constexpr int lines = 16;  ///< threads that have the same train rows

  FT_HOST_DEVICE static int row(int rank, int r) { return rank / 16 + 16 * r; }
  FT_HOST_DEVICE static int column(int rank, int c) { return rank % 16 + 16 * c; }
  FT_HOST_DEVICE static int share(int) { return 0; }
  FT_HOST_DEVICE static int line(int rank) { return rank / 16; }
};

/// Whether tensor cores compute the sums of D, where there are some.
template <typename D>
inline constexpr bool has_exact_products =
    products_by_mma<D> == products::of_bits || products_by_mma<D> == products::of_bytes;

template <typename D>
struct match_scratch {
  using reader = row_parts<D>;
  using part = typename reader::part;
  /// Parts of a row at a time.
  static constexpr int each =
      min_of(reader::parts, max_of(static_cast<int>(128 / sizeof(part)), 1));

  part rows[2][each][match_side + 1];  ///< one more, against conflicts of banks
  typename reader::sum own[2][reader::uses_own_sums || has_exact_products<D> ? match_side : 1];
  two_nearest_rows<descriptor_distance<D>> best[has_exact_products<D> ? match_side : 1];
  nearest_row<descriptor_distance<D>>
      of_train[has_exact_products<D> ? pairs_of_mma::lines : pairs_apart::lines][match_side + 4];
};

/// Item: a strip of query rows and a strip of train rows.
template <typename D>
struct match_strips {
  static constexpr bool wide_on_host = true;
  static constexpr int resident_blocks = 2;
  using scratch = std::conditional_t<has_shortlist<D>, shortlist_scratch, match_scratch<D>>;
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
    strip_pair<D> const mine = strip_pair<D>::of(query, train, queries, trains, q, t, mutual, work);
    if constexpr (Group::max_threads == 1) {
      static_cast<void>(s);
      by_rows(mine);
    } else if constexpr (has_shortlist<D>) {
      shortlist_tiles<D>::compare(g, s, mine);
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
  using pairs = std::conditional_t<has_mma && has_exact_products<D>, pairs_of_mma, pairs_apart>;
  /// Bits that differ are those that are set in one row, and in the other, but not in both.
  static constexpr bool counts_bits = has_mma && products_by_mma<D> == products::of_bits;
  static constexpr bool uses_own_sums = reader::uses_own_sums || counts_bits;

  // ---- the host

  /// Query rows that go through the train rows together, by parts.
  struct rows_together {
    part rows[match_own][reader::parts];
    sum own[match_own];
    two best[match_own];
  };

  FT_HOST_DEVICE static void by_rows(strip_pair<D> const& in) {
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
  FT_HOST_DEVICE static void compare_row(strip_pair<D> const& in, rows_together& mine, int i,
                                         int count, int j) {
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
  FT_HOST_DEVICE static void by_tiles(Group g, scratch& s, strip_pair<D> const& in) {
    for (int q = in.first_query; q < in.last_query; q += match_side) {
      two best[pairs::rows];
      FT_UNROLL
      for (int r = 0; r < pairs::rows; ++r) { best[r] = two::none(); }
      for (int t = in.first_train; t < in.last_train; t += match_side) {
        sum sums[pairs::rows][pairs::columns] = {};
        add_tile(g, s, in, q, t, sums);
        one of_train[pairs::columns];
        FT_UNROLL
        for (int c = 0; c < pairs::columns; ++c) {
          int const j = t + pairs::column(g.rank(), c);
          of_train[c] = one::none();
          FT_UNROLL
          for (int r = 0; r < pairs::rows; ++r) {
            int const i = q + pairs::row(g.rank(), r);
            distance_type const d =
                distance_of(sums[r][c], own_sum(s, 0, i - q), own_sum(s, 1, j - t));
            best[r].add(j < in.last_train ? d : no_distance<distance_type>, j);
            of_train[c].add(i < in.last_query ? d : no_distance<distance_type>, i);
          }
        }
        if (in.of_train != nullptr) { keep_of_train(g, s, in, q, t, of_train); }
      }
      keep_of_query(g, s, in, q, best);
    }
  }
  FT_HOST_DEVICE static distance_type distance_of(sum const& ab, sum const& aa, sum const& bb) {
    if constexpr (counts_bits) {
      return aa + bb - 2 * ab;
    } else {
      return usable_distance(reader::distance_of(ab, aa, bb));
    }
  }
  /// Merges what the threads of a query row found.
  template <typename Group>
  FT_HOST_DEVICE static void keep_of_query(Group g, scratch& s, strip_pair<D> const& in, int q,
                                           two (&best)[pairs::rows]) {
    bool const is_first = g.rank() % pairs::lanes == 0;
    int const share = pairs::share(g.rank());
    FT_UNROLL
    for (int r = 0; r < pairs::rows; ++r) {
      best[r] = g.template reduce_lanes<pairs::lanes>(best[r], merge_nearest{});
      if (is_first && share != 0) { s.best[pairs::row(g.rank(), r)] = best[r]; }
    }
    if (pairs::shares > 1) { g.sync(); }
    FT_UNROLL
    for (int r = 0; r < pairs::rows; ++r) {
      int const row = pairs::row(g.rank(), r);
      if (!is_first || share != 0 || q + row >= in.last_query) { continue; }
      in.of_query[q + row] = pairs::shares > 1 ? merge_nearest{}(best[r], s.best[row]) : best[r];
    }
  }

  /// Sums over all parts of the rows of a tile.
  template <typename Group>
  FT_HOST_DEVICE static void add_tile(Group g, scratch& s, strip_pair<D> const& in, int q, int t,
                                      sum (&sums)[pairs::rows][pairs::columns]) {
    constexpr int each = scratch::each;
    sum own{};
    for (int first = 0; first < reader::parts; first += each) {
      g.sync();
      load(g, s, in, q, t, first);
      g.sync();
      int const n = reader::parts % each == 0 ? each : min_of(each, reader::parts - first);
      if constexpr (uses_own_sums) {
        for (int p = 0; p < n && g.rank() < 2 * match_side; ++p) {
          part const& mine = s.rows[g.rank() / match_side][p][g.rank() % match_side];
          reader::add(own, mine, counts_bits ? part{} : mine);
        }
      }
      if constexpr (counts_bits) {
        for (int p = 0; p < n; ++p) { multiply_bits(g, s, p, sums); }
      } else if constexpr (std::is_same<pairs, pairs_of_mma>::value) {
        for (int p = 0; p < n; p += 2) { multiply_bytes(g, s, p, p + 1 < n, sums); }
      } else {
        for (int p = 0; p < n; ++p) { add_part(g, s, p, sums); }
      }
    }
    if constexpr (uses_own_sums) {
      if (g.rank() < 2 * match_side) { s.own[g.rank() / match_side][g.rank() % match_side] = own; }
      g.sync();
    }
  }
  template <typename Group>
  FT_HOST_DEVICE static void add_part(Group g, scratch const& s, int p,
                                      sum (&sums)[pairs::rows][pairs::columns]) {
    part theirs[pairs::columns];
    FT_UNROLL
    for (int c = 0; c < pairs::columns; ++c) {
      theirs[c] = s.rows[1][p][pairs::column(g.rank(), c)];
    }
    FT_UNROLL
    for (int r = 0; r < pairs::rows; ++r) {
      part const mine = s.rows[0][p][pairs::row(g.rank(), r)];
      FT_UNROLL
      for (int c = 0; c < pairs::columns; ++c) { reader::add(sums[r][c], mine, theirs[c]); }
    }
  }
  /// Two parts, or one, of all rows, a warp together. What lies in which thread: PTX ISA,
  /// mma.m16n8k32, .s8.
  template <typename Group>
  FT_HOST_DEVICE static void multiply_bytes(Group g, scratch const& s, int p, bool both,
                                            sum (&sums)[pairs::rows][pairs::columns]) {
    int const word = g.rank() % 4;
    auto const at = [&](int of, int part, int row) {
      return part == 0 || both ? s.rows[of][p + part][row].of[word] : 0;
    };
    int const row = pairs::row(g.rank(), 0);
    std::int32_t const a[4] = {at(0, 0, row), at(0, 0, row + 8), at(0, 1, row), at(0, 1, row + 8)};
    FT_UNROLL
    for (int c = 0; c < pairs::columns; c += 2) {
      int const column = pairs::share(g.rank()) * 32 + c * 4 + g.rank() % 32 / 4;
      std::int32_t const b[2] = {at(1, 0, column), at(1, 1, column)};
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
      asm volatile(
          "mma.sync.aligned.m16n8k32.row.col.s32.s8.s8.s32 "
          "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
          : "+r"(sums[0][c]), "+r"(sums[0][c + 1]), "+r"(sums[1][c]), "+r"(sums[1][c + 1])
          : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
#else
      static_cast<void>(a), static_cast<void>(b), static_cast<void>(sums);
#endif
    }
  }
  /// The bits that both have in a part of all rows, 128 or 256 of them: m16n8k128 and m16n8k256,
  /// .b1.
  template <typename Group>
  FT_HOST_DEVICE static void multiply_bits(Group g, scratch const& s, int p,
                                           sum (&sums)[pairs::rows][pairs::columns]) {
    constexpr bool wide = sizeof(part) == 32;
    constexpr int second = wide ? 4 : 0;  // of the words of a part that a thread has
    int const row = pairs::row(g.rank(), 0), word = g.rank() % 4;
    part const& upper = s.rows[0][p][row];
    part const& lower = s.rows[0][p][row + 8];
    std::uint32_t const a[4] = {upper.words[word], lower.words[word], upper.words[word + second],
                                lower.words[word + second]};
    FT_UNROLL
    for (int c = 0; c < pairs::columns; c += 2) {
      part const& theirs = s.rows[1][p][pairs::share(g.rank()) * 32 + c * 4 + g.rank() % 32 / 4];
      std::uint32_t const b[2] = {theirs.words[word], theirs.words[word + second]};
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
      if constexpr (wide) {
        asm volatile(
            "mma.sync.aligned.m16n8k256.row.col.s32.b1.b1.s32.and.popc "
            "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
            : "+r"(sums[0][c]), "+r"(sums[0][c + 1]), "+r"(sums[1][c]), "+r"(sums[1][c + 1])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
      } else {
        asm volatile(
            "mma.sync.aligned.m16n8k128.row.col.s32.b1.b1.s32.and.popc "
            "{%0, %1, %2, %3}, {%4, %5}, {%6}, {%0, %1, %2, %3};"
            : "+r"(sums[0][c]), "+r"(sums[0][c + 1]), "+r"(sums[1][c]), "+r"(sums[1][c + 1])
            : "r"(a[0]), "r"(a[1]), "r"(b[0]));
      }
#else
      static_cast<void>(a), static_cast<void>(b), static_cast<void>(sums);
#endif
    }
  }
  /// Parts of the rows of a tile; instead of rows that are not there, the last one. The number of
  /// turns is a constant, so that the compiler has all parts read before the first is stored.
  template <typename Group>
  FT_HOST_DEVICE static void load(Group g, scratch& s, strip_pair<D> const& in, int q, int t,
                                  int first) {
    constexpr int each = scratch::each;
    constexpr int turns = ceil_div(match_side * each, match_threads);
    constexpr bool is_whole = reader::parts % each == 0 && match_side * each % match_threads == 0;
    D const* const rows[2] = {in.query + q, in.train + t};
    int const last[2] = {in.last_query - q - 1, in.last_train - t - 1};
    FT_UNROLL
    for (int of = 0; of < 2; ++of) {
      FT_UNROLL
      for (int k = 0; k < turns; ++k) {
        int const i = k * match_threads + g.rank();
        int const row = i / each, p = i % each;
        if (is_whole || (row < match_side && first + p < reader::parts)) {
          s.rows[of][p][row] = reader::part_of(rows[of][min_of(row, last[of])], first + p);
        }
      }
    }
  }
  FT_HOST_DEVICE static sum own_sum(scratch const& s, int of, int row) {
    if constexpr (uses_own_sums) {
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
  FT_HOST_DEVICE static void keep_of_train(Group g, scratch& s, strip_pair<D> const& in, int q,
                                           int t, one const (&found)[pairs::columns]) {
    FT_UNROLL
    for (int c = 0; c < pairs::columns; ++c) {
      s.of_train[pairs::line(g.rank())][pairs::column(g.rank(), c)] = found[c];
    }
    g.sync();
    int const j = t + g.rank();
    if (g.rank() >= match_side || j >= in.last_train) { return; }
    one best = q == in.first_query ? one::none() : in.of_train[j];
    for (int k = 0; k < pairs::lines; ++k) {
      one const other = s.of_train[k][g.rank()];
      best = other < best ? other : best;
    }
    in.of_train[j] = best;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
