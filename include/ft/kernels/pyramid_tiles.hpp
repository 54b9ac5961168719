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
  int groups = 0;
  tile_group group[max_levels];
  tile_span const* spans = nullptr;
};

namespace detail {

/// Spans of one axis for levels first - 1 to last. @return false where a tile would need more than
/// `limit` pixels along the axis @param largest gets the longest stretch that a tile needs
inline bool tile_spans(resize_tap const* const* taps, int const* size, int first, int last,
                       int tiles, int limit, std::vector<tile_span>* spans, int& largest) {
  int const levels = last - first + 2;  // with the source
  std::vector<tile_span> all(static_cast<std::size_t>(levels * tiles));
  largest = 0;
  for (int t = 0; t < tiles; ++t) {
    int begin = 0;
    int end = 0;
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
      largest = max_of(largest, end - begin);
      all[static_cast<std::size_t>((l - first + 1) * tiles + t)] = {
          static_cast<std::int16_t>(own_begin), static_cast<std::int16_t>(own_end),
          static_cast<std::int16_t>(begin), static_cast<std::int16_t>(end)};
    }
  }
  if (largest > limit) { return false; }
  if (spans != nullptr) { *spans = std::move(all); }
  return true;
}

}  // namespace detail

/// Chooses groups and tiles for a geometry, on the host. @param taps from make_resize_taps, on the
/// host
/// @param spans gets the table; the caller copies it to the executor and sets `spans` of the result
/// @param side of a tile in the group's source, about, pixels
inline pyramid_tiles make_pyramid_tiles(pyramid_geometry const& g, resize_tap const* taps,
                                        std::vector<tile_span>& spans, int side = 72) {
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
    std::vector<tile_span> across;
    std::vector<tile_span> down;
    // As many levels as a tile of about that size can carry; of a single one, smaller tiles.
    for (int last = g.levels - 1; made.columns == 0; --last) {
      int const least = last > first ? side : 1;
      for (int s = side; s >= least && made.columns == 0; s /= 2) {
        int const nx = ceil_div(g.width[first - 1], s);
        int const ny = ceil_div(g.height[first - 1], s);
        int w = 0;
        int h = 0;
        constexpr int any = 1 << 14;
        detail::tile_spans(columns, g.width, first, last, nx, any, &across, w);
        detail::tile_spans(rows, g.height, first, last, ny, any, &down, h);
        if (w * h <= pyramid_tiles::scratch_pixels) { made = {first, last, nx, ny, 0}; }
      }
    }
    made.spans = static_cast<int>(spans.size());
    for (int l = 0; l < made.last - made.first + 2; ++l) {
      auto const append = [&](std::vector<tile_span> const& from, int tiles) {
        auto const begin = from.begin() + static_cast<std::ptrdiff_t>(l) * tiles;
        spans.insert(spans.end(), begin, begin + tiles);
      };
      append(across, made.columns);
      append(down, made.rows);
    }
    result.group[result.groups++] = made;
    first = made.last + 1;
  }
  return result;
}

/// One tile of one image: its part of every level of a group.
struct resize_tile {
  struct scratch {
    std::uint8_t pixels[2][pyramid_tiles::scratch_pixels];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, pyramid_tiles const& tiles,
                                 int group_index) const {
    tile_group const& group = tiles.group[group_index];
    int const in_image = item % (group.columns * group.rows);
    int const image = item / (group.columns * group.rows);
    int const column = in_image % group.columns;
    int const row = in_image / group.columns;
    tile_span const* spans = tiles.spans + group.spans;
    // A group's threads as rows of up to 32 lanes.
    int const lanes = min_of(g.size(), 32);
    int const lane = g.rank() % lanes;
    int const first_row = g.rank() / lanes;
    int const rows = g.size() / lanes;

    tile_span x = spans[column];
    tile_span y = spans[group.columns + row];
    int from_width = x.need_end - x.need_begin;
    {
      auto const source = pyramid.level(image, group.first - 1);
      for (int r = first_row; r < y.need_end - y.need_begin; r += rows) {
        std::uint8_t const* const in = source.row(y.need_begin + r) + x.need_begin;
        std::uint8_t* const out = s.pixels[0] + r * from_width;
        for (int c = lane; c < from_width; c += lanes) { out[c] = in[c]; }
      }
    }
    g.sync();
    for (int l = group.first; l <= group.last; ++l) {
      spans += group.columns + group.rows;
      std::uint8_t const* const from = s.pixels[(l - group.first) & 1];
      std::uint8_t* const to = s.pixels[(l - group.first + 1) & 1];
      int const from_x = x.need_begin;
      int const from_y = y.need_begin;
      x = spans[column];
      y = spans[group.columns + row];
      int const width = x.need_end - x.need_begin;
      int const height = y.need_end - y.need_begin;
      resize_tap const* const columns = all_taps + pyramid.geometry.tap_offset[l];
      resize_tap const* const rows_taps = columns + pyramid.geometry.width[l];
      auto const level = pyramid.level(image, l);
      for (int c = lane; c < width; c += lanes) {
        int const at_x = x.need_begin + c;
        resize_tap const h = columns[at_x];
        std::uint8_t const* const left = from + (h.first - from_x);
        bool const own_column = at_x >= x.own_begin && at_x < x.own_end;
        for (int r = first_row; r < height; r += rows) {
          int const at_y = y.need_begin + r;
          resize_tap const v = rows_taps[at_y];
          std::uint8_t const pixel =
              detail::resized_pixel(left + (v.first - from_y) * from_width,
                                    left + (v.first + v.offset - from_y) * from_width, h, v);
          to[r * width + c] = pixel;
          if (own_column && at_y >= y.own_begin && at_y < y.own_end) {
            level.row(at_y)[at_x] = pixel;
          }
        }
      }
      from_width = width;
      g.sync();
    }
  }
};

/// Levels 1.. of every image from its level 0, one launch per group of levels, whatever the batch.
/// Asynchronous on `exec`; allocates nothing. @param taps,tiles.spans in the executor's memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps,
                   pyramid_tiles const& tiles) {
  for (int i = 0; i < tiles.groups; ++i) {
    tile_group const& group = tiles.group[i];
    for_each_item<per_block<256>>(exec, pyramid.batch * group.columns * group.rows, resize_tile{},
                                  pyramid, taps, tiles, i);
  }
}

}  // namespace FT_ABI
}  // namespace ft
