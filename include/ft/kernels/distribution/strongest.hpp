// SPDX-License-Identifier: Apache-2.0
/// @file Keeps the strongest corner of every node.
#pragma once

#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {
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
}  // namespace FT_ABI
}  // namespace ft
