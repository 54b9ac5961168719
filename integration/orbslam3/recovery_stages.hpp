// SPDX-License-Identifier: Apache-2.0
/// @file Relocalisation's stages between ORB-SLAM3's members and the device's arrays.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_exchange.hpp"

namespace ft {
namespace orbslam3 {

/// What a stage of relocalisation returns instead of its answer if its input is refused.
inline constexpr int recovery_refused = -1;

/// Where the answer of a call of the pose solver goes: the arguments of MLPnPsolver::iterate().
struct pnp_answer {
  bool& no_more;
  std::vector<bool>& inliers;  ///< by keypoint
  int& count;                  ///< of inliers, 0 without a pose
  Eigen::Matrix4f& T_cw;       ///< without a pose it stays as it is
};

/// Whether a keyframe's points can be searched in a frame: both have an entry for the point of each
/// keypoint, the frame has descriptors, and there is room.
/// @param points entries of the keyframe
template <typename Frame, typename KeyFrame>
bool can_search_keyframe(frame_exchange<Frame> const& frames, Frame const& frame,
                         KeyFrame const& keyframe, std::size_t points) {
  auto const size = [&](auto const& of, int camera) {
    return static_cast<std::size_t>(frames.count(of, camera));
  };
  auto const has_room = [&](auto const& of) {
    return frames.keys(of, 0).size() == size(of, 0) && frames.fits(of);
  };
  std::size_t const left = size(frame, 0);
  std::size_t const all = left + size(frame, 1);
  auto const rows = static_cast<std::size_t>(frame.mDescriptors.rows);
  bool const described =
      rows == all ||
      (rows == left && static_cast<std::size_t>(frame.mDescriptorsRight.rows) == size(frame, 1));
  return has_room(frame) && has_room(keyframe) && described && frame.mvpMapPoints.size() == all &&
         points == size(keyframe, 0) + size(keyframe, 1) && frames.bounds_of(frame).have_area();
}

/// Takes the matched keypoints of the left camera to the device, without those whose points are
/// bad.
/// @param keys keypoints of the left camera at undistorted places
/// @param keypoint gets the keypoint of each correspondence
/// @return false for more keypoints than there is room for, or an octave that the frame has not
template <typename Frame, typename Keypoint, typename MapPoint>
bool put_correspondences(Frame const& frame, std::vector<Keypoint> const& keys,
                         std::vector<MapPoint*> const& matches, pnp_arrays& to,
                         std::vector<int>& keypoint) {
  std::size_t const n = std::min(keys.size(), matches.size());
  if (n > static_cast<std::size_t>(to.capacity)) { return false; }
  keypoint.clear();
  to.count = 0;
  for (std::size_t i = 0; i < n; ++i) {
    MapPoint* const p = matches[i];
    if (p == nullptr || p->isBad()) { continue; }
    auto const& k = keys[i];
    auto const octave = static_cast<std::size_t>(k.octave);
    if (octave >= frame.mvLevelSigma2.size()) { return false; }
    auto const at = to.count++;
    auto const position = p->GetWorldPos();
    to.pixel[2 * at] = k.pt.x;
    to.pixel[2 * at + 1] = k.pt.y;
    for (int d = 0; d < 3; ++d) { to.point[3 * at + d] = position(d); }
    to.max_error2[at] = frame.mvLevelSigma2[octave] * 5.991f;
    keypoint.push_back(static_cast<int>(i));
  }
  return true;
}

/// @param keypoint of each correspondence @param keypoints of the frame
inline void take_pnp(pnp_found const& found, std::vector<int> const& keypoint,
                     std::size_t keypoints, pnp_answer const& to) {
  to.no_more = found.no_more;
  to.count = found.any ? found.inliers : 0;
  to.inliers.assign(keypoints, false);
  if (!found.any) { return; }
  for (std::size_t i = 0; i < keypoint.size(); ++i) {
    if (found.inlier[i] != 0) { to.inliers[static_cast<std::size_t>(keypoint[i])] = true; }
  }
  to.T_cw.setIdentity();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { to.T_cw(r, c) = found.T_cw.R[3 * r + c]; }
    to.T_cw(r, 3) = found.T_cw.t[r];
  }
}

}  // namespace orbslam3
}  // namespace ft
