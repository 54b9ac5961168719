// SPDX-License-Identifier: Apache-2.0
/// @file Stage: copies images and other inputs from host memory into executor memory.
///
/// Threads copy, not a copy engine. A copy engine is no faster for a pair of images, makes one copy
/// after the other, and has its addresses fixed when a graph is recorded.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// An image in host memory that the executor's threads can read.
struct alignas(16) image_source {
  /// A multiple of 16, rows of `stride` readable bytes; null if the image was uploaded before.
  std::uint8_t const* data = nullptr;
  int stride = 0;     ///< a multiple of 16, at least the width
  int first_row = 0;  ///< rows above were uploaded before
};

/// A block of host memory and its destination.
struct block_source {
  void* to = nullptr;
  void const* from = nullptr;  ///< host memory that the executor's threads can read
  int quads = 0;               ///< length in units of 16 bytes, to which both addresses are aligned
};

namespace detail {

/// Block k of n copies chunks k, k + n, ... of the inputs: images first, then the two blocks.
struct receive_parts {
  static constexpr int quads = frame_arrivals::quads_of_part;
  /// Blocks of the launch. Concurrent reads of host memory complete in any order. With few chunks
  /// in flight, upper rows arrive before lower ones; this number still keeps the bus busy.
  static constexpr int fetchers = 24;
  static constexpr int in_flight = 2;       ///< chunks per block
  static constexpr int sources_held = 128;  ///< image sources in scratch at a time
  /// One thread per quad, and a warp that signals the chunks that have arrived while the other
  /// warps wait for more.
  static constexpr int threads = quads + 32;
  struct alignas(16) quad {
    std::uint32_t words[4];
  };
  /// Bytes, because shared memory has no default member initialisers.
  struct scratch {
    alignas(image_source) unsigned char bytes[sources_held * sizeof(image_source)];
    FT_HOST_DEVICE image_source* sources() { return reinterpret_cast<image_source*>(bytes); }
  };
  static constexpr bool prefers_shared = true;

  static int parts_of(block_source const& first, block_source const& second) {
    return ceil_div(first.quads + second.quads, quads);
  }

  /// Resets the counters of the chunks that this block copies.
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch&, int item, image_pyramid_view const&,
                               image_source const*, block_source const&, block_source const&,
                               frame_arrivals const& arrivals) const {
    arrivals.reset_received(g, item, fetchers);
  }

  /// @param sources [batch of pyramids], host memory
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& to,
                                 image_source const* sources, block_source const& first,
                                 block_source const& second, frame_arrivals const& arrivals) const {
    int const of_image = frame_arrivals::parts_of(to.geometry);
    inputs in{s, to, sources, first, second, of_image, to.batch * of_image};
    int const parts = in.of_images + ceil_div(first.quads + second.quads, quads);
    if constexpr (Group::max_threads == 1) {
      for (int part = item; part < parts; part += fetchers) {
        if (in.is_absent(part)) { continue; }
        in.hold_sources(g, part);
        for (int i = 0; i < quads; ++i) {
          route const w = in.route_of(part, i);
          if (w.from != nullptr) { *w.to = *w.from; }
        }
        if (arrivals.overlapping() && part < in.of_images) { arrive(g, arrivals.received + part); }
      }
    } else {
      copy_pipelined(g, item, parts, in, arrivals);
    }
  }

private:
  /// Source and destination of a quad; null past the end.
  struct route {
    quad const* from;
    quad* to;
  };

  /// The inputs of a frame as one sequence of chunks.
  struct inputs {
    scratch& s;
    image_pyramid_view const& to;
    image_source const* sources;
    block_source const& first;
    block_source const& second;
    int of_image;   ///< chunks of an image
    int of_images;  ///< chunks of all images
    int held = -1;  ///< index of the sources in scratch, in units of sources_held

    /// Whether a chunk is that of an image that never comes.
    FT_HOST_DEVICE bool is_absent(int part) const {
      return part < of_images && to.absent.has(part / of_image);
    }
    /// Quad i of a chunk.
    FT_HOST_DEVICE route route_of(int part, int i) const {
      int const image = part / of_image;
      if (part >= of_images) {
        int const at = (part - of_images) * quads + i;
        block_source const& block = at < first.quads ? first : second;
        int const in_block = at < first.quads ? at : at - first.quads;
        bool const there = in_block < block.quads;
        return {there ? static_cast<quad const*>(block.from) + in_block : nullptr,
                there ? static_cast<quad*>(block.to) + in_block : nullptr};
      }
      auto const level = to.level(image, 0);
      int const of_row = ceil_div(level.width, 16);
      int const at = (part - image * of_image) * quads + i;
      int const y = at / of_row;
      image_source const& from = s.sources()[image % sources_held];
      if (y < from.first_row || y >= level.height || from.data == nullptr) {
        return {nullptr, nullptr};
      }
      auto const x = static_cast<std::ptrdiff_t>(16 * (at - y * of_row));
      return {
          reinterpret_cast<quad const*>(from.data + static_cast<std::ptrdiff_t>(y) * from.stride +
                                        x),
          reinterpret_cast<quad*>(level.data + static_cast<std::ptrdiff_t>(y) * level.stride + x)};
    }
    /// Loads the image sources that a chunk needs into scratch.
    template <typename Group>
    FT_HOST_DEVICE void hold_sources(Group g, int part) {
      int const image = part / of_image;
      if (part >= of_images || image / sources_held == held) { return; }
      held = image / sources_held;
      g.sync();
      for (int k = g.rank(); k < sources_held && held * sources_held + k < to.batch;
           k += g.size()) {
        s.sources()[k] = sources[held * sources_held + k];
      }
      g.sync();
    }
  };

  /// Copies chunks item, item + fetchers, ... with `in_flight` of them prefetched.
  template <typename Group>
  FT_HOST_DEVICE static void copy_pipelined(Group g, int item, int parts, inputs& in,
                                            frame_arrivals const& arrivals) {
    static_assert(Group::max_threads == threads, "a thread a quad");
    quad loaded[in_flight];
    quad* place[in_flight];
    auto const load = [&](int k, int part) {
      place[k] = nullptr;
      if (part >= parts || in.is_absent(part)) { return; }
      in.hold_sources(g, part);
      if (g.rank() >= quads) { return; }
      route const w = in.route_of(part, g.rank());
      place[k] = w.to;
      if (w.from != nullptr) { loaded[k] = *w.from; }
    };
    FT_UNROLL
    for (int k = 0; k < in_flight; ++k) { load(k, item + k * fetchers); }
    for (int base = item; base < parts; base += in_flight * fetchers) {
      FT_UNROLL
      for (int k = 0; k < in_flight; ++k) {
        int const part = base + k * fetchers;
        if (part >= parts) { break; }
        if (place[k] != nullptr) { *place[k] = loaded[k]; }
        load(k, part + in_flight * fetchers);
        if (arrivals.overlapping() && part < in.of_images && !in.is_absent(part)) {
          arrive(g, arrivals.received + part, quads);
        }
      }
    }
  }
};

}  // namespace detail

/// Copies level 0 of all images of a batch that are not absent, and two blocks. Asynchronous on
/// `exec`: inputs must stay unchanged until it is done. Allocates nothing; one launch.
/// @param sources [to.batch] in host memory that the executor's threads can read; read when the
///   launch runs
/// @param to must have a geometry even if its batch is 0
/// @param arrivals signals finished chunks to concurrent launches
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

// Stage: writes map points from the host into the map.

/// One map point from the host.
struct point_update {
  int slot;
  int observations;
  vec3<float> position;  ///< world, metres
  vec3<float> normal;
  float min_distance, max_distance;  ///< metres
  descriptor orb;

  /// @throws bad_argument for a NaN in any of the lengths
  void check() const {
    bool const number =
        !(std::isnan(position.x) || std::isnan(position.y) || std::isnan(position.z) ||
          std::isnan(normal.x) || std::isnan(normal.y) || std::isnan(normal.z) ||
          std::isnan(min_distance) || std::isnan(max_distance));
    if (!number) {
      throw bad_argument("ft: the map point for slot " + std::to_string(slot) +
                         " has a NaN in its position, normal or distances");
    }
  }
};

/// Writes the points of an update into the map.
struct apply_updates {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, point_update const* updates,
                                 map_points_view const& map) const {
    point_update const u = updates[item];
    map.position(u.slot) = u.position;
    map.normal(u.slot) = u.normal;
    map.min_distance(u.slot) = u.min_distance;
    map.max_distance(u.slot) = u.max_distance;
    map.orb(u.slot) = u.orb;
    map.observations(u.slot) = u.observations;
  }
};

}  // namespace FT_ABI
}  // namespace ft
