// SPDX-License-Identifier: Apache-2.0
/// @file Codes of points: the path of a point through the quadtree of its level as one integer.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
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
}  // namespace FT_ABI
}  // namespace ft
