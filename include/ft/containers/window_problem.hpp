// SPDX-License-Identifier: Apache-2.0
/// @file Small bundle adjustments: a few views, the points that they see, and the observations.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Most views of a problem.
inline constexpr int max_window_views = 64;

/// Where a camera sees a point. Aligned, so that a GPU loads it at once.
struct alignas(16) window_observation {
  float x, y;        ///< pixels
  float right_x;     ///< column in the right image of a rectified pair; negative = none
  float inv_sigma2;  ///< weight, 1 / pixels^2; 0 = the point is not seen
};

/// A motion from one view to the next, measured by an IMU or by wheels.
struct window_link {
  rigid<double> motion;       ///< frame of the view before to that of this one, metres
  double rotation_weight;     ///< 1 / rad^2; not above 0 = not measured
  double translation_weight;  ///< 1 / m^2, of the vector between the centres; likewise
};

/// Parts of an observation that disagree with the result: too far from the point's image, or
/// without an image.
enum window_outlier : unsigned char {
  outlying_pixel = 1,  ///< (x, y)
  outlying_right = 2,  ///< x - right_x of a rectified pair
};

/// What became of an adjustment.
struct window_outcome {
  double first_cost;  ///< robust cost of the start
  double last_cost;   ///< robust cost of the result, at most first_cost
  int steps;          ///< steps that were tried, refused ones included
  int valid;          ///< 0 = nothing could be adjusted, and nothing was changed
};

/// A batch of bundle adjustments in executor memory, each with room for `views` views and `points`
/// points. Entry v of problem b is at `b * views + v`, point p at `b * points + p`.
///
/// The first `fixed_count` views stay where they are, the others and all points are moved. Views
/// and points past the counts are neither read nor written.
struct window_problem_view {
  int views = 0;    ///< capacity, at most max_window_views
  int points = 0;   ///< capacity
  int cameras = 1;  ///< cameras with observations of their own in a view: 1 for a rectified pair,
                    ///< which has its right column in the observation; else those of the rig
  int batch = 0;
  int* view_count = nullptr;           ///< [batch] views in use
  int* fixed_count = nullptr;          ///< [batch] of these, the first ones that stay
  int* point_count = nullptr;          ///< [batch] points in use
  rigid<double>* T_cw = nullptr;       ///< [batch][views] start and result; metres
  vec3<double>* position = nullptr;    ///< [batch][points] start and result; world, metres
  window_observation* seen = nullptr;  ///< [batch][points][views][cameras]
  window_link* link = nullptr;  ///< [batch][views] from the view before; the first is not read.
                                ///< Null: none
  /// [batch][views][views] Q, 1 / m^2, symmetric and positive semidefinite: the centres C of all
  /// views cost the sum over pairs (u, v) of Q_uv (C_u - G_u) (C_v - G_v). Null: nothing
  double* centre_information = nullptr;
  vec3<double>* centre_goal = nullptr;  ///< [batch][views] G, world, metres
  /// [batch][points][views][cameras] result of a valid problem: bits of window_outlier. 0 where the
  /// point is not seen.
  unsigned char* outlier = nullptr;
  window_outcome* outcome = nullptr;  ///< [batch] result

  FT_HOST_DEVICE std::ptrdiff_t view(int b, int v) const {
    return static_cast<std::ptrdiff_t>(b) * views + v;
  }
  FT_HOST_DEVICE std::ptrdiff_t point(int b, int p) const {
    return static_cast<std::ptrdiff_t>(b) * points + p;
  }
  /// Index into `seen` and `outlier`.
  FT_HOST_DEVICE std::ptrdiff_t sighting(int b, int p, int v, int camera) const {
    return (point(b, p) * views + v) * cameras + camera;
  }
};
static_assert(std::is_trivially_copyable<window_problem_view>::value, "passed to kernels");

/// The capacities of a batch of problems.
struct window_capacity {
  int views = 15;      ///< 1 to max_window_views
  int points = 4096;   ///< 1 to 2^20
  int cameras = 1;     ///< 1 to 16
  bool links = false;  ///< whether there is room for links, and for a cost of the centres
};

/// Places the arrays into an arena. Nothing is initialised.
/// @throws bad_argument for a capacity out of range
inline void carve(carver& c, window_problem_view& v, window_capacity const& capacity, int batch) {
  detail::require_range("views of a window", capacity.views, 1, max_window_views);
  detail::require_range("points of a window", capacity.points, 1, 1 << 20);
  detail::require_range("cameras of a window", capacity.cameras, 1, 16);
  detail::require_range("batch of windows", batch, 1, 1 << 16);
  v.views = capacity.views;
  v.points = capacity.points;
  v.cameras = capacity.cameras;
  v.batch = batch;
  c.place({batch}, v.view_count, v.fixed_count, v.point_count);
  c.place({batch, v.views}, v.T_cw);
  c.place({batch, v.points}, v.position);
  c.place({batch, v.points, v.views, v.cameras}, v.seen);
  if (capacity.links) {
    c.place({batch, v.views}, v.link, v.centre_goal);
    c.place({batch, v.views, v.views}, v.centre_information);
  }
  c.place({batch, v.points, v.views, v.cameras}, v.outlier);
  c.place({batch}, v.outcome);
}

}  // namespace FT_ABI
}  // namespace ft
