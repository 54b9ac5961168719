// SPDX-License-Identifier: Apache-2.0
/// @file Container: how much of a frame's images is there while they are fetched, and which have
/// their keypoints in place. By it a launch waits for parts of one that is still running, in place
/// of all of it.
///
/// A launch that waits in this way is beside() the one that it waits for, which has begun with all
/// of its items: what it waits for comes, whatever else a device does. Where launches follow each
/// other everything is there already.
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

/// What the group wrote before is seen by those that await the count which this raises by one.
/// @param rank of the thread that does so, once its own loads are there
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

/// Until each of `count` counters is at least `n`. On the host, where nothing overlaps, they are.
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

/// Counters in executor memory, 0 before a frame. A view without them says that everything is
/// there.
struct frame_arrivals {
  static constexpr int quads_of_part = 256;  ///< of 16 bytes: an image is fetched in such parts

  unsigned* received = nullptr;  ///< [batch][parts] 1 = the part is there
  unsigned* placed = nullptr;    ///< [batch] 1 = an image's keypoints have their places
  int batch = 0;
  int parts = 0;  ///< of an image
  int quads_of_row = 0;

  FT_HOST_DEVICE bool overlapping() const { return received != nullptr; }
  FT_HOST_DEVICE static int parts_of(pyramid_geometry const& g) {
    return ceil_div(ceil_div(g.width[0], 16) * g.height[0], quads_of_part);
  }
  FT_HOST_DEVICE int counters() const { return batch * (parts + 1); }  ///< of both kinds

  /// For rows [begin, end) of level 0.
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

inline void carve(carver& c, frame_arrivals& v, pyramid_geometry const& g, int batch) {
  v.batch = batch;
  v.parts = frame_arrivals::parts_of(g);
  v.quads_of_row = ceil_div(g.width[0], 16);
  auto const b = static_cast<std::size_t>(batch);
  v.received = c.take<unsigned>(b * static_cast<std::size_t>(v.parts));
  v.placed = c.take<unsigned>(b);
}

/// Sets a counter to 0, those of parts first.
struct clear_arrival {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, frame_arrivals const& arrivals) const {
    int const parts = arrivals.batch * arrivals.parts;
    (item < parts ? arrivals.received[item] : arrivals.placed[item - parts]) = 0;
  }
};

/// The same and what else there is, for with_small_items.
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
