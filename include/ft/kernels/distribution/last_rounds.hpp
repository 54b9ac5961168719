// SPDX-License-Identifier: Apache-2.0
/// @file A round that splits node by node, for lists of any length. Keys have 64 bits.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/detail/introsort.hpp"
#include "ft/kernels/distribution/level_tree.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail::quadtree {

inline constexpr int key_place_end = 24;  ///< bits of place and gain in a key

/// The key of a node; nodes are split in ascending order of their keys. From the top: 26 bits of
/// points and 14 of the left edge, both inverted, 22 of `place`, which breaks ties, and 2 of the
/// gain, the number of nodes that the split adds to the list.
template <typename Group, typename Index>
FT_HOST_DEVICE unsigned long long split_key(level_work<Group, Index> const& work, int depth,
                                            node_range<Index> node, int place) {
  level_tree<Index> const& t = work.t;
  int const row = work.codes.row_of(depth);
  auto const count = static_cast<unsigned>(node.end - node.begin);
  int const edge = work.codes.left_edge(t.points[t.index_at(node.begin)].x, depth - 1);
  return static_cast<unsigned long long>(0x3ffffffu - count) << 38 |
         static_cast<unsigned long long>(0x3fffu - static_cast<unsigned>(edge)) << key_place_end |
         static_cast<unsigned long long>(place) << 2 |
         static_cast<unsigned long long>(children_of(t, node, row, work.s.totals[row]) - 1);
}

/// Fills the keys of the first `children` nodes. Place and index of a key are those of its node in
/// the list: later nodes are nearer to the front. Nodes of one point come last.
template <typename Group, typename Index>
FT_HOST_DEVICE void make_stable_keys(level_work<Group, Index> const& work, int depth,
                                     int children) {
  level_tree<Index> const& t = work.t;
  for (int i = work.g.rank(); i < children; i += work.g.size()) {
    node_range<Index> const node = t.list[i];
    unsigned long long key = ~0ull << key_place_end | static_cast<unsigned long long>(i) << 2;
    if (node.end - node.begin > 1) { key = split_key(work, depth, node, i); }
    t.node_keys[i] = key;
    t.splits_before[i] = 0;
    t.gain_before[i] = 0;
  }
}

/// The same for nodes of more than one point only, in the order in which introsort leaves them,
/// from the last. `next[k].begin` gets the index of the node that has key k.
template <typename Group, typename Index>
FT_HOST_DEVICE void make_std_sort_keys(level_work<Group, Index> const& work, int depth,
                                       int children) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  int n = 0;
  for (int base = 0; base < children; base += g.size()) {
    int const i = base + g.rank();
    node_range<Index> node{0, 0};
    if (i < children) { node = t.list[i]; }
    int more = 0;
    int const at = n + g.exclusive_count(node.end - node.begin > 1, more);
    if (node.end - node.begin > 1) { t.node_keys[at] = split_key(work, depth, node, i); }
    n += more;
  }
  introsort_partitions(g, reversed_array<unsigned long long>{t.node_keys, n}, n,
                       by_points_and_edge{key_place_end},
                       introsort_workspace<node_range<Index>, int>{t.next, t.splits_before,
                                                                   t.gain_before, work.s.open});
  g.sync();
  for (int i = g.rank(); i < children; i += g.size()) {
    t.splits_before[i] = 0;
    t.gain_before[i] = 0;
  }
  constexpr unsigned long long places = (1ull << key_place_end) - 4;
  for (int k = g.rank(); k < n; k += g.size()) {
    unsigned long long const key = t.node_keys[k];
    t.next[k].begin = static_cast<Index>((key & places) >> 2);
    t.node_keys[k] = (key & ~places) | static_cast<unsigned long long>(k) << 2;
  }
}

/// Index of the node that has key k, if keys were made in the order of their places.
template <tie_rule Ties, typename Index>
FT_HOST_DEVICE int node_of_key(level_tree<Index> const& t, int k) {
  return Ties == tie_rule::stable ? k : static_cast<int>(t.next[k].begin);
}

/// Fills `splits_before` and `gain_before` by comparing all pairs of n keys. A warp compares 32
/// keys with 16 others at a time.
template <tie_rule Ties, typename Group, typename Index>
FT_HOST_DEVICE void rank_splits(Group g, level_tree<Index> const& t, int n) {
  constexpr int keys = 16;
  auto const part = g.part();
  int const columns = ceil_div(n, keys);
  int const tiles = columns * ceil_div(n, 32);
  for (int tile = g.part_index(); tile < tiles; tile += g.parts()) {
    int const row = tile / columns;
    int const first = (tile - row * columns) * keys;
    int const end = min_of(first + keys, n);
    for (int k = part.rank(); k < 32; k += part.size()) {
      int const i = 32 * row + k;
      if (i >= n) { break; }
      unsigned long long const key = t.node_keys[i];
      int splits = 0;
      int gain = 0;
      for (int j = first; j < end; ++j) {
        unsigned long long const other = t.node_keys[j];
        if (other < key) {
          ++splits;
          gain += static_cast<int>(other & 3);
        }
      }
      int const node = node_of_key<Ties>(t, i);
      atomic_add(t.splits_before + node, splits);
      atomic_add(t.gain_before + node, gain);
    }
  }
}

/// The same by sorting the keys.
template <tie_rule Ties, typename Group, typename Index>
FT_HOST_DEVICE void sort_splits(Group g, level_tree<Index> const& t, int n) {
  g.sort(t.node_keys, n);
  int gained = 0;
  for (int base = 0; base < n; base += g.size()) {
    int const i = base + g.rank();
    unsigned long long const key = i < n ? t.node_keys[i] : 0;
    int total = 0;
    int const before = g.exclusive_scan(static_cast<int>(key & 3), total);
    if (i < n) {
      int const node = node_of_key<Ties>(t, static_cast<int>(key >> 2 & 0x3fffff));
      t.splits_before[node] = i;
      t.gain_before[node] = gained + before;
    }
    gained += total;
  }
}

/// Whether node i of the list is split in this round.
template <typename Index>
FT_HOST_DEVICE bool is_split(level_tree<Index> const& t, int i, list_state const& list,
                             int wanted) {
  return i < list.children && t.list[i].end - t.list[i].begin > 1 &&
         list.size + t.gain_before[i] < wanted;
}

/// Writes the next list: the new nodes, the last one first, then the nodes that are not split.
/// @return the state of that list
template <typename Group, typename Index>
FT_HOST_DEVICE list_state write_next_list(level_work<Group, Index> const& work, int depth,
                                          int wanted, list_state const& list) {
  Group const g = work.g;
  level_tree<Index> const& t = work.t;
  int const row = work.codes.row_of(depth);
  int const heads = work.s.totals[row];
  int stayed = 0;
  int made = 0;
  for (int base = 0; base < list.size; base += g.size()) {
    int const i = base + g.rank();
    bool const splits = is_split(t, i, list, wanted);
    bool const stays = i < list.size && !splits;
    int total = 0;
    int const rank = g.exclusive_scan(static_cast<int>(stays), total);
    made = work.s.made;
    if (stays) { t.next[made + stayed + rank] = t.list[i]; }
    if (splits) {
      node_range<Index> const node = t.list[i];
      write_children(t, t.next, node, row,
                     {depth, children_of(t, node, row, heads),
                      made - 1 - t.splits_before[i] - t.gain_before[i]});
    }
    stayed += total;
  }
  return {made, made + stayed};
}

/// One round. Advances `list`; exchanges `t.list` and `t.next`.
template <tie_rule Ties, typename Group, typename Index>
FT_HOST_DEVICE void split_nodes(level_work<Group, Index> const& work, int depth, int wanted,
                                list_state& list) {
  Group const g = work.g;
  scratch& s = work.s;
  level_tree<Index>& t = work.t;
  node_codes const& codes = work.codes;
  int const row = codes.row_of(depth);
  int const heads = s.totals[row];
  int const multiple = list.size - s.totals[codes.rows + codes.row_of(depth - 1)];
  int keys = list.children;
  if constexpr (Ties == tie_rule::stable) {
    make_stable_keys(work, depth, list.children);
  } else {
    make_std_sort_keys(work, depth, list.children);
    keys = multiple;
  }
  if (g.rank() == 0) { s.made = 0; }
  g.sync();
  if (g.size() > 1 && keys <= ranked_nodes) {
    rank_splits<Ties>(g, t, keys);
  } else {
    sort_splits<Ties>(g, t, keys);
  }
  g.sync();
  // The last node to be split gives the number of nodes created.
  for (int i = g.rank(); i < list.children; i += g.size()) {
    if (!is_split(t, i, list, wanted)) { continue; }
    int const gained = t.gain_before[i] + children_of(t, t.list[i], row, heads) - 1;
    if (list.size + gained >= wanted || t.splits_before[i] + 1 == multiple) {
      s.made = t.splits_before[i] + 1 + gained;
    }
  }
  list = write_next_list(work, depth, wanted, list);
  if (g.rank() == 0) { s.candidates = 0; }
  g.sync();
  node_range<Index>* const swap = t.list;
  t.list = t.next;
  t.next = swap;
}

}  // namespace detail::quadtree
}  // namespace FT_ABI
}  // namespace ft
