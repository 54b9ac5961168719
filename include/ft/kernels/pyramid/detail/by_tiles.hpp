// SPDX-License-Identifier: Apache-2.0
/// @file Resizing by tiles, several levels in one launch: the form for a device.
#pragma once

#include <cstdint>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// One tile of one image: its part of every level of a group. Scratch holds whole words, as the
/// image does: a row of a tile starts with the word of its first column.
struct resize_tile {
  /// Taps of the four columns of a word. Their sources lie within eight bytes, and these within
  /// three words.
  struct alignas(16) word_taps {
    std::uint32_t place;  ///< of the first word, from the start of a row
    std::uint32_t align;  ///< selects four of the eight bytes from two words
    std::uint32_t pairs;  ///< one byte per column: indices of its two sources among the eight
    std::uint32_t unused;
    std::uint32_t weights[4];  ///< low half: of the left source; high half: of the right one
  };
  /// Tap of a row.
  struct row_tap {
    std::uint32_t
        place;  ///< low half: of the upper row, in words; high half: distance to the lower
    std::uint32_t weights;  ///< low half: of the upper row; high half: of the lower one
    FT_HOST_DEVICE int above() const { return static_cast<int>(place & 0xffffu); }
    FT_HOST_DEVICE int below() const { return above() + static_cast<int>(place >> 16); }
    FT_HOST_DEVICE std::uint32_t w_above() const { return weights & 0xffffu; }
    FT_HOST_DEVICE std::uint32_t w_below() const { return weights >> 16; }
  };
  /// A tile's part of the source or of a level, computed once for all threads.
  struct alignas(16) level_plan {
    tile_span x, y;
    std::uint8_t* pixels;  ///< of the whole level
    int stride;            ///< of the whole level
    int first_word;        ///< column of the level, in words, at which scratch rows start
    int words;             ///< of a row in scratch
    int height;            ///< rows in scratch
    int first_column;      ///< index of the first word_taps
    int first_row;         ///< index of the first row_tap
    small_divider row_of;  ///< divides by `words`
    int whole_words;       ///< 1 = the level's rows may be written by words
    int spread;            ///< 1 = the sources of some word span more than eight bytes
  };
  static constexpr int threads = 256;
  frame_arrivals arrivals{};
  static constexpr bool prefers_shared = true;

  struct scratch {
    /// Two levels in turn, with two more words, which the loads of the last pixels may touch.
    std::uint32_t pixels[2][pyramid_tiles::scratch_pixels / 4 + 2];
    word_taps columns[pyramid_tiles::scratch_taps / 4];  ///< of all levels in order
    row_tap rows[pyramid_tiles::scratch_taps];
    level_plan level[max_levels + 1];  ///< source first
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, pyramid_tiles const& tiles,
                                 int group_index) const {
    tile_group const& group = tiles.group[group_index];
    int const image = item / (group.columns * group.rows);
    if (pyramid.absent.has(image)) { return; }
    int const in_image = item - image * group.columns * group.rows;
    int const row = in_image / group.columns;
    int const levels = group.last - group.first + 1;
    if (g.part_index() == 0) {
      tile_place const at{image, in_image - row * group.columns, row};
      plan_levels(g.part(), s, pyramid, tiles.spans + group.spans, group, at);
    }
    g.sync();
    stage_taps(g, s, pyramid.geometry, all_taps, group.first, levels);
    level_plan const source = s.level[0];
    if (arrivals.overlapping()) {
      arrivals.await_rows(g, image, source.y.need_begin, source.y.need_end);
    }
    pixel_rectangle const needed{source.x.need_begin, source.y.need_begin,
                                 source.x.need_end - source.x.need_begin, source.height};
    stage_rectangle(g, pyramid.level(image, group.first - 1), needed, s.pixels[0], source.words);
    g.sync();
    for (int i = 1; i <= levels; ++i) {
      level_plan const plan = s.level[i];
      if (plan.spread == 0) {
        make_level<false>(g, s, i, plan, nullptr);
      } else {
        make_level<true>(g, s, i, plan,
                         all_taps + pyramid.geometry.tap_offset[group.first - 1 + i]);
      }
      g.sync();
    }
  }

private:
  struct tile_place {
    int image, column, row;
  };

  /// Computes the plans of all levels, by one warp. @param spans of the group
  template <typename Part>
  FT_HOST_DEVICE static void plan_levels(Part part, scratch& s, image_pyramid_view const& pyramid,
                                         tile_span const* spans, tile_group const& group,
                                         tile_place const& at) {
    int const levels = group.last - group.first + 1;
    int words_before = 0;
    int rows_before = 0;
    for (int base = 0; base <= levels; base += part.size()) {
      int const i = base + part.rank();
      level_plan plan{};
      if (i <= levels) {
        tile_span const* const of_level = spans + i * (group.columns + group.rows);
        plan.x = of_level[at.column];
        plan.y = of_level[group.columns + at.row];
        auto const level = pyramid.level(at.image, group.first - 1 + i);
        plan.pixels = level.data;
        plan.stride = level.stride;
        plan.whole_words = static_cast<int>(has_word_rows(level));
        plan.first_word = plan.x.need_begin / 4;
        plan.height = plan.y.need_end - plan.y.need_begin;
        plan.words = plan.x.need_begin < plan.x.need_end && plan.height > 0
                         ? (plan.x.need_end + 3) / 4 - plan.first_word
                         : 0;
        plan.row_of = small_divider(max_of(plan.words, 1));
      }
      // The source has no taps.
      int total = 0;
      plan.first_column = words_before + part.exclusive_scan(i == 0 ? 0 : plan.words, total);
      words_before += total;
      plan.first_row = rows_before + part.exclusive_scan(i == 0 ? 0 : plan.height, total);
      rows_before += total;
      if (i <= levels) { s.level[i] = plan; }
    }
  }

  /// Loads the taps of all levels at once, so no level waits for its own. Columns of a word outside
  /// the span get the tap of the nearest column inside.
  template <typename Group>
  FT_HOST_DEVICE static void stage_taps(Group g, scratch& s, pyramid_geometry const& geometry,
                                        resize_tap const* all_taps, int first, int levels) {
    int const words = s.level[levels].first_column + s.level[levels].words;
    int const rows = s.level[levels].first_row + s.level[levels].height;
    for (int at = g.rank(); at < words + rows; at += g.size()) {
      int i = 1;
      if (at < words) {
        while (i < levels && at >= s.level[i + 1].first_column) { ++i; }
        level_plan const& plan = s.level[i];
        bool fits = true;
        s.columns[at] = taps_of_word(all_taps + geometry.tap_offset[first - 1 + i], plan.x,
                                     4 * (plan.first_word + at - plan.first_column),
                                     4 * s.level[i - 1].first_word, fits);
        if (!fits) { s.level[i].spread = 1; }
      } else {
        int const r = at - words;
        while (i < levels && r >= s.level[i + 1].first_row) { ++i; }
        level_plan const& plan = s.level[i];
        resize_tap const t =
            all_taps[geometry.tap_offset[first - 1 + i] + geometry.width[first - 1 + i] +
                     plan.y.need_begin + r - plan.first_row];
        level_plan const& from = s.level[i - 1];
        s.rows[r] = {static_cast<std::uint32_t>((t.first - from.y.need_begin) * from.words |
                                                t.offset * from.words << 16),
                     static_cast<std::uint32_t>(t.w0 | t.w1 << 16)};
      }
    }
  }
  FT_HOST_DEVICE static resize_tap tap_of(resize_tap const* columns, tile_span const& x, int c) {
    return columns[clamp(c, int{x.need_begin}, x.need_end - 1)];
  }
  /// @param fits becomes false if the sources span more than eight bytes
  FT_HOST_DEVICE static word_taps taps_of_word(resize_tap const* taps, tile_span const& x, int c,
                                               int from_x, bool& fits) {
    word_taps to{};
    int const start = tap_of(taps, x, c).first - from_x;
    to.place = static_cast<std::uint32_t>(start / 4);
    to.align = 0x3210u + 0x1111u * static_cast<std::uint32_t>(start % 4);
    FT_UNROLL
    for (int k = 0; k < 4; ++k) {
      resize_tap const t = tap_of(taps, x, c + k);
      auto const left = static_cast<std::uint32_t>(t.first - from_x - start);
      std::uint32_t const right = left + static_cast<std::uint32_t>(t.offset);
      fits = fits && right < 8;
      to.pairs |= ((left & 7u) | (right & 7u) << 4) << (8 * k);
      to.weights[k] = static_cast<std::uint32_t>(t.w0 | t.w1 << 16);
    }
    return to;
  }

  /// Interpolated values of the four columns of a word, without their lowest four bits.
  struct row_sums {
    std::uint32_t of[4];
  };
  FT_HOST_DEVICE static row_sums sums_of_row(std::uint32_t const* row, word_taps const& taps) {
    std::uint32_t const* const from = row + taps.place;
    std::uint32_t const middle = from[1];
    std::uint32_t const low = select_bytes(from[0], middle, taps.align);
    std::uint32_t const high = select_bytes(middle, from[2], taps.align);
    row_sums sums;
    FT_UNROLL
    for (int k = 0; k < 4; ++k) {
      std::uint32_t const pair = select_bytes(low, high, taps.pairs >> (8 * k));
      sums.of[k] = dot_of_2(taps.weights[k], pair, 0) >> 4;
    }
    return sums;
  }
  /// sums_of_row() for sources at any distance. @param taps of the whole level's columns
  FT_HOST_DEVICE static row_sums sums_of_spread_row(std::uint32_t const* row,
                                                    resize_tap const* taps, tile_span const& x,
                                                    int column, int from_x) {
    auto const* const bytes = reinterpret_cast<std::uint8_t const*>(row);
    row_sums sums;
    for (int k = 0; k < 4; ++k) {
      resize_tap const t = tap_of(taps, x, column + k);
      std::uint8_t const* const left = bytes + (t.first - from_x);
      sums.of[k] = static_cast<std::uint32_t>(left[0] * t.w0 + left[t.offset] * t.w1) >> 4;
    }
    return sums;
  }

  /// Interpolates four pixels between two rows. Only the high halves of the products count, two of
  /// them per word.
  FT_HOST_DEVICE static std::uint32_t mix_rows(row_sums const& above, row_sums const& below,
                                               row_tap const& v) {
    constexpr std::uint32_t high_halves = 0x7632;
    std::uint32_t pair[2];
    FT_UNROLL
    for (int k = 0; k < 2; ++k) {
      std::uint32_t const a =
          permute_bytes(above.of[k] * v.w_above(), above.of[k + 2] * v.w_above(), high_halves);
      std::uint32_t const b =
          permute_bytes(below.of[k] * v.w_below(), below.of[k + 2] * v.w_below(), high_halves);
      pair[k] = (a + b + 0x00020002u) >> 2;
    }
    return permute_bytes(pair[0], pair[1], 0x6240);
  }

  /// Computes level i from the one below, two rows of a word at a time.
  /// @tparam Spread whether sources span more than eight bytes
  /// @param spread then the taps of the whole level's columns
  template <bool Spread, typename Group>
  FT_HOST_DEVICE static void make_level(Group g, scratch& s, int i, level_plan const& plan,
                                        resize_tap const* spread) {
    std::uint32_t const* const from = s.pixels[(i - 1) & 1];
    std::uint32_t* const to = s.pixels[i & 1];
    int const from_x = 4 * s.level[i - 1].first_word;
    word_taps const* const columns = s.columns + plan.first_column;
    row_tap const* const rows = s.rows + plan.first_row;
    int const items = plan.words * ((plan.height + 1) / 2);
    static_cast<void>(spread);
    static_cast<void>(from_x);
    for (int at = g.rank(); at < items; at += g.size()) {
      int const pair_row = plan.row_of(at);
      int const word = at - pair_row * plan.words;
      word_taps const column = columns[word];
      auto const sums = [&](int row) {
        if constexpr (Spread) {
          return sums_of_spread_row(from + row, spread, plan.x, 4 * (plan.first_word + word),
                                    from_x);
        } else {
          return sums_of_row(from + row, column);
        }
      };
      int const last = min_of(2 * pair_row + 1, plan.height - 1);
      row_tap const v0 = rows[2 * pair_row];
      row_tap const v1 = rows[last];
      row_sums const above = sums(v0.above());
      row_sums below = sums(v0.below());
      write_word(to, plan, 2 * pair_row, word, mix_rows(above, below, v0));
      if (last == 2 * pair_row) { continue; }
      if (v1.above() != v0.below()) { below = sums(v1.above()); }
      write_word(to, plan, last, word, mix_rows(below, sums(v1.below()), v1));
    }
  }

  /// Writes a word to scratch, and to the level the pixels that the tile owns.
  FT_HOST_DEVICE static void write_word(std::uint32_t* scratch_words, level_plan const& plan,
                                        int row, int word, std::uint32_t pixels) {
    scratch_words[row * plan.words + word] = pixels;
    int const at_y = plan.y.need_begin + row;
    if (at_y < plan.y.own_begin || at_y >= plan.y.own_end) { return; }
    int const at_x = 4 * (plan.first_word + word);
    // 32 bits are enough: a level has fewer than 2^32 pixels.
    std::uint8_t* const to =
        plan.pixels + (static_cast<unsigned>(at_y) * static_cast<unsigned>(plan.stride) +
                       static_cast<unsigned>(at_x));
    if (plan.whole_words != 0 && at_x >= plan.x.own_begin && at_x + 4 <= plan.x.own_end) {
      store_word(to, pixels);
      return;
    }
    for (int k = 0; k < 4; ++k) {
      if (at_x + k >= plan.x.own_begin && at_x + k < plan.x.own_end) {
        to[k] = static_cast<std::uint8_t>(pixels >> (8 * k));
      }
    }
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
