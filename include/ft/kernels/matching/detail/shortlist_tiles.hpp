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
  static constexpr int each = 64;  ///< numbers of a row at a time
  /// Four words more, so that the eight rows that a warp reads lie in different banks.
  std::uint32_t rows[2][match_side][each / 2 + 4];
  row_bound bounds[2][match_side];
  short_row best[match_side];
  nearest_row<float> of_train[pairs_of_mma::lines][match_side + 4];
  float rest_of_train[pairs_of_mma::lines][match_side + 4];
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
        bound_tile(g, s, in, q, t, products, best);
      }
      keep_of_query(g, s, in, q, best);
    }
  }

private:
  using reader = row_parts<D>;
  using pairs = pairs_of_mma;
  using limit = lower_bound<D, base_model_of<D>>;
  /// Threads that load a row together, and the parts of a row that lie in shared memory.
  static constexpr int loaders = match_threads / match_side;
  static constexpr int each_parts = shortlist_scratch::each / 4;

  /// Products of all pairs of a tile, and what the bound takes of its rows.
  template <typename Group>
  FT_HOST_DEVICE static void multiply_tile(Group g, shortlist_scratch& s, strip_pair<D> const& in,
                                           int q, int t,
                                           float (&products)[pairs::rows][pairs::columns]) {
    float squares[2] = {}, errors[2] = {};
    for (int first = 0; first < reader::parts; first += each_parts) {
      g.sync();
      load(g, s.rows[0], in.query + q, in.last_query - q, first, squares[0], errors[0]);
      load(g, s.rows[1], in.train + t, in.last_train - t, first, squares[1], errors[1]);
      g.sync();
      int const steps = ceil_div(min_of(each_parts, reader::parts - first), 4);
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
  /// Parts of 64 rows; instead of rows that are not there, the last one. Past the last part zeros.
  template <typename Group>
  FT_HOST_DEVICE static void load(Group g,
                                  std::uint32_t (&to)[match_side][shortlist_scratch::each / 2 + 4],
                                  D const* rows, int count, int first, float& squares,
                                  float& errors) {
    int const row = g.rank() / loaders;
    D const& mine = rows[min_of(row, count - 1)];
    FT_UNROLL
    for (int k = 0; k < each_parts / loaders; ++k) {
      int const p = k * loaders + g.rank() % loaders;
      typename reader::part v{};
      if (reader::parts % each_parts == 0 || first + p < reader::parts) {
        v = reader::part_of(mine, first + p);
      }
      FT_UNROLL
      for (int w = 0; w < 2; ++w) {
        std::uint32_t const both = limit::rounded(v.of[2 * w], v.of[2 * w + 1]);
        limit::add(squares, errors, v.of[2 * w], both & 0xffffu);
        limit::add(squares, errors, v.of[2 * w + 1], both >> 16);
        to[row][2 * p + w] = both;
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
    std::uint32_t const a[4] = {s.rows[0][row][at], s.rows[0][row + 8][at], s.rows[0][row][at + 4],
                                s.rows[0][row + 8][at + 4]};
    FT_UNROLL
    for (int c = 0; c < pairs::columns; c += 2) {
      int const column = pairs::share(g.rank()) * 32 + c * 4 + g.rank() % 32 / 4;
      std::uint32_t const b[2] = {s.rows[1][column][at], s.rows[1][column][at + 4]};
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
  /// Bounds of all pairs of a tile, for the rows and, where asked for, the columns.
  template <typename Group>
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
        found.add(q + row < in.last_query ? bound : no_distance<float>, q + row);
      }
      if (in.of_train != nullptr) {
        s.of_train[pairs::line(g.rank())][column] = found.kept;
        s.rest_of_train[pairs::line(g.rank())][column] = found.rest;
      }
    }
    if (in.of_train != nullptr) { keep_of_train(g, s, in, q, t); }
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
      all = merge_short_columns{}(all, {s.of_train[k][column], s.rest_of_train[k][column]});
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
