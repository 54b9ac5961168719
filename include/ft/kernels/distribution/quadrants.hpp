// SPDX-License-Identifier: Apache-2.0
/// @file Shared parts of the rounds that split node by node.
///
/// Such a round splits the nodes of the preceding round that have more than one point, until the
/// list has the wanted number of nodes. The fullest node is first; of equals the one furthest
/// right; of equals again the tie rule decides. The number of splits and of additional nodes before
/// each candidate are sums over the candidates with smaller keys, so all candidates are decided at
/// once.
#pragma once

#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail::quadtree {

/// The state of the list between two rounds that split node by node.
struct list_state {
  int children;  ///< nodes created in the last round; they are at the front
  int size;
};

/// Ascending by points, then by the left edge. Keys have both inverted above `shift` bits.
struct by_points_and_edge {
  int shift;
  template <typename Key>
  FT_HOST_DEVICE bool operator()(Key a, Key b) const {
    return a >> shift > b >> shift;
  }
};

/// Number of non-empty quadrants of a node. @param row of their depth @param total bits of the row
template <typename Index>
FT_HOST_DEVICE int children_of(level_tree<Index> const& t, node_range<Index> node, int row,
                               int total) {
  int const end = node.end < t.n ? t.rank(row, node.end) : total;
  return end - t.rank(row, node.begin);
}

/// Places of the quadrants of a node. The last one created gets place `last - (count - 1)`.
struct quadrant_places {
  int depth;
  int count;
  int last;
};

/// Writes the quadrants of a node. Those of even depths are in the reverse order of their codes,
/// whose bits are inverted there.
template <typename Index>
FT_HOST_DEVICE void write_children(level_tree<Index> const& t, node_range<Index>* list,
                                   node_range<Index> node, int row, quadrant_places to) {
  int begin = node.begin;
  for (int c = 0; c < to.count; ++c) {
    int const end = c + 1 == to.count ? static_cast<int>(node.end) : t.bit_above(row, begin);
    int const creation = to.depth % 2 == 0 ? to.count - 1 - c : c;
    list[to.last - creation] = {static_cast<Index>(begin), static_cast<Index>(end)};
    begin = end;
  }
}

}  // namespace detail::quadtree
}  // namespace FT_ABI
}  // namespace ft
