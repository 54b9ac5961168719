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
#include "ft/kernels/detail/corner_runs.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

/// A corner before it becomes a keypoint; position relative to the work area's corner (16, 16).
struct alignas(8) corner {
  std::uint16_t x, y;
  std::int32_t response;
};

/// In a list of any order a corner has its rank in place of its response: 8 bits of response, and
/// below them what is higher for a lower place in the level's `cell_corners`. So of equals the
/// first in the ordered list is above the others.
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
  corner* entries = nullptr;       ///< [batch][total_slots], per level in any order: corner_rank
  int* entry_count = nullptr;      ///< [batch][levels]

  /// Whether places in the largest level are few enough for corner_rank.
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

namespace detail {

/// Circle of 16 pixels around a pixel, starting below it. Values are offsets for one row stride.
struct fast_circle {
  int offset[16];
  FT_HOST_DEVICE explicit constexpr fast_circle(int stride)
      : offset{3 * stride,  3 * stride + 1,  2 * stride + 2,  stride + 3,
               3,           -stride + 3,     -2 * stride + 2, -3 * stride + 1,
               -3 * stride, -3 * stride - 1, -2 * stride - 2, -stride - 3,
               -3,          stride - 3,      2 * stride - 2,  3 * stride - 1} {}
};

/// The largest threshold below which the pixel is a corner, 0 where it is none above `threshold`:
/// over the 16 arcs of 9, the largest of the smallest difference, less one. From pairs of 16 bits,
/// which a device has instructions for. @param threshold 0 or more
FT_HOST_DEVICE inline int fast_score_of_pairs(std::uint8_t const* center, fast_circle const& circle,
                                              int threshold) {
  std::uint32_t p[8];  // opposite pixels of the circle: k, and k + 8 in the high half
  FT_UNROLL
  for (int k = 0; k < 8; ++k) {
    p[k] = center[circle.offset[k]] | static_cast<std::uint32_t>(center[circle.offset[k + 8]])
                                          << 16;
  }
  // Runs of 2, 4 and 8 from every second pixel; each is in two arcs of 9, one pixel longer at
  // either end, of which the better one counts.
  std::uint32_t low[4];
  std::uint32_t high[4];
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    low[i] = min_pairs(p[2 * i], p[2 * i + 1]);
    high[i] = max_pairs(p[2 * i], p[2 * i + 1]);
  }
  std::uint32_t low4[4];
  std::uint32_t high4[4];
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    low4[i] = min_pairs(low[i], i < 3 ? low[(i + 1) & 3] : swap_pair(low[0]));
    high4[i] = max_pairs(high[i], i < 3 ? high[(i + 1) & 3] : swap_pair(high[0]));
  }
  std::uint32_t brightest = 0;          // largest over the arcs of the smallest pixel
  std::uint32_t darkest = 0x00ff00ffu;  // smallest of the largest
  FT_UNROLL
  for (int i = 0; i < 4; ++i) {
    std::uint32_t const low8 =
        min_pairs(low4[i], i < 2 ? low4[(i + 2) & 3] : swap_pair(low4[(i + 2) & 3]));
    std::uint32_t const high8 =
        max_pairs(high4[i], i < 2 ? high4[(i + 2) & 3] : swap_pair(high4[(i + 2) & 3]));
    std::uint32_t const after = swap_pair(p[2 * i]);
    std::uint32_t const before = i > 0 ? p[(2 * i + 7) & 7] : swap_pair(p[7]);
    brightest = max_pairs(brightest, min_pairs(low8, max_pairs(before, after)));
    darkest = min_pairs(darkest, max_pairs(high8, min_pairs(before, after)));
  }
  int const v = center[0];
  int const bright = static_cast<int>(max_of(brightest & 0xffffu, brightest >> 16)) - v;
  int const dark = v - static_cast<int>(min_of(darkest & 0xffffu, darkest >> 16));
  int const best = max_of(bright, dark);
  return best > threshold ? best - 1 : 0;
}

/// Tells which of four differences exceed a threshold, by the highest bit of each byte; other bits
/// may be anything. A byte may carry into the next one: then one that is equal to the threshold
/// passes, too. @param rest from threshold_rest()
FT_HOST_DEVICE inline std::uint32_t exceeding(std::uint32_t differences, std::uint32_t rest) {
  return (differences + rest) | differences;
}
/// What takes a difference above the threshold to 128. @param threshold 0 to 255; above 127 as 127
FT_HOST_DEVICE inline std::uint32_t threshold_rest(int threshold) {
  return static_cast<std::uint32_t>(127 - min_of(threshold, 127)) * 0x01010101u;
}

}  // namespace detail

/// One cell: scores, suppression, choice of the threshold, corners in raster order.
struct detect_cell {
  static constexpr bool wide_on_host = true;
  /// Bytes from row to row in scratch. A pixel and its score have the same place in their arrays.
  static constexpr int pitch = 80;
  static constexpr int chain = 5;  ///< rows that a thread looks at together
  /// A patch's, and those that threads look at beyond it.
  static constexpr int staged_rows =
      3 * chain * ((max_cell_side + 3 * chain - 1) / (3 * chain)) + 6;
  static constexpr int list_size = 1536;
  static constexpr int word_items_most = (max_cell_side + 6) / 4 * (staged_rows - 6) / chain;
  static constexpr int most_kept = (max_cell_side + 1) / 2 * ((max_cell_side + 1) / 2);
  static_assert(2 * most_kept <= staged_rows * pitch, "corners fit into the place of the pixels");
  static_assert(pitch >= 3 + max_patch_side && pitch % 16 == 0, "rows of whole words");
  struct quad {
    alignas(16) std::uint32_t words[4];
  };
  struct scratch {
    std::uint32_t pixels[staged_rows * pitch / 4];
    quad scores[(max_cell_side + 2) * pitch / 16];  ///< from row 2 on, with a rim of zeros
    std::uint16_t candidates[list_size];            ///< places of pixels worth a score, any order
    /// Of the strict threshold, and how many more of the lenient one; may exceed the list: then all
    /// pixels are tried. Two, as a warp may list while another still reads the first.
    int candidate_count[2];
    int kept;                                ///< corners: their places are kept_places()
    std::uint32_t lenient[word_items_most];  ///< flags of pixels for the lenient threshold alone

    /// Instead of the pixels, which have their scores when a corner is found.
    FT_HOST_DEVICE std::uint16_t* kept_places() { return reinterpret_cast<std::uint16_t*>(pixels); }
  };

  /// Whether corners are also entered into the list of any order.
  bool enters = false;
  /// Of its blocks on a multiprocessor: all of an image pair's at once on a large device.
  static constexpr int side_by_side = 12;

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

private:
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

  /// Returns the number of corners.
  template <typename Group>
  FT_HOST_DEVICE static int detect_together(Group g, scratch& s, gray_view level,
                                            cell_place const& in, corner_params const& params,
                                            corner* list, entry_list const& entered) {
    int const x0 = in.x0;
    int const y0 = in.y0;
    int const patch_w = in.patch_w;
    int const patch_h = in.patch_h;
    int const inner_w = patch_w - 6;
    int const inner_h = patch_h - 6;
    int const first_x = (x0 & 3) + 3;  // column of the first pixel that can be a corner
    auto const* const pixels = reinterpret_cast<std::uint8_t const*>(s.pixels);
    auto* const scores = reinterpret_cast<std::uint8_t*>(s.scores);
    constexpr int score_offset = -2 * pitch;

    detail::stage_rectangle<6>(g, level, x0, y0, patch_w, patch_h, s.pixels, pitch / 4);
    for (int i = g.rank(); i < (inner_h + 2) * pitch / 16; i += g.size()) { s.scores[i] = {}; }
    if (g.rank() == 0) {
      s.candidate_count[0] = 0;
      s.candidate_count[1] = 0;
      s.kept = 0;
    }
    g.sync();

    constexpr detail::fast_circle circle(pitch);
    // Scores do not depend on the threshold, and none that is suppressed at the strict one survives
    // at the lenient: pixels for that one are only tried where nothing is found.
    bool const has_lenient = params.min_threshold < params.ini_threshold;
    int const strict = max_of(params.ini_threshold, 0);
    int const low = has_lenient ? max_of(params.min_threshold, 0) : strict;
    list_by_words(g, s, first_x, inner_w, inner_h, strict, low);
    g.sync();
    int candidates = 0;
    bool listed = true;
    auto const place = [&](int i) {
      if (listed) { return static_cast<int>(s.candidates[i]); }
      int const y = i / inner_w;
      return (y + 3) * pitch + first_x + i - y * inner_w;
    };
    for (bool lenient = false;; lenient = true) {
      int const scored = candidates;
      candidates = s.candidate_count[0] + (lenient ? s.candidate_count[1] : 0);
      if (candidates > list_size) {
        listed = false;
        candidates = inner_w * inner_h;
      }
      if (candidates > 0) {
        for (int i = (listed ? scored : 0) + g.rank(); i < candidates; i += g.size()) {
          int const at = place(i);
          int const score = detail::fast_score_of_pairs(pixels + at, circle, low);
          scores[at + score_offset] = static_cast<std::uint8_t>(score);
        }
        g.sync();
        int const least = max_of(lenient ? low : strict, 1);
        for (int i = g.rank(); i < candidates; i += g.size()) {
          int const at = place(i);
          if (suppressed_score(scores + at + score_offset) < least) { continue; }
          s.kept_places()[atomic_add(&s.kept, 1)] = static_cast<std::uint16_t>(at);
        }
        g.sync();
      }
      if (s.kept != 0 || lenient || !has_lenient) { break; }
      list_lenient(g, s, first_x, inner_w, inner_h);
      g.sync();
    }
    // A corner's place in raster order is how many are before it. There are few: each is compared
    // with all, in place of scans with their barriers. A warp takes its entries for itself.
    int const found = s.kept;
    std::uint16_t const* const kept = s.kept_places();
    auto const warp = g.part();
    for (int base = g.part_index() * warp.size(); base < found; base += g.size()) {
      int entry = 0;
      if (entered.to != nullptr && warp.rank() == 0) {
        entry = atomic_add(entered.count, min_of(warp.size(), found - base));
      }
      int const i = base + warp.rank();
      int const at = kept[min_of(i, found - 1)];
      int to = 0;
      for (int k = 0; k < found; ++k) { to += static_cast<int>(kept[k] < at); }
      entry = warp.shuffle(entry, 0) + warp.rank();
      if (i >= found) { continue; }
      int const y = at / pitch;
      corner const c{static_cast<std::uint16_t>(in.x_rel + 3 + at - y * pitch - first_x),
                     static_cast<std::uint16_t>(in.y_rel + y), scores[at + score_offset]};
      list[to] = c;
      if (entered.to != nullptr) { entered.write(entry, to, c); }
    }
    return found;
  }

  /// The same by a single thread: every pixel gets a score, straight from the image, and only then
  /// the threshold is chosen.
  FT_HOST_DEVICE FT_INLINE static int detect_alone(scratch& s, gray_view level,
                                                   cell_place const& in,
                                                   corner_params const& params, corner* list) {
    constexpr int run = detail::run_pixels;
    constexpr int margin = 4;  // columns before a row's first score
    static_assert(margin + max_cell_side < pitch && margin + run < pitch, "rows have a rim");
    int const inner_w = in.patch_w - 6;
    int const inner_h = in.patch_h - 6;
    int const runs = ceil_div(inner_w, run);
    // The last run of a row ends with it: it begins in the one before where there is one.
    int const last_start = max_of(inner_w - run, 0);
    auto const start = [&](int r) { return min_of(r * run, last_start); };
    auto const filled = static_cast<std::size_t>(max_of(inner_w, run));
    auto* const scores = reinterpret_cast<std::uint8_t*>(s.scores);
    auto* const kept = reinterpret_cast<std::uint8_t*>(s.pixels);
    auto const width = static_cast<std::size_t>(inner_w);

    int const low = clamp(min_of(params.min_threshold, params.ini_threshold), 0, 255);
    std::memset(scores, 0, pitch);
    for (int y = 0; y < inner_h; ++y) {
      std::uint8_t const* const from = level.row(in.y0 + 3 + y) + in.x0 + 3;
      std::uint8_t* const row = scores + (y + 1) * pitch;
      for (int r = 0; r < runs; ++r) {
        detail::score_run(from + start(r), level.stride, static_cast<std::uint8_t>(low),
                          row + margin + start(r));
      }
      std::memset(row, 0, margin);
      std::memset(row + margin + inner_w, 0, pitch - margin - width);
    }
    std::memset(scores + (inner_h + 1) * pitch, 0, pitch);

    std::uint8_t highest[run] = {};
    for (int y = 0; y < inner_h; ++y) {
      std::uint8_t const* const row = scores + (y + 1) * pitch + margin;
      std::uint8_t* const to = kept + y * pitch;
      for (int r = 0; r < runs; ++r) { detail::suppress_run(row + start(r), pitch, to + start(r)); }
      std::memset(to + inner_w, 0, filled - width);
      for (int r = 0; r < runs; ++r) {
        for (int k = 0; k < run; ++k) { highest[k] = max_of(highest[k], to[start(r) + k]); }
      }
    }
    int strongest = 0;
    for (int k = 0; k < run; ++k) { strongest = max_of(strongest, int{highest[k]}); }

    // Scores do not depend on the threshold: what survives suppression at the lenient one and
    // passes the strict one is what the strict one alone gives.
    int const strict_threshold = max_of(params.ini_threshold, 1);
    int const threshold =
        strongest >= strict_threshold ? strict_threshold : max_of(params.min_threshold, 1);
    if (strongest < threshold) { return 0; }
    int found = 0;
    for (int y = 0; y < inner_h; ++y) {
      std::uint8_t const* const row = kept + y * pitch;
      for (int r = 0; r < runs; ++r) {
        int const seen = r * run - start(r);  // by the run before
        detail::for_each_above(row + start(r), static_cast<std::uint8_t>(threshold), [&](int k) {
          if (k < seen) { return; }
          int const x = start(r) + k;
          list[found++] = {static_cast<std::uint16_t>(in.x_rel + 3 + x),
                           static_cast<std::uint16_t>(in.y_rel + 3 + y), row[x]};
        });
      }
    }
    return found;
  }

  /// The words that can hold corners, row by row: each is an item, with those `3 k` rows below it.
  struct word_items {
    int first;  ///< column of a row's first word, in words
    int n;      ///< of a row
    int count;
    detail::small_divider row_of;

    FT_HOST_DEVICE word_items(int first_x, int inner_w, int inner_h)
        : first(first_x / 4),
          n((first_x + inner_w + 3) / 4 - first),
          count(n * 3 * ceil_div(inner_h, 3 * chain)),
          row_of(n) {}
    /// Row of the patch 3 above an item's first pixels, and column of the word.
    struct position {
      int y, w;
    };
    FT_HOST_DEVICE position operator()(int i) const {
      int const row = row_of(i);
      return {row + row / 3 * (3 * (chain - 1)), first + i - row * n};
    }
  };
  /// Lists pixels by the flags of an item: bit 8 - chain + k of byte j is pixel j of row k.
  template <typename Group>
  FT_HOST_DEVICE static void append(Group g, scratch& s, word_items::position const& item,
                                    std::uint32_t flags, int listed, int* count) {
    int const at = (item.y + 3 - 3 * (8 - chain)) * pitch + 4 * item.w;
    detail::append_flagged(
        g, flags,
        [&](unsigned bit) { return at + static_cast<int>(bit % 8 * (3 * pitch) + bit / 8); },
        s.candidates + listed, list_size - listed, count);
  }

  /// Lists the places of pixels that can be corners at the strict threshold, by all threads of a
  /// group: each time a word of a few rows, 3 apart, so that a row is above and below others. Notes
  /// the others that can be corners at the lenient one. Nine in a row on the circle hold one of
  /// each opposite pair, so one of both pairs on the axes must differ by more than the threshold: a
  /// few that are no corners pass, no corner fails.
  template <typename Group>
  FT_HOST_DEVICE static void list_by_words(Group g, scratch& s, int first_x, int inner_w,
                                           int inner_h, int strict, int lenient) {
    constexpr int step = 3 * pitch / 4;
    constexpr std::uint32_t signs = 0x80808080u;
    word_items const items(first_x, inner_w, inner_h);
    std::uint32_t const strict_rest = detail::threshold_rest(strict);
    std::uint32_t const lenient_rest = detail::threshold_rest(lenient);
    for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
      int const i = min_of(base + g.rank(), items.count - 1);
      auto const item = items(i);
      std::uint32_t const* p = s.pixels + item.y * (pitch / 4) + item.w;
      std::uint32_t strict_flags = 0;
      std::uint32_t flags = 0;
      std::uint32_t middle = p[step];
      std::uint32_t difference = detail::differences_of_4(p[0], middle);
      std::uint32_t strict_above = detail::exceeding(difference, strict_rest);
      std::uint32_t above = detail::exceeding(difference, lenient_rest);
      FT_UNROLL
      for (int k = 0; k < chain; ++k) {
        p += step;
        std::uint32_t const down = p[step];
        std::uint32_t const before =
            detail::differences_of_4(detail::permute_bytes(p[-1], middle, 0x4321), middle);
        std::uint32_t const after =
            detail::differences_of_4(detail::permute_bytes(middle, p[1], 0x6543), middle);
        difference = detail::differences_of_4(middle, down);
        std::uint32_t const strict_below = detail::exceeding(difference, strict_rest);
        std::uint32_t const below = detail::exceeding(difference, lenient_rest);
        std::uint32_t const strict_beside =
            detail::exceeding(before, strict_rest) | detail::exceeding(after, strict_rest);
        std::uint32_t const beside =
            detail::exceeding(before, lenient_rest) | detail::exceeding(after, lenient_rest);
        strict_flags = strict_flags >> 1 | ((strict_above | strict_below) & strict_beside & signs);
        flags = flags >> 1 | ((above | below) & beside & signs);
        strict_above = strict_below;
        above = below;
        middle = down;
      }
      // Not those beside or below the cell's.
      int const left = max_of(first_x - 4 * item.w, 0);
      int const right = max_of(4 * item.w + 4 - first_x - inner_w, 0);
      int const rows = min_of((inner_h - item.y + 2) / 3, chain);
      std::uint32_t const inside = ((1u << rows) - 1) * (0x01010101u << (8 - chain)) &
                                   0xffffffffu << (8 * left) & 0xffffffffu >> (8 * right);
      bool const own = base + g.rank() < items.count;
      strict_flags = own ? strict_flags & inside : 0;
      if (own) { s.lenient[i] = flags & inside & ~strict_flags; }
      append(g, s, item, strict_flags, 0, &s.candidate_count[0]);
    }
  }
  /// Lists the pixels that the same threads have noted, after the others.
  template <typename Group>
  FT_HOST_DEVICE static void list_lenient(Group g, scratch& s, int first_x, int inner_w,
                                          int inner_h) {
    word_items const items(first_x, inner_w, inner_h);
    int const listed = min_of(s.candidate_count[0], list_size);
    for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
      int const i = min_of(base + g.rank(), items.count - 1);
      append(g, s, items(i), base + g.rank() < items.count ? s.lenient[i] : 0, listed,
             &s.candidate_count[1]);
    }
  }

  /// The score where it exceeds those of all eight neighbours, else 0.
  FT_HOST_DEVICE static int suppressed_score(std::uint8_t const* p) {
    int const v = p[0];
    if (v == 0) { return 0; }
    int const beside = max_of(p[-1], p[1]);
    int const above = max_of(max_of(p[-pitch - 1], p[-pitch]), p[-pitch + 1]);
    int const below = max_of(max_of(p[pitch - 1], p[pitch]), p[pitch + 1]);
    return v > max_of(beside, max_of(above, below)) ? v : 0;
  }
};

/// Moves a cell's corners to their place in the level's list; the first of an image clears the
/// counts of levels without a cell.
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
    corner const* const from = v.cell_corners + v.level_slot(image, l) +
                               static_cast<std::ptrdiff_t>(in_level) * layout.slots[l];
    corner* const to = v.level_list(image, l) + before;
    for (int i = g.rank(); i < count; i += g.size()) { to[i] = from[i]; }
    if (in_level == layout.cells_of(l) - 1 && g.rank() == 0) {
      v.list_count[image * layout.levels + l] = before + count;
    }
    if (cell == 0) {
      for (int i = g.rank(); i < layout.levels; i += g.size()) {
        if (layout.cells_of(i) == 0) { v.list_count[image * layout.levels + i] = 0; }
      }
    }
  }
};

/// Corners of all cells of all images: `out.cell_corners` and `out.cell_count`; and `out.entries`,
/// for who need not wait for gather_corners(). Asynchronous on `exec`; allocates nothing; one
/// launch. @pre `out.can_enter()`, and `out.entry_count` is 0
template <typename Exec>
void enter_corners(Exec const& exec, image_pyramid_view const& pyramid, corner_params const& params,
                   corners_view const& out) {
  for_each_item<per_block<128>>(evenly(exec), out.batch * out.layout.cells, detect_cell{true},
                                pyramid, out, params);
}
/// From the cells to `out.list`, per level in cell order, and `out.list_count`. Asynchronous on
/// `exec`; allocates nothing; one launch.
template <typename Exec>
void gather_corners(Exec const& exec, corners_view const& out) {
  if (out.layout.cells == 0) {
    fill_bytes(exec, out.list_count, 0,
               static_cast<std::size_t>(out.batch * out.layout.levels) * sizeof(int));
    return;
  }
  for_each_item<per_warp>(exec, out.batch * out.layout.cells, gather_cell{}, out);
}
/// Corners of all levels of all images: `out.list`, per level in cell order, and `out.list_count`.
/// Asynchronous on `exec`; allocates nothing; two launches.
template <typename Exec>
void detect_corners(Exec const& exec, image_pyramid_view const& pyramid,
                    corner_params const& params, corners_view const& out) {
  for_each_item<per_block<128>>(evenly(exec), out.batch * out.layout.cells, detect_cell{}, pyramid,
                                out, params);
  gather_corners(exec, out);
}

}  // namespace FT_ABI
}  // namespace ft
