// SPDX-License-Identifier: Apache-2.0
/// @file Stage: corners. FAST-9/16 with non-maximum suppression per cell, a strict threshold first
/// and a lenient one where a cell would stay empty. Source: specification section 2; Rosten and
/// Drummond, "Machine learning for high-speed corner detection", ECCV 2006.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// A corner before it becomes a keypoint; position relative to the work area's corner (16, 16).
struct corner {
  std::uint16_t x, y;
  std::int32_t response;
};

inline constexpr int corner_border = 16;  ///< the work area starts here
inline constexpr int corner_cell_size = 35;
inline constexpr int max_cell_side = 69;  ///< of a level with a single cell
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
  int slots[max_levels] = {};       ///< corners that a cell of this level can hold at most
  std::ptrdiff_t first_slot[max_levels] = {};
  std::ptrdiff_t total_slots =
      0;  ///< of an image: suppression bounds the number, nothing can overflow

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
  /// Where a level's corners start in the gathered list of an image, and how many fit.
  FT_HOST_DEVICE std::ptrdiff_t level_slots(int l) const {
    return static_cast<std::ptrdiff_t>(cells_of(l)) * slots[l];
  }
};

struct corner_params {
  int ini_threshold = 20;
  int min_threshold = 7;
};

/// Corners of a batch of images: per cell as found, then gathered per level in order.
struct corners_view {
  corner_layout layout;
  int batch = 0;
  corner* cell_corners = nullptr;  ///< [batch][total_slots], per cell
  int* cell_count = nullptr;       ///< [batch][cells]
  corner* list = nullptr;          ///< [batch][total_slots], per level, cells in order
  int* list_count = nullptr;       ///< [batch][levels]

  FT_HOST_DEVICE corner* level_list(int image, int l) const {
    return list + image * layout.total_slots + layout.first_slot[l];
  }
};

inline void carve(carver& c, corners_view& v, corner_layout const& layout, int batch) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const slots = detail::checked_mul(b, static_cast<std::size_t>(layout.total_slots));
  v.layout = layout;
  v.batch = batch;
  v.cell_corners = c.take<corner>(slots);
  v.cell_count = c.take<int>(b * static_cast<std::size_t>(layout.cells));
  v.list = c.take<corner>(slots);
  v.list_count = c.take<int>(b * static_cast<std::size_t>(layout.levels));
}

namespace detail {

/// Circle of 16 pixels around a pixel, starting below it. Values are offsets for one row stride.
struct fast_circle {
  int offset[16];
  FT_HOST_DEVICE explicit fast_circle(int stride)
      : offset{3 * stride,  3 * stride + 1,  2 * stride + 2,  stride + 3,
               3,           -stride + 3,     -2 * stride + 2, -3 * stride + 1,
               -3 * stride, -3 * stride - 1, -2 * stride - 2, -stride - 3,
               -3,          stride - 3,      2 * stride - 2,  3 * stride - 1} {}
};

/// True where `mask` (16 bits, cyclic) has 9 ones in a row.
FT_HOST_DEVICE inline bool has_arc_of_9(unsigned mask) {
  unsigned m = mask | (mask << 16);
  m &= m >> 1;  // runs of 2
  m &= m >> 2;  // 4
  m &= m >> 4;  // 8
  return (m & (mask | (mask << 16)) >> 8) != 0;
}

/// The largest threshold below which the pixel is a corner, 0 where it is none above `threshold`:
/// over the 16 arcs of 9, the largest of the smallest difference, less one.
FT_HOST_DEVICE inline int fast_score(std::uint8_t const* center, fast_circle const& circle,
                                     int threshold) {
  int const v = center[0];
  // Nine in a row hold one of every opposite pair.
  int const high = v + threshold;
  int const low = v - threshold;
  int const p0 = center[circle.offset[0]];
  int const p8 = center[circle.offset[8]];
  bool bright = p0 > high || p8 > high;
  bool dark = p0 < low || p8 < low;
  if (!bright && !dark) { return 0; }
  int const p4 = center[circle.offset[4]];
  int const p12 = center[circle.offset[12]];
  bright = bright && (p4 > high || p12 > high);
  dark = dark && (p4 < low || p12 < low);
  if (!bright && !dark) { return 0; }
  int d[16];
  unsigned bright_mask = 0;
  unsigned dark_mask = 0;
  FT_UNROLL
  for (int k = 0; k < 16; ++k) {
    d[k] = center[circle.offset[k]] - v;
    bright_mask |= static_cast<unsigned>(d[k] > threshold) << k;
    dark_mask |= static_cast<unsigned>(d[k] < -threshold) << k;
  }
  bool const is_bright = has_arc_of_9(bright_mask);
  if (!is_bright && !has_arc_of_9(dark_mask)) { return 0; }
  // A pixel cannot be both: two arcs of 9 of 16 overlap.
  int best = 0;
  int m2[16];
  int m4[16];
  FT_UNROLL
  for (int k = 0; k < 16; ++k) { d[k] = is_bright ? d[k] : -d[k]; }
  FT_UNROLL
  for (int k = 0; k < 16; ++k) { m2[k] = min_of(d[k], d[(k + 1) & 15]); }
  FT_UNROLL
  for (int k = 0; k < 16; ++k) { m4[k] = min_of(m2[k], m2[(k + 2) & 15]); }
  FT_UNROLL
  for (int k = 0; k < 16; ++k) {
    best = max_of(best, min_of(min_of(m4[k], m4[(k + 4) & 15]), d[(k + 8) & 15]));
  }
  return best - 1;
}

}  // namespace detail

/// One cell: scores, suppression, choice of the threshold, corners in raster order.
struct detect_cell {
  struct scratch {
    std::uint8_t pixels[max_patch_side * max_patch_side];
    std::uint8_t scores[(max_cell_side + 2) * (max_cell_side + 2)];  ///< with a rim of zeros
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 corners_view const& out, corner_params const& params) const {
    corner_layout const& layout = out.layout;
    int const image = item / layout.cells;
    int const cell = item % layout.cells;
    int const l = layout.level_of(cell);
    int const in_level = cell - layout.first_cell[l];
    int const cell_w = layout.cell_width[l];
    int const cell_h = layout.cell_height[l];
    int const x_rel = in_level % layout.cols[l] * cell_w;
    int const y_rel = in_level / layout.cols[l] * cell_h;
    auto const level = pyramid.level(image, l);
    int const x0 = corner_border + x_rel;
    int const y0 = corner_border + y_rel;
    int const patch_w = min_of(cell_w + 6, level.width - corner_border - x0);
    int const patch_h = min_of(cell_h + 6, level.height - corner_border - y0);
    int& count = out.cell_count[item];
    if (patch_w < 7 || patch_h < 7) {
      if (g.rank() == 0) { count = 0; }
      return;
    }

    for (int i = g.rank(); i < patch_w * patch_h; i += g.size()) {
      s.pixels[i] = level(x0 + i % patch_w, y0 + i / patch_w);
    }
    int const inner_w = patch_w - 6;
    int const inner_h = patch_h - 6;
    int const pitch = inner_w + 2;
    for (int i = g.rank(); i < pitch; i += g.size()) {
      s.scores[i] = 0;
      s.scores[(inner_h + 1) * pitch + i] = 0;
    }
    for (int i = g.rank(); i < inner_h; i += g.size()) {
      s.scores[(i + 1) * pitch] = 0;
      s.scores[(i + 1) * pitch + inner_w + 1] = 0;
    }
    g.sync();

    int const low = min_of(params.min_threshold, params.ini_threshold);
    detail::fast_circle const circle(patch_w);
    for (int i = g.rank(); i < inner_w * inner_h; i += g.size()) {
      int const x = i % inner_w;
      int const y = i / inner_w;
      s.scores[(y + 1) * pitch + x + 1] = static_cast<std::uint8_t>(
          detail::fast_score(s.pixels + (y + 3) * patch_w + x + 3, circle, low));
    }
    g.sync();

    // Scores do not depend on the threshold: what survives suppression at the lenient one and
    // passes the strict one is what the strict one alone gives.
    int strict_count = 0;
    for (int i = g.rank(); i < inner_w * inner_h; i += g.size()) {
      int const score = suppressed_score(s, i, inner_w, pitch);
      strict_count += static_cast<int>(score >= params.ini_threshold && score > 0);
    }
    bool const any_strict = g.reduce(strict_count, sum_op{}) > 0;
    int const threshold = max_of(any_strict ? params.ini_threshold : params.min_threshold, 1);

    corner* const list = out.cell_corners + image * layout.total_slots + layout.first_slot[l] +
                         static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    int found = 0;
    for (int base = 0; base < inner_w * inner_h; base += g.size()) {
      int const i = base + g.rank();
      int const score = i < inner_w * inner_h ? suppressed_score(s, i, inner_w, pitch) : 0;
      bool const keep = score >= threshold;
      int total = 0;
      int const at = g.exclusive_scan(static_cast<int>(keep), total);
      if (keep) {
        list[found + at] = {static_cast<std::uint16_t>(x_rel + 3 + i % inner_w),
                            static_cast<std::uint16_t>(y_rel + 3 + i / inner_w), score};
      }
      found += total;
    }
    if (g.rank() == 0) { count = found; }
  }

private:
  /// The score where it exceeds those of all eight neighbours, else 0.
  FT_HOST_DEVICE static int suppressed_score(scratch const& s, int i, int inner_w, int pitch) {
    std::uint8_t const* const p = s.scores + (i / inner_w + 1) * pitch + i % inner_w + 1;
    int const v = p[0];
    if (v == 0) { return 0; }
    bool const largest = v > p[-1] && v > p[1] && v > p[-pitch - 1] && v > p[-pitch] &&
                         v > p[-pitch + 1] && v > p[pitch - 1] && v > p[pitch] && v > p[pitch + 1];
    return largest ? v : 0;
  }
};

/// Moves a cell's corners to their place in the level's list.
struct gather_cell {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, corners_view const& v) const {
    corner_layout const& layout = v.layout;
    int const image = item / layout.cells;
    int const cell = item % layout.cells;
    int const l = layout.level_of(cell);
    int const first = image * layout.cells + layout.first_cell[l];
    int const in_level = cell - layout.first_cell[l];
    int before = 0;
    for (int i = g.rank(); i < in_level; i += g.size()) { before += v.cell_count[first + i]; }
    before = g.reduce(before, sum_op{});
    int const count = v.cell_count[item];
    corner const* const from = v.cell_corners + image * layout.total_slots + layout.first_slot[l] +
                               static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    corner* const to = v.level_list(image, l) + before;
    for (int i = g.rank(); i < count; i += g.size()) { to[i] = from[i]; }
    if (in_level == layout.cells_of(l) - 1 && g.rank() == 0) {
      v.list_count[image * layout.levels + l] = before + count;
    }
  }
};

/// Corners of all levels of all images: `out.list`, per level in cell order, and `out.list_count`.
/// Asynchronous on `exec`; allocates nothing; two launches.
template <typename Exec>
void detect_corners(Exec const& exec, image_pyramid_view const& pyramid,
                    corner_params const& params, corners_view const& out) {
  fill_bytes(exec, out.list_count, 0,
             static_cast<std::size_t>(out.batch * out.layout.levels) *
                 sizeof(int));  // levels without a cell
  for_each_item<per_block<128>>(exec, out.batch * out.layout.cells, detect_cell{}, pyramid, out,
                                params);
  for_each_item<per_warp>(exec, out.batch * out.layout.cells, gather_cell{}, out);
}

}  // namespace FT_ABI
}  // namespace ft
