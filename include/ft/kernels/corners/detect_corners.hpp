// SPDX-License-Identifier: Apache-2.0
/// @file Stage: corners. FAST-9/16 with non-maximum suppression per cell, a strict threshold first
/// and a lenient one where a cell would stay empty. Source: specification section 2; Rosten and
/// Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/corners/cell_device.hpp"
#include "ft/kernels/corners/cell_host.hpp"
#include "ft/kernels/corners/gather.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// One cell: scores, suppression, choice of the threshold, corners in raster order.
struct detect_cell {
  static constexpr bool wide_on_host = true;
  /// Blocks per multiprocessor: with 12, all cells of an image pair are resident on a large device.
  static constexpr int resident_blocks = 12;
  using scratch = cell_scratch;

  bool enters = false;  ///< also append to the unordered list

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 corners_view const& out, corner_params const& params) const {
    corner_layout const& layout = out.layout;
    int const image = item / layout.cells;
    int const cell = item - image * layout.cells;
    int const l = layout.level_of(cell);
    int const in_level = cell - layout.first_cell[l];
    int const cell_w = layout.cell_width[l];
    int const cell_h = layout.cell_height[l];
    int const row = in_level / layout.cols[l];
    int const x_rel = (in_level - row * layout.cols[l]) * cell_w;
    int const y_rel = row * cell_h;
    auto const level = pyramid.level(image, l);
    int const x0 = corner_border + x_rel;
    int const y0 = corner_border + y_rel;
    int const patch_w = min_of(cell_w + 6, level.width - corner_border - x0);
    int const patch_h = min_of(cell_h + 6, level.height - corner_border - y0);
    cell_place const at{x0, y0, patch_w, patch_h, x_rel, y_rel};
    std::ptrdiff_t const first = static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    corner* const list = out.cell_corners + out.level_slot(image, l) + first;
    entry_list const entered{enters ? out.entries + out.level_slot(image, l) : nullptr,
                             out.entry_count + image * layout.levels + l,
                             static_cast<std::uint32_t>(first)};
    int found = 0;
    if (patch_w >= 7 && patch_h >= 7) {
      if constexpr (Group::max_threads == 1) {
        found = detect_alone(s, level, at, params, list);
        if (enters) {
          int const entry = atomic_add(entered.count, found);
          for (int i = 0; i < found; ++i) { entered.write(entry + i, i, list[i]); }
        }
      } else {
        found = detect_together(g, s, level, at, params, list, entered);
      }
    }
    if (g.rank() == 0) { out.cell_count[item] = found; }
  }
};

}  // namespace detail

/// Detects the corners of all images: per cell (`out.cell_corners`, `out.cell_count`) and per level
/// in any order (`out.entries`, `out.entry_count`). A consumer of the entries need not wait for
/// gather_corners(). Asynchronous on `exec`; allocates nothing; one launch.
/// @pre `out.can_enter()`, and `out.entry_count` is 0
template <typename Exec>
void enter_corners(Exec const& exec, image_pyramid_view const& pyramid, corner_params const& params,
                   corners_view const& out) {
  for_each_item<per_block<128>>(detail::with_order(exec, detail::launch_order::full_wave),
                                out.batch * out.layout.cells, detail::detect_cell{true}, pyramid,
                                out, params);
}

/// Detects the corners of all images and gathers them: `out.list`, per level in cell order, and
/// `out.list_count`. Asynchronous on `exec`; allocates nothing; two launches.
template <typename Exec>
void detect_corners(Exec const& exec, image_pyramid_view const& pyramid,
                    corner_params const& params, corners_view const& out) {
  for_each_item<per_block<128>>(detail::with_order(exec, detail::launch_order::full_wave),
                                out.batch * out.layout.cells, detail::detect_cell{}, pyramid, out,
                                params);
  gather_corners(exec, out);
}

}  // namespace FT_ABI
}  // namespace ft
