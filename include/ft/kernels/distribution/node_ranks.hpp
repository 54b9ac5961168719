// SPDX-License-Identifier: Apache-2.0
/// @file Marks the first point of every node at every depth, and counts these marks.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/level_tree.hpp"

namespace ft {
inline namespace FT_ABI {
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
