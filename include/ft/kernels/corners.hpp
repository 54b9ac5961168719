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
  /// How many corners a level's list can hold.
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
  static constexpr int mask_words = (max_cell_side + 31) / 32;
  struct scratch {
    std::uint8_t pixels[max_patch_side * max_patch_side];
    std::uint8_t scores[(max_cell_side + 2) * (max_cell_side + 2)];  ///< with a rim of zeros
    std::uint16_t candidates[max_cell_side * max_cell_side];         ///< y << 8 | x, any order
    int candidate_count;
    unsigned kept[2][max_cell_side]
                 [mask_words];  ///< bit per pixel: above the lenient, the strict threshold
    int row_start[max_cell_side];
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
    int const inner_w = patch_w - 6;
    int const inner_h = patch_h - 6;
    int const pitch = inner_w + 2;
    tile_threads const t(g);

    for (int y = t.row; y < patch_h; y += t.rows) {
      std::uint8_t const* const from = level.row(y0 + y) + x0;
      for (int x = t.lane; x < patch_w; x += t.lanes) { s.pixels[y * patch_w + x] = from[x]; }
    }
    for (int y = t.row; y < inner_h + 2; y += t.rows) {
      for (int x = t.lane; x < pitch; x += t.lanes) { s.scores[y * pitch + x] = 0; }
    }
    for (int i = g.rank(); i < 2 * inner_h * mask_words; i += g.size()) {
      s.kept[i / (inner_h * mask_words)][i / mask_words % inner_h][i % mask_words] = 0;
    }
    if (g.rank() == 0) { s.candidate_count = 0; }
    g.sync();

    int const low = min_of(params.min_threshold, params.ini_threshold);
    for (int y = t.row; y < inner_h; y += t.rows) {
      find_candidates(t, s, y, inner_w, patch_w, low);
    }
    g.sync();

    int const candidates = s.candidate_count;
    detail::fast_circle const circle(patch_w);
    for (int i = g.rank(); i < candidates; i += g.size()) {
      int const x = s.candidates[i] & 255;
      int const y = s.candidates[i] >> 8;
      s.scores[(y + 1) * pitch + x + 1] = static_cast<std::uint8_t>(
          detail::fast_score(s.pixels + (y + 3) * patch_w + x + 3, circle, low));
    }
    g.sync();

    // Scores do not depend on the threshold: what survives suppression at the lenient one and
    // passes the strict one is what the strict one alone gives.
    int const lenient = max_of(params.min_threshold, 1);
    int const strict_threshold = max_of(params.ini_threshold, 1);
    for (int i = g.rank(); i < candidates; i += g.size()) {
      int const x = s.candidates[i] & 255;
      int const y = s.candidates[i] >> 8;
      int const score = suppressed_score(s.scores + (y + 1) * pitch + x + 1, pitch);
      unsigned const bit = 1u << (x & 31);
      if (score >= lenient) { atomic_or(&s.kept[0][y][x / 32], bit); }
      if (score >= strict_threshold) { atomic_or(&s.kept[1][y][x / 32], bit); }
    }
    g.sync();

    bool any_strict = false;
    for (int i = g.rank(); i < inner_h * mask_words; i += g.size()) {
      any_strict = any_strict || s.kept[1][i / mask_words][i % mask_words] != 0;
    }
    int const chosen = g.reduce(static_cast<int>(any_strict), max_op{});
    for (int y = g.rank(); y < inner_h; y += g.size()) {
      int in_row = 0;
      for (int w = 0; w < mask_words; ++w) { in_row += popcount(s.kept[chosen][y][w]); }
      s.row_start[y] = in_row;
    }
    g.sync();
    int const found = g.exclusive_scan_array(s.row_start, inner_h);
    g.sync();

    corner* const list = out.cell_corners + image * layout.total_slots + layout.first_slot[l] +
                         static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    for (int i = g.rank(); i < candidates; i += g.size()) {
      int const x = s.candidates[i] & 255;
      int const y = s.candidates[i] >> 8;
      unsigned const* const row = s.kept[chosen][y];
      unsigned const bit = 1u << (x & 31);
      if ((row[x / 32] & bit) == 0) { continue; }
      int at = s.row_start[y] + popcount(row[x / 32] & (bit - 1));
      for (int w = 0; w < x / 32; ++w) { at += popcount(row[w]); }
      list[at] = {static_cast<std::uint16_t>(x_rel + 3 + x),
                  static_cast<std::uint16_t>(y_rel + 3 + y), s.scores[(y + 1) * pitch + x + 1]};
    }
    if (g.rank() == 0) { count = found; }
  }

private:
  /// A group's threads as rows of up to 32 lanes.
  struct tile_threads {
    int lane, lanes, row, rows;
    template <typename Group>
    FT_HOST_DEVICE explicit tile_threads(Group g)
        : lane(g.rank() % min_of(g.size(), 32)),
          lanes(min_of(g.size(), 32)),
          row(g.rank() / lanes),
          rows(g.size() / lanes) {}
  };

  /// Lists the pixels of a row that can be corners: nine in a row on the circle hold one of each
  /// opposite pair, so one of both pairs on the axes must be brighter, or one of both darker.
  FT_HOST_DEVICE static void find_candidates(tile_threads const& t, scratch& s, int y, int inner_w,
                                             int patch_w, int threshold) {
    constexpr int run = 16;  // on the host, as many tests at a time without a branch between them
    std::uint8_t const* const p = s.pixels + (y + 3) * patch_w + 3;
    int const step = t.lanes == 1 ? run : t.lanes;
    for (int base = t.lane; base < inner_w; base += step) {
      int const n = t.lanes == 1 ? min_of(run, inner_w - base) : 1;
      std::uint8_t flags[run];
      for (int k = 0; k < n; ++k) {
        std::uint8_t const* const c = p + base + k;
        int const v = c[0];
        int const up = c[-3 * patch_w];
        int const down = c[3 * patch_w];
        int const left = c[-3];
        int const right = c[3];
        int const brightest = min_of(max_of(up, down), max_of(left, right));
        int const darkest = max_of(min_of(up, down), min_of(left, right));
        flags[k] =
            static_cast<std::uint8_t>((brightest > v + threshold) | (darkest < v - threshold));
      }
      for (int k = 0; k < n; ++k) {
        if (flags[k] != 0) {
          int const at = atomic_add(&s.candidate_count, 1);
          s.candidates[at] = static_cast<std::uint16_t>(y << 8 | (base + k));
        }
      }
    }
  }

  /// The score where it exceeds those of all eight neighbours, else 0.
  FT_HOST_DEVICE static int suppressed_score(std::uint8_t const* p, int pitch) {
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
