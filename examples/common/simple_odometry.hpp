// SPDX-License-Identifier: Apache-2.0
/// @file A minimal stereo odometry with ft::frame_tracker. Points with stereo depth are searched in
/// every frame, and new ones are added when too few are found. It has no keyframe graph and no
/// bundle adjustment; see examples/track_sequence for those.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <vector>

#include "examples/common/run.hpp"
#include "examples/common/scene.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/frame_tracker.hpp"

namespace demo {

template <typename Exec>
class simple_odometry {
public:
  simple_odometry(Exec const& exec, scene const& scene)
      : exec_(exec), tracker_(exec, rig_of(scene), params_of(scene)) {}

  /// Tracks a frame and waits for its result. The world is the first frame's left camera.
  /// @return number of inliers; for the first frame, number of new points
  int track(image_pair const& images) {
    tracker_.set_image(0, 0, view(images.left));
    tracker_.set_image(0, 1, view(images.right));
    if (points_ == 0) {
      tracker_.extract(exec_);  // no points to search for yet
      exec_.wait();
      return add_points();
    }

    // The newest points, some of which may be in view.
    std::vector<int> local(
        static_cast<std::size_t>(std::min(points_, tracker_.params().local_points)));
    std::iota(local.begin(), local.end(), points_ - static_cast<int>(local.size()));

    // Features, stereo, both searches and pose optimisations: on a GPU one launch of a graph.
    tracker_.track(exec_, {velocity_ * T_cw_, local});
    exec_.wait();

    auto const frame = tracker_.frame();
    ft::pose const T_cw = frame.T_cw().orthonormalized();  // else rounding errors grow
    velocity_ = (T_cw * T_cw_.inverse()).orthonormalized();
    T_cw_ = T_cw;
    if (frame.inliers() < enough_inliers) { add_points(); }
    return frame.inliers();
  }

  ft::pose const& T_cw() const { return T_cw_; }
  int points() const { return points_; }

private:
  static constexpr int enough_inliers = 250;  ///< with fewer, points are added
  static constexpr float far = 6;             ///< metres: beyond, stereo depth is unreliable

  static ft::rectified_rig rig_of(scene const& scene) {
    auto const [fx, fy, cx, cy] = scene.intrinsics();
    return ft::rectified_rig::make({fx, fy, cx, cy}, scene.baseline());
  }
  static ft::tracker_params params_of(scene const& scene) {
    ft::tracker_params params;
    params.orb.width = scene.width();
    params.orb.height = scene.height();
    params.map_slots = 1 << 16;
    params.local_points = 4000;
    return params;
  }

  /// Creates a map point for every near keypoint that holds none.
  int add_points() {
    auto const keypoints = tracker_.frame().left();
    std::vector<ft::descriptor> descriptors(static_cast<std::size_t>(keypoints.size()));
    tracker_.download_descriptors(exec_, 0, descriptors.data(), keypoints.size());
    exec_.wait();

    auto const& geometry = tracker_.geometry();
    std::vector<int> held(static_cast<std::size_t>(tracker_.capacity()), -1);
    std::vector<ft::point_update> made;
    for (auto const& k : keypoints) {
      int& slot = held[static_cast<std::size_t>(k.number)];
      slot = k.slot;
      bool const room = points_ < tracker_.params().map_slots;
      if (slot >= 0 || !(k.depth > 0 && k.depth < far) || !room) { continue; }
      slot = points_++;
      ft::point_update u;
      u.slot = slot;
      u.observations = 1;
      u.position = T_cw_.inverse() * k.point;
      auto const ray = u.position - T_cw_.centre();
      float const distance = std::sqrt(ft::dot(ray, ray));
      u.normal = {ray.x / distance, ray.y / distance, ray.z / distance};
      // The distances at which some level of the pyramid shows the point as it looks here.
      u.max_distance = distance * geometry.scale[k.octave];
      u.min_distance = u.max_distance / geometry.scale[geometry.levels - 1];
      u.orb = descriptors[static_cast<std::size_t>(k.number)];
      made.push_back(u);
    }
    tracker_.update_map(exec_, 0, made.data(), static_cast<int>(made.size()));
    tracker_.set_last(exec_, 0, T_cw_, held);  // the next frame searches for the new points, too
    exec_.wait();
    return static_cast<int>(made.size());
  }

  Exec exec_;
  ft::frame_tracker<Exec> tracker_;
  ft::pose T_cw_ = ft::pose::identity();
  ft::pose velocity_ = ft::pose::identity();  ///< T_cw of a frame times the inverse of the last one
  int points_ = 0;
};

}  // namespace demo
