// SPDX-License-Identifier: Apache-2.0
/// @file What is kept of keyframes, so that their places are recognised later.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/containers/columns.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Keypoints with a depth of keyframes, a row for each, in executor memory.
struct loop_archive_view {
  int rows = 0;
  int points = 0;                ///< of a row, at most
  int* count = nullptr;          ///< [rows]
  descriptor* orb = nullptr;     ///< [rows][points]
  vec3<float>* point = nullptr;  ///< [rows][points] in the frame of the keyframe's pose, metres
  float* x = nullptr;            ///< [rows][points] pixels
  float* y = nullptr;            ///< [rows][points] pixels
  float* right_x = nullptr;      ///< [rows][points] pixels, -1 = none
  float* inv_sigma2 = nullptr;   ///< [rows][points] 1 / variance of the position, 1 / pixels^2
  int* camera = nullptr;         ///< [rows][points] of a multi_rig, ascending in a row; 0

  template <typename Visit>
  void columns(Visit&& each) {
    each({rows}, count);
    each({rows, points}, orb, point, x, y, right_x, inv_sigma2, camera);
  }
  FT_HOST_DEVICE std::ptrdiff_t at(int row) const {
    return static_cast<std::ptrdiff_t>(row) * points;
  }
};
static_assert(std::is_trivially_copyable<loop_archive_view>::value, "passed to kernels");

/// Places the arrays into an arena. @throws bad_argument for a size out of range
inline void carve(carver& c, loop_archive_view& v, int rows, int points) {
  detail::require_range("keyframes that are kept for loops", rows, 4, 1 << 20);
  detail::require_range("points of a keyframe that is kept for loops", points, 16, 1 << 12);
  v.rows = rows;
  v.points = points;
  detail::place_columns(c, v);
}

/// What was found between two keyframes.
struct loop_match {
  rigid<double> T_query_row;  ///< from the frame of the row's pose to that of the query's, metres,
                              ///< or the row's units
  int matches;                ///< that are each other's nearest
  int inliers;                ///< of these, those that agree with the pose; 0 = there is none
  /// Of one camera alone how many units of the query a unit of the row is, by the depths of both,
  /// and the standard deviation of its natural logarithm; else 1 and 0.
  double scale;
  double scale_sigma;
  /// Upper triangle by rows of the pose's information matrix, as in pose_problem, in units of the
  /// row.
  float information[21];
};

}  // namespace FT_ABI
}  // namespace ft
