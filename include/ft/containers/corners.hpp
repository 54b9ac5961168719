// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a batch of images, before they become keypoints.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// A corner before it becomes a keypoint.
struct alignas(8) corner {
  std::uint16_t x, y;     ///< relative to the work area's origin (16, 16), pixels of the level
  std::int32_t response;  ///< score; in `corners_view::entries` a corner_rank
};

/// Key of a corner in a list of any order: 8 bits of response, and below them 24 bits that decrease
/// with the place in the level's ordered array. So among equal responses the corner that comes
/// first in the ordered list has the highest rank.
struct corner_rank {
  static constexpr int place_bits = 24;
  static constexpr std::uint32_t last_place = (1u << place_bits) - 1;

  FT_HOST_DEVICE static std::uint32_t of(int response, std::uint32_t place) {
    return static_cast<std::uint32_t>(response) << place_bits | (last_place - place);
  }
  FT_HOST_DEVICE static int response(std::uint32_t rank) {
    return static_cast<int>(rank >> place_bits);
  }
};

inline constexpr int corner_border = 16;     ///< width of the margin around the work area
inline constexpr int corner_cell_size = 35;  ///< nominal side of a cell
inline constexpr int max_cell_side = 69;     ///< in a level with a single cell
inline constexpr int max_patch_side = max_cell_side + 6;

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
  /// Capacity of a level's list.
  FT_HOST_DEVICE std::ptrdiff_t level_slots(int l) const {
    return static_cast<std::ptrdiff_t>(cells_of(l)) * slots[l];
  }
};

/// Corners of a batch of images: per cell, gathered per level in cell order, and per level in any
/// order.
struct corners_view {
  corner_layout layout;
  int batch = 0;
  corner* cell_corners = nullptr;  ///< [batch][total_slots] per cell
  int* cell_count = nullptr;       ///< [batch][cells]
  corner* list = nullptr;          ///< [batch][total_slots] per level, in cell order
  int* list_count = nullptr;       ///< [batch][levels]
  corner* entries = nullptr;       ///< [batch][total_slots] per level in any order, with ranks
  int* entry_count = nullptr;      ///< [batch][levels]

  /// Whether every place of the largest level fits into a corner_rank.
  bool can_enter() const {
    std::ptrdiff_t most = 0;
    for (int l = 0; l < layout.levels; ++l) { most = max_of(most, layout.level_slots(l)); }
    return most <= std::ptrdiff_t{corner_rank::last_place};
  }
  FT_HOST_DEVICE std::ptrdiff_t level_slot(int image, int l) const {
    return image * layout.total_slots + layout.first_slot[l];
  }
  FT_HOST_DEVICE corner* level_list(int image, int l) const { return list + level_slot(image, l); }
};

/// Places the arrays into an arena.
inline void carve(carver& c, corners_view& v, corner_layout const& layout, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const slots = detail::checked_mul(b, static_cast<std::size_t>(layout.total_slots));
  v.layout = layout;
  v.batch = batch;
  v.cell_corners = c.take<corner>(slots);
  v.cell_count = c.take<int>(b * static_cast<std::size_t>(layout.cells));
  v.list = c.take<corner>(slots);
  v.list_count = c.take<int>(b * static_cast<std::size_t>(layout.levels));
  v.entries = c.take<corner>(slots);
  v.entry_count = c.take<int>(b * static_cast<std::size_t>(layout.levels));
}

}  // namespace FT_ABI
}  // namespace ft
