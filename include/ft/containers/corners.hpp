// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a batch of images, before they become keypoints.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/columns.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// A corner before it becomes a keypoint.
struct alignas(8) corner {
  std::uint16_t x, y;     ///< relative to the work area's origin (16, 16), pixels of the level
  std::int32_t response;  ///< corner score, 1 to 254
};

inline constexpr int corner_border = 16;     ///< width of the margin around the work area
inline constexpr int corner_cell_size = 35;  ///< nominal side of a cell
inline constexpr int max_cell_side = 69;     ///< in a level with a single cell
inline constexpr int corner_margin = 3;      ///< of a patch around the pixels of its cell
inline constexpr int max_patch_side = max_cell_side + 2 * corner_margin;

/// The order of the corners of a level: cell by cell, row by row within a cell. The sequential rule
/// lists them in this order. Of equal corners, the quadtree keeps the first one.
struct corner_order {
  int cols = 0;
  int cell_width = 0;
  int cell_height = 0;
  detail::small_divider col_of{1};
  detail::small_divider row_of{1};

  corner_order() = default;
  FT_HOST_DEVICE corner_order(int columns, int width, int height)
      : cols(columns), cell_width(width), cell_height(height), col_of(width), row_of(height) {}
  /// Ascending in this order, and distinct for distinct pixels of the work area.
  FT_HOST_DEVICE std::uint32_t operator()(int x, int y) const {
    int const col = col_of(max_of(x - corner_margin, 0));
    int const row = row_of(max_of(y - corner_margin, 0));
    int const in_rows =
        (row * cols + col) * (cell_height + 2 * corner_margin) + y - row * cell_height;
    return static_cast<std::uint32_t>(in_rows) *
               static_cast<std::uint32_t>(cell_width + 2 * corner_margin) +
           static_cast<std::uint32_t>(x - col * cell_width);
  }
};

/// Cells of all levels of one image, numbered level by level.
struct corner_layout {
  int levels = 0;
  int cols[max_levels] = {};
  int rows[max_levels] = {};
  int cell_width[max_levels] = {};
  int cell_height[max_levels] = {};
  int first_cell[max_levels] = {};  ///< of a level
  int cells = 0;                    ///< of an image
  /// Capacity of a cell: the most corners that suppression can leave, so nothing overflows.
  int slots[max_levels] = {};
  std::ptrdiff_t first_slot[max_levels] = {};  ///< of a level
  std::ptrdiff_t total_slots = 0;              ///< of an image

  static corner_layout make(pyramid_geometry const& g) {
    corner_layout c;
    c.levels = g.levels;
    for (int l = 0; l < g.levels; ++l) {
      int const width = g.width[l] - 2 * corner_border;
      int const height = g.height[l] - 2 * corner_border;
      c.cols[l] = width > 0 ? width / corner_cell_size : 0;
      c.rows[l] = height > 0 ? height / corner_cell_size : 0;
      c.first_cell[l] = c.cells;
      c.first_slot[l] = c.total_slots;
      if (c.cols[l] == 0 || c.rows[l] == 0) {
        c.cols[l] = c.rows[l] = 0;
        continue;
      }
      c.cell_width[l] = ceil_div(width, c.cols[l]);
      c.cell_height[l] = ceil_div(height, c.rows[l]);
      c.slots[l] = ceil_div(c.cell_width[l], 2) * ceil_div(c.cell_height[l], 2);
      int const cells = c.cols[l] * c.rows[l];
      c.cells += cells;
      c.total_slots += static_cast<std::ptrdiff_t>(cells) * c.slots[l];
    }
    return c;
  }
  FT_HOST_DEVICE int level_of(int cell) const {
    int l = 0;
    while (l + 1 < levels && cell >= first_cell[l + 1]) { ++l; }
    return l;
  }
  FT_HOST_DEVICE int cells_of(int l) const { return cols[l] * rows[l]; }
  /// @pre the level has cells
  FT_HOST_DEVICE corner_order order_of(int l) const {
    return {cols[l], cell_width[l], cell_height[l]};
  }
  /// Capacity of a level's list.
  FT_HOST_DEVICE std::ptrdiff_t level_slots(int l) const {
    return static_cast<std::ptrdiff_t>(cells_of(l)) * slots[l];
  }
};

/// Corners of a batch of images, per level in any order. Stages that depend on an order use
/// corner_order.
struct corners_view {
  corner_layout layout;
  int batch = 0;
  corner* list = nullptr;     ///< [batch][total_slots] per level
  int* list_count = nullptr;  ///< [batch][levels]
  /// [batch][levels] progress of a running detection: finished cells << 32 | their corners. 0
  /// before and after the detection
  unsigned long long* progress = nullptr;

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, layout.total_slots}, list);
    each({batch, layout.levels}, list_count, progress);
  }
  FT_HOST_DEVICE std::ptrdiff_t level_slot(int image, int l) const {
    return image * layout.total_slots + layout.first_slot[l];
  }
  FT_HOST_DEVICE corner* level_list(int image, int l) const { return list + level_slot(image, l); }
};

namespace detail {

/// Keeps those corners of a list for which keep(corner) holds, in their order. All threads of a
/// group call. @return how many
template <typename Group, typename Keep>
FT_HOST_DEVICE int keep_corners(Group g, corner* list, int n, Keep const& keep) {
  int kept = 0;
  for (int base = 0; base < n; base += g.size()) {
    int const i = base + g.rank();
    corner const c = i < n ? list[i] : corner{};
    bool const stays = i < n && keep(c);
    int total = 0;
    int const rank = g.exclusive_scan(static_cast<int>(stays), total);
    g.sync();  // all reads before the first write
    if (stays) { list[kept + rank] = c; }
    kept += total;
  }
  g.sync();
  return kept;
}

}  // namespace detail

/// Places the arrays into an arena.
inline void carve(carver& c, corners_view& v, corner_layout const& layout, int batch) {
  v.layout = layout;
  v.batch = batch;
  detail::place_columns(c, v);
}

}  // namespace FT_ABI
}  // namespace ft
