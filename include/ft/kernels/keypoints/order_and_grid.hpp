// SPDX-License-Identifier: Apache-2.0
/// @file Stage: the order of keypoints, and their feature grids, in one launch.
///
/// The group that orders the keypoints of an image has their coordinates in registers when it
/// computes their places. In the same pass it counts them into the cells of the image's grid, and
/// it lists the cells at the end. This saves a launch compared with order_corners() followed by
/// build_grid(), with the same results. Sources: specification sections 4 and 7.
#pragma once

#include <cstdint>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/keypoints/order.hpp"

namespace ft {
inline namespace FT_ABI {

/// The grids into which the keypoints of stereo pairs are sorted. Image 2b is the left one of pair
/// b.
/// @tparam Rectified left images go to `cells`, one grid a pair, right ones to `right_rows`;
///   otherwise image i goes to grid i of `cells`
template <bool Rectified>
struct keypoint_grids {
  feature_grid_view cells;
  feature_grid_view right_rows;  ///< one column of image rows; rectified pairs only
};

namespace detail {

/// Fills the grids of keypoint_grids from the keypoints that order_image writes.
template <bool Rectified>
struct grid_filler {
  using scratch = grid_scratch;
  keypoint_grids<Rectified> grids;

  template <typename Group>
  FT_HOST_DEVICE void prepare(Group g, scratch& s, int image, keypoints_view const& all) const {
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) { fill.clear(g, s, grid.geometry); }
    });
  }
  template <typename Group>
  FT_HOST_DEVICE std::uint32_t count(Group, scratch& s, int image, keypoints_view const& all,
                                     float x, float y) const {
    std::uint32_t entry = 0;
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) { entry = fill.count(s, grid.geometry, x, y); }
    });
    return entry;
  }
  FT_HOST_DEVICE void keep(scratch& s, int keypoint, std::uint32_t entry) const {
    if (keypoint < scratch::size) { s.entry[keypoint] = entry; }
  }
  template <typename Group>
  FT_HOST_DEVICE void fill(Group g, scratch& s, int image, keypoints_view const& all, int n) const {
    with_grid<Group>(image, all, [&](auto fill, feature_grid_view const& grid, bool in_scratch) {
      if (in_scratch) {
        fill.sort(g, s, n, grid);
      } else {
        g.sync();
        fill(g, s, 0, all.slice(image), 0, 1, grid);
      }
    });
  }

private:
  /// Calls f(fill_grid, the image's grid, whether all keypoints of the image fit into scratch).
  template <typename Group, typename F>
  FT_HOST_DEVICE void with_grid(int image, keypoints_view const& all, F const& f) const {
    auto const call = [&](auto fill, feature_grid_view const& grid) {
      f(fill, grid, scratch::template serves<Group>(grid.geometry, all.capacity));
    };
    if (!Rectified) {
      call(fill_grid<nearest_cell>{}, grids.cells.slice(image));
    } else if (image % 2 == 0) {
      call(fill_grid<nearest_cell>{}, grids.cells.slice(image / 2));
    } else {
      call(fill_grid<row_cell>{}, grids.right_rows.slice(image / 2));
    }
  }
};

}  // namespace detail

/// order_corners(), and fills the grids with the keypoints. Asynchronous on `exec`; allocates
/// nothing; one launch.
template <typename Exec, bool Rectified>
void order_corners(Exec const& exec, ordering_view const& v,
                   keypoint_grids<Rectified> const& grids) {
  detail::order_with(exec, v, detail::grid_filler<Rectified>{grids});
}

}  // namespace FT_ABI
}  // namespace ft
