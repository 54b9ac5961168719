// SPDX-License-Identifier: Apache-2.0
/// @file Container: progress of a frame. It counts the uploaded chunks of the images, and flags
/// images whose keypoints have their places. A concurrent launch waits for these parts rather than
/// for the whole preceding grid.
///
/// Such a launch has launch_order::concurrent. All blocks of the preceding grid have started by
/// then, so it makes progress even if other work runs on the device. For launches in stream order
/// every wait is already satisfied.
#pragma once

#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Increments a counter with release semantics, after all earlier writes of the group.
/// @param rank of the thread that increments
template <typename Group>
FT_HOST_DEVICE void arrive(Group const& g, unsigned* counter, int rank = 0) {
  g.sync();
  if (g.rank() == rank % g.size()) { atomic_increment_release(counter); }
}

/// Sets counters first, first + step, ... below `end` to 0, in the prologue of the stage that will
/// increment them. No dependent grid starts before the whole group has done so: the fence and the
/// barrier come before the group lets dependents start.
template <typename Group>
FT_HOST_DEVICE void reset(Group const& g, unsigned* counters, int first, int end, int step) {
  for (int i = first + g.rank() * step; i < end; i += g.size() * step) { counters[i] = 0; }
#if defined(__CUDA_ARCH__)
  __threadfence();
#endif
  g.sync();
}

/// Waits until each of `count` counters is at least `n`, with acquire semantics. On the host
/// nothing runs concurrently, so the counters have reached it already.
template <typename Group>
FT_HOST_DEVICE void await(Group const& g, unsigned const* counters, int count, int n) {
#if defined(__CUDA_ARCH__)
  for (int i = g.rank(); i < count; i += g.size()) {
    while (atomic_load_acquire(counters + i) < static_cast<unsigned>(n)) { __nanosleep(64); }
  }
#else
  static_cast<void>(counters);
  static_cast<void>(count);
  static_cast<void>(n);
#endif
  g.sync();
}

}  // namespace detail

/// Counters in executor memory. The stage that increments them resets them in its prologue. In a
/// view without counters every wait returns at once.
struct frame_arrivals {
  static constexpr int quads_of_part = 256;  ///< size of a chunk, in units of 16 bytes

  unsigned* received = nullptr;  ///< [batch][parts] 1 = the chunk has been uploaded
  unsigned* placed = nullptr;    ///< [batch] 1 = the image's keypoints have their places
  int batch = 0;
  int parts = 0;  ///< chunks of an image
  int quads_of_row = 0;

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, parts}, received);
    each({batch}, placed);
  }
  FT_HOST_DEVICE bool overlapping() const { return received != nullptr; }
  FT_HOST_DEVICE static int parts_of(pyramid_geometry const& g) {
    return ceil_div(ceil_div(g.width[0], 16) * g.height[0], quads_of_part);
  }

  /// Waits for rows [begin, end) of level 0.
  template <typename Group>
  FT_HOST_DEVICE void await_rows(Group const& g, int image, int begin, int end) const {
    int const first = begin * quads_of_row / quads_of_part;
    int const last = (end * quads_of_row - 1) / quads_of_part;
    detail::await(g, received + image * parts + first, last - first + 1, 1);
  }
  /// Resets the counters of chunks first, first + step, ... of all images.
  template <typename Group>
  FT_HOST_DEVICE void reset_received(Group const& g, int first, int step) const {
    if (overlapping()) { detail::reset(g, received, first, batch * parts, step); }
  }
  template <typename Group>
  FT_HOST_DEVICE void reset_placed(Group const& g, int image) const {
    if (overlapping()) { detail::reset(g, placed, image, image + 1, 1); }
  }
  template <typename Group>
  FT_HOST_DEVICE void tell_placed(Group const& g, int image) const {
    if (overlapping()) { detail::arrive(g, placed + image); }
  }
  template <typename Group>
  FT_HOST_DEVICE void await_placed(Group const& g, int image) const {
    if (overlapping()) {
      detail::await(g, placed + image, 1, 1);
    } else {
      g.sync();
    }
  }
};
static_assert(std::is_trivially_copyable<frame_arrivals>::value, "passed to kernels");

/// Places the counters into an arena.
inline void carve(carver& c, frame_arrivals& v, pyramid_geometry const& g, int batch) {
  v.batch = batch;
  v.parts = frame_arrivals::parts_of(g);
  v.quads_of_row = ceil_div(g.width[0], 16);
  detail::place_columns(c, v);
}

}  // namespace FT_ABI
}  // namespace ft
