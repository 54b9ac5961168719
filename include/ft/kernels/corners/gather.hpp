// SPDX-License-Identifier: Apache-2.0
/// @file Stage: gathers the corners of all cells into one list per level, in cell order.
#pragma once

#include <cstddef>

#include "ft/containers/corners.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Copies a cell's corners to their place in the level's list. The first cell of an image clears
/// the counts of levels without cells.
struct gather_cell {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, corners_view const& v) const {
    corner_layout const& layout = v.layout;
    int const image = item / layout.cells;
    int const cell = item % layout.cells;
    int const l = layout.level_of(cell);
    int const first = image * layout.cells + layout.first_cell[l];
    int const in_level = cell - layout.first_cell[l];
    int before = 0;
    for (int i = g.rank(); i < in_level; i += g.size()) { before += v.cell_count[first + i]; }
    before = g.reduce(before, sum_op{});
    int const count = v.cell_count[item];
    corner const* const from = v.cell_corners + v.level_slot(image, l) +
                               static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    corner* const to = v.level_list(image, l) + before;
    for (int i = g.rank(); i < count; i += g.size()) { to[i] = from[i]; }
    if (in_level == layout.cells_of(l) - 1 && g.rank() == 0) {
      v.list_count[image * layout.levels + l] = before + count;
    }
    if (cell == 0) {
      for (int i = g.rank(); i < layout.levels; i += g.size()) {
        if (layout.cells_of(i) == 0) { v.list_count[image * layout.levels + i] = 0; }
      }
    }
  }
};

}  // namespace detail

/// Fills `out.list` and `out.list_count` from the cells, per level in cell order. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void gather_corners(Exec const& exec, corners_view const& out) {
  if (out.layout.cells == 0) {
    fill_bytes(exec, out.list_count, 0,
               static_cast<std::size_t>(out.batch * out.layout.levels) * sizeof(int));
    return;
  }
  for_each_item<per_warp>(exec, out.batch * out.layout.cells, detail::gather_cell{}, out);
}

}  // namespace FT_ABI
}  // namespace ft
