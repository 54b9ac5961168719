// SPDX-License-Identifier: Apache-2.0
/// @file Stage: scale pyramid. Each level is the bilinear resize of the preceding one,
/// bit-identical to cv::resize(INTER_LINEAR) on 8-bit images. Source: specification section 1.
#pragma once

#include <cstdint>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/host_simd.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pyramid/detail/by_tiles.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"
#include "ft/types/images.hpp"

namespace ft {
inline namespace FT_ABI {

// Resizing by bands of rows, one thread per band: the form for the host.

namespace detail {

/// Interpolation along rows for up to N columns. Uses AVX2 if the processor has it.
template <int N>
class column_taps {
public:
  /// @param taps of n columns @param width of the rows
  FT_HOST_DEVICE column_taps(resize_tap const* taps, int n, int width) : taps_(taps), n_(n) {
#if FT_HAS_SHUFFLE
    if (!has_wide_vectors() || width < 16) { return; }
    for (; 8 * (count_ + 1) <= n; ++count_) {
      resize_tap const* const t = taps + 8 * count_;
      eight_taps& e = eights_[count_];
      e.first = min_of(t[0].first, width - 16);
      if (t[7].first + t[7].offset - e.first > 15) { return; }  // a large step: no shuffle
      for (int k = 0; k < 8; ++k) {
        auto const place = static_cast<std::uint8_t>(t[k].first - e.first);
        e.pick[4 * k] = place;
        e.pick[4 * k + 1] = eight_taps::zero;
        e.pick[4 * k + 2] = static_cast<std::uint8_t>(place + t[k].offset);
        e.pick[4 * k + 3] = eight_taps::zero;
        e.weights[2 * k] = t[k].w0;
        e.weights[2 * k + 1] = t[k].w1;
      }
    }
#else
    static_cast<void>(width);
#endif
  }

  /// out[x] = (pixel * weight + next pixel * weight) >> 4. @param out [N]
  FT_HOST_DEVICE void interpolate(std::uint8_t const* row, std::int16_t* out) const {
#if FT_HAS_SHUFFLE
    if (count_ > 0) { weigh_eights(row, eights_, count_, out); }
#endif
    for (int x = 8 * count_; x < n_; ++x) {
      resize_tap const& t = taps_[x];
      std::uint8_t const* const p = row + t.first;
      out[x] = static_cast<std::int16_t>((p[0] * t.w0 + p[t.offset] * t.w1) >> 4);
    }
  }

private:
  resize_tap const* taps_;
  int n_;
  int count_ = 0;  ///< eights that use the shuffle
  eight_taps eights_[N / 8];
};

/// One band of rows of one level of one image, by a single thread.
struct resize_band {
  static constexpr bool wide_on_host = true;
  static constexpr int rows = 32;
  using scratch = no_scratch;

  FT_HOST_DEVICE static int bands(pyramid_geometry const& geometry, int l) {
    return ceil_div(geometry.height[l], rows);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, image_pyramid_view const& pyramid,
                                 resize_tap const* all_taps, int l) const {
    int const in_image = bands(pyramid.geometry, l);
    int const image = item / in_image;
    if (pyramid.absent.has(image)) { return; }
    int const first = item % in_image * rows;
    gray_view const from = pyramid.level(image, l - 1);
    auto const to = pyramid.level(image, l);
    int const end = min_of(first + rows, to.height);
    resize_tap const* const taps = all_taps + pyramid.geometry.tap_offset[l];
    static_assert(Group::max_threads == 1, "a band is computed by one thread");
    for (int x = 0; x < to.width; x += strip) {
      resize_strip(from, to, taps, {x, min_of(strip, to.width - x), first, end});
    }
  }

private:
  static constexpr int strip = 256;  ///< columns whose taps are kept at a time
  static constexpr int run = 32;     ///< columns per vectorised loop

  /// Columns [x, x + n), rows [first, end).
  struct part {
    int x, n, first, end;
  };
  /// Computes a part of a level. A source row is interpolated once, although two rows of the level
  /// may read it.
  FT_HOST_DEVICE FT_INLINE static void resize_strip(gray_view from, image_view<std::uint8_t> to,
                                                    resize_tap const* taps, part const& of) {
    int const n = of.n;
    column_taps<strip> columns(taps + of.x, n, from.width);
    std::int16_t sums[2][strip] = {};
    int row_of[2] = {-1, -1};
    auto const sums_of = [&](int row, int other) {
      for (int k = 0; k < 2; ++k) {
        if (row_of[k] == row) { return k; }
      }
      int const k = row_of[0] == other ? 1 : 0;
      row_of[k] = row;
      columns.interpolate(from.row(row), sums[k]);
      return k;
    };
    for (int y = of.first; y < of.end; ++y) {
      resize_tap const v = taps[to.width + y];
      int const k0 = sums_of(v.first, v.first + v.offset);
      int const k1 = sums_of(v.first + v.offset, v.first);
      std::uint8_t* const out = to.row(y) + of.x;
      int at = 0;
      for (; at + run <= n; at += run) {
        mix_rows<run>(sums[k0] + at, sums[k1] + at, v, out + at, run);
      }
      mix_rows<run>(sums[k0] + at, sums[k1] + at, v, out + at, n - at);
    }
  }

  /// Interpolates between two rows. A full run has a constant length, which vectorises.
  template <int Run>
  FT_HOST_DEVICE FT_INLINE static void mix_rows(std::int16_t const* s0, std::int16_t const* s1,
                                                resize_tap const& v, std::uint8_t* out, int n) {
    auto const mixed = [&](int k) {
      return static_cast<std::uint8_t>(((v.w0 * s0[k] >> 16) + (v.w1 * s1[k] >> 16) + 2) >> 2);
    };
    if (n == Run) {
      for (int k = 0; k < Run; ++k) { out[k] = mixed(k); }
    } else {
      for (int k = 0; k < n; ++k) { out[k] = mixed(k); }
    }
  }
};

}  // namespace detail

/// Computes levels 1.. of every image from its level 0, by bands of rows. For the host: a band is
/// the work of one thread. Devices use tiles. Asynchronous on `exec`; allocates nothing; one launch
/// per level, for the whole batch.
/// @param taps from make_resize_taps, executor memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps) {
  for (int l = 1; l < pyramid.geometry.levels; ++l) {
    for_each_item<per_thread>(exec, pyramid.batch * detail::resize_band::bands(pyramid.geometry, l),
                              detail::resize_band{}, pyramid, taps, l);
  }
}

/// Computes the same by tiles: one launch per group of levels, for the whole batch. Asynchronous on
/// `exec`; allocates nothing. @param taps,tiles `taps` and `tiles.spans` in executor memory
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps,
                   pyramid_tiles const& tiles) {
  for (int i = 0; i < tiles.groups; ++i) {
    tile_group const& group = tiles.group[i];
    for_each_item<per_block<detail::resize_tile::threads>>(
        detail::with_order(exec, detail::launch_order::full_wave),
        pyramid.batch * group.columns * group.rows, detail::resize_tile{}, pyramid, taps, tiles, i);
  }
}

/// The same for a launch that may be concurrent with receive_images(), which must precede it with
/// the same `arrivals`: each tile waits for its own rows. @param tiles of a single group
template <typename Exec>
void build_pyramid(Exec const& exec, image_pyramid_view const& pyramid, resize_tap const* taps,
                   pyramid_tiles const& tiles, frame_arrivals const& arrivals) {
  for_each_item<per_block<detail::resize_tile::threads>>(
      exec, pyramid.batch * tiles.group[0].columns * tiles.group[0].rows,
      detail::resize_tile{arrivals}, pyramid, taps, tiles, 0);
}

}  // namespace FT_ABI
}  // namespace ft
