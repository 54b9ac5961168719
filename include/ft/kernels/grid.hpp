// SPDX-License-Identifier: Apache-2.0
/// @file Stage: feature grid. Keypoints into cells, in index order, without a limit per cell.
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

namespace detail {

/// Block scratch of fill_grid: for grids of less than so many cells, and images of up to so many
/// keypoints.
struct grid_scratch {
  static constexpr int size = 4096;
  static constexpr std::uint32_t nowhere = 0xffffffffu;
  int start[size];            ///< of cells; their counts at first
  std::uint32_t entry[size];  ///< of a keypoint: its cell, and how many of it were counted before
  std::uint16_t list[size];   ///< cell by cell, in any order within one

  /// Whether a group works in scratch: threads keep their part of it in registers.
  template <typename Group>
  FT_HOST_DEVICE static bool serves(grid_geometry const& g, int keypoints) {
    return Group::max_threads >= 256 && g.cells() < size && keypoints <= size;
  }
};

/// The grid of one image: counts, their prefix sum, then every keypoint into its cell's part of the
/// list. A group of several threads fills a part in any order; each keypoint then counts the lower
/// ones of its cell, which is its place. No sort, and the same lists on every executor.
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
      s.entry[i] = count(s, grid.geometry, get<field::x>(kp, i), get<field::y>(kp, i));
    }
    g.sync();
    sort(g, s, n, grid);
  }

  /// In scratch, by several threads: first of all.
  template <typename Group>
  FT_HOST_DEVICE static void clear(Group g, scratch& s, grid_geometry const& geometry) {
    for (int c = g.rank(); c < geometry.cells(); c += g.size()) { s.start[c] = 0; }
    g.sync();
  }
  /// Then for each keypoint, in any order. Returns its entry.
  FT_HOST_DEVICE static std::uint32_t count(scratch& s, grid_geometry const& geometry, float x,
                                            float y) {
    int const c = Cell::of(geometry, x, y);
    if (c < 0) { return scratch::nowhere; }
    return static_cast<std::uint32_t>(atomic_add(s.start + c, 1) << 16 | c);
  }
  /// At last. @pre all are counted, and a sync() since
  template <typename Group>
  FT_HOST_DEVICE static void sort(Group g, scratch& s, int n, feature_grid_view const& grid) {
    // Prefix sum, each thread over cells that follow each other.
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
    g.sync();
    constexpr int together = 2;  // keypoints of a thread at a time
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
    g.sync();
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
          for (int m = 0; m < 4; ++m) {  // where fewer are left, the last one again
            int const other = s.list[min_of(at + m, to[k] - 1)];
            lower += static_cast<int>((at + m < to[k]) & (other < i));
          }
        }
        if (from[k] < to[k]) { grid.indices[from[k] + lower] = i; }
      }
    }
  }

private:
  /// Without scratch. Not unrolled: few need it, and all would fetch it.
  template <typename Group>
  FT_HOST_DEVICE static void in_memory(Group g, keypoints_view const& kp, int n,
                                       feature_grid_view const& grid) {
    int const cells = grid.geometry.cells();
    int* const start = grid.start;
    int* const list = Group::max_threads == 1 ? grid.indices : grid.unsorted;
    auto const cell = [&](int i) {
      return Cell::of(grid.geometry, get<field::x>(kp, i), get<field::y>(kp, i));
    };
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
    // start[c] moves forward while its cell fills and ends as the start of the next.
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
    // From the last cell down, so that a thread writes what no later step reads.
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

/// Grids of the images first, first + step, ... of a batch of keypoints. Asynchronous on `exec`;
/// allocates nothing; one launch. @tparam Cell nearest_cell (search windows) or row_cell (rectified
/// stereo)
template <typename Cell, typename Exec>
void build_grid(Exec const& exec, keypoints_view const& keypoints, int first, int step, int images,
                feature_grid_view const& grids) {
  for_each_item<per_block<1024>>(exec, images, detail::fill_grid<Cell>{}, keypoints, first, step,
                                 grids);
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
