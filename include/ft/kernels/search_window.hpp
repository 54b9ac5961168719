// SPDX-License-Identifier: Apache-2.0
/// @file Search windows: where a map point is looked for in the current frame.
#pragma once

#include <cstddef>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/feature_grid.hpp"

namespace ft {
inline namespace FT_ABI {

/// A square of keypoint positions and a range of octaves.
struct search_window {
  float x, y;        ///< centre, pixels
  float radius;      ///< half side, and tolerance of the right column; pixels
  float right_x;     ///< predicted column in the right image
  int min_level;     ///< 0 or below: no lower limit
  int max_level;     ///< below 0: no upper limit
  int slot;          ///< map point looked for; -1 = this window is not searched
  bool check_right;  ///< compare right columns where the keypoint has one

  FT_HOST_DEVICE static search_window none() { return {0, 0, 0, 0, 0, 0, -1, false}; }
};

/// Windows of one search, in search order: [cameras][batch][capacity].
struct search_windows_view {
  search_window* windows = nullptr;
  int* count = nullptr;  ///< [batch]
  int capacity = 0;
  int batch = 0;
  int cameras = 1;

  FT_HOST_DEVICE search_window const& at(int camera, int b, int i) const {
    return windows[(static_cast<std::ptrdiff_t>(camera) * batch + b) * capacity + i];
  }
};

inline void carve(carver& c, search_windows_view& v, int capacity, int batch, int cameras) {
  v.capacity = capacity;
  v.batch = batch;
  v.cameras = cameras;
  v.windows =
      c.take<search_window>(static_cast<std::size_t>(cameras) * static_cast<std::size_t>(batch) *
                            static_cast<std::size_t>(capacity));
  v.count = c.take<int>(static_cast<std::size_t>(batch));
}

/// Calls visit(k) in the grid's order for every keypoint of the window's cells, k = -1 for threads
/// of the group that have none in a step; every thread takes part in every call.
template <typename Group, typename Visit>
FT_HOST_DEVICE void visit_cells(Group g, search_window const& w, feature_grid_view const& grid,
                                Visit const& visit) {
  cell_window const cells = cell_window::of(grid.geometry, w.x, w.y, w.radius);
  if (cells.y0 > cells.y1) { return; }
  for (int cx = cells.x0; cx <= cells.x1; ++cx) {
    // Cells of a column follow each other, so the column's part of the window is one run.
    int const begin = grid.start[cx * grid.geometry.rows + cells.y0];
    int const end = grid.start[cx * grid.geometry.rows + cells.y1 + 1];
    for (int base = begin; base < end; base += g.size()) {
      int const k = base + g.rank();
      visit(k < end ? grid.indices[k] : -1);
    }
  }
}

/// True for a keypoint of the window's octaves strictly inside the square.
FT_HOST_DEVICE inline bool inside(search_window const& w, keypoints_view const& kp, int k) {
  int const octave = get<field::octave>(kp, k);
  return octave >= w.min_level && (w.max_level < 0 || octave <= w.max_level) &&
         ::fabsf(get<field::x>(kp, k) - w.x) < w.radius &&
         ::fabsf(get<field::y>(kp, k) - w.y) < w.radius;
}

}  // namespace FT_ABI
}  // namespace ft
