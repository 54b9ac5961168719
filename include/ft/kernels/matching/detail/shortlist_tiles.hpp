// SPDX-License-Identifier: Apache-2.0
/// @file Strips of rows of float or float16: whom tensor cores cannot rule out.
///
/// In place of distances there are bounds below them (lower_bound.hpp). Of each query row a strip
/// keeps the two least with their rows, and the third least without; of each train row the least
/// and the second least. Whoever knows a strict distance then knows which of the rows may be
/// nearer: none, one of those that are kept, or, where the bound without a row is not above it, any
/// of the strip (rescored_match.hpp).
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/detail/lower_bound.hpp"
#include "ft/kernels/matching/detail/strips.hpp"
#include "ft/kernels/matching/match_types.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The two least bounds so far, and the third.
struct short_row {
  two_nearest_rows<float> kept;
  float rest;

  FT_HOST_DEVICE static short_row none() {
    return {two_nearest_rows<float>::none(), no_distance<float>};
  }
  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE FT_INLINE void add(float bound, int at) {
    rest = min_of(rest, max_of(bound, kept.second.distance));
    kept.add(bound, at);
  }
};
struct merge_short_rows {
  FT_HOST_DEVICE short_row operator()(short_row const& a, short_row const& b) const {
    float const third = min_of(max_of(a.kept.first.distance, b.kept.second.distance),
                               max_of(a.kept.second.distance, b.kept.first.distance));
    return {merge_nearest{}(a.kept, b.kept), min_of(third, min_of(a.rest, b.rest))};
  }
};

/// The least bound so far, and the second.
struct short_column {
  nearest_row<float> kept;
  float rest;

  FT_HOST_DEVICE static short_column none() {
    return {nearest_row<float>::none(), no_distance<float>};
  }
  /// @param at must exceed those of earlier calls
  FT_HOST_DEVICE FT_INLINE void add(float bound, int at) {
    rest = min_of(rest, max_of(bound, kept.distance));
    kept.add(bound, at);
  }
};
struct merge_short_columns {
  FT_HOST_DEVICE short_column operator()(short_column const& a, short_column const& b) const {
    float const second = max_of(a.kept.distance, b.kept.distance);
    return {b.kept < a.kept ? b.kept : a.kept, min_of(second, min_of(a.rest, b.rest))};
  }
};

struct shortlist_scratch {
  static constexpr int each = 128;  ///< numbers of a row at a time
  /// Four words more, so that the eight rows that a warp reads lie in different banks.
  using row = rounded_numbers[each / 8 + 1];
  struct of_columns {
    nearest_row<float> kept[pairs_of_mma::lines][match_side + 4];
    float rest[pairs_of_mma::lines][match_side + 4];
  };
  union {
    row rows[2][match_side];
    of_columns of_train;  ///< after the products
  };
  row_bound bounds[2][match_side];
  short_row best[match_side];
};

static_assert(sizeof(shortlist_scratch) <= 47 * 1024, "static shared memory of a block");

/// Tiles of a strip of query rows and a strip of train rows, by the threads of a block.
template <typename D>
struct shortlist_tiles {
  template <typename Group>
  FT_HOST_DEVICE static void compare(Group g, shortlist_scratch& s, strip_pair<D> const& in) {
    for (int q = in.first_query; q < in.last_query; q += match_side) {
      short_row best[pairs::rows];
      FT_UNROLL
      for (int r = 0; r < pairs::rows; ++r) { best[r] = short_row::none(); }
      for (int t = in.first_train; t < in.last_train; t += match_side) {
        float products[pairs::rows][pairs::columns] = {};
        multiply_tile(g, s, in, q, t, products);
        if (in.of_train == nullptr) {
          bound_tile<false>(g, s, in, q, t, products, best);
        } else {
          bound_tile<true>(g, s, in, q, t, products, best);
          keep_of_train(g, s, in, q, t);
        }
      }
      keep_of_query(g, s, in, q, best);
    }
  }

private:
  using pairs = pairs_of_mma;
  using limit = lower_bound<D, base_model_of<D>>;
  /// Threads that load a row together.
  static constexpr int loaders = match_threads / match_side;
  /// Runs of eight numbers of a row, and those that lie in shared memory.
  static constexpr int runs = ceil_div(base_model_of<D>::size, 8);
  static constexpr int each_runs = min_of(shortlist_scratch::each / 8, runs);

  /// Products of all pairs of a tile, and what the bound takes of its rows.
  template <typename Group>
  FT_HOST_DEVICE static void multiply_tile(Group g, shortlist_scratch& s, strip_pair<D> const& in,
                                           int q, int t,
                                           float (&products)[pairs::rows][pairs::columns]) {
    float squares[2] = {}, errors[2] = {};
    for (int first = 0; first < runs; first += each_runs) {
      g.sync();
      load(g, s, in, q, t, first, squares, errors);
      g.sync();
      constexpr bool is_whole = runs % each_runs == 0;
      int const steps = ceil_div(is_whole ? each_runs : min_of(each_runs, runs - first), 2);
      for (int k = 0; k < steps; ++k) { multiply(g, s, 8 * k, products); }
    }
    FT_UNROLL
    for (int of = 0; of < 2; ++of) {
      squares[of] = g.template reduce_lanes<loaders>(squares[of], sum_op{});
      errors[of] = g.template reduce_lanes<loaders>(errors[of], sum_op{});
      if (g.rank() % loaders == 0) {
        s.bounds[of][g.rank() / loaders] = limit::of(squares[of], errors[of]);
      }
    }
    g.sync();
  }
  /// Numbers of the rows of a tile; instead of rows that are not there, the last one. Past the last
  /// run zeros. Of float16 all are read before the first is stored; of others the registers of a
  /// thread hold those of one tile.
  template <typename Group>
  FT_HOST_DEVICE static void load(Group g, shortlist_scratch& s, strip_pair<D> const& in, int q,
                                  int t, int first, float (&squares)[2], float (&errors)[2]) {
    constexpr int turns = ceil_div(each_runs, loaders);
    constexpr bool is_whole = runs % each_runs == 0 && each_runs % loaders == 0;
    constexpr bool of_words = limit::of_halves && base_model_of<D>::size % 8 == 0;
    constexpr int together = of_words ? 2 * turns : turns;
    int const row = g.rank() / loaders, lane = g.rank() % loaders;
    D const& query = in.query[q + min_of(row, in.last_query - q - 1)];
    D const& train = in.train[t + min_of(row, in.last_train - t - 1)];
    FT_UNROLL
    for (int k = 0; k < 2 * turns; k += together) {
      float numbers[together][8] = {};
      rounded_numbers rounded[together] = {};
      FT_UNROLL
      for (int m = 0; m < together; ++m) {
        int const r = first + (k + m) % turns * loaders + lane;
        if (is_whole || r < runs) {
          rounded[m] = limit::read(k + m < turns ? query : train, r, numbers[m]);
        }
      }
      FT_UNROLL
      for (int m = 0; m < together; ++m) {
        int const of = (k + m) / turns;
        FT_UNROLL
        for (int i = 0; i < 8; ++i) {
          limit::add(squares[of], errors[of], numbers[m][i],
                     rounded[m].words[i / 2] >> 16 * (i % 2) & 0xffffu);
        }
        s.rows[of][row][(k + m) % turns * loaders + lane] = rounded[m];
      }
    }
  }
  /// Sixteen numbers of all rows, from a word on, a warp together. What lies in which thread: PTX
  /// ISA, mma.m16n8k16, .f16 and .bf16.
  template <typename Group>
  FT_HOST_DEVICE static void multiply(Group g, shortlist_scratch const& s, int word,
                                      float (&products)[pairs::rows][pairs::columns]) {
    int const row = pairs::row(g.rank(), 0);
    int const at = word + g.rank() % 4;
    auto const word_of = [&](int of, int r, int w) { return s.rows[of][r][w / 4].words[w % 4]; };
    std::uint32_t const a[4] = {word_of(0, row, at), word_of(0, row + 8, at),
                                word_of(0, row, at + 4), word_of(0, row + 8, at + 4)};
    FT_UNROLL
    for (int c = 0; c < pairs::columns; c += 2) {
      int const column = pairs::share(g.rank()) * 32 + c * 4 + g.rank() % 32 / 4;
      std::uint32_t const b[2] = {word_of(1, column, at), word_of(1, column, at + 4)};
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
#define FT_MULTIPLY(TYPE)                                                              \
  asm volatile("mma.sync.aligned.m16n8k16.row.col.f32." TYPE "." TYPE                  \
               ".f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"  \
               : "+f"(products[0][c]), "+f"(products[0][c + 1]), "+f"(products[1][c]), \
                 "+f"(products[1][c + 1])                                              \
               : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]))
      if constexpr (limit::of_halves) {
        FT_MULTIPLY("f16");
      } else {
        FT_MULTIPLY("bf16");
      }
#undef FT_MULTIPLY
#else
      static_cast<void>(a), static_cast<void>(b), static_cast<void>(products);
#endif
    }
  }
  /// Bounds of all pairs of a tile, for the rows and, if Mutual, the columns.
  template <bool Mutual, typename Group>
  FT_HOST_DEVICE static void bound_tile(Group g, shortlist_scratch& s, strip_pair<D> const& in,
                                        int q, int t,
                                        float const (&products)[pairs::rows][pairs::columns],
                                        short_row (&best)[pairs::rows]) {
    FT_UNROLL
    for (int c = 0; c < pairs::columns; ++c) {
      int const column = pairs::column(g.rank(), c);
      row_bound const theirs = s.bounds[1][column];
      auto found = short_column::none();
      FT_UNROLL
      for (int r = 0; r < pairs::rows; ++r) {
        int const row = pairs::row(g.rank(), r);
        float const bound = limit::below(products[r][c], s.bounds[0][row], theirs);
        best[r].add(t + column < in.last_train ? bound : no_distance<float>, t + column);
        if (Mutual) { found.add(q + row < in.last_query ? bound : no_distance<float>, q + row); }
      }
      if (Mutual) {
        s.of_train.kept[pairs::line(g.rank())][column] = found.kept;
        s.of_train.rest[pairs::line(g.rank())][column] = found.rest;
      }
    }
  }
  /// Merges what the threads of a query row found.
  template <typename Group>
  FT_HOST_DEVICE static void keep_of_query(Group g, shortlist_scratch& s, strip_pair<D> const& in,
                                           int q, short_row (&best)[pairs::rows]) {
    bool const is_first = g.rank() % pairs::lanes == 0;
    int const share = pairs::share(g.rank());
    FT_UNROLL
    for (int r = 0; r < pairs::rows; ++r) {
      best[r] = g.template reduce_lanes<pairs::lanes>(best[r], merge_short_rows{});
      if (is_first && share != 0) { s.best[pairs::row(g.rank(), r)] = best[r]; }
    }
    g.sync();
    FT_UNROLL
    for (int r = 0; r < pairs::rows; ++r) {
      int const row = pairs::row(g.rank(), r);
      if (!is_first || share != 0 || q + row >= in.last_query) { continue; }
      short_row const all = merge_short_rows{}(best[r], s.best[row]);
      in.of_query[q + row] = all.kept;
      in.rest_of_query[q + row] = all.rest;
    }
  }
  /// Merges what the train rows of a tile found into what they found in the tiles before.
  template <typename Group>
  FT_HOST_DEVICE static void keep_of_train(Group g, shortlist_scratch const& s,
                                           strip_pair<D> const& in, int q, int t) {
    g.sync();
    int const column = g.rank() / loaders, j = t + column;
    auto all = short_column::none();
    FT_UNROLL
    for (int k = g.rank() % loaders; k < pairs::lines; k += loaders) {
      all = merge_short_columns{}(all, {s.of_train.kept[k][column], s.of_train.rest[k][column]});
    }
    all = g.template reduce_lanes<loaders>(all, merge_short_columns{});
    if (g.rank() % loaders != 0 || j >= in.last_train) { return; }
    if (q != in.first_query) {
      all = merge_short_columns{}(all, {in.of_train[j], in.rest_of_train[j]});
    }
    in.of_train[j] = all.kept;
    in.rest_of_train[j] = all.rest;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
