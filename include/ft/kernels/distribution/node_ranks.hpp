// SPDX-License-Identifier: Apache-2.0
/// @file Marks the first point of every node at every depth, and counts these marks.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {

// The rounds that split every node: their number, and the resulting list.

namespace detail::quadtree {

/// Numbers of rounds, counted from 1.
struct round_counts {
  int whole;  ///< last round that splits every node in list order
  int last;   ///< last round; those after `whole` split node by node. 0 = more depths are needed
};

/// The length of the list after a round is the number of nodes at its depth: every round but the
/// last splits every node with more than one point, even if it goes node by node.
/// @param totals bits of the rows, from count_heads()
FT_HOST_DEVICE inline round_counts count_rounds(node_codes const& codes, int const* totals,
                                                int wanted) {
  int const* const alone = totals + codes.rows;
  int whole = 0;
  int before = totals[0];
  for (int round = 1; codes.complete || round <= codes.depths; ++round) {
    int const row = codes.row_of(round);
    int const size = totals[row];
    bool const done = size >= wanted || size <= before;
    if (whole == 0 && (done || size + 3 * (size - alone[row]) > wanted)) { whole = round; }
    if (done) { return {whole, round}; }
    before = size;
  }
  return {0, 0};
}

/// Writes the list after `whole` rounds that split every node; a thread per node. The nodes created
/// in the last round come first, then the nodes of one point created in the preceding round, and so
/// on. Nodes of one round are in the order of their codes, descending if the round is odd.
/// @return number of nodes created in the last round
template <typename Group, typename Index>
FT_HOST_DEVICE int list_nodes(level_work<Group, Index> const& work, int whole) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  node_codes const& codes = work.codes;
  int const* const totals = work.s.totals;
  int const* const alone = totals + codes.rows;
  int const size = totals[codes.row_of(whole)];
  int const alone_before = alone[codes.row_of(whole - 1)];
  int const children = size - alone_before;
  if (g.rank() == 0) { work.s.candidates = 0; }
  for (int i = g.rank(); i < size; i += g.size()) {
    int const begin = t.select(codes.row_of(whole), i);
    int const end = t.bit_above(codes.row_of(whole), begin);
    // A node of one point was created when the point parted from both of its neighbours.
    int const round =
        end - begin == 1 ? min_of(max_of(t.depth_at(begin), t.depth_at(end)), whole) : whole;
    int first = 0;
    int count = children;
    int rank = i - t.rank(codes.rows + codes.row_of(whole - 1), begin);
    if (round < whole) {
      int const up_to = alone[round];
      int const sooner = round > 0 ? alone[round - 1] : 0;
      first = children + alone_before - up_to;
      count = up_to - sooner;
      rank = t.rank(codes.rows + round, begin) -
             (round > 0 ? t.rank(codes.rows + round - 1, begin) : 0);
    }
    t.list[first + (round % 2 == 0 ? rank : count - 1 - rank)] = {static_cast<Index>(begin),
                                                                  static_cast<Index>(end)};
  }
  g.sync();
  return children;
}

}  // namespace detail::quadtree

namespace detail::quadtree {

/// Writes word w of a node row and of the row of nodes with a single point.
template <typename Index>
struct row_writer {
  level_tree<Index> const& t;
  int rows;
  int w;
  int following;  ///< parting depth of the first point after the word
  unsigned end;   ///< the bit after the last point

  FT_HOST_DEVICE row_writer(level_tree<Index> const& tree, int row_count, int word)
      : t(tree),
        rows(row_count),
        w(word),
        following(tree.depth_at(32 * word + 32)),
        end(tree.n < 32 * word + 32 ? 1u << (tree.n & 31) : 0) {}
  FT_HOST_DEVICE void operator()(int k, unsigned heads) const {
    t.rows[k * t.words + w] = heads;
    t.rows[(rows + k) * t.words + w] =
        heads & ((heads | end) >> 1 | static_cast<unsigned>(following <= k) << 31);
  }
};

/// Fills the rows. A warp takes 32 points: five ballots give the bits of their depths, from which
/// each lane computes one row.
template <typename Group, typename Index>
FT_HOST_DEVICE void mark_heads(level_work<Group, Index> const& work) {
  constexpr int planes = 5;
  constexpr int never = node_codes::never;
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  int const rows = work.codes.rows;
  auto const part = g.part();
  for (int w = g.part_index(); w < t.words; w += g.parts()) {
    row_writer<Index> const write(t, rows, w);
    if constexpr (Group::max_threads == 1) {
      unsigned parted[never + 1] = {};
      for (int p = 32 * w; p < min_of(32 * w + 32, t.n); ++p) {
        parted[t.depth_at(p)] |= 1u << (p & 31);
      }
      unsigned heads = 0;
      for (int k = 0; k < rows; ++k) { write(k, heads |= parted[k]); }
      continue;
    }
    unsigned plane[planes] = {};
    for (int base = 0; base < 32; base += part.size()) {
      int const p = 32 * w + base + part.rank();
      unsigned const depth = p < t.n ? t.order[p] >> t.index_bits : static_cast<unsigned>(never);
      FT_UNROLL
      for (int b = 0; b < planes; ++b) { plane[b] |= part.ballot((depth >> b & 1) != 0) << base; }
    }
    // A point is the first of its node at depth k if its parting depth is at most k.
    for (int k = part.rank(); k < rows; k += part.size()) {
      unsigned less = 0;
      unsigned equal = ~0u;
      FT_UNROLL
      for (int b = planes - 1; b >= 0; --b) {
        unsigned const bit = 0u - (static_cast<unsigned>(k) >> b & 1);
        less |= equal & bit & ~plane[b];
        equal &= ~(bit ^ plane[b]);
      }
      write(k, less | equal);
    }
  }
  g.sync();
}

/// Counts the bits of the rows: below each word, and of each row in `totals`. A warp takes a row.
template <typename Group, typename Index>
FT_HOST_DEVICE void count_heads(level_work<Group, Index> const& work) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  auto const part = g.part();
  int const chunk = ceil_div(t.words, part.size());
  int const first = min_of(part.rank() * chunk, t.words);
  int const end = min_of(first + chunk, t.words);
  for (int row = g.part_index(); row < 2 * work.codes.rows; row += g.parts()) {
    unsigned const* const bits = t.rows + row * t.words;
    Index* const before = t.before + row * t.words;
    int sum = 0;
    for (int w = first; w < end; ++w) {
      before[w] = static_cast<Index>(sum);
      sum += popcount(bits[w]);
    }
    int total = 0;
    int const at = part.exclusive_scan(sum, total);
    for (int w = first; w < end && at > 0; ++w) { before[w] = static_cast<Index>(before[w] + at); }
    if (part.rank() == 0) { work.s.totals[row] = total; }
  }
  g.sync();
}

}  // namespace detail::quadtree

}  // namespace FT_ABI
}  // namespace ft
