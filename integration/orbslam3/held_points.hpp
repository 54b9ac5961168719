// SPDX-License-Identifier: Apache-2.0
/// @file The map points that a frame's keypoints hold, as slots of the device and back.
#pragma once

#include <cstddef>
#include <mutex>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_changes.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/local_map.hpp"
#include "integration/orbslam3/map_mirror.hpp"

namespace ft {
namespace orbslam3 {

/// @tparam Types with frame and map_point
template <typename Types>
class held_points {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  held_points(device_tracker& device, map_mirror<map_point>& mirror,
              frame_exchange<frame_type>& frames)
      : device_(&device), mirror_(&mirror), frames_(&frames) {}

  static bool holds(frame_type const& frame, std::size_t i) {
    return i < frame.mvpMapPoints.size() && frame.mvpMapPoints[i] != nullptr;
  }
  /// Sends the points that a frame's keypoints hold.
  void send(int b, frame_type const& frame, bool inliers_only) {
    if (gather(b, frame, inliers_only)) { device_->send(b, frame_part::holder); }
  }
  /// Likewise of a keyframe, those that are not bad and not in `found`.
  template <typename KeyFrame, typename Found>
  void send_searched(int b, KeyFrame const& keyframe, std::vector<map_point*> const& points,
                     Found const& found) {
    frame_arrays const& a = device_->frame(b);
    frames_->for_each_number(keyframe, [&](std::size_t i, int number) {
      map_point* const p = points[i];
      bool const wanted = p != nullptr && found.count(p) == 0;
      int const slot = wanted ? mirror_->visit(p, a.holder[number]) : -1;
      a.holder[number] = wanted && !mirror_->bad(slot) ? slot : -1;
    });
    device_->send(b, frame_part::holder);
  }
  /// The buffer of a frame and of the points that it holds, for a pose. As in the original, map
  /// points are locked while they are read. The lock is not held while waiting for the device.
  int bind(frame_type const& frame) {
    int const b = frames_->bind(frame, -1);
    bool changed = false;
    {
      std::unique_lock<std::mutex> const lock(map_point::mGlobalMutex);
      mirror_->begin_call();
      changed = gather(b, frame, false);
    }
    if (changed) { device_->send(b, frame_part::holder); }
    mirror_->flush();
    return b;
  }
  /// Flags the keypoints whose points a pose has released, and no other that holds a point.
  void write_outliers(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    frames_->for_each_number(frame, [&](std::size_t i, int number) {
      if (holds(frame, i)) { frame.mvbOutlier[i] = a.holder[number] < 0; }
    });
  }
  /// Copies the device's matches to the frame's keypoints.
  void write_matches(int b, frame_type& frame) const {
    frame_arrays const& a = device_->frame(b);
    frames_->for_each_number(frame, [&](std::size_t i, int number) {
      if (a.holder[number] >= 0) { frame.mvpMapPoints[i] = mirror_->owner(a.holder[number]); }
    });
  }

private:
  /// Collects the slots of the points that a frame's keypoints hold.
  /// @return whether they have changed
  bool gather(int b, frame_type const& frame, bool inliers_only) {
    frame_arrays const& a = device_->frame(b);
    bool changed = false;
    frames_->for_each_number(frame, [&](std::size_t i, int number) {
      prefetch_number(frame.mvpMapPoints, i + 16);
      bool const held = holds(frame, i) && !(inliers_only && frame.mvbOutlier[i]);
      int const slot = held ? mirror_->visit(frame.mvpMapPoints[i], a.holder[number]) : -1;
      replace(a.holder[number], slot, changed);
    });
    return changed;
  }

  device_tracker* device_;
  map_mirror<map_point>* mirror_;
  frame_exchange<frame_type>* frames_;
};

}  // namespace orbslam3
}  // namespace ft
