// SPDX-License-Identifier: Apache-2.0
/// @file The quadtree of one level in memory: sorted points, rows of bits, the list of nodes.
#pragma once

#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/distribution/layout.hpp"

namespace ft {
inline namespace FT_ABI {

// Codes of points: the path of a point through the quadtree of its level as one integer.

namespace detail::quadtree {

/// Positions at which the nodes of a level are split. They depend on the size of the level only.
///
/// The code of a point is the number of its root, followed by two bits for each depth from 1 to
/// `depths`: bit 0 is set in the right half of the parent, bit 1 in the lower half. The bits of
/// even depths are inverted. New nodes are pushed to the front of the list, which reverses their
/// order in every round. With every other depth inverted, the nodes of round k are in descending
/// order of their codes if k is odd, and in ascending order if k is even.
struct node_codes {
  static constexpr int never = 31;  ///< parting depth of points with the same code

  int width, height;  ///< of the level's work area, pixels
  int roots;
  float root_width;
  int depths;     ///< depths in a code, two bits each
  bool complete;  ///< no deeper node separates two pixels
  int rows;       ///< depths 0 to `depths`
  int bins;       ///< values of a code's leading bits, by which points are sorted first
  int bin_shift;  ///< bits of a code below those
  unsigned flip;  ///< the inverted bits

  /// @param points of the level, which determine the number of bins
  /// @param most_depths limit of `depths`; fewer if they are already complete
  FT_HOST_DEVICE node_codes(int w, int h, int root_count, int points, int most_depths,
                            int most_bins)
      : width(w),
        height(h),
        roots(root_count),
        root_width(div(static_cast<float>(w), static_cast<float>(root_count))) {
    // At the depth before the last, a node has at most one pixel. A point that rounding assigned to
    // the neighbour of its root is separated from the last column at most one depth later. A code
    // has at most 31 bits: a side has at most 16384 pixels, and with k > 1 roots the height is less
    // than 1.5 / k of the width.
    int const side = max_of(static_cast<int>(root_width) + 2, height);
    int full = 1;
    while (1 << (full - 1) < side) { ++full; }
    depths = min_of(full, most_depths);
    complete = depths == full;
    rows = depths + 1;
    bins = roots;
    bin_shift = 2 * depths;
    while (4 * bins <= min_of(most_bins, 4 * points) && bin_shift > 0) {
      bins *= 4;
      bin_shift -= 2;
    }
    flip = (depths % 2 == 0 ? 0x33333333u : 0xccccccccu) & ((1u << 2 * depths) - 1);
  }

  FT_HOST_DEVICE int root_of(int x) const {
    return min_of(static_cast<int>(div(static_cast<float>(x), root_width)), roots - 1);
  }
  FT_HOST_DEVICE int root_edge(int root) const {
    return static_cast<int>(mul(root_width, static_cast<float>(root)));
  }
  /// Bit 2 * (depths - d) is set if the point is in the second half at depth d.
  FT_HOST_DEVICE unsigned axis_code(int offset, int side) const {
    unsigned code = 0;
    for (int d = 0; d < depths; ++d) {
      int const middle = (side + 1) >> 1;
      bool const second = offset >= middle;
      code = code << 2 | static_cast<unsigned>(second);
      offset -= second ? middle : 0;
      side = second ? side - middle : middle;
    }
    return code;
  }
  /// The code of a point (x, y) is column_code(x) ^ row_code(y).
  FT_HOST_DEVICE unsigned column_code(int x) const {
    int const root = root_of(x);
    int const edge = root_edge(root);
    return (static_cast<unsigned>(root) << 2 * depths |
            axis_code(x - edge, root_edge(root + 1) - edge)) ^
           flip;
  }
  FT_HOST_DEVICE unsigned row_code(int y) const { return axis_code(y, height) << 1; }
  /// Left edge of the node at `depth` that contains column x.
  FT_HOST_DEVICE int left_edge(int x, int depth) const {
    int const root = root_of(x);
    int edge = root_edge(root);
    int side = root_edge(root + 1) - edge;
    for (int d = 0; d < depth; ++d) {
      int const middle = (side + 1) >> 1;
      bool const second = x - edge >= middle;
      edge += second ? middle : 0;
      side = second ? side - middle : middle;
    }
    return edge;
  }
  /// First depth at which the nodes of two codes differ.
  FT_HOST_DEVICE int parting_depth(unsigned a, unsigned b) const {
    unsigned const x = a ^ b;
    if (x == 0) { return never; }
#if defined(__CUDA_ARCH__)
    int const top = 31 - __clz(static_cast<int>(x));
#else
    int const top = 31 - __builtin_clz(x);
#endif
    return max_of(depths - top / 2, 0);
  }
  /// Row of a depth. All nodes below the last depth are those of the last depth.
  FT_HOST_DEVICE int row_of(int depth) const { return min_of(depth, depths); }
};

}  // namespace detail::quadtree

namespace detail::quadtree {

inline constexpr int threads = 512;         ///< of a block
inline constexpr int scratch_nodes = 512;   ///< most nodes of a level in shared memory
inline constexpr int max_bins = 2048;       ///< of the sort by code
inline constexpr int more_bins = 8192;      ///< likewise, if the points leave room for them
inline constexpr int usual_depths = 7;      ///< of codes at first; all depths if those are too few
inline constexpr int max_rows = 16;         ///< depths 0 to 15: a node of 2^14 pixels, and one more
inline constexpr int crowded_bin = 128;     ///< with a fuller bin, points are sorted by comparison
inline constexpr int ranked_nodes = 256;    ///< most nodes that are ranked by comparing all pairs
inline constexpr int bytes_per_point = 12;  ///< of shared memory: key or rows, and order
inline constexpr int min_scratch_points = 2048;  ///< fewer would leave no room for the nodes
static_assert(2 * max_rows * 6 == 6 * 32, "rows and counts take 6 bytes a point");
static_assert(2 * scratch_nodes * sizeof(node_range<std::uint16_t>) <= 2 * min_scratch_points,
              "both lists take at most 2 bytes a point");

/// Static shared memory of a block.
struct scratch {
  struct split_store {
    unsigned long long keys[scratch_nodes];
    int splits_before[scratch_nodes];
    int gain_before[scratch_nodes];
  };
  struct packed_store {
    unsigned keys[scratch_nodes];
    int before[scratch_nodes];
    std::uint16_t left[scratch_nodes];  ///< for introsort; then the place of each node's key
    std::uint16_t right[scratch_nodes];
  };
  union {
    alignas(16) int bins[max_bins];
    split_store splits;
    packed_store packed;
  } b;
  int totals[2 * max_rows];  ///< bits of each row
  int made;                  ///< nodes created in the current round
  int candidates;            ///< keys of split_packed() so far
  union {
    unsigned crowded;  ///< 1 = a bin has more than crowded_bin points; during the sort
    int open[2];       ///< for introsort
  };
};

/// The points of a level and its list of nodes.
///
/// Row k, for k in [0, rows), has a bit for each sorted point that is the first of its node at
/// depth k. Row `rows + k` has a bit for each point that is alone in its node. Bits below a
/// position are counted from `before`, which has the number of bits below each word of a row.
/// @tparam Index type of positions among the sorted points
template <typename Index>
struct level_tree {
  static constexpr int index_bits = 26;  ///< of an entry of `order`; above them the depth
  static constexpr unsigned index_mask = (1u << index_bits) - 1;

  corner const* points;
  int n;                     ///< points
  int words;                 ///< of a row
  corner* copy = nullptr;    ///< points are copied there at their first use; null = not copied
  unsigned long long* keys;  ///< code << 32 | index
  unsigned* order;           ///< [n] by code: parting depth from the predecessor, and index
  int order_size;            ///< at least n
  bool prepared = false;     ///< bins are empty, and `order` has the tables of codes
  int* bins;                 ///< used by the sort only
  int most_bins;
  unsigned* rows;
  Index* before;
  node_range<Index>* list;  ///< front first
  node_range<Index>* next;
  unsigned long long* node_keys;
  int* splits_before;  ///< per node: number of nodes that are split before it
  int* gain_before;    ///< per node: number of nodes that these splits add to the list

  /// First depth at which the point at position p is not in the node of its predecessor.
  FT_HOST_DEVICE int depth_at(int p) const {
    return p < n ? static_cast<int>(order[p] >> index_bits) : 0;
  }
  FT_HOST_DEVICE int index_at(int p) const { return static_cast<int>(order[p] & index_mask); }
  /// Bits of a row below position p < n.
  FT_HOST_DEVICE int rank(int row, int p) const {
    int const at = row * words + p / 32;
    return before[at] + popcount(rows[at] & ((1u << (p & 31)) - 1));
  }
  /// Position of bit number i of a row.
  FT_HOST_DEVICE int select(int row, int i) const {
    int const first = row * words;
    int w = 0;
    for (int end = words; end - w > 1;) {
      int const middle = (w + end) / 2;
      if (before[first + middle] <= i) {
        w = middle;
      } else {
        end = middle;
      }
    }
    unsigned bits = rows[first + w];
    int left = i - before[first + w];
    int p = 32 * w;
    for (int step = 16; step > 0; step /= 2) {
      int const below = popcount(bits & ((1u << step) - 1));
      bool const above = left >= below;
      left -= above ? below : 0;
      bits >>= above ? step : 0;
      p += above ? step : 0;
    }
    return p;
  }
  /// Position of the first bit of a row above position p; n if there is none.
  FT_HOST_DEVICE int bit_above(int row, int p) const {
    int w = p / 32;
    unsigned bits = rows[row * words + w] & ~((2u << (p & 31)) - 1);
    while (bits == 0) {
      if (++w == words) { return n; }
      bits = rows[row * words + w];
    }
    return 32 * w + popcount((bits & (0u - bits)) - 1);
  }
};

/// The state that the steps of a level share.
template <typename Group, typename Index>
struct level_work {
  Group g;
  scratch& s;
  level_tree<Index>& t;
  node_codes const& codes;
};

/// A corner as one word. Unpacking waits for the load, so it is done as late as possible.
using corner_word = unsigned long long;
static_assert(sizeof(corner) == sizeof(corner_word) && alignof(corner) == sizeof(corner_word),
              "one load");
FT_HOST_DEVICE inline corner corner_of(corner_word word) {
  corner c;
  std::memcpy(&c, &word, sizeof(c));
  return c;
}

/// Points that a thread keeps in registers: those with the numbers rank + k * threads.
/// @tparam Held how many; 0 = none
template <int Held>
struct held_points {
  static constexpr int size = max_of(Held, 1);
  corner_word words[size];

  /// @param n readable points
  template <typename Group>
  FT_HOST_DEVICE void fetch(Group g, corner const* points, int n) {
    FT_UNROLL
    for (int k = 0; k < Held; ++k) {
      int const i = g.rank() + k * g.size();
      words[k] = {};
      if (i < n) { words[k] = *reinterpret_cast<corner_word const*>(points + i); }
    }
  }
};

}  // namespace detail::quadtree

// Shared parts of the rounds that split node by node.
//
// Such a round splits the nodes of the preceding round that have more than one point, until the
// list has the wanted number of nodes. The fullest node is first; of equals the one furthest
// right; of equals again the tie rule decides. The number of splits and of additional nodes before
// each candidate are sums over the candidates with smaller keys, so all candidates are decided at
// once.

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
