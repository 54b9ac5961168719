// SPDX-License-Identifier: Apache-2.0
/// @file Stage: even distribution of corners over a level by a quadtree. Source: specification
/// section 3.
///
/// The rule is sequential. The work area is divided into root nodes. A round walks the list of
/// nodes and replaces every node with several points by its non-empty quadrants, which it pushes to
/// the front of the list. When the next round could make too many nodes, it splits node by node
/// instead, the fullest first, until there are enough. Each node then keeps its strongest point.
/// The order of the list is the order of the corners.
///
/// It is computed in parallel, because
/// - nodes are halved at fixed places, so that the path of a point does not depend on other points.
///   The path is a code of two bits per depth (level_tree.hpp). Once the points are sorted by code
///   (sort_by_code.hpp), every node of every depth is a range of them;
/// - every round but the last splits every node with more than one point. So the length of the list
///   after round k is the number of nodes at depth k, and all lengths are known before any node is
///   split. They are counted in rows of bits that mark the first point of each node
///   (node_ranks.hpp);
/// - pushing to the front reverses the order. With the bits of every other depth inverted, the
///   nodes of a round are in ascending or descending order of their codes. So the list after the
///   rounds that split every node is written at once (node_ranks.hpp).
///
/// Only the rounds that split node by node run one after the other (last_rounds.hpp), and each of
/// them decides all nodes at once by ranks. docs/architecture.md explains why the result is that of
/// the loop.
///
/// A block takes a level. If its points fit, they are in shared memory; otherwise the same code
/// works in the workspace.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/distribution/last_rounds.hpp"
#include "ft/kernels/distribution/last_rounds_packed.hpp"
#include "ft/kernels/distribution/layout.hpp"
#include "ft/kernels/distribution/level_tree.hpp"
#include "ft/kernels/distribution/node_ranks.hpp"
#include "ft/kernels/distribution/sort_by_code.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace FT_ABI {

// Keeps the strongest corner of every node.

namespace detail::quadtree {

/// Highest for the strongest corner; among equals, for the first one in the level's order.
FT_HOST_DEVICE inline unsigned long long strength_of(corner const& c, corner_order const& order) {
  return static_cast<unsigned long long>(static_cast<std::uint32_t>(c.response)) << 32 |
         (0xffffffffu - order(c.x, c.y));
}

/// Writes the strongest point of each of the first `size` nodes of the list; among equals the first
/// one in the level's order. Up to four threads take a node.
template <typename Group, typename Index>
FT_HOST_DEVICE void keep_strongest(Group g, level_tree<Index> const& t, int size,
                                   corner_order const& order, corner* kept) {
  constexpr int most = 4;
  constexpr int batch = Group::max_threads == 1 ? 1 : 4;  // loads in flight together
  int const lanes = g.lanes(most);
  int const lane = g.rank() % lanes;
  for (int base = 0; base < size; base += g.size() / lanes) {
    int const i = base + g.rank() / lanes;
    unsigned long long mine = 0;
    int strongest = 0;
    if (i < size) {
      node_range<Index> const node = t.list[i];
      // Reads past the end repeat the last point, so that no load depends on a branch.
      for (int first = node.begin + lane; first < node.end; first += batch * lanes) {
        int index[batch];
        unsigned long long strength[batch];
        FT_UNROLL
        for (int k = 0; k < batch; ++k) {
          index[k] = t.index_at(min_of(first + k * lanes, node.end - 1));
        }
        FT_UNROLL
        for (int k = 0; k < batch; ++k) { strength[k] = strength_of(t.points[index[k]], order); }
        FT_UNROLL
        for (int k = 0; k < batch; ++k) {
          if (strength[k] > mine) {
            mine = strength[k];
            strongest = index[k];
          }
        }
      }
    }
    unsigned long long const best = g.template reduce_lanes<most>(mine, max_op{});
    if (i < size && mine == best) { kept[i] = t.points[strongest]; }
  }
}

}  // namespace detail::quadtree

namespace detail {

/// Layout of the dynamic shared memory of a block: 8 bytes a point for keys, later reused for the
/// rows, then 4 bytes a point for `order`.
struct level_memory {
  int points = 0;  ///< most points of a level in shared memory; 0 = all levels in the workspace

  /// @param bytes of dynamic shared memory that are available
  static level_memory of(std::size_t bytes) {
    auto const points = min_of(bytes / quadtree::bytes_per_point, std::size_t{0xffe0}) / 32 * 32;
    bool const enough = points >= std::size_t{quadtree::min_scratch_points};
    return {enough ? static_cast<int>(points) : 0};
  }
  std::size_t bytes() const { return static_cast<std::size_t>(points) * quadtree::bytes_per_point; }
  /// Whether `more_bins` fit, which they do if a block has a multiprocessor to itself.
  FT_HOST_DEVICE bool has_more_bins() const { return points > quadtree::more_bins / 2; }
  /// Largest number of points whose keys leave room for `more_bins` after them.
  FT_HOST_DEVICE int points_with_more_bins() const { return points - quadtree::more_bins / 2; }
  FT_HOST_DEVICE int* more_bins(unsigned char* memory) const {
    return reinterpret_cast<int*>(memory + 8 * points_with_more_bins());
  }
  FT_HOST_DEVICE unsigned* order(unsigned char* memory) const {
    return reinterpret_cast<unsigned*>(memory + 8 * points);
  }
};

/// One level of one image.
/// @tparam Alone whether a block has a multiprocessor to itself, with all of its registers
template <bool Alone, tie_rule Ties>
struct distribute_level {
  static constexpr bool wide_on_host = true;
  using scratch = quadtree::scratch;
  static constexpr int resident_blocks = Alone ? 1 : 0;
  /// Points that a thread keeps in registers while they are sorted.
  static constexpr int held = Alone ? 8 : 0;

  level_memory memory;

  std::size_t extra_bytes() const { return memory.bytes(); }

  /// Clears the bins and fills the tables of codes.
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch& s, int item, corners_view const&,
                               distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    int const l = item % layout.levels;
    if (memory.points == 0 || layout.capacity[l] == 0) { return; }
    quadtree::node_codes const codes(layout.width[l], layout.height[l], layout.roots[l], 1,
                                     quadtree::usual_depths, 1);
    quadtree::clear_bins(g, s.b.bins, quadtree::max_bins);
    if (memory.has_more_bins()) {
      quadtree::clear_bins(g, memory.more_bins(g.extra()), quadtree::more_bins);
    }
    if (codes.width + codes.height <= memory.points) {
      quadtree::fill_code_table(g, codes, memory.order(g.extra()));
    }
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, corners_view const& corners,
                                 distribution_view const& v) const {
    distribution_layout const& layout = v.layout;
    place const at{item / layout.levels, item % layout.levels};
    // Prefetches points before their count is known.
    quadtree::held_points<held> points{};
    corner const* const list = corners.level_list(at.image, at.level);
    points.fetch(g, list, static_cast<int>(corners.layout.level_slots(at.level)));
    int const n = corners.list_count[item];
    if (n == 0 || layout.capacity[at.level] == 0) {
      if (g.rank() == 0) { v.kept_count[item] = 0; }
      return;
    }
    corner* const kept = v.kept + at.image * layout.total + layout.first[at.level];
    wanted_nodes const wanted{layout, at.level, v.wanted(at.image, at.level)};
    bool in_scratch = false;
    int size = 0;
    if constexpr (Group::max_threads > 1) {  // one thread has no scratch of that kind
      in_scratch = n <= memory.points && wanted.most() <= quadtree::scratch_nodes;
      if (in_scratch) {
        auto t = tree_in_scratch(g, s, n);
        t.points = list;
        size = make_nodes(g, s, t, points, wanted);
        keep_strongest(g, t, size, corners.layout.order_of(at.level), kept);
      }
    }
    if (!in_scratch) {
      auto t = tree_in_workspace(s, n, at, corners, v);
      t.points = list;
      size = make_nodes(g, s, t, quadtree::held_points<0>{}, wanted);
      keep_strongest(g, t, size, corners.layout.order_of(at.level), kept);
    }
    if (g.rank() == 0) { v.kept_count[item] = size; }
  }

private:
  struct place {
    int image, level;
  };
  /// How many nodes a level should have.
  struct wanted_nodes {
    distribution_layout const& layout;
    int level, features;

    FT_HOST_DEVICE int most() const { return layout.most_nodes(level, features); }
  };

  template <typename Group>
  FT_HOST_DEVICE quadtree::level_tree<std::uint16_t> tree_in_scratch(Group g, scratch& s,
                                                                     int n) const {
    using index = std::uint16_t;
    unsigned char* const data = g.extra();
    quadtree::level_tree<index> t;
    t.n = n;
    t.words = ceil_div(n, 32);
    t.keys = reinterpret_cast<unsigned long long*>(data);
    t.order = memory.order(data);
    t.prepared = true;
    if (n <= memory.points_with_more_bins()) {
      t.bins = memory.more_bins(data);
      t.most_bins = quadtree::more_bins;
    } else {
      t.bins = s.b.bins;
      t.most_bins = quadtree::max_bins;
    }
    t.order_size = memory.points;
    // The copy lies between keys or rows and what follows them: both lists, or the bins.
    int const copy_at = 8 * 32 * t.words;
    if (copy_at + static_cast<int>(sizeof(corner)) * n <=
        min_of(6 * memory.points, 8 * memory.points_with_more_bins())) {
      t.copy = reinterpret_cast<corner*>(data + copy_at);
    }
    t.rows = reinterpret_cast<unsigned*>(data);
    t.before = reinterpret_cast<index*>(t.rows + 2 * quadtree::max_rows * t.words);
    t.list = reinterpret_cast<node_range<index>*>(data + 6 * memory.points);
    t.next = t.list + quadtree::scratch_nodes;
    t.node_keys = s.b.splits.keys;
    t.splits_before = s.b.splits.splits_before;
    t.gain_before = s.b.splits.gain_before;
    return t;
  }

  FT_HOST_DEVICE static quadtree::level_tree<int> tree_in_workspace(scratch& s, int n, place in,
                                                                    corners_view const& corners,
                                                                    distribution_view const& v) {
    distribution_layout const& layout = v.layout;
    int const at = in.image * layout.total + layout.first[in.level];
    std::ptrdiff_t const slot =
        in.image * corners.layout.total_slots + corners.layout.first_slot[in.level];
    quadtree::level_tree<int> t;
    t.keys = v.keys + slot +
             static_cast<std::ptrdiff_t>(distribution_view::key_pad) *
                 (in.image * layout.levels + in.level);
    t.order = v.order + slot;
    t.bins = s.b.bins;
    t.most_bins = quadtree::max_bins;
    t.order_size = static_cast<int>(corners.layout.level_slots(in.level));
    t.n = n;
    t.words = ceil_div(n, 32);
    // Rows and their counts take the place of the keys: 2 * max_rows words of each for 32 points.
    t.rows = reinterpret_cast<unsigned*>(t.keys);
    t.before = reinterpret_cast<int*>(t.rows + static_cast<std::ptrdiff_t>(2 * quadtree::max_rows) *
                                                   t.words);
    t.list = v.list[0] + at;
    t.next = v.list[1] + at;
    t.node_keys = v.node_keys + at;
    t.splits_before = v.splits_before + at;
    t.gain_before = v.gain_before + at;
    return t;
  }

  /// Writes the nodes of a level to `t.list`. @param points the first points of each thread
  /// @return number of nodes
  template <int Held, typename Group, typename Index>
  FT_HOST_DEVICE static int make_nodes(Group g, scratch& s, quadtree::level_tree<Index>& t,
                                       quadtree::held_points<Held> points, wanted_nodes const& in) {
    distribution_layout const& layout = in.layout;
    int const l = in.level;
    int const wanted = in.features;
    for (int most = quadtree::usual_depths;; most = quadtree::max_rows - 1) {
      quadtree::node_codes const codes(layout.width[l], layout.height[l], layout.roots[l], t.n,
                                       most, t.most_bins);
      quadtree::level_work<Group, Index> const work{g, s, t, codes};
      sort_by_code(work, points);
      mark_heads(work);
      count_heads(work);
      quadtree::round_counts const rounds = quadtree::count_rounds(codes, s.totals, wanted);
      if (rounds.last == 0) {  // points are crowded: all depths are needed
        points.fetch(g, t.points, t.n);
        continue;
      }
      quadtree::list_state list{list_nodes(work, rounds.whole),
                                s.totals[codes.row_of(rounds.whole)]};
      for (int depth = rounds.whole + 1; depth <= rounds.last; ++depth) {
        if (!quadtree::split_packed<Ties>(work, depth, wanted, list)) {
          quadtree::split_nodes<Ties>(work, depth, wanted, list);
        }
      }
      return list.size;
    }
  }
};

/// Distributes with a given division of shared memory; see distribute_corners().
template <tie_rule Ties, typename Exec>
void distribute_in(Exec const& exec, level_memory memory, corners_view const& corners,
                   distribution_view const& out) {
  using shape = per_block<quadtree::threads>;
  int const items = out.batch * out.layout.levels;
  if constexpr (Exec::space == memory_space::device) {
    if (memory.has_more_bins()) {
      for_each_item<shape>(exec, items, distribute_level<true, Ties>{memory}, corners, out);
      return;
    }
  }
  for_each_item<shape>(exec, items, distribute_level<false, Ties>{memory}, corners, out);
}

}  // namespace detail

/// Thins the corners of every level of every image to about the wanted number. Asynchronous on
/// `exec`; allocates nothing; one launch. The result does not depend on the order of the lists.
/// @pre corners lie within their level's work area
template <typename Exec>
void distribute_corners(Exec const& exec, corners_view const& corners, distribution_view const& out,
                        tie_rule ties = tie_rule::stable) {
  using op = detail::distribute_level<false, tie_rule::stable>;
  int const items = out.batch * out.layout.levels;
  auto const memory =
      detail::level_memory::of(extra_scratch<detail::quadtree::threads, op>(exec, items));
  if (ties == tie_rule::std_sort) {
    detail::distribute_in<tie_rule::std_sort>(exec, memory, corners, out);
  } else {
    detail::distribute_in<tie_rule::stable>(exec, memory, corners, out);
  }
}

}  // namespace FT_ABI
}  // namespace ft
