// SPDX-License-Identifier: Apache-2.0
/// @file What images look like around the map points of an odometry.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// The pixels around the keypoint of a keyframe that held a map point first, at the keypoint's
/// level, and how they lie in space.
struct point_patch {
  static constexpr int side = 10;   ///< pixels
  static constexpr int before = 4;  ///< of them left of, and above, the keypoint's pixel

  vec3<float> across, down;        ///< world, metres: from a pixel to the next one, across the ray
  float x, y;                      ///< from the keypoint's pixel to the keypoint, 0 to 1 pixel
  std::uint8_t grey[side * side];  ///< by rows
};

/// Weight of a keypoint that was moved to its point's patch, in those of a corner: half a pixel of
/// its level in place of one.
inline constexpr float weight_of_aligned = 4;
/// Times this in the last round of a pose, where outliers are known, and in adjustments: a quarter
/// of a pixel. Most are within 0.1, a few are half a pixel off.
inline constexpr float aligned_at_last = 4;
/// Of its chi-square there: where Huber's loss becomes linear, at 0.15 pixels.
inline constexpr double aligned_robust = 0.0225 * weight_of_aligned * aligned_at_last;

/// Patches by slot, in executor memory. They are not part of a map that is saved: points get new
/// ones.
struct point_patches_view {
  int slots = 0;
  int batch = 0;
  int* number = nullptr;         ///< [batch][slots] of the point; 0 = the slot has no patch
  point_patch* patch = nullptr;  ///< [batch][slots]

  template <typename Visit>
  void columns(Visit&& each) {
    each({batch, slots}, number, patch);
  }
  FT_HOST_DEVICE std::ptrdiff_t at(int b, int slot) const {
    return static_cast<std::ptrdiff_t>(b) * slots + slot;
  }
};
static_assert(std::is_trivially_copyable<point_patches_view>::value, "passed to kernels");

/// Places the arrays into an arena. clear() comes before the first use.
inline void carve(carver& c, point_patches_view& v, int slots, int batch) {
  v.slots = slots;
  v.batch = batch;
  detail::place_columns(c, v);
}

/// No point has a patch. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void clear(Exec const& exec, point_patches_view const& v) {
  fill_bytes(exec, v.number, 0,
             static_cast<std::size_t>(v.batch) * static_cast<std::size_t>(v.slots) * sizeof(int));
}

}  // namespace FT_ABI
}  // namespace ft
