// SPDX-License-Identifier: Apache-2.0
/// @file The path of a run as loops have corrected it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "examples/sequence/types.hpp"
#include "examples/track_sequence/setup.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/poses.hpp"

namespace app {

/// Poses as they were tracked, in the frame of the odometry.
class corrected_path {
public:
  void add(std::int64_t time_ns, ft::rigid<double> const& T_odom_camera) {
    tracked_.push_back({time_ns, 0, T_odom_camera, T_odom_camera});
  }
  seq::trajectory as_tracked() const { return by({}); }
  /// Each pose moves with the last keyframe that is not after it.
  seq::trajectory by(std::vector<ft::placed_keyframe> const& keyframes) const {
    seq::trajectory path;
    std::size_t next = 0;
    ft::rigid<double> T_world_odom = ft::rigid<double>::identity();
    for (ft::placed_keyframe const& p : tracked_) {
      for (; next < keyframes.size() && keyframes[next].time_ns <= p.time_ns; ++next) {
        T_world_odom = keyframes[next].T_world_camera * keyframes[next].T_odom_camera.inverse();
      }
      path.push_back(stamped(p.time_ns, T_world_odom * p.T_odom_camera));
    }
    return path;
  }

private:
  std::vector<ft::placed_keyframe> tracked_;
};

}  // namespace app
