// SPDX-License-Identifier: Apache-2.0
/// @file What corner detection keeps of one cell.
#pragma once

#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

struct corner_params {
  int ini_threshold = 20;
  int min_threshold = 7;
};

namespace detail {

/// Bytes from row to row in scratch. A pixel and its score have the same place in their arrays.
inline constexpr int cell_pitch = 80;
inline constexpr int cell_chain = 5;  ///< rows that a thread looks at together
inline constexpr int cell_list_size = 1536;

/// Memory of one cell: shared memory on a device.
struct cell_scratch {
  /// A patch's, and those that threads look at beyond it.
  static constexpr int staged_rows = 3 * cell_chain * ceil_div(max_cell_side, 3 * cell_chain) + 6;
  static constexpr int word_items_most = (max_cell_side + 6) / 4 * (staged_rows - 6) / cell_chain;
  static constexpr int most_kept = (max_cell_side + 1) / 2 * ((max_cell_side + 1) / 2);
  static_assert(2 * most_kept <= staged_rows * cell_pitch,
                "corners fit into the place of the pixels");
  static_assert(cell_pitch >= 3 + max_patch_side && cell_pitch % 16 == 0, "rows of whole words");
  struct quad {
    alignas(16) std::uint32_t words[4];
  };
  std::uint32_t pixels[staged_rows * cell_pitch / 4];
  quad scores[(max_cell_side + 2) * cell_pitch / 16];  ///< from row 2 on, with a rim of zeros
  std::uint16_t candidates[cell_list_size];  ///< places of pixels worth a score, any order
  /// Of the strict threshold, and how many more of the lenient one; may exceed the list: then all
  /// pixels are tried. Two, as a warp may list while another still reads the first.
  int candidate_count[2];
  int kept;                                ///< corners: their places are kept_places()
  std::uint32_t lenient[word_items_most];  ///< flags of pixels for the lenient threshold alone

  /// Instead of the pixels, which have their scores when a corner is found.
  FT_HOST_DEVICE std::uint16_t* kept_places() { return reinterpret_cast<std::uint16_t*>(pixels); }
};

/// Where a cell is: its patch in the level, and that in the work area.
struct cell_place {
  int x0, y0, patch_w, patch_h;
  int x_rel, y_rel;
};

/// Where a cell enters its corners.
struct entry_list {
  corner* to;  ///< the level's, null = it does not
  int* count;
  std::uint32_t place;  ///< of the cell's first corner

  /// Corner i of the cell, as entry number `entry`.
  FT_HOST_DEVICE void write(int entry, int i, corner const& c) const {
    to[entry] = {c.x, c.y,
                 static_cast<std::int32_t>(
                     corner_rank::of(c.response, place + static_cast<std::uint32_t>(i)))};
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
