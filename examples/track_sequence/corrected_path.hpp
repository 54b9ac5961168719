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
    tracked_.push_back({time_ns, 0, T_odom_camera, T_odom_camera, 1});
  }
  seq::trajectory as_tracked() const { return by({}); }
  /// Each pose moves with the last keyframe that is not after it.
  seq::trajectory by(std::vector<ft::placed_keyframe> const& keyframes) const {
    seq::trajectory path;
    std::size_t next = 0;
    auto T_world_odom = ft::similarity<double>::identity();
    for (ft::placed_keyframe const& p : tracked_) {
      for (; next < keyframes.size() && keyframes[next].time_ns <= p.time_ns; ++next) {
        ft::placed_keyframe const& k = keyframes[next];
        T_world_odom =
            with_scale(k.T_world_camera, k.scale) * with_scale(k.T_odom_camera.inverse(), 1);
      }
      ft::similarity<double> const T = T_world_odom * with_scale(p.T_odom_camera, 1);
      path.push_back(stamped(p.time_ns, {T.R, T.t}));
    }
    return path;
  }

private:
  static ft::similarity<double> with_scale(ft::rigid<double> const& T, double scale) {
    return {T.R, T.t, scale};
  }
  std::vector<ft::placed_keyframe> tracked_;
};

}  // namespace app
