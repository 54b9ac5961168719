// SPDX-License-Identifier: Apache-2.0
/// @file Tiles and groups of levels of a pyramid.
///
/// A block owns the same part of every level of a group. It recomputes the parts of its neighbours
/// that it needs, so no level waits for the whole level below.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

// Tables of bilinear resizing: the source pixels of each column and row of a level, and
// their weights. Source: specification section 1.

/// The two source columns (or rows) of a destination column (or row), and their weights, which sum
/// to 2048.
struct resize_tap {
  std::int32_t first;
  std::int16_t offset;  ///< from the first to the second: 1, or 0 at the far edge
  std::int16_t w0, w1;
  std::int16_t unused;
};

namespace detail {

/// Taps along one axis, for a resize from `from` to `to` pixels. @param taps [to]
inline void fill_taps(resize_tap* taps, int from, int to) {
  double const ratio = static_cast<double>(from) / to;
  for (int d = 0; d < to; ++d) {
    float f = static_cast<float>((d + 0.5) * ratio - 0.5);
    int i = static_cast<int>(std::floor(f));
    f -= static_cast<float>(i);
    if (i < 0) {
      i = 0;
      f = 0;
    }
    if (i >= from - 1) {
      i = from - 1;
      f = 0;
    }
    taps[d] = {i, static_cast<std::int16_t>(i + 1 < from ? 1 : 0),
               static_cast<std::int16_t>(std::lrint((1.0f - f) * 2048.0f)),
               static_cast<std::int16_t>(std::lrint(f * 2048.0f)), 0};
  }
}

}  // namespace detail

/// Computes the tables of build_pyramid(), on the host. @param taps [geometry.taps]
inline void make_resize_taps(pyramid_geometry const& geometry, resize_tap* taps) {
  for (int l = 1; l < geometry.levels; ++l) {
    resize_tap* const columns = taps + geometry.tap_offset[l];
    detail::fill_taps(columns, geometry.width[l - 1], geometry.width[l]);
    detail::fill_taps(columns + geometry.width[l], geometry.height[l - 1], geometry.height[l]);
  }
}

/// Columns or rows of a level that a tile owns, and the larger range that it computes.
struct tile_span {
  std::int16_t own_begin, own_end;
  std::int16_t need_begin, need_end;
};

/// Levels first..last, computed from level first - 1 in one launch.
struct tile_group {
  int first = 0;
  int last = 0;
  int columns = 0;  ///< of tiles
  int rows = 0;     ///< of tiles
  int spans = 0;    ///< index of the first span: columns, then rows, from level first - 1 on
};

/// Plan of a whole pyramid.
struct pyramid_tiles {
  static constexpr int scratch_pixels = 12 * 1024;  ///< of a level, in a tile
  static constexpr int scratch_taps = 1024;         ///< of all levels, in a tile
  static constexpr int word_rest = 6;  ///< most columns added by rounding a tile to whole words
  int groups = 0;
  tile_group group[max_levels];
  tile_span const* spans = nullptr;  ///< executor memory
};

namespace detail {

/// Spans of all tiles along one axis.
struct axis_tiles {
  std::vector<tile_span> spans;  ///< [level from the source on][tile]
  int longest = 0;               ///< longest span that a tile computes
  int computed = 0;              ///< most columns or rows of a tile, over all levels but the source
};

/// Spans of levels first - 1 to last, from the last one down: each level computes its own part and
/// the pixels that the level above reads.
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
      if (l < last) {  // pixels that the level above reads
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

/// Chooses groups and tiles for a geometry, on the host.
/// @param taps from make_resize_taps, host memory
/// @param spans gets the table; the caller copies it to the executor and sets `spans` of the result
/// @param side approximate side of a tile in the group's source, pixels
inline pyramid_tiles make_pyramid_tiles(pyramid_geometry const& g, resize_tap const* taps,
                                        std::vector<tile_span>& spans, int side = 56) {
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
    // Takes as many levels as fit with tiles of about that size. If not even one fits, takes
    // smaller tiles.
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

}  // namespace FT_ABI
}  // namespace ft
