// SPDX-License-Identifier: Apache-2.0
/// @file A frame of an odometry as what is kept of it for loops, and kept keyframes as they are
/// seen.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <vector>

#include "ft/containers/loop_archive.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/loops/keep_keyframe.hpp"
#include "ft/pipelines/detail/odometry_stages.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What loops take of an odometry.
template <typename Exec>
struct looped_odometry {
  loop_params params;
  tracking_rules rules;
  odometry_input* input;
  odometry_output const* output;
  bool one_camera, has_imu;
  int depth_cameras;
  /// Keeps the last frame as a row of the archive, see frame_with_points().
  std::function<void(Exec const&, int row, bool with_depths)> keep;
};

/// Median distance of the points of a row; 0 without any.
inline double median_distance(loop_archive_view const& archive, int row) {
  std::vector<float> all;
  for (std::ptrdiff_t i = archive.at(row); i < archive.at(row) + archive.count[row]; ++i) {
    all.push_back(dot(archive.point[i], archive.point[i]));
  }
  if (all.empty()) { return 0; }
  auto const middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::nth_element(all.begin(), middle, all.end());
  return std::sqrt(static_cast<double>(*middle));
}

/// Where a camera is, and which way it looks.
struct camera_view {
  vec3<double> at, ahead;
  /// How far two and what they look at are from each other. @param far distance of that
  double off(camera_view const& other, double far) const {
    auto const shift = at - other.at;
    auto const looks = shift + scaled(ahead - other.ahead, far);
    return std::sqrt(dot(shift, shift)) + std::sqrt(dot(looks, looks));
  }
};
inline camera_view view_of(rigid<double> const& T_camera) {
  return {T_camera.t, T_camera.R * vec3<double>{0, 0, 1}};
}

/// The last frame with the depths of its keypoints: of one camera those of the map, or, if they are
/// to say nothing, the same for all.
template <typename Exec, typename Rig>
auto frame_with_points([[maybe_unused]] Exec const& exec, odometry_stages<Exec, Rig> const& stages,
                       [[maybe_unused]] bool with_depths = true) {
  auto in = stages.as_keyframe();
  if constexpr (odometry_stages<Exec, Rig>::starts_from_motion) {
    auto const& seen = stages.beginning.points();  // the next keyframe writes it anew
    if (with_depths) {
      place_held_points(exec, in, stages.own.map.points, seen.depth, seen.point);
    } else {
      place_all_ahead(exec, in.frame.capacity(), seen.depth, seen.point);
    }
    in.depth = seen.depth;
    in.point = seen.point;
  }
  return in;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
