// SPDX-License-Identifier: Apache-2.0
/// @file A round that splits node by node, for lists of up to one node per thread. Each thread
/// keeps its node in registers, and keys have 32 bits.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/detail/introsort.hpp"
#include "ft/kernels/distribution/level_tree.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail::quadtree {

/// Keys of 32 bits, from the top: points and left edge, both inverted, place, gain. The wider the
/// level, the fewer bits are left for points: 127 points fit with 16384 columns, 2047 with 1024.
struct packed_keys {
  static constexpr int gain_bits = 2;
  static constexpr int place_bits = 9;
  static constexpr unsigned gain_mask = (1u << gain_bits) - 1;
  static constexpr unsigned place_mask = (1u << place_bits) - 1;
  /// Added to the number of candidates for those with too many points.
  static constexpr int large_node = 1 << 16;
  static_assert(scratch_nodes <= 1 << place_bits, "places of nodes");

  int edge_bits = 1;
  int count_shift;
  unsigned most_points;

  FT_HOST_DEVICE explicit packed_keys(int width) {
    while (1 << edge_bits < width) { ++edge_bits; }
    count_shift = gain_bits + place_bits + edge_bits;
    most_points = ~0u >> count_shift;
  }
  FT_HOST_DEVICE unsigned key(unsigned points, int edge, int place, int gain) const {
    return (most_points - min_of(points, most_points)) << count_shift |
           static_cast<unsigned>((1 << edge_bits) - 1 - edge) << (gain_bits + place_bits) |
           static_cast<unsigned>(place) << gain_bits | static_cast<unsigned>(gain);
  }
};

/// The node of a thread, and its key if it can be split.
template <typename Index>
struct own_node {
  node_range<Index> node;
  unsigned points;
  bool candidate;
  int count = 0;  ///< quadrants
  unsigned key = 0;
};

template <typename Group, typename Index>
FT_HOST_DEVICE own_node<Index> take_own_node(level_work<Group, Index> const& work,
                                             packed_keys const& format, int depth,
                                             list_state const& list) {
  level_tree<Index> const& t = work.t;
  int const i = work.g.rank();
  node_range<Index> node{0, 0};
  if (i < list.size) { node = t.list[i]; }
  auto const points = static_cast<unsigned>(node.end - node.begin);
  own_node<Index> own{node, points, i < list.children && points > 1};
  if (own.candidate) {
    int const row = work.codes.row_of(depth);
    own.count = children_of(t, node, row, work.s.totals[row]);
    int const edge = work.codes.left_edge(t.points[t.index_at(node.begin)].x, depth - 1);
    own.key = format.key(points, edge, i, own.count - 1);
  }
  return own;
}

/// Writes the keys of the candidates to shared memory, padded to whole quads. Keys contain their
/// nodes' places, so they may be in any order. Ends with a sync().
/// @return false if a node has too many points for a key
template <tie_rule Ties, typename Group, typename Index>
FT_HOST_DEVICE bool write_packed_keys(level_work<Group, Index> const& work,
                                      own_node<Index> const& own, unsigned most_points,
                                      int candidates, int size) {
  constexpr int large_node = packed_keys::large_node;
  Group const g = work.g;
  scratch& s = work.s;
  unsigned* const keys = s.b.packed.keys;
  auto const part = g.part();
  int const i = g.rank();
  int of_part = 0;
  int const in_part = part.exclusive_count(own.candidate, of_part);
  int const large = part.any(own.candidate && own.points > most_points) ? large_node : 0;
  int first = 0;
  if (part.rank() == 0 && of_part > 0) { first = atomic_add(&s.candidates, of_part + large); }
  first = part.shuffle(first, 0) & (large_node - 1);
  int at = first + in_part;
  if constexpr (Ties == tie_rule::std_sort) {  // in the order of their nodes
    int all = 0;
    at = g.exclusive_count(own.candidate, all);
  }
  if (own.candidate) { keys[at] = own.key; }
  if (i >= candidates && i < ceil_div(candidates, 4) * 4) { keys[i] = ~0u; }
  if (i < size) { s.b.packed.before[i] = 0; }
  if (i == 0) { s.made = 0; }
  g.sync();
  return s.candidates < large_node;
}

/// Permutes the packed keys, which are in the order of their nodes, into the order in which
/// introsort leaves them, from the last. Their indices become their places; `left[i]` gets the
/// place of node i.
template <typename Group, typename Index>
FT_HOST_DEVICE void place_as_std_sort(level_work<Group, Index> const& work, int n) {
  using format = packed_keys;
  Group const g = work.g;
  auto& packed = work.s.b.packed;
  introsort_partitions(g, reversed_array<unsigned>{packed.keys, n}, n,
                       by_points_and_edge{format::gain_bits + format::place_bits},
                       introsort_workspace<node_range<Index>, std::uint16_t>{
                           work.t.next, packed.left, packed.right, work.s.open});
  g.sync();
  constexpr unsigned places = format::place_mask << format::gain_bits;
  for (int k = g.rank(); k < n; k += g.size()) {
    unsigned const key = packed.keys[k];
    packed.left[(key & places) >> format::gain_bits] = static_cast<std::uint16_t>(k);
    packed.keys[k] = (key & ~places) | static_cast<unsigned>(k) << format::gain_bits;
  }
  g.sync();
}

/// For each key: sums the splits that precede it and, in the lower half, their gain. A warp
/// compares 32 keys with a part of all keys.
template <typename Group>
FT_HOST_DEVICE void rank_packed(Group g, scratch& s, int n) {
  struct alignas(16) quad {
    unsigned of[4];
  };
  if (n == 0) { return; }
  auto const part = g.part();
  auto const* const quads = reinterpret_cast<quad const*>(s.b.packed.keys);
  int const all = ceil_div(n, 4);
  int const rows = ceil_div(n, 32);
  int const columns = max_of(g.parts() / rows, 1);
  int const each = ceil_div(all, columns);
  for (int tile = g.part_index(); tile < rows * columns; tile += g.parts()) {
    int const row = tile / columns;
    int const from = (tile - row * columns) * each;
    int const to = min_of(from + each, all);
    for (int k = 32 * row + part.rank(); k < min_of(32 * row + 32, n); k += part.size()) {
      unsigned const key = s.b.packed.keys[k];
      unsigned sum = 0;
      for (int j = from; j < to; ++j) {
        quad const q = quads[j];
        FT_UNROLL
        for (unsigned const other : q.of) {
          sum += other < key ? (other & packed_keys::gain_mask) | 1u << 16 : 0u;
        }
      }
      atomic_add(s.b.packed.before + (key >> packed_keys::gain_bits & packed_keys::place_mask),
                 static_cast<int>(sum));
    }
  }
}

/// One round, in place. Advances `list`.
/// @return false, with nothing changed, if the list has too many nodes or a node has too many
///   points
template <tie_rule Ties, typename Group, typename Index>
FT_HOST_DEVICE bool split_packed(level_work<Group, Index> const& work, int depth, int wanted,
                                 list_state& list) {
  Group const g = work.g;
  scratch& s = work.s;
  level_tree<Index> const& t = work.t;
  node_codes const& codes = work.codes;
  if (g.size() == 1 || list.size > min_of(g.size(), scratch_nodes)) { return false; }
  int const i = g.rank();
  int const size = list.size;
  int const candidates = size - s.totals[codes.rows + codes.row_of(depth - 1)];
  packed_keys const format(codes.width);
  own_node<Index> const own = take_own_node(work, format, depth, list);
  if (!write_packed_keys<Ties>(work, own, format.most_points, candidates, size)) { return false; }
  int place = i;
  if constexpr (Ties == tie_rule::std_sort) {
    place_as_std_sort(work, candidates);
    if (own.candidate) { place = s.b.packed.left[i]; }
  }
  rank_packed(g, s, candidates);
  g.sync();
  // The last node to be split gives the number of nodes created.
  int const* const before = s.b.packed.before;
  int const splits_before = i < size ? before[place] >> 16 : 0;
  int const gain_before = i < size ? before[place] & 0xffff : 0;
  bool const splits = own.candidate && size + gain_before < wanted;
  if (splits) {
    int const gained = gain_before + own.count - 1;
    if (size + gained >= wanted || splits_before + 1 == candidates) {
      s.made = splits_before + 1 + gained;
    }
  }
  bool const stays = i < size && !splits;
  int stayed = 0;
  int const rank = g.exclusive_count(stays, stayed);
  int const made = s.made;
  if (stays) { t.list[made + rank] = own.node; }
  if (splits) {
    write_children(t, t.list, own.node, codes.row_of(depth),
                   {depth, own.count, made - 1 - splits_before - gain_before});
  }
  if (i == 0) { s.candidates = 0; }
  g.sync();
  list = {made, made + stayed};
  return true;
}

}  // namespace detail::quadtree
}  // namespace FT_ABI
}  // namespace ft
