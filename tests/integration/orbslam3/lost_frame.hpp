// SPDX-License-Identifier: Apache-2.0
/// @file A frame that is to be relocalised with a keyframe, and what the pose solver writes.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/recovery_stages.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/two_views.hpp"

namespace orbslam3_test {

struct lost_frame : two_views {
  explicit lost_frame(sensor kind, unsigned seed = 3) : two_views(kind, seed) {
    auto const& s = settings;
    ft::orbslam3::fill_scale_tables(
        ft::pyramid_geometry::make(s.width, s.height, s.levels, s.scale_factor), s.scale_factor,
        frame);
  }
  /// Points by keypoint, nearly all of them right: a wide search from the last frame.
  std::vector<stand_in::map_point*> matches() const {
    auto f = frame;
    plain_search(settings).search_last(f, world.last, 15, true);
    return f.mvpMapPoints;
  }
  std::vector<stand_in::keypoint> const& left_keys() const {
    return frame.Nleft >= 0 ? frame.mvKeys : frame.mvKeysUn;
  }
  /// Keypoints that hold a point.
  int held() const {
    auto const& all = frame.mvpMapPoints;
    return static_cast<int>(all.size() -
                            static_cast<std::size_t>(std::count(all.begin(), all.end(), nullptr)));
  }
};

/// The variables of Tracking::Relocalization.
struct pose_variables {
  int found = 0;
  bool no_more = false;
  std::vector<bool> inliers;
  int count = -1;
  Eigen::Matrix4f T_cw = Eigen::Matrix4f::Zero();

  ft::orbslam3::pnp_answer answer() { return {no_more, inliers, count, T_cw}; }
  friend bool operator==(pose_variables const& a, pose_variables const& b) {
    return a.found == b.found && a.no_more == b.no_more && a.inliers == b.inliers &&
           a.count == b.count && a.T_cw == b.T_cw;
  }
};

}  // namespace orbslam3_test
