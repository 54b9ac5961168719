// SPDX-License-Identifier: Apache-2.0
/// @file Stage: feature grid. Keypoints into cells, in index order, without a limit per cell.
/// Source: specification section 7.
#pragma once

#include <cstddef>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// Cell of the search grid: nearest cell corner, half away from zero; -1 outside the grid.
struct nearest_cell {
  FT_HOST_DEVICE static int of(grid_geometry const& g, float x, float y) {
    float const fx = detail::mul(x - g.min_x, g.inv_width);
    float const fy = detail::mul(y - g.min_y, g.inv_height);
    if (!(fx > -1.0f && fx < static_cast<float>(g.cols) && fy > -1.0f &&
          fy < static_cast<float>(g.rows))) {
      return -1;  // also NaN
    }
    int const cx = round_away(fx);
    int const cy = round_away(fy);
    return cx < 0 || cx >= g.cols || cy < 0 || cy >= g.rows ? -1 : cx * g.rows + cy;
  }
};

/// Cell of a grid of image rows (one column, cells one pixel high): int(y).
struct row_cell {
  FT_HOST_DEVICE static int of(grid_geometry const& g, float, float y) {
    return y >= 0 && y < static_cast<float>(g.rows) ? static_cast<int>(y) : -1;
  }
};

/// The grid of one image. Keypoints are taken in portions of one per thread, in order; inside a
/// portion a thread counts the earlier ones of its cell. No sort, and the same lists on every
/// executor.
/// @tparam Cell nearest_cell or row_cell @tparam Threads of the block
template <typename Cell, int Threads>
struct fill_grid {
  struct scratch {
    int cell[Threads];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, keypoints_view const& all,
                                 int first, int step, feature_grid_view const& grids) const {
    keypoints_view const kp = all.slice(first + item * step);
    feature_grid_view const grid = grids.slice(item);
    int const cells = grid.geometry.cells();
    int const n = *kp.count;
    for (int c = g.rank(); c <= cells; c += g.size()) { grid.start[c] = 0; }
    g.sync();
    for (int i = g.rank(); i < n; i += g.size()) {
      int const c = Cell::of(grid.geometry, get<field::x>(kp, i), get<field::y>(kp, i));
      if (c >= 0) { atomic_add(grid.start + c, 1); }
    }
    g.sync();
    g.exclusive_scan_array(grid.start, cells + 1);
    g.sync();
    // start[c] moves forward while its cell fills and ends as start[c + 1]; shifted back below.
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      int const c =
          i < n ? Cell::of(grid.geometry, get<field::x>(kp, i), get<field::y>(kp, i)) : -1;
      s.cell[g.rank()] = c;
      g.sync();
      if (c >= 0) {
        int before = 0;
        for (int t = 0; t < g.rank(); ++t) { before += static_cast<int>(s.cell[t] == c); }
        grid.indices[grid.start[c] + before] = i;
      }
      g.sync();
      if (c >= 0) { atomic_add(grid.start + c, 1); }
      g.sync();
    }
    for (int base = (cells / g.size()) * g.size(); base >= 0; base -= g.size()) {
      int const c = base + g.rank();
      int const previous = c <= cells && c > 0 ? grid.start[c - 1] : 0;
      g.sync();
      if (c <= cells) { grid.start[c] = previous; }
      g.sync();
    }
  }
};

/// Grids of the images first, first + step, ... of a batch of keypoints. Asynchronous on `exec`;
/// allocates nothing; one launch. @tparam Cell nearest_cell (search windows) or row_cell (rectified
/// stereo)
template <typename Cell, typename Exec>
void build_grid(Exec const& exec, keypoints_view const& keypoints, int first, int step, int images,
                feature_grid_view const& grids) {
  constexpr int threads = 256;
  for_each_item<per_block<threads>>(exec, images, fill_grid<Cell, threads>{}, keypoints, first,
                                    step, grids);
}

/// The cells that a search window touches: [x0, x1] x [y0, y1], empty where x0 > x1 or y0 > y1.
struct cell_window {
  int x0, x1, y0, y1;

  FT_HOST_DEVICE static cell_window of(grid_geometry const& g, float x, float y, float r) {
    cell_window w;
    w.x0 = max_of(0, to_cell(::floorf(detail::mul(x - g.min_x - r, g.inv_width)), g.cols));
    w.x1 = min_of(g.cols - 1, to_cell(::ceilf(detail::mul(x - g.min_x + r, g.inv_width)), g.cols));
    w.y0 = max_of(0, to_cell(::floorf(detail::mul(y - g.min_y - r, g.inv_height)), g.rows));
    w.y1 = min_of(g.rows - 1, to_cell(::ceilf(detail::mul(y - g.min_y + r, g.inv_height)), g.rows));
    if (!(r >= 0 && x - x == 0 && y - y == 0)) { w.x1 = -1; }  // no numbers, no cells
    return w;
  }

private:
  /// Keeps the conversion defined for values far outside.
  FT_HOST_DEVICE static int to_cell(float v, int n) {
    return v >= -1.0f ? static_cast<int>(min_of(v, static_cast<float>(n))) : -1;  // NaN, too
  }
};

}  // namespace FT_ABI
}  // namespace ft
