// SPDX-License-Identifier: Apache-2.0
/// @file The map points that a frame's keypoints hold, as slots of the device and back.
#pragma once

#include <algorithm>
#include <cstddef>
#include <mutex>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/local_map.hpp"
#include "integration/orbslam3/map_mirror.hpp"

namespace ft::orbslam3 {

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
  static constexpr int at_a_time = 256;  ///< keypoints

  /// Result for a run of keypoints.
  struct alignas(64) part {
    bool changed;
    std::vector<int> unknown;  ///< numbers of keypoints whose points the mirror has to look at
  };

  /// Collects the slots of the points that a frame's keypoints hold. Most points are in the slots
  /// that they were in: this is checked on several threads.
  /// @return whether they have changed
  bool gather(int b, frame_type const& frame, bool inliers_only) {
    int const left = frames_->count(frame, 0);
    int const all = left + frames_->count(frame, 1);
    auto const count = static_cast<std::size_t>((all + at_a_time - 1) / at_a_time);
    if (parts_.size() < count) { parts_.resize(count); }
    frame_arrays const& a = device_->frame(b);
    auto const number_of = [&](int i) { return i < left ? i : a.capacity + i - left; };
    device_->helpers().share(static_cast<int>(count), [&](int p) {
      part& own = parts_[static_cast<std::size_t>(p)];
      own.changed = false;
      own.unknown.clear();
      for (int i = p * at_a_time; i < std::min((p + 1) * at_a_time, all); ++i) {
        auto const at = static_cast<std::size_t>(i);
        if (holds(frame, at + 16)) { prefetch(&frame.mvpMapPoints[at + 16]->mnId); }
        int& slot = a.holder[number_of(i)];
        bool const held = holds(frame, at) && !(inliers_only && frame.mvbOutlier[at]);
        if (!held) {
          replace(slot, -1, own.changed);
        } else if (!mirror_->keep(slot, frame.mvpMapPoints[at])) {
          own.unknown.push_back(i);
        }
      }
    });
    bool changed = false;
    for (std::size_t p = 0; p < count; ++p) {
      changed = changed || parts_[p].changed;
      for (int const i : parts_[p].unknown) {
        int& slot = a.holder[number_of(i)];
        replace(slot, mirror_->visit(frame.mvpMapPoints[static_cast<std::size_t>(i)], slot),
                changed);
      }
    }
    return changed;
  }

  device_tracker* device_;
  map_mirror<map_point>* mirror_;
  frame_exchange<frame_type>* frames_;
  std::vector<part> parts_;
};

}  // namespace ft::orbslam3
