// SPDX-License-Identifier: Apache-2.0
/// @file Stage: images and other inputs from host memory into an executor's, by its threads.
///
/// A copy engine is no faster for a pair of images, takes one copy after the other, and copies from
/// where it was told when a graph was recorded; threads read where the images lie now.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

/// An image in host memory that the executor's threads can read.
struct alignas(16) image_source {
  std::uint8_t const* data = nullptr;  ///< a multiple of 16, rows of `stride` readable bytes
  int stride = 0;                      ///< a multiple of 16, at least the width
};

/// Host memory that moves as it is.
struct block_source {
  void* to = nullptr;
  void const* from = nullptr;  ///< host memory that the executor's threads can read
  int quads = 0;               ///< of 16 bytes, as both addresses are multiples of
};

namespace detail {

/// Every so many-th part of a frame's input, in order: parts of images, and of what comes besides.
struct receive_parts {
  static constexpr int quads = frame_arrivals::quads_of_part;
  /// That take turns. What a device asks its host for at the same time comes in any order: few
  /// enough parts are on their way for rows to come before those below them, and enough for the bus
  /// to be busy.
  static constexpr int fetchers = 24;
  static constexpr int in_flight = 2;  ///< parts of a fetcher
  static constexpr int sources_held = 128;
  /// With a warp that tells what is there while the others wait for more.
  static constexpr int threads = quads + 32;
  struct alignas(16) quad {
    std::uint32_t words[4];
  };
  struct scratch {
    image_source sources[sources_held];
  };
  static constexpr bool shares_multiprocessors = true;

  static int parts_of(block_source const& first, block_source const& second) {
    return ceil_div(first.quads + second.quads, quads);
  }

  /// @param sources [batch of pyramids], host memory
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& to,
                                 image_source const* sources, block_source const& first,
                                 block_source const& second, frame_arrivals const& arrivals) const {
    int const of_image = frame_arrivals::parts_of(to.geometry);
    int const of_images = to.batch * of_image;
    int const parts = of_images + ceil_div(first.quads + second.quads, quads);
    int held = -1;  // which of the sources are
    // Where quad `i` of a part is, and where it goes.
    struct way {
      quad const* from;
      quad* to;
    };
    auto const way_of = [&](int part, int i) {
      int const image = part / of_image;
      if (part >= of_images) {
        int const at = (part - of_images) * quads + i;
        block_source const& block = at < first.quads ? first : second;
        int const in_block = at < first.quads ? at : at - first.quads;
        bool const there = in_block < block.quads;
        return way{there ? static_cast<quad const*>(block.from) + in_block : nullptr,
                   there ? static_cast<quad*>(block.to) + in_block : nullptr};
      }
      auto const level = to.level(image, 0);
      int const of_row = ceil_div(level.width, 16);
      int const at = (part - image * of_image) * quads + i;
      int const y = at / of_row;
      if (y >= level.height) { return way{nullptr, nullptr}; }
      auto const x = static_cast<std::ptrdiff_t>(16 * (at - y * of_row));
      image_source const& from = s.sources[image % sources_held];
      return way{
          reinterpret_cast<quad const*>(from.data + static_cast<std::ptrdiff_t>(y) * from.stride +
                                        x),
          reinterpret_cast<quad*>(level.data + static_cast<std::ptrdiff_t>(y) * level.stride + x)};
    };
    auto const hold_sources = [&](int part) {
      int const image = part / of_image;
      if (part >= of_images || image / sources_held == held) { return; }
      held = image / sources_held;
      g.sync();
      for (int k = g.rank(); k < sources_held && held * sources_held + k < to.batch;
           k += g.size()) {
        s.sources[k] = sources[held * sources_held + k];
      }
      g.sync();
    };
    if constexpr (Group::max_threads == 1) {
      for (int part = item; part < parts; part += fetchers) {
        hold_sources(part);
        for (int i = 0; i < quads; ++i) {
          way const w = way_of(part, i);
          if (w.from != nullptr) { *w.to = *w.from; }
        }
        if (arrivals.overlapping() && part < of_images) { arrive(g, arrivals.received + part); }
      }
    } else {
      static_assert(Group::max_threads == threads, "a thread a quad");
      quad on_way[in_flight];
      quad* place[in_flight];
      auto const ask = [&](int k, int part) {
        place[k] = nullptr;
        if (part >= parts) { return; }
        hold_sources(part);
        if (g.rank() >= quads) { return; }
        way const w = way_of(part, g.rank());
        place[k] = w.to;
        if (w.from != nullptr) { on_way[k] = *w.from; }
      };
      FT_UNROLL
      for (int k = 0; k < in_flight; ++k) { ask(k, item + k * fetchers); }
      for (int base = item; base < parts; base += in_flight * fetchers) {
        FT_UNROLL
        for (int k = 0; k < in_flight; ++k) {
          int const part = base + k * fetchers;
          if (part >= parts) { break; }
          if (place[k] != nullptr) { *place[k] = on_way[k]; }
          ask(k, part + in_flight * fetchers);
          if (arrivals.overlapping() && part < of_images) {
            arrive(g, arrivals.received + part, quads);
          }
        }
      }
    }
  }
};

}  // namespace detail

/// Fetches level 0 of all images of a batch, and two blocks. Asynchronous on `exec`: what is read
/// must stay as it is until it is done; allocates nothing; one launch.
/// @param sources [to.batch], in host memory that the executor's threads can read, looked at when
/// the launch runs
/// @param to has a geometry also where its batch is 0
/// @param arrivals tells the launches that overlap with this one what is there
template <typename Exec>
void receive_images(Exec const& exec, image_source const* sources, image_pyramid_view const& to,
                    block_source const& first = {}, block_source const& second = {},
                    frame_arrivals const& arrivals = {}) {
  int const parts = to.batch * frame_arrivals::parts_of(to.geometry) +
                    detail::receive_parts::parts_of(first, second);
  for_each_item<per_block<detail::receive_parts::threads>>(
      exec, min_of(parts, detail::receive_parts::fetchers), detail::receive_parts{}, to, sources,
      first, second, arrivals);
}

}  // namespace FT_ABI
}  // namespace ft
