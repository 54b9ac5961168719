// SPDX-License-Identifier: Apache-2.0
/// @file Stage: collects the newest keyframes and their points for an adjustment.
#pragma once

#include <cstddef>

#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/odometry_map.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

struct window_params {
  int moving = 8;  ///< newest keyframes, which are adjusted, 1 or more
  int fixed = 5;   ///< keyframes before these, which stay, 0 or more. The views of a
                   ///< window_problem_view are at least moving + fixed
};

/// Inputs of gather_window, apart from the map.
struct window_input {
  int const* flags = nullptr;  ///< [batch] 1 = gather
  pyramid_geometry geometry;
  window_params params;
};

/// Where the contents of a window_problem_view come from.
struct window_sources_view {
  int* keyframe = nullptr;       ///< [batch][views] number of a view's keyframe
  int* slot = nullptr;           ///< [batch][points]
  int* number = nullptr;         ///< [batch][points] of the point
  int* keypoint = nullptr;       ///< [batch][points][views][cameras] number of an observation's
                                 ///< keypoint; undefined where the point is not seen
  int* left_out = nullptr;       ///< [batch] points for which there was no room
  int* point_of_slot = nullptr;  ///< [batch][slots] workspace of gather_window
};

/// Places the arrays into an arena.
inline void carve(carver& c, window_sources_view& v, window_capacity const& size, int slots,
                  int batch) {
  auto const b = static_cast<std::size_t>(batch);
  std::size_t const points = detail::checked_mul(b, static_cast<std::size_t>(size.points));
  v.keyframe = c.take<int>(b * static_cast<std::size_t>(size.views));
  v.slot = c.take<int>(points);
  v.number = c.take<int>(points);
  v.keypoint =
      c.take<int>(detail::checked_mul(points, static_cast<std::size_t>(size.views * size.cameras)));
  v.left_out = c.take<int>(b);
  v.point_of_slot = c.take<int>(detail::checked_mul(b, static_cast<std::size_t>(slots)));
}

/// Fills the problems of the batch entries whose flag is set; those of others are not touched.
template <typename Exec>
void gather_window(Exec const& exec, window_input const& in, odometry_map_view const& map,
                   window_problem_view const& problem, window_sources_view const& sources);

}  // namespace FT_ABI
}  // namespace ft
