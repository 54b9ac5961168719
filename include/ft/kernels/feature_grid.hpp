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

/// The grid of one image: counts, their prefix sum, then every keypoint into its cell's part of the
/// list. A group of several threads fills a part in any order; each keypoint then counts the lower
/// ones of its cell, which is its place. No sort, and the same lists on every executor.
/// @tparam Cell nearest_cell or row_cell
template <typename Cell>
struct fill_grid {
  /// Grids of up to so many cells, and images of up to so many keypoints, are worked on in block
  /// scratch, others in executor memory.
  static constexpr int scratch_size = 4096;
  struct scratch {
    int start[scratch_size];
    int unsorted[scratch_size];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, keypoints_view const& all,
                                 int first, int step, feature_grid_view const& grids) const {
    keypoints_view const kp = all.slice(first + item * step);
    feature_grid_view const grid = grids.slice(item);
    int const cells = grid.geometry.cells();
    int const n = *kp.count;
    constexpr bool one_thread = Group::max_threads == 1;
    int* const start = !one_thread && cells < scratch_size ? s.start : grid.start;
    int* const list = one_thread ? grid.indices : n <= scratch_size ? s.unsorted : grid.unsorted;
    for (int c = g.rank(); c <= cells; c += g.size()) { start[c] = 0; }
    g.sync();
    for (int i = g.rank(); i < n; i += g.size()) {
      int const c = cell_of(grid, kp, i);
      if (c >= 0) { atomic_add(start + c, 1); }
    }
    g.sync();
    // Prefix sum, each thread over cells that follow each other.
    int const each = ceil_div(cells, g.size());
    int const begin = min_of(g.rank() * each, cells);
    int const end = min_of(begin + each, cells);
    int mine = 0;
    for (int c = begin; c < end; ++c) { mine += start[c]; }
    int total = 0;
    int before = g.exclusive_scan(mine, total);
    for (int c = begin; c < end; ++c) {
      int const count = start[c];
      start[c] = before;
      before += count;
    }
    g.sync();
    // start[c] moves forward while its cell fills and ends as the start of the next.
    for (int i = g.rank(); i < n; i += g.size()) {
      int const c = cell_of(grid, kp, i);
      if (c >= 0) { list[atomic_add(start + c, 1)] = i; }
    }
    g.sync();
    if constexpr (!one_thread) {
      for (int i = g.rank(); i < n; i += g.size()) {
        int const c = cell_of(grid, kp, i);
        if (c < 0) { continue; }
        int const from = c > 0 ? start[c - 1] : 0;
        int const to = start[c];
        int lower = 0;
        for (int at = from; at < to; ++at) { lower += static_cast<int>(list[at] < i); }
        grid.indices[from + lower] = i;
      }
      g.sync();
    }
    // From the last cell down, so that a thread writes what no later step reads.
    for (int base = (cells / g.size()) * g.size(); base >= 0; base -= g.size()) {
      int const c = base + g.rank();
      int const previous = c <= cells && c > 0 ? start[c - 1] : 0;
      if (start == grid.start) { g.sync(); }
      if (c <= cells) { grid.start[c] = previous; }
      if (start == grid.start) { g.sync(); }
    }
  }

private:
  FT_HOST_DEVICE static int cell_of(feature_grid_view const& grid, keypoints_view const& kp,
                                    int i) {
    return Cell::of(grid.geometry, get<field::x>(kp, i), get<field::y>(kp, i));
  }
};

/// Grids of the images first, first + step, ... of a batch of keypoints. Asynchronous on `exec`;
/// allocates nothing; one launch. @tparam Cell nearest_cell (search windows) or row_cell (rectified
/// stereo)
template <typename Cell, typename Exec>
void build_grid(Exec const& exec, keypoints_view const& keypoints, int first, int step, int images,
                feature_grid_view const& grids) {
  for_each_item<per_block<1024>>(exec, images, fill_grid<Cell>{}, keypoints, first, step, grids);
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
