// SPDX-License-Identifier: Apache-2.0
/// @file Sorts the corners of a level, which detection lists in any order.
#pragma once

#include <algorithm>

#include "ft/containers/corners.hpp"

namespace test {

/// Sorts corners of a level into the level's order: cell by cell, row by row within a cell.
inline void sort_corners(ft::corner* corners, int count, ft::corner_layout const& layout,
                         int level) {
  if (count == 0) { return; }
  ft::corner_order const order = layout.order_of(level);
  std::stable_sort(corners, corners + count, [&](ft::corner const& a, ft::corner const& b) {
    return order(a.x, a.y) < order(b.x, b.y);
  });
}

}  // namespace test
