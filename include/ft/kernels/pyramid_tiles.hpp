// SPDX-License-Identifier: Apache-2.0
/// @file Stage: scale pyramid, several levels in one launch. A block owns the same part of every
/// level; what it needs of its neighbours' parts it computes again, in block scratch, so that no
/// level waits for the whole of the one before. The pixels are those of pyramid.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/pyramid.hpp"

namespace ft {
inline namespace FT_ABI {

/// Columns or rows of a level that belong to a tile, and those that it has to compute.
struct tile_span {
  std::int16_t own_begin, own_end;
  std::int16_t need_begin, need_end;
};

/// Levels first..last, made from level first - 1 in one launch.
struct tile_group {
  int first = 0;
  int last = 0;
  int columns = 0;  ///< tiles
  int rows = 0;
  int spans = 0;  ///< of level first - 1: its columns, then its rows; then the next level's
};

/// How a pyramid is made in groups of levels. Its spans lie in the executor's memory.
struct pyramid_tiles {
  static constexpr int scratch_pixels = 12 * 1024;  ///< of a level, in a tile
  static constexpr int scratch_taps = 1024;         ///< of all levels, in a tile
  static constexpr int word_rest = 6;  ///< most columns more that a tile's whole words have
  int groups = 0;
  tile_group group[max_levels];
  tile_span const* spans = nullptr;
};

namespace detail {

/// What tiles need along one axis.
struct axis_tiles {
  std::vector<tile_span> spans;  ///< [level from the source on][tile]
  int longest = 0;               ///< stretch that a tile needs of a level
  int computed = 0;  ///< columns or rows of a tile, over all levels but the source, at most
};

/// Of levels first - 1 to last.
inline axis_tiles tile_axis(resize_tap const* const* taps, int const* size, int first, int last,
                            int tiles) {
  int const levels = last - first + 2;  // with the source
  axis_tiles all;
  all.spans.resize(static_cast<std::size_t>(levels * tiles));
  for (int t = 0; t < tiles; ++t) {
    int begin = 0;
    int end = 0;
    int computed = 0;
    for (int l = last; l >= first - 1; --l) {
      int const own_begin = l < first ? 0 : static_cast<int>(std::int64_t{t} * size[l] / tiles);
      int const own_end = l < first ? 0 : static_cast<int>(std::int64_t{t + 1} * size[l] / tiles);
      if (l < last) {  // what the level above reads
        if (begin < end) {
          resize_tap const& a = taps[l + 1][begin];
          resize_tap const& b = taps[l + 1][end - 1];
          begin = a.first;
          end = b.first + b.offset + 1;
        }
        if (l >= first && own_begin < own_end) {
          begin = begin < end ? min_of(begin, own_begin) : own_begin;
          end = max_of(end, own_end);
        }
      } else {
        begin = own_begin;
        end = own_end;
      }
      all.longest = max_of(all.longest, end - begin);
      if (l >= first) { computed += end - begin; }
      all.spans[static_cast<std::size_t>((l - first + 1) * tiles + t)] = {
          static_cast<std::int16_t>(own_begin), static_cast<std::int16_t>(own_end),
          static_cast<std::int16_t>(begin), static_cast<std::int16_t>(end)};
    }
    all.computed = max_of(all.computed, computed);
  }
  return all;
}

}  // namespace detail

/// Chooses groups and tiles for a geometry, on the host. @param taps from make_resize_taps, on the
/// host
/// @param spans gets the table; the caller copies it to the executor and sets `spans` of the result
/// @param side of a tile in the group's source, about, pixels
inline pyramid_tiles make_pyramid_tiles(pyramid_geometry const& g, resize_tap const* taps,
                                        std::vector<tile_span>& spans, int side = 80) {
  resize_tap const* columns[max_levels] = {};
  resize_tap const* rows[max_levels] = {};
  for (int l = 1; l < g.levels; ++l) {
    columns[l] = taps + g.tap_offset[l];
    rows[l] = columns[l] + g.width[l];
  }
  pyramid_tiles result;
  spans.clear();
  int first = 1;
  while (first < g.levels) {
    tile_group made;
    detail::axis_tiles across;
    detail::axis_tiles down;
    // As many levels as a tile of about that size can carry; of a single one, smaller tiles.
    for (int last = g.levels - 1; made.columns == 0; --last) {
      int const least = last > first ? side : 1;
      for (int s = side; s >= least && made.columns == 0; s /= 2) {
        int const nx = ceil_div(g.width[first - 1], s);
        int const ny = ceil_div(g.height[first - 1], s);
        across = detail::tile_axis(columns, g.width, first, last, nx);
        down = detail::tile_axis(rows, g.height, first, last, ny);
        constexpr int rest = pyramid_tiles::word_rest;
        int const all_taps = across.computed + down.computed + (last - first + 1) * (rest + 3);
        if ((across.longest + rest) * down.longest <= pyramid_tiles::scratch_pixels &&
            all_taps <= pyramid_tiles::scratch_taps) {
          made = {first, last, nx, ny, 0};
        }
      }
    }
    made.spans = static_cast<int>(spans.size());
    for (int l = 0; l < made.last - made.first + 2; ++l) {
      auto const append = [&](std::vector<tile_span> const& from, int tiles) {
        auto const begin = from.begin() + static_cast<std::ptrdiff_t>(l) * tiles;
        spans.insert(spans.end(), begin, begin + tiles);
      };
      append(across.spans, made.columns);
      append(down.spans, made.rows);
    }
    result.group[result.groups++] = made;
    first = made.last + 1;
  }
  return result;
}

/// One tile of one image: its part of every level of a group. Levels lie in scratch in words, as in
/// memory: a row of a tile starts with the word that its first needed column is in.
struct resize_tile {
  /// A tap in bytes of the scratch that it reads.
  struct tap {
    std::uint32_t place;    ///< of the first neighbour; how far the second is, in the high half
    std::uint32_t weights;  ///< of the first; of the second in the high half
    FT_HOST_DEVICE int first() const { return static_cast<int>(place & 0xffffu); }
    FT_HOST_DEVICE int step() const { return static_cast<int>(place >> 16); }
    FT_HOST_DEVICE int w0() const { return static_cast<int>(weights & 0xffffu); }
    FT_HOST_DEVICE int w1() const { return static_cast<int>(weights >> 16); }
  };
  struct four_taps {  ///< of the columns of a word
    alignas(16) tap of[4];
  };
  struct scratch {
    std::uint32_t pixels[2][pyramid_tiles::scratch_pixels / 4];
    four_taps taps[pyramid_tiles::scratch_taps / 4];  ///< per level: columns, then rows
    tile_span x[max_levels + 1];                      ///< of the source and the levels
    tile_span y[max_levels + 1];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, pyramid_tiles const& tiles,
                                 int group_index) const {
    tile_group const& group = tiles.group[group_index];
    int const image = item / (group.columns * group.rows);
    int const in_image = item - image * group.columns * group.rows;
    int const row = in_image / group.columns;
    int const column = in_image - row * group.columns;
    int const levels = group.last - group.first + 1;
    for (int i = g.rank(); i <= levels; i += g.size()) {
      tile_span const* const spans = tiles.spans + group.spans + i * (group.columns + group.rows);
      s.x[i] = spans[column];
      s.y[i] = spans[group.columns + row];
    }
    g.sync();
    detail::stage_rectangle(g, pyramid.level(image, group.first - 1), s.x[0].need_begin,
                            s.y[0].need_begin, s.x[0].need_end - s.x[0].need_begin,
                            s.y[0].need_end - s.y[0].need_begin, s.pixels[0], words_of(s.x[0]));
    stage_taps(g, s, pyramid.geometry, all_taps, group.first, levels);
    g.sync();
    four_taps const* taps = s.taps;
    for (int i = 1; i <= levels; ++i) {
      make_level(g, s.pixels[(i - 1) & 1], s.pixels[i & 1], taps, s.x[i], s.y[i],
                 pyramid.level(image, group.first - 1 + i));
      taps += words_of(s.x[i]) + (s.y[i].need_end - s.y[i].need_begin + 3) / 4;
      g.sync();
    }
  }

private:
  FT_HOST_DEVICE static int first_word(tile_span const& x) { return x.need_begin / 4; }
  FT_HOST_DEVICE static int words_of(tile_span const& x) {
    return x.need_begin < x.need_end ? (x.need_end + 3) / 4 - first_word(x) : 0;
  }

  /// The taps of all levels at once, so that none waits for them. Columns of a word that are not
  /// needed get the tap of one that is.
  template <typename Group>
  FT_HOST_DEVICE static void stage_taps(Group g, scratch& s, pyramid_geometry const& geometry,
                                        resize_tap const* all_taps, int first, int levels) {
    auto* const to = &s.taps[0].of[0];
    int begin = 0;  // of a level's
    for (int i = 1, at = g.rank(); i <= levels; ++i) {
      tile_span const x = s.x[i];
      tile_span const y = s.y[i];
      int const columns = 4 * words_of(x);
      int const end = begin + columns + (y.need_end - y.need_begin + 3) / 4 * 4;
      int const pitch = 4 * words_of(s.x[i - 1]);
      int const from_x = 4 * first_word(s.x[i - 1]);
      int const from_y = s.y[i - 1].need_begin;
      resize_tap const* const taps = all_taps + geometry.tap_offset[first - 1 + i];
      for (; at < end; at += g.size()) {
        int const c = at - begin;
        bool const is_column = c < columns;
        int const of = is_column ? clamp(4 * first_word(x) + c, int{x.need_begin}, x.need_end - 1)
                                 : min_of(y.need_begin + c - columns, y.need_end - 1) +
                                       geometry.width[first - 1 + i];
        resize_tap const t = taps[of];
        int const scale = is_column ? 1 : pitch;
        int const place = (t.first - (is_column ? from_x : from_y)) * scale;
        to[at] = {static_cast<std::uint32_t>(place | t.offset * scale << 16),
                  static_cast<std::uint32_t>(t.w0 | t.w1 << 16)};
      }
      begin = end;
    }
  }

  /// A level from the one before, a word of two rows at a time.
  template <typename Group>
  FT_HOST_DEVICE static void make_level(Group g, std::uint32_t const* from_words,
                                        std::uint32_t* to_words, four_taps const* columns,
                                        tile_span x, tile_span y,
                                        image_view<std::uint8_t> const& level) {
    constexpr int at_once = 2;
    int const words = words_of(x);
    int const height = y.need_end - y.need_begin;
    if (words == 0 || height <= 0) { return; }
    auto const* const from = reinterpret_cast<std::uint8_t const*>(from_words);
    tap const* const rows = (columns + words)->of;
    bool const whole_words = detail::has_word_rows(level);
    detail::small_divider const row_of(words);
    int const items = words * ((height + at_once - 1) / at_once);
    for (int i = g.rank(); i < items; i += g.size()) {
      int const first_row = row_of(i) * at_once;
      int const word = i - first_row / at_once * words;
      four_taps const h = columns[word];
      std::uint32_t pixels[at_once];
      FT_UNROLL
      for (int k = 0; k < at_once; ++k) {
        tap const v = rows[min_of(first_row + k, height - 1)];
        std::uint32_t four = 0;
        FT_UNROLL
        for (int c = 0; c < 4; ++c) {
          std::uint8_t const* const row0 = from + v.first() + h.of[c].first();
          std::uint8_t const* const row1 = row0 + v.step();
          int const h0 = row0[0] * h.of[c].w0() + row0[h.of[c].step()] * h.of[c].w1();
          int const h1 = row1[0] * h.of[c].w0() + row1[h.of[c].step()] * h.of[c].w1();
          auto const pixel = static_cast<unsigned>(
              (((v.w0() * (h0 >> 4)) >> 16) + ((v.w1() * (h1 >> 4)) >> 16) + 2) >> 2);
          four |= pixel << (8 * c);
        }
        pixels[k] = four;
      }
      int const at_x = 4 * (first_word(x) + word);
      bool const own_word = whole_words && at_x >= x.own_begin && at_x + 4 <= x.own_end;
      FT_UNROLL
      for (int k = 0; k < at_once; ++k) {
        int const r = first_row + k;
        if (r >= height) { continue; }
        to_words[r * words + word] = pixels[k];
        int const at_y = y.need_begin + r;
        if (at_y < y.own_begin || at_y >= y.own_end) { continue; }
        std::uint8_t* const to = level.row(at_y) + at_x;
        if (own_word) {
          detail::store_word(to, pixels[k]);
        } else {
          for (int c = 0; c < 4; ++c) {
            if (at_x + c >= x.own_begin && at_x + c < x.own_end) {
              to[c] = static_cast<std::uint8_t>(pixels[k] >> (8 * c));
            }
          }
        }
      }
    }
  }
};

/// Levels 1.. of every image from its level 0, one launch per group of levels, whatever the batch.
/// Asynchronous on `exec`; allocates nothing. @param taps and `tiles.spans`: executor memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps,
                   pyramid_tiles const& tiles) {
  for (int i = 0; i < tiles.groups; ++i) {
    tile_group const& group = tiles.group[i];
    for_each_item<per_block<512>>(exec, pyramid.batch * group.columns * group.rows, resize_tile{},
                                  pyramid, taps, tiles, i);
  }
}

}  // namespace FT_ABI
}  // namespace ft
