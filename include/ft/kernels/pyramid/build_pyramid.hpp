// SPDX-License-Identifier: Apache-2.0
/// @file Stage: scale pyramid. Each level is the bilinear resize of the preceding one,
/// bit-identical to cv::resize(INTER_LINEAR) on 8-bit images. Source: specification section 1.
#pragma once

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pyramid/detail/by_rows.hpp"
#include "ft/kernels/pyramid/detail/by_tiles.hpp"
#include "ft/kernels/pyramid/resize_taps.hpp"
#include "ft/kernels/pyramid/tile_layout.hpp"

namespace ft {
inline namespace FT_ABI {

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
