// SPDX-License-Identifier: Apache-2.0
/// @file The path of a run as loops have corrected it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "examples/sequence/odometry_input.hpp"
#include "examples/sequence/report.hpp"
#include "examples/sequence/types.hpp"
#include "examples/track_sequence/setup.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/poses.hpp"

namespace app {

/// Poses as they were tracked, in the frame of the odometry.
class corrected_path {
public:
  void add(std::int64_t time_ns, ft::rigid<double> const& T_odom_camera) {
    tracked_.push_back({time_ns, 0, T_odom_camera, T_odom_camera, 1, false});
  }
  seq::trajectory as_tracked() const { return by({}); }
  /// Each pose moves with the last keyframe that is not after it. Those of a loaded map are before
  /// all poses, whatever their times.
  seq::trajectory by(std::vector<ft::placed_keyframe> const& keyframes) const {
    seq::trajectory path;
    std::size_t next = 0;
    auto T_world_odom = ft::similarity<double>::identity();
    for (ft::placed_keyframe const& p : tracked_) {
      for (; next < keyframes.size() && is_before(keyframes[next], p); ++next) {
        ft::placed_keyframe const& k = keyframes[next];
        T_world_odom =
            with_scale(k.T_world_camera, k.scale) * with_scale(k.T_odom_camera.inverse(), 1);
      }
      ft::similarity<double> const T = T_world_odom * with_scale(p.T_odom_camera, 1);
      path.push_back(seq::stamped(p.time_ns, {T.R, T.t}));
    }
    return path;
  }

private:
  static bool is_before(ft::placed_keyframe const& k, ft::placed_keyframe const& p) {
    return k.loaded || k.time_ns <= p.time_ns;
  }
  static ft::similarity<double> with_scale(ft::rigid<double> const& T, double scale) {
    return {T.R, T.t, scale};
  }
  std::vector<ft::placed_keyframe> tracked_;
};

inline std::vector<seq::loop_edge> edges_of(std::vector<ft::placed_keyframe> const& keyframes,
                                            std::vector<ft::closed_loop> const& loops) {
  std::vector<seq::loop_edge> edges;
  for (ft::closed_loop const& l : loops) {
    ft::placed_keyframe const& from = keyframes[static_cast<std::size_t>(l.from)];
    ft::placed_keyframe const& to = keyframes[static_cast<std::size_t>(l.to)];
    edges.push_back({seq::stamped(from.time_ns, from.T_world_camera),
                     seq::stamped(to.time_ns, to.T_world_camera), l.inliers, from.loaded});
  }
  return edges;
}

}  // namespace app
