// SPDX-License-Identifier: Apache-2.0
/// @file Shared memory, position and output of the corner detection in one cell.
#pragma once

#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Thresholds on the difference of grey levels, 0 to 255.
struct corner_params {
  int ini_threshold = 20;  ///< strict
  int min_threshold = 7;   ///< lenient: used in cells that stay empty at the strict one
};

namespace detail {

/// Bytes from row to row in scratch. A pixel and its score have the same place in their arrays.
inline constexpr int cell_pitch = 80;
/// Rows per item of the candidate search, 3 apart.
inline constexpr int cell_chain = 5;
/// Capacity of the candidate list; a cell with more candidates scores every pixel.
inline constexpr int cell_list_size = 1536;

/// Scratch of one cell: shared memory on a device.
struct cell_scratch {
  /// Rows of the largest patch, rounded up to whole items of the candidate search.
  static constexpr int staged_rows = 3 * cell_chain * ceil_div(max_cell_side, 3 * cell_chain) + 6;
  static constexpr int max_word_items = (max_cell_side + 6) / 4 * (staged_rows - 6) / cell_chain;
  static constexpr int max_kept = (max_cell_side + 1) / 2 * ((max_cell_side + 1) / 2);
  static_assert(2 * max_kept <= staged_rows * cell_pitch, "kept places fit over the pixels");
  static_assert(cell_pitch >= 3 + max_patch_side && cell_pitch % 16 == 0, "rows of whole words");
  struct quad {
    alignas(16) std::uint32_t words[4];
  };
  std::uint32_t pixels[staged_rows * cell_pitch / 4];
  quad scores[(max_cell_side + 2) * cell_pitch / 16];  ///< from row 2 on, with a rim of zeros
  std::uint16_t candidates[cell_list_size];            ///< places of pixels to score, any order
  /// Candidates of the strict threshold, and additional ones of the lenient threshold. Two
  /// counters, because a warp may append to the second while another one still reads the first.
  int candidate_count[2];
  int kept;                               ///< number of corners
  int first;                              ///< index of the first one in the level's list
  std::uint32_t lenient[max_word_items];  ///< flags of pixels for the lenient threshold only

  /// Places of the corners. They overwrite the pixels, which are all scored by then.
  FT_HOST_DEVICE std::uint16_t* kept_places() { return reinterpret_cast<std::uint16_t*>(pixels); }
};

/// Position of a cell: its patch in the level, and the patch's origin in the work area.
struct cell_place {
  int x0, y0, patch_w, patch_h;
  int x_rel, y_rel;
};

/// The pixels of a staged patch that can be corners: w x h, from row 3 on.
struct cell_inner {
  int first_x;  ///< column in scratch
  int w, h;
};

/// The list of a level, to which its cells append their corners in any order. Detection counts in
/// `progress`, which the last cell to finish resets, so that it is 0 between launches.
struct level_list {
  corner* to;
  int* count;                    ///< gets the number of corners of the level
  unsigned long long* progress;  ///< finished cells << 32 | their corners
  int cells;                     ///< of the level

  /// Finishes a cell with `found` corners; called once per cell. Returns the index of its first
  /// corner.
  FT_HOST_DEVICE int finish_cell(int found) const {
    unsigned long long const before =
        atomic_add(progress, 1ull << 32 | static_cast<unsigned long long>(found));
    int const first = static_cast<int>(before & 0xffffffffu);
    if (static_cast<int>(before >> 32) + 1 == cells) {
      atomic_exchange(progress, 0ull);
      *count = first + found;
    }
    return first;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
