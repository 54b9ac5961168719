// SPDX-License-Identifier: Apache-2.0
/// @file The local map of a frame: its points as slots of the mirror, and what the frustum test
/// leaves in them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/device_tracker.hpp"
#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/map_mirror.hpp"

namespace ft {
namespace orbslam3 {

template <typename Types>
class local_map {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  /// @param draws whether Frame::mmProjectPoints is filled
  local_map(device_tracker& device, map_mirror<map_point>& mirror, settings const& s, bool draws)
      : device_(&device), mirror_(&mirror), quirks_(s.reference_quirks), draws_(draws) {}

  /// The request of a search in `points`; their slots are with the device.
  /// @return points that are tested
  int gather(local_map_request& request, frame_type const& frame,
             std::vector<map_point*> const& points, bool far_points, float far_threshold) {
    int const n = static_cast<int>(points.size());
    slots_ = device_->local_slots(n);
    likely_.resize(points.size(), -1);
    recorded_.clear();
    bool changed = false;
    int tested_points = 0;
    for (int i = 0; i < n; ++i) {
      prefetch(points, i);
      map_point* const point = points[static_cast<std::size_t>(i)];
      int& slot = likely_[static_cast<std::size_t>(i)];
      slot = mirror_->visit(point, slot);
      bool const bad = mirror_->bad(slot);
      bool const tested = !bad && point->mnLastFrameSeen != frame.mnId;
      replace(slots_[i], tested ? slot : -1, changed);
      tested_points += static_cast<int>(tested);
      bool const far = far_points && point->mTrackDepth > far_threshold;
      if (tested && far && two_cameras()) {
        recorded_.push_back({i, recorded_sight::not_right_alone, slot, {}});
      }
      if (!tested && !bad && !far && quirks_) { record(*point, i, slot); }
    }
    request.slots_changed = changed;
    request.points = n;
    request.recorded = static_cast<int>(recorded_.size());
    if (request.recorded > 0) {
      std::memcpy(device_->recorded_sights(request.recorded), recorded_.data(),
                  recorded_.size() * sizeof(recorded_sight));
    }
    return tested_points;
  }

  /// The tracked values of all points that were tested. @return points in view
  int write_sights(frame_type& frame, std::vector<map_point*> const& points) {
    drawn_.clear();
    sight const* const left = device_->sights();
    sight const* const right = left + points.size();
    bool const two = two_cameras();
    int in_view = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      prefetch(points, static_cast<int>(i));
      if (slots_[i] < 0) { continue; }
      map_point& p = *points[i];
      p.mbTrackInView = left[i].level >= 0;
      p.mbTrackInViewR = two && right[i].level >= 0;
      if (p.mbTrackInView) {
        p.mTrackProjX = left[i].x;
        p.mTrackProjY = left[i].y;
        p.mTrackDepth = left[i].distance;
        p.mnTrackScaleLevel = left[i].level;
        p.mTrackViewCos = left[i].cosine;
        if (!two) { p.mTrackProjXR = left[i].right_x; }
        if (draws_) { drawn_.push_back({p.mnId, i}); }
      }
      if (p.mbTrackInViewR) {
        p.mTrackProjXR = right[i].x;
        p.mTrackProjYR = right[i].y;
        p.mTrackDepthR = right[i].distance;
        p.mnTrackScaleLevelR = right[i].level;
        p.mTrackViewCosR = right[i].cosine;
      }
      if (!p.mbTrackInView && !p.mbTrackInViewR) { continue; }
      p.IncreaseVisible(1);
      ++in_view;
    }
    draw(frame);
    return in_view;
  }

private:
  bool two_cameras() const { return device_->cameras() == 2; }

  /// A point that is not tested, but was seen by an earlier test and is searched there.
  void record(map_point const& p, int index, int slot) {
    if (p.mbTrackInView) {
      recorded_.push_back({index,
                           0,
                           slot,
                           {p.mTrackProjX, p.mTrackProjY, p.mTrackProjXR, p.mTrackViewCos,
                            p.mTrackDepth, p.mnTrackScaleLevel}});
    }
    if (two_cameras() && p.mbTrackInViewR) {
      recorded_.push_back({index,
                           1,
                           slot,
                           {p.mTrackProjXR, p.mTrackProjYR, 0.0f, p.mTrackViewCosR, p.mTrackDepthR,
                            p.mnTrackScaleLevelR}});
    }
  }
  /// In the order of the map, where a node goes in next to the one before.
  void draw(frame_type& frame) {
    using place = typename std::decay_t<decltype(frame.mmProjectPoints)>::mapped_type;
    sight const* const left = device_->sights();
    std::sort(drawn_.begin(), drawn_.end());
    for (auto const& [id, i] : drawn_) {
      frame.mmProjectPoints.insert_or_assign(frame.mmProjectPoints.end(), id,
                                             place(left[i].x, left[i].y));
    }
  }
  /// Map points lie all over the heap: the one that comes soon is fetched while this one is read.
  static void prefetch(std::vector<map_point*> const& points, int i) {
#if defined(__GNUC__)
    auto const soon = static_cast<std::size_t>(i) + 8;
    if (soon < points.size()) {
      __builtin_prefetch(&points[soon]->mnId);
      __builtin_prefetch(&points[soon]->mnLastFrameSeen);
    }
#else
    static_cast<void>(points);
    static_cast<void>(i);
#endif
  }

  device_tracker* device_;
  map_mirror<map_point>* mirror_;
  bool quirks_;
  bool draws_;
  int* slots_ = nullptr;
  std::vector<int> likely_;  ///< slots of the last local map: most are in the same place again
  std::vector<recorded_sight> recorded_;
  std::vector<std::pair<unsigned long, std::size_t>> drawn_;  ///< map point, place in the local map
};

}  // namespace orbslam3
}  // namespace ft
