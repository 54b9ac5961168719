// SPDX-License-Identifier: Apache-2.0
/// @file Stage: corners. FAST-9/16 with non-maximum suppression per cell: a strict threshold first,
/// and a lenient one for cells that would stay empty. Source: specification section 2; Rosten and
/// Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/corners/cell_device.hpp"
#include "ft/kernels/corners/cell_host.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// One cell: scores, suppression, choice of the threshold.
struct detect_cell {
  static constexpr bool wide_on_host = true;
  /// Blocks per multiprocessor: with 12, all cells of an image pair are resident on a large device.
  static constexpr int resident_blocks = 12;
  using scratch = cell_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 corners_view const& out, corner_params const& params) const {
    corner_layout const& layout = out.layout;
    int const image = item / layout.cells;
    if (pyramid.absent.has(image)) { return; }
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
    int const of_level = image * layout.levels + l;
    level_list const list{out.level_list(image, l), out.list_count + of_level,
                          out.progress + of_level, layout.cells_of(l)};
    if (patch_w < 2 * corner_margin + 1 || patch_h < 2 * corner_margin + 1) {
      if (g.rank() == 0) { list.finish_cell(0); }
    } else if constexpr (Group::max_threads == 1) {
      detect_alone(s, level, at, params, list);
    } else {
      detect_together(g, s, level, at, params, list);
    }
  }
};

}  // namespace detail

/// Clears all arrays; once, before the first detect_corners(). It sets the count of levels without
/// cells, which detection never writes. It also makes reads beyond the counts of lists defined.
/// Asynchronous on `exec`; allocates nothing.
template <typename Exec>
void clear_corners(Exec const& exec, corners_view const& corners) {
  auto const batch = static_cast<std::size_t>(corners.batch);
  auto const levels = batch * static_cast<std::size_t>(corners.layout.levels);
  fill_bytes(exec, corners.list, 0,
             batch * static_cast<std::size_t>(corners.layout.total_slots) * sizeof(corner));
  fill_bytes(exec, corners.list_count, 0, levels * sizeof(int));
  fill_bytes(exec, corners.progress, 0, levels * sizeof(unsigned long long));
}

/// Detects the corners of all images that are not absent into `out.list` and `out.list_count`, per
/// level in any order. Asynchronous on `exec`; allocates nothing; one launch.
/// @pre clear_corners() was called once for `out`; every call resets `out.progress` to 0
template <typename Exec>
void detect_corners(Exec const& exec, image_pyramid_view const& pyramid,
                    corner_params const& params, corners_view const& out) {
  for_each_item<per_block<128>>(detail::with_order(exec, detail::launch_order::full_wave),
                                out.batch * out.layout.cells, detail::detect_cell{}, pyramid, out,
                                params);
}

}  // namespace FT_ABI
}  // namespace ft
