// SPDX-License-Identifier: Apache-2.0
/// @file Frame::mGrid: the keypoints of each cell.
#pragma once

#include <cstddef>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/kernels/grid.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {

/// Fills grids on the host: nearly all of the time goes into taking memory for a thousand lists,
/// which is shared among threads, and which a device could not do. To work out the cells takes a
/// few microseconds, and a grid from the device would have to be transferred.
class cell_lists {
public:
  explicit cell_lists(helper_threads& helpers) : helpers_(&helpers) {}

  /// Replaces the contents of all cells: indices of keypoints, ascending. Keypoints outside of the
  /// cells are left out.
  /// @param image bounds that the cells cover, pixels
  /// @param grid [column][row]
  template <typename Keypoint, typename List, std::size_t Columns, std::size_t Rows>
  void fill(bounds const& image, std::vector<Keypoint> const& keypoints,
            List (&grid)[Columns][Rows]) {
    sort(grid_geometry::over(image.min_x, image.min_y, image.max_x, image.max_y,
                             static_cast<int>(Columns), static_cast<int>(Rows)),
         keypoints);
    constexpr int parts = static_cast<int>((Columns + columns_at_a_time - 1) / columns_at_a_time);
    helpers_->share(parts, [&](int part) {
      std::size_t const begin = static_cast<std::size_t>(part) * columns_at_a_time;
      for (std::size_t x = begin; x < begin + columns_at_a_time && x < Columns; ++x) {
        for (std::size_t y = 0; y < Rows; ++y) {
          std::size_t const cell = x * Rows + y;
          grid[x][y].assign(sorted_.begin() + (cell == 0 ? 0 : end_[cell - 1]),
                            sorted_.begin() + end_[cell]);
        }
      }
    });
  }

private:
  static constexpr std::size_t columns_at_a_time = 4;

  /// Fills sorted_, the indices cell by cell, and end_, where each cell ends in it.
  template <typename Keypoint>
  void sort(grid_geometry const& geometry, std::vector<Keypoint> const& keypoints) {
    std::size_t const n = keypoints.size();
    cell_.resize(n);
    sorted_.resize(n);
    end_.assign(static_cast<std::size_t>(geometry.cells()), 0);
    for (std::size_t i = 0; i < n; ++i) {
      int const c = nearest_cell::of(geometry, keypoints[i].pt.x, keypoints[i].pt.y);
      cell_[i] = c;
      if (c >= 0) { ++end_[static_cast<std::size_t>(c)]; }
    }
    std::ptrdiff_t before = 0;
    for (std::ptrdiff_t& e : end_) {
      std::ptrdiff_t const here = e;
      e = before;
      before += here;
    }
    for (std::size_t i = 0; i < n; ++i) {
      if (cell_[i] < 0) { continue; }
      std::ptrdiff_t& at = end_[static_cast<std::size_t>(cell_[i])];
      sorted_[static_cast<std::size_t>(at++)] = i;
    }
  }

  helper_threads* helpers_;
  std::vector<int> cell_;  ///< by keypoint, -1 = none
  std::vector<std::ptrdiff_t> end_;
  std::vector<std::size_t> sorted_;
};

}  // namespace orbslam3
}  // namespace ft
