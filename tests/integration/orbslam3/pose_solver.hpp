// SPDX-License-Identifier: Apache-2.0
/// @file Poses by RANSAC, which the shim leaves to ORB-SLAM3: by ft, on the host.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/interop/eigen.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "integration/orbslam3/rigs.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

/// The variables of Tracking::Relocalization.
struct pose_variables {
  bool no_more = false;
  std::vector<bool> inliers;
  int count = 0;
  Eigen::Matrix4f T_cw = Eigen::Matrix4f::Zero();
};

/// Of MLPnPsolver: one candidate, whose points are matched to the keypoints of the left camera.
class pose_solver {
public:
  pose_solver(ft::orbslam3::settings const& s, stand_in::frame const& f,
              std::vector<stand_in::map_point*> const& matches, std::uint64_t seed)
      : settings_(s), keypoints_(matches.size()) {
    auto const& keys = f.Nleft >= 0 ? f.mvKeys : f.mvKeysUn;
    auto const n = static_cast<int>(std::min(keys.size(), matches.size()));
    memory_ = ft::arena<ft::memory_space::host>([&](ft::carver& c) {
      carve(c, problem_, 1, n);
      carve(c, result_, 1, n);
      carve(c, work_, problem_, params_);
    });
    int count = 0;
    for (int i = 0; i < n; ++i) {
      auto* const p = matches[static_cast<std::size_t>(i)];
      if (p == nullptr || p->isBad()) { continue; }
      auto const& k = keys[static_cast<std::size_t>(i)];
      problem_.pixel[count] = {k.pt.x, k.pt.y};
      problem_.point[count] = ft::vec3_from_eigen(p->GetWorldPos());
      problem_.max_error2[count] = f.mvLevelSigma2[static_cast<std::size_t>(k.octave)] * 5.991f;
      problem_.keypoint[count++] = i;
    }
    *problem_.count = count;
    *problem_.seed = seed;
    ft::start_pnp(exec_, work_);
  }

  /// MLPnPsolver::iterate(5, ...). @return whether there is a pose
  bool iterate(pose_variables& to) {
    if (settings_.left.kind == ft::orbslam3::lens::pinhole) {
      go_on(ft::orbslam3::rig_of<ft::rectified_rig>(settings_));
    } else {
      go_on(ft::orbslam3::rig_of<ft::orbslam3::fisheye_rig>(settings_));
    }
    ft::pnp_result const& found = *result_.result;
    to.no_more = ft::no_more(found.status);
    to.count = found.inliers;
    to.inliers.assign(keypoints_, false);
    if (!ft::has_pose(found.status)) { return false; }
    for (int i = 0; i < *problem_.count; ++i) {
      if (result_.inlier[i] == 0) { continue; }
      to.inliers[static_cast<std::size_t>(problem_.keypoint[i])] = true;
    }
    to.T_cw = ft::to_isometry(found.T_cw).matrix();
    return true;
  }

private:
  template <typename Rig>
  void go_on(Rig const& rig) {
    auto const& camera = ft::detail::left_camera(rig);
    ft::pnp_rays(exec_, camera, problem_);
    ft::continue_pnp(exec_, camera, problem_, params_, result_, work_);
  }

  ft::host_exec exec_;
  ft::orbslam3::settings settings_;
  std::size_t keypoints_;
  ft::pnp_params params_;
  ft::pnp_problems_view problem_;
  ft::pnp_results_view result_;
  ft::pnp_workspace work_;
  ft::arena<ft::memory_space::host> memory_;
};

}  // namespace orbslam3_test
