// SPDX-License-Identifier: Apache-2.0
/// @file How a launch is ordered with respect to the preceding grid.
#pragma once

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// An executor launches in the order that with_order(exec, order) gave it, serial by default. On
/// the host, and outside recordings, all three are stream order.
enum class launch_order {
  /// Waits for the preceding grid before it touches memory. In a recording the kernel is set up
  /// while that grid still runs (programmatic dependent launch), which saves about a microsecond.
  serial,
  /// Uses no output of the preceding grid except by signals, and runs concurrently with it: only
  /// grids that the preceding one waited for are complete. All blocks of that grid have started, so
  /// a concurrent launch may also wait for parts of its output (containers/frame_arrivals.hpp). It
  /// does not complete before that grid has, so a launch that waits for it waits for both. A
  /// side_branch does the same for more than one launch, but a launch that joins one was measured
  /// to start two microseconds late.
  concurrent,
  /// Starts when the preceding grid has completed. For grids of one full wave: an early launch
  /// would spread their blocks unevenly over the multiprocessors.
  full_wave,
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
