// SPDX-License-Identifier: Apache-2.0
/// @file Bundle adjustment of a few keyframes and the points that they see, on the host.
#pragma once

#include <array>
#include <vector>

#include "examples/track_sequence/odometry.hpp"

namespace app {

/// A point seen by one camera of one view. In a rectified pair the right camera's column is not a
/// measurement of its own: camera 1 gives the disparity as u, and v is 0.
struct sighting {
  int view;
  int point;
  int camera;     ///< 0 left, 1 right
  double u, v;    ///< pixels
  double weight;  ///< 1 / pixels^2
};

struct adjustment {
  std::vector<rigid_pose> views;  ///< T_cw; the first `fixed` ones are constant
  int fixed = 0;
  std::vector<std::array<double, 3>> points;  ///< world, metres
  std::vector<sighting> sightings;            ///< sorted by point, then by view
};

/// Lowers the sum of the robust reprojection errors over views and points: Levenberg-Marquardt with
/// the points eliminated (Triggs and others, "Bundle adjustment - a modern synthesis", 1999).
/// Points and views change only if the sum becomes smaller. Plain sums in a fixed order: equal
/// inputs give equal bytes.
/// @param rig its cameras' parameters are read
/// @param steps most steps to try
/// @return squared weighted error of every sighting at the end, negative if it has no image
std::vector<double> adjust(odometry_options const& rig, adjustment& a, int steps);

}  // namespace app
