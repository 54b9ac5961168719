// SPDX-License-Identifier: Apache-2.0
/// @file Container: progress of a frame. It counts the chunks of the images that have been
/// uploaded, and tells which images have their keypoints in place. A concurrent launch waits for
/// these parts rather than for the whole preceding grid.
///
/// Such a launch has launch_order::concurrent. All blocks of that grid have started by
/// then, so it makes progress whatever else runs on the device. For launches in stream order every
/// wait is already satisfied.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Increments a counter with release semantics, after all earlier writes of the group.
/// @param rank of the thread that does it
template <typename Group>
FT_HOST_DEVICE void arrive(Group const& g, unsigned* counter, int rank = 0) {
  g.sync();
#if defined(__CUDA_ARCH__)
  if (g.rank() == rank) {
    asm volatile("red.release.gpu.global.add.u32 [%0], 1;" ::"l"(counter) : "memory");
  }
#else
  static_cast<void>(rank);
  __atomic_fetch_add(counter, 1u, __ATOMIC_RELEASE);
#endif
}

/// Waits until each of `count` counters is at least `n`, with acquire semantics. On the host
/// nothing runs concurrently, and they always are.
template <typename Group>
FT_HOST_DEVICE void await(Group const& g, unsigned const* counters, int count, int n) {
#if defined(__CUDA_ARCH__)
  for (int i = g.rank(); i < count; i += g.size()) {
    for (;;) {
      unsigned seen;
      asm volatile("ld.acquire.gpu.global.u32 %0, [%1];"
                   : "=r"(seen)
                   : "l"(counters + i)
                   : "memory");
      if (seen >= static_cast<unsigned>(n)) { break; }
      asm volatile("nanosleep.u32 64;");
    }
  }
#else
  static_cast<void>(counters);
  static_cast<void>(count);
  static_cast<void>(n);
#endif
  g.sync();
}

}  // namespace detail

/// Counters in executor memory, 0 before a frame. In a view without counters every wait returns at
/// once.
struct frame_arrivals {
  static constexpr int quads_of_part = 256;  ///< size of a chunk, in units of 16 bytes

  unsigned* received = nullptr;  ///< [batch][parts] 1 = the chunk has been uploaded
  unsigned* placed = nullptr;    ///< [batch] 1 = the image's keypoints have their places
  int batch = 0;
  int parts = 0;  ///< chunks of an image
  int quads_of_row = 0;

  FT_HOST_DEVICE bool overlapping() const { return received != nullptr; }
  FT_HOST_DEVICE static int parts_of(pyramid_geometry const& g) {
    return ceil_div(ceil_div(g.width[0], 16) * g.height[0], quads_of_part);
  }
  FT_HOST_DEVICE int counters() const { return batch * (parts + 1); }  ///< of both kinds

  /// Waits for rows [begin, end) of level 0.
  template <typename Group>
  FT_HOST_DEVICE void await_rows(Group const& g, int image, int begin, int end) const {
    int const first = begin * quads_of_row / quads_of_part;
    int const last = (end * quads_of_row - 1) / quads_of_part;
    detail::await(g, received + image * parts + first, last - first + 1, 1);
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
  auto const b = static_cast<std::size_t>(batch);
  v.received = c.take<unsigned>(b * static_cast<std::size_t>(v.parts));
  v.placed = c.take<unsigned>(b);
}

/// Sets one counter to 0; those of chunks come first.
struct clear_arrival {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_arrivals const& arrivals) const {
    int const parts = arrivals.batch * arrivals.parts;
    (item < parts ? arrivals.received[item] : arrivals.placed[item - parts]) = 0;
  }
};

/// Clears the counters and does the items of another stage, for with_small_items.
template <typename Also>
struct clear_arrivals_and {
  frame_arrivals arrivals;
  Also also;

  FT_HOST_DEVICE int count() const { return arrivals.counters() + also.count(); }
  FT_HOST_DEVICE void operator()(int item) const {
    int const counters = arrivals.counters();
    if (item < counters) {
      no_scratch none;
      clear_arrival{}(single_group{}, none, item, arrivals);
    } else {
      also(item - counters);
    }
  }
};

}  // namespace FT_ABI
}  // namespace ft
