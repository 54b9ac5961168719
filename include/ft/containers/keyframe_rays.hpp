// SPDX-License-Identifier: Apache-2.0
/// @file What keyframes keep of their keypoints for later triangulation.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/keyframes.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Cells of an image in which rays are sorted, about as many as lines are long in pixels of them.
inline constexpr int ray_columns = 32;
inline constexpr int ray_rows = 24;
inline constexpr int ray_cells = ray_columns * ray_rows;

/// Where the rays of a cell are: within `reach` of `middle`, with what each may be off from an
/// epipolar plane. So a plane with the unit normal n has none of them if |n middle| > reach.
struct ray_cell {
  vec3<float> middle;
  float reach;  ///< below 0: there are none
};

/// Rays and descriptors of the keypoints of a keyframes_view with one camera, in executor memory,
/// indexed as there.
struct keyframe_rays_view {
  int* number = nullptr;       ///< [batch][positions] of the keyframe that they belong to, 0 = none
  vec3<float>* ray = nullptr;  ///< [batch][positions][capacity] unit length, camera frame; 0 = none
  descriptor* orb = nullptr;   ///< [batch][positions][capacity]
  ray_cell* cell = nullptr;    ///< [batch][positions][ray_cells]
  int* first = nullptr;        ///< [batch][positions][ray_cells + 1] of a cell in `in_cell`
  int* in_cell = nullptr;  ///< [batch][positions][capacity] keypoints cell by cell, in any order
};
static_assert(std::is_trivially_copyable<keyframe_rays_view>::value, "passed to kernels");

/// Places the arrays into an arena. clear() comes before the first use.
inline void carve(carver& c, keyframe_rays_view& v, keyframes_capacity const& size, int batch) {
  auto const positions = size.positions;
  c.place({batch, positions}, v.number);
  c.place({batch, positions, size.keypoints}, v.ray, v.orb);
  c.place({batch, positions, ray_cells}, v.cell);
  c.place({batch, positions, ray_cells + 1}, v.first);
  c.place({batch, positions, size.keypoints}, v.in_cell);
}

/// No keyframe of batch entry b has rays. Asynchronous if the executor is; allocates nothing.
template <typename Exec>
void forget_rays(Exec const& exec, keyframe_rays_view const& v, int positions, int b) {
  fill_bytes(exec, v.number + static_cast<std::ptrdiff_t>(b) * positions, 0,
             static_cast<std::size_t>(positions) * sizeof(int));
}

}  // namespace FT_ABI
}  // namespace ft
