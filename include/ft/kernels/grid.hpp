// SPDX-License-Identifier: Apache-2.0
/// @file Stage: feature grid. Sorts keypoints into cells, in index order, without a limit per cell.
/// Source: specification section 7.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// Cells of search windows: the nearest cell corner, halves away from zero; -1 outside the grid.
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

/// Cells of a grid of image rows, which has one column and cells one pixel high: int(y).
struct row_cell {
  FT_HOST_DEVICE static int of(grid_geometry const& g, float, float y) {
    return y >= 0 && y < static_cast<float>(g.rows) ? static_cast<int>(y) : -1;
  }
};

namespace detail {

/// Scratch of fill_grid, for grids of fewer than `size` cells and images of up to `size` keypoints.
struct grid_scratch {
  static constexpr int size = 4096;
  static constexpr std::uint32_t nowhere = 0xffffffffu;
  int start[size];            ///< counts of the cells, then their starts
  std::uint32_t entry[size];  ///< per keypoint: its cell, and its number in the cell, in any order
  std::uint16_t list[size];   ///< keypoints cell by cell, in any order within a cell

  /// Whether a group works in scratch. Its threads keep their cells in registers.
  template <typename Group>
  FT_HOST_DEVICE static bool serves(grid_geometry const& g, int keypoints) {
    return Group::max_threads >= 256 && g.cells() < size && keypoints <= size;
  }
};

/// The grid of one image: counts per cell, their prefix sum, then the keypoints of each cell.
///
/// Several threads fill a cell in any order. A keypoint's place is then the number of lower
/// keypoints in the same cell. No sort is needed, and all executors give the same lists.
/// @tparam Cell nearest_cell or row_cell
template <typename Cell>
struct fill_grid {
  using scratch = grid_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, keypoints_view const& all,
                                 int first, int step, feature_grid_view const& grids) const {
    keypoints_view const kp = all.slice(first + item * step);
    feature_grid_view const grid = grids.slice(item);
    int const n = *kp.count;
    if (!scratch::template serves<Group>(grid.geometry, n)) {
      in_memory(g, kp, n, grid);
      return;
    }
    clear(g, s, grid.geometry);
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      s.entry[i] = count(s, grid.geometry, kp.x(i), kp.y(i));
    }
    g.sync();
    sort(g, s, n, grid);
  }

  /// First step in scratch, by several threads.
  template <typename Group>
  FT_HOST_DEVICE static void clear(Group g, scratch& s, grid_geometry const& geometry) {
    for (int c = g.rank(); c < geometry.cells(); c += g.size()) { s.start[c] = 0; }
    g.sync();
  }
  /// Second step: counts a keypoint, in any order. Returns its entry.
  FT_HOST_DEVICE static std::uint32_t count(scratch& s, grid_geometry const& geometry, float x,
                                            float y) {
    int const c = Cell::of(geometry, x, y);
    if (c < 0) { return scratch::nowhere; }
    return static_cast<std::uint32_t>(atomic_add(s.start + c, 1) << 16 | c);
  }
  /// Last step: writes the grid. @pre all keypoints are counted, followed by a sync()
  template <typename Group>
  FT_HOST_DEVICE static void sort(Group g, scratch& s, int n, feature_grid_view const& grid) {
    scan_cells(g, s, grid);
    g.sync();
    list_by_cell(g, s, n);
    g.sync();
    write_in_order(g, s, n, grid);
  }

private:
  static constexpr int together = 2;  ///< keypoints per thread whose loads are in flight at once

  /// From counts to starts, in scratch and in the grid. Each thread scans consecutive cells.
  template <typename Group>
  FT_HOST_DEVICE static void scan_cells(Group g, scratch& s, feature_grid_view const& grid) {
    constexpr int most =
        Group::max_threads >= 256 ? ceil_div(scratch::size, Group::max_threads) : 1;
    int const cells = grid.geometry.cells();
    int const each = ceil_div(cells, g.size());
    int const begin = g.rank() * each;
    int here[most];
    int mine = 0;
    FT_UNROLL
    for (int k = 0; k < most; ++k) {
      here[k] = k < each && begin + k < cells ? s.start[begin + k] : 0;
      mine += here[k];
    }
    int total = 0;
    int before = g.exclusive_scan(mine, total);
    FT_UNROLL
    for (int k = 0; k < most; ++k) {
      if (k < each && begin + k < cells) {
        s.start[begin + k] = before;
        grid.start[begin + k] = before;
      }
      before += here[k];
    }
    if (g.rank() == 0) {
      s.start[cells] = total;
      grid.start[cells] = total;
    }
  }
  /// Fills `s.list`, in any order within a cell.
  template <typename Group>
  FT_HOST_DEVICE static void list_by_cell(Group g, scratch& s, int n) {
    FT_NO_UNROLL
    for (int base = g.rank(); base < n; base += together * g.size()) {
      std::uint32_t e[together];
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const i = base + k * g.size();
        e[k] = i < n ? s.entry[i] : scratch::nowhere;
      }
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        if (e[k] == scratch::nowhere) { continue; }
        s.list[s.start[e[k] & 0xffffu] + static_cast<int>(e[k] >> 16)] =
            static_cast<std::uint16_t>(base + k * g.size());
      }
    }
  }
  /// Ranks the keypoints of each cell by counting lower ones, and writes them in order.
  template <typename Group>
  FT_HOST_DEVICE static void write_in_order(Group g, scratch& s, int n,
                                            feature_grid_view const& grid) {
    FT_NO_UNROLL
    for (int base = g.rank(); base < n; base += together * g.size()) {
      int from[together];
      int to[together];
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const i = base + k * g.size();
        std::uint32_t const e = i < n ? s.entry[i] : scratch::nowhere;
        bool const there = e != scratch::nowhere;
        from[k] = there ? s.start[e & 0xffffu] : 0;
        to[k] = there ? s.start[(e & 0xffffu) + 1] : 0;
      }
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const i = base + k * g.size();
        int lower = 0;
        FT_NO_UNROLL
        for (int at = from[k]; at < to[k]; at += 4) {
          FT_UNROLL
          for (int m = 0; m < 4; ++m) {  // past the end: repeats the last one
            int const other = s.list[min_of(at + m, to[k] - 1)];
            lower += static_cast<int>((at + m < to[k]) & (other < i));
          }
        }
        if (from[k] < to[k]) { grid.indices[from[k] + lower] = i; }
      }
    }
  }

  /// The grid without scratch. Loops are not unrolled, which keeps the code of this rare path
  /// small.
  template <typename Group>
  FT_HOST_DEVICE static void in_memory(Group g, keypoints_view const& kp, int n,
                                       feature_grid_view const& grid) {
    int const cells = grid.geometry.cells();
    int* const start = grid.start;
    int* const list = Group::max_threads == 1 ? grid.indices : grid.unsorted;
    auto const cell = [&](int i) { return Cell::of(grid.geometry, kp.x(i), kp.y(i)); };
    FT_NO_UNROLL
    for (int c = g.rank(); c <= cells; c += g.size()) { start[c] = 0; }
    g.sync();
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      int const c = cell(i);
      if (c >= 0) { atomic_add(start + c, 1); }
    }
    g.sync();
    int const each = ceil_div(cells, g.size());
    int const begin = min_of(g.rank() * each, cells);
    int const end = min_of(begin + each, cells);
    int mine = 0;
    FT_NO_UNROLL
    for (int c = begin; c < end; ++c) { mine += start[c]; }
    int total = 0;
    int before = g.exclusive_scan(mine, total);
    FT_NO_UNROLL
    for (int c = begin; c < end; ++c) {
      int const here = start[c];
      start[c] = before;
      before += here;
    }
    g.sync();
    // start[c] advances while cell c fills, and ends at the start of the next cell.
    FT_NO_UNROLL
    for (int i = g.rank(); i < n; i += g.size()) {
      int const c = cell(i);
      if (c >= 0) { list[atomic_add(start + c, 1)] = i; }
    }
    g.sync();
    FT_NO_UNROLL
    for (int i = g.rank(); list != grid.indices && i < n; i += g.size()) {
      int const c = cell(i);
      if (c < 0) { continue; }
      int const from = c > 0 ? start[c - 1] : 0;
      int const to = start[c];
      int lower = 0;
      FT_NO_UNROLL
      for (int at = from; at < to; ++at) { lower += static_cast<int>(list[at] < i); }
      grid.indices[from + lower] = i;
    }
    g.sync();
    shift_starts(g, start, cells);
  }
  /// Moves the starts up by one cell, from the last cell down, so that nothing is read after it was
  /// overwritten.
  template <typename Group>
  FT_HOST_DEVICE static void shift_starts(Group g, int* start, int cells) {
    FT_NO_UNROLL
    for (int base = (cells / g.size()) * g.size(); base >= 0; base -= g.size()) {
      int const c = base + g.rank();
      int const previous = c <= cells && c > 0 ? start[c - 1] : 0;
      g.sync();
      if (c <= cells) { start[c] = previous; }
      g.sync();
    }
  }
};

}  // namespace detail

/// Builds the grids of images first, first + step, ... of a batch of keypoints. Asynchronous on
/// `exec`; allocates nothing; one launch.
/// @tparam Cell nearest_cell (search windows) or row_cell (rectified stereo)
template <typename Cell, typename Exec>
void build_grid(Exec const& exec, keypoints_view const& keypoints, int first, int step, int images,
                feature_grid_view const& grids) {
  for_each_item<per_block<1024>>(exec, images, detail::fill_grid<Cell>{}, keypoints, first, step,
                                 grids);
}

/// The cells that a search window touches: [x0, x1] x [y0, y1]; empty if x0 > x1 or y0 > y1.
struct cell_window {
  int x0, x1, y0, y1;

  FT_HOST_DEVICE static cell_window of(grid_geometry const& g, float x, float y, float r) {
    cell_window w;
    w.x0 = max_of(0, to_cell(::floorf(detail::mul(x - g.min_x - r, g.inv_width)), g.cols));
    w.x1 = min_of(g.cols - 1, to_cell(::ceilf(detail::mul(x - g.min_x + r, g.inv_width)), g.cols));
    w.y0 = max_of(0, to_cell(::floorf(detail::mul(y - g.min_y - r, g.inv_height)), g.rows));
    w.y1 = min_of(g.rows - 1, to_cell(::ceilf(detail::mul(y - g.min_y + r, g.inv_height)), g.rows));
    if (!(r >= 0 && x - x == 0 && y - y == 0)) { w.x1 = -1; }  // NaN or infinity: empty
    return w;
  }

private:
  /// A conversion that is defined for all values, including NaN and values far outside.
  FT_HOST_DEVICE static int to_cell(float v, int n) {
    return v >= -1.0f ? static_cast<int>(min_of(v, static_cast<float>(n))) : -1;  // NaN, too
  }
};

}  // namespace FT_ABI
}  // namespace ft
