// SPDX-License-Identifier: Apache-2.0
/// @file The rounds that split every node: their number, and the resulting list.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {
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
}  // namespace FT_ABI
}  // namespace ft
