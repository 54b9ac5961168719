// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints sorted into cells, in compressed row storage: no limit per cell.
#pragma once

#include <cstddef>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// Geometry of the cells: `cols` x `rows` over [min_x, max_x] x [min_y, max_y], pixels.
struct grid_geometry {
  int cols = 64;
  int rows = 48;
  float min_x = 0, min_y = 0, max_x = 0, max_y = 0;
  float inv_width = 0;   ///< cols / (max_x - min_x)
  float inv_height = 0;  ///< rows / (max_y - min_y)

  static grid_geometry over(float min_x, float min_y, float max_x, float max_y, int cols = 64,
                            int rows = 48) {
    return {cols,
            rows,
            min_x,
            min_y,
            max_x,
            max_y,
            static_cast<float>(cols) / (max_x - min_x),
            static_cast<float>(rows) / (max_y - min_y)};
  }
  FT_HOST_DEVICE int cells() const { return cols * rows; }
};

/// Cell c of batch entry b holds indices[b * capacity + start[b * (cells + 1) + c] .. next start),
/// in ascending order. Cells are numbered column by column: c = column * rows + row.
struct feature_grid_view {
  grid_geometry geometry;
  int capacity = 0;
  int* start = nullptr;     ///< [batch][cells + 1]
  int* indices = nullptr;   ///< [batch][capacity]
  int* unsorted = nullptr;  ///< [batch][capacity] workspace of build_grid()

  FT_HOST_DEVICE feature_grid_view slice(int b) const {
    feature_grid_view v = *this;
    v.start += b * (geometry.cells() + 1);
    v.indices += static_cast<std::ptrdiff_t>(b) * capacity;
    v.unsorted += static_cast<std::ptrdiff_t>(b) * capacity;
    return v;
  }
};

/// Places a grid into an arena.
inline void carve(carver& c, feature_grid_view& v, grid_geometry const& geometry, int capacity,
                  int batch) {
  v.geometry = geometry;
  v.capacity = capacity;
  c.place({batch, geometry.cells() + 1}, v.start);
  c.place({batch, capacity}, v.indices, v.unsorted);
}

/// Owner of a grid; move-only.
template <memory_space Space>
class feature_grid : public owner<feature_grid_view, Space> {
public:
  feature_grid() = default;
  /// @throws bad_argument for a grid without cells, capacity or batch
  feature_grid(grid_geometry const& geometry, int capacity, int batch = 1)
      : owner<feature_grid_view, Space>([&](carver& c, feature_grid_view& v) {
          detail::require(capacity >= 1 && batch >= 1 && geometry.cells() >= 1,
                          "a grid needs cells, a capacity and a batch of 1 or more");
          carve(c, v, geometry, capacity, batch);
        }) {}
};

}  // namespace FT_ABI
}  // namespace ft
