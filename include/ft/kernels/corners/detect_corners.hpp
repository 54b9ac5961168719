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
#include "ft/kernels/corners/detail/cell_device.hpp"
#include "ft/kernels/corners/detail/strip_host.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// A cell of an image.
struct cell_at {
  cell_place place;
  bool has_pixels;  ///< that can be corners
};
FT_HOST_DEVICE inline cell_at cell_of(corner_layout const& layout, gray_view level, int l, int row,
                                      int col) {
  int const x_rel = col * layout.cell_width[l];
  int const y_rel = row * layout.cell_height[l];
  int const x0 = corner_border + x_rel;
  int const y0 = corner_border + y_rel;
  int const patch_w = min_of(layout.cell_width[l] + 6, level.width - corner_border - x0);
  int const patch_h = min_of(layout.cell_height[l] + 6, level.height - corner_border - y0);
  return {{x0, y0, patch_w, patch_h, x_rel, y_rel},
          patch_w > 2 * corner_margin && patch_h > 2 * corner_margin};
}
FT_HOST_DEVICE inline level_list list_of(corners_view const& out, int image, int l) {
  int const of_level = image * out.layout.levels + l;
  return {out.level_list(image, l), out.list_count + of_level, out.progress + of_level,
          out.layout.cells_of(l)};
}

/// One cell, on a device: scores, suppression, choice of the threshold.
struct detect_cell {
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
    int const row = in_level / layout.cols[l];
    auto const level = pyramid.level(image, l);
    cell_at const at = cell_of(layout, level, l, row, in_level - row * layout.cols[l]);
    level_list const list = list_of(out, image, l);
    if (at.has_pixels) {
      detect_together(g, s, level, at.place, params, list);
    } else if (g.rank() == 0) {
      list.finish_cell(0);
    }
  }
};

/// One strip of neighbouring cells, on the host: long rows of pixels suit a CPU.
struct detect_strip {
  static constexpr bool wide_on_host = true;
  using scratch = strip_scratch;

  /// Strips of an image.
  FT_HOST_DEVICE static int strips(corner_layout const& layout) {
    int all = 0;
    for (int l = 0; l < layout.levels; ++l) { all += layout.rows[l] * in_row(layout, l); }
    return all;
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch& s, int item, image_pyramid_view const& pyramid,
                                 corners_view const& out, corner_params const& params) const {
    static_assert(Group::max_threads == 1, "a strip is searched by one thread");
    corner_layout const& layout = out.layout;
    int const of_image = strips(layout);
    int const image = item / of_image;
    if (pyramid.absent.has(image)) { return; }
    int strip = item - image * of_image;
    int l = 0;
    for (; strip >= layout.rows[l] * in_row(layout, l); ++l) {
      strip -= layout.rows[l] * in_row(layout, l);
    }
    int const cells = ceil_div(layout.cols[l], in_row(layout, l));
    int const row = strip / in_row(layout, l);
    int const first = strip % in_row(layout, l) * cells;
    detect(s, pyramid.level(image, l), l, row, {first, min_of(first + cells, layout.cols[l])},
           layout, params, list_of(out, image, l));
  }

private:
  FT_HOST_DEVICE static int in_row(corner_layout const& layout, int l) {
    return ceil_div(layout.cols[l], strip_cells);
  }
  /// Columns [first, end) of cells.
  struct columns {
    int first, end;
  };
  FT_HOST_DEVICE FT_INLINE static void detect(scratch& s, gray_view level, int l, int row,
                                              columns const& of, corner_layout const& layout,
                                              corner_params const& params, level_list const& list) {
    cell_place cells[strip_cells];
    int count = 0;
    for (int col = of.first; col < of.end; ++col) {
      cell_at const at = cell_of(layout, level, l, row, col);
      if (at.has_pixels) {
        cells[count++] = at.place;
      } else {
        list.finish_cell(0);
      }
    }
    if (count == 0) { return; }
    int const low = clamp(min_of(params.min_threshold, params.ini_threshold), 0, 255);
    score_strip(s, level, cells, count, static_cast<std::uint8_t>(low));
    for (int c = 0; c < count; ++c) { list_cell(s, s.scores[c], cells[c], params, list); }
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
  if constexpr (Exec::asynchronous) {
    for_each_item<per_block<128>>(detail::with_order(exec, detail::launch_order::full_wave),
                                  out.batch * out.layout.cells, detail::detect_cell{}, pyramid, out,
                                  params);
  } else {
    for_each_item<per_thread>(exec, out.batch * detail::detect_strip::strips(out.layout),
                              detail::detect_strip{}, pyramid, out, params);
  }
}

}  // namespace FT_ABI
}  // namespace ft
