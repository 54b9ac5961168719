// SPDX-License-Identifier: Apache-2.0
/// @file Sorts the points of a level by their codes.
///
/// A counting sort by the leading bits of the codes, then a rank within each bin by counting the
/// smaller keys of the bin. Keys are (code, index), so they are distinct. A level with a crowded
/// bin is sorted by comparison. Written by hand: the number of points, 0 to about 18,000, is known
/// only at run time, but the library sorts of a block have a fixed size.
#pragma once

#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {

// The bins of the sort by code: clearing, and the prefix sum of their counts.

namespace detail::quadtree {

template <typename Group>
FT_HOST_DEVICE void clear_bins(Group g, int* bins, int n) {
  for (int i = g.rank(); i < n; i += g.size()) { bins[i] = 0; }
}

/// scan_bins() by one thread.
FT_HOST_DEVICE inline void scan_bins_alone(scratch& s, int* bins, int n) {
  int at = 0;
  for (int i = 0; i < n; ++i) {
    int const count = bins[i];
    if (count > crowded_bin) { s.crowded = 1; }
    bins[i] = at;
    at += count;
  }
}

/// scan_bins() by a block. A thread keeps its counts in registers, in quads that it loads at once;
/// the quads of a warp are consecutive.
/// @tparam Each most quads of a thread
template <int Each, typename Group>
FT_HOST_DEVICE void scan_quads(Group g, scratch& s, int* bins, int n) {
  struct alignas(16) quad {
    int of[4];
  };
  auto* const quads = reinterpret_cast<quad*>(bins);
  auto const part = g.part();
  int const width = part.size();
  int const chunk = ceil_div(n, g.parts());
  int const first = g.part_index() * chunk;
  int const end = min_of(first + chunk, n);
  quad q[Each];
  int sum[Each];
  int all = 0;
  int most = 0;
  FT_UNROLL
  for (int k = 0; k < Each; ++k) {
    int const i = first + k * width + part.rank();
    q[k] = {};
    if (i < end) { q[k] = quads[i]; }
    sum[k] = q[k].of[0] + q[k].of[1] + q[k].of[2] + q[k].of[3];
    all += sum[k];
    most = max_of(max_of(most, max_of(q[k].of[0], q[k].of[1])), max_of(q[k].of[2], q[k].of[3]));
  }
  if (most > crowded_bin) { s.crowded = 1; }
  int total = 0;
  int at = g.exclusive_scan(all, total);
  if constexpr (Each > 1) {
    int warp_at = part.shuffle(at, 0);
    FT_UNROLL
    for (int k = 0; k < Each; ++k) {
      sum[k] = part.exclusive_scan(sum[k], total) + warp_at;
      warp_at += total;
    }
  } else {
    sum[0] = at;
  }
  FT_UNROLL
  for (int k = 0; k < Each; ++k) {
    int const i = first + k * width + part.rank();
    at = sum[k];
    FT_UNROLL
    for (int& count : q[k].of) {
      int const here = count;
      count = at;
      at += here;
    }
    if (i < end) { quads[i] = q[k]; }
  }
}

/// Replaces the counts of n bins by the sums of the lower ones, and sets `s.crowded` if a bin has
/// more than `crowded_bin` points. @param bins up to the next multiple of 4
template <typename Group>
FT_HOST_DEVICE void scan_bins(Group g, scratch& s, int* bins, int n) {
  int const quads = ceil_div(n, 4);
  if constexpr (Group::max_threads == 1) {
    scan_bins_alone(s, bins, 4 * quads);
  } else {
    constexpr int most_quads = more_bins / 4 / Group::max_threads;
    static_assert(4 * most_quads * Group::max_threads == more_bins, "whole quads");
    if (quads > g.size()) {
      scan_quads<most_quads>(g, s, bins, quads);
    } else {
      scan_quads<1>(g, s, bins, quads);
    }
  }
}

}  // namespace detail::quadtree

namespace detail::quadtree {

/// Fills a table with the codes of all columns, followed by those of all rows.
template <typename Group>
FT_HOST_DEVICE void fill_code_table(Group g, node_codes const& codes, unsigned* table) {
  for (int i = g.rank(); i < codes.width + codes.height; i += g.size()) {
    table[i] = i < codes.width ? codes.column_code(i) : codes.row_code(i - codes.width);
  }
}

inline constexpr int rank_bits = 12;  ///< of a point's rank in its bin, below its code

/// State of a thread's held points: code << rank_bits | rank in the bin.
template <int Held>
struct held_codes {
  unsigned of[max_of(Held, 1)];

  /// Whether codes and ranks fit, and all points are held.
  template <typename Group, typename Index>
  FT_HOST_DEVICE static bool fit(level_work<Group, Index> const& work) {
    node_codes const& codes = work.codes;
    int const most = Held * work.g.size();
    return Held > 0 && most <= 1 << rank_bits && work.t.n <= most &&
           static_cast<unsigned long long>(codes.roots) << 2 * codes.depths <=
               1u << (32 - rank_bits);
  }
};

/// Counts the held points into their bins. The loops are separate, so that no point waits for the
/// loads of another.
template <int Held, typename Group, typename Index>
FT_HOST_DEVICE void count_held(level_work<Group, Index> const& work,
                               held_points<Held> const& points, held_codes<Held>& held) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  node_codes const& codes = work.codes;
  unsigned const* const table = t.order;
  auto const is_point = [&](int k) { return g.rank() + k * g.size() < t.n; };
  int rank[max_of(Held, 1)] = {};
  FT_UNROLL
  for (int k = 0; k < Held; ++k) {
    int const x = is_point(k) ? corner_of(points.words[k]).x : 0;
    int const y = is_point(k) ? corner_of(points.words[k]).y : 0;
    held.of[k] = table[x] ^ table[codes.width + y];
  }
  FT_UNROLL
  for (int k = 0; k < Held; ++k) {
    if (is_point(k)) { rank[k] = atomic_add(t.bins + (held.of[k] >> codes.bin_shift), 1); }
  }
  if (t.copy != nullptr) {
    FT_UNROLL
    for (int k = 0; k < Held; ++k) {
      if (is_point(k)) { t.copy[g.rank() + k * g.size()] = corner_of(points.words[k]); }
    }
  }
  FT_UNROLL
  for (int k = 0; k < Held; ++k) {
    held.of[k] = held.of[k] << rank_bits | static_cast<unsigned>(rank[k]);
  }
}

/// Moves the keys of the held points to their bins.
template <int Held, typename Group, typename Index>
FT_HOST_DEVICE void place_held(level_work<Group, Index> const& work, held_codes<Held> const& held) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  int begin[max_of(Held, 1)];
  FT_UNROLL
  for (int k = 0; k < Held; ++k) {
    begin[k] = t.bins[held.of[k] >> rank_bits >> work.codes.bin_shift];
  }
  FT_UNROLL
  for (int k = 0; k < Held; ++k) {
    int const i = g.rank() + k * g.size();
    if (i < t.n) {
      int const rank = static_cast<int>(held.of[k] & ((1u << rank_bits) - 1));
      t.keys[begin[k] + rank] =
          static_cast<unsigned long long>(held.of[k] >> rank_bits) << 32 | static_cast<unsigned>(i);
    }
  }
}

inline constexpr int sort_batch = 4;  ///< loads of a thread in flight together

/// Counts points from memory into their bins. Without tables it leaves their codes in `t.order`.
template <typename Group, typename Index>
FT_HOST_DEVICE void count_points(level_work<Group, Index> const& work, bool tables) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  node_codes const& codes = work.codes;
  unsigned* const table = t.order;
  auto const code_of = [&](corner const& p) {
    return tables ? table[p.x] ^ table[codes.width + p.y]
                  : codes.column_code(p.x) ^ codes.row_code(p.y);
  };
  for (int base = g.rank(); base < t.n; base += sort_batch * g.size()) {
    corner p[sort_batch];
    FT_UNROLL
    for (int k = 0; k < sort_batch; ++k) { p[k] = t.points[min_of(base + k * g.size(), t.n - 1)]; }
    FT_UNROLL
    for (int k = 0; k < sort_batch; ++k) {
      int const i = base + k * g.size();
      if (i < t.n) {
        unsigned const code = code_of(p[k]);
        if (!tables) { t.order[i] = code; }
        if (t.copy != nullptr) { t.copy[i] = p[k]; }
        atomic_add(t.bins + (code >> codes.bin_shift), 1);
      }
    }
  }
}

/// Moves the keys of these points to their bins, whose starts become their ends.
template <typename Group, typename Index>
FT_HOST_DEVICE void place_points(level_work<Group, Index> const& work, bool tables) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  unsigned const* const table = t.order;
  for (int base = g.rank(); base < t.n; base += sort_batch * g.size()) {
    unsigned code[sort_batch];
    FT_UNROLL
    for (int k = 0; k < sort_batch; ++k) {
      int const i = min_of(base + k * g.size(), t.n - 1);
      corner const p = t.points[i];
      code[k] = tables ? table[p.x] ^ table[work.codes.width + p.y] : t.order[i];
    }
    FT_UNROLL
    for (int k = 0; k < sort_batch; ++k) {
      int const i = base + k * g.size();
      if (i < t.n) {
        int const to = atomic_add(t.bins + (code[k] >> work.codes.bin_shift), 1);
        t.keys[to] = static_cast<unsigned long long>(code[k]) << 32 | static_cast<unsigned>(i);
      }
    }
  }
}

/// Fills `order` from keys that are in their bins. The place of a point in its bin is the number of
/// smaller keys, the largest of which is that of its predecessor.
/// @param ends whether `bins` has the ends of bins rather than their starts
template <typename Group, typename Index>
FT_HOST_DEVICE void order_within_bins(level_work<Group, Index> const& work, bool ends) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  node_codes const& codes = work.codes;
  int const* const bins = t.bins;
  bool const compare = work.s.crowded != 0;
  if (compare) { g.sort(t.keys, t.n); }
  for (int p = g.rank(); p < t.n; p += g.size()) {
    unsigned long long const key = t.keys[p];
    unsigned const code = static_cast<unsigned>(key >> 32);
    unsigned const bin = code >> codes.bin_shift;
    int const at = static_cast<int>(bin) - (ends ? 1 : 0);
    int const bin_begin = compare ? p : at >= 0 ? bins[at] : 0;
    int const bin_end = compare ? p : at + 1 < codes.bins ? bins[at + 1] : t.n;
    int to = bin_begin;
    auto previous = bin_begin > 0 ? static_cast<unsigned>(t.keys[bin_begin - 1] >> 32) : 0u;
    for (int q = bin_begin; q < bin_end; ++q) {
      unsigned long long const other = t.keys[q];
      bool const smaller = other < key;
      to += static_cast<int>(smaller);
      previous = max_of(previous, smaller ? static_cast<unsigned>(other >> 32) : 0u);
    }
    int const depth = to == 0 ? 0 : codes.parting_depth(previous, code);
    t.order[to] =
        static_cast<unsigned>(depth) << t.index_bits | static_cast<unsigned>(key & t.index_mask);
  }
}

/// Fills `order`: the points by (code, index). @param points the first points of each thread
template <int Held, typename Group, typename Index>
FT_HOST_DEVICE void sort_by_code(level_work<Group, Index> const& work,
                                 held_points<Held> const& points) {
  Group const g = work.g;
  level_tree<Index>& t = work.t;
  node_codes const& codes = work.codes;
  // Tables of codes occupy the memory of `order`, which is filled later. They are worthwhile unless
  // there are few points.
  int const sides = codes.width + codes.height;
  bool const tables = sides <= t.order_size && (t.prepared || sides < 2 * t.n);
  if (!t.prepared) {
    clear_bins(g, t.bins, ceil_div(codes.bins, 4) * 4);
    if (tables) { fill_code_table(g, codes, t.order); }
  }
  t.prepared = false;  // for a repetition with more depths
  if (g.rank() == 0) { work.s.crowded = 0; }
  g.sync();
  held_codes<Held> held{};
  bool const holds = tables && held_codes<Held>::fit(work);
  if (holds) {
    count_held(work, points, held);
  } else {
    count_points(work, tables);
  }
  g.sync();
  if (t.copy != nullptr) {
    t.points = t.copy;
    t.copy = nullptr;
  }
  scan_bins(g, work.s, t.bins, codes.bins);
  g.sync();
  if (holds) {
    place_held(work, held);
  } else {
    place_points(work, tables);
  }
  g.sync();
  order_within_bins(work, !holds);
  g.sync();
}

}  // namespace detail::quadtree

}  // namespace FT_ABI
}  // namespace ft
