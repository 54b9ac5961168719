// SPDX-License-Identifier: Apache-2.0
/// @file The local map of a frame: the slots of its points, and the results of the frustum test.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <numeric>
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

  /// @param draws whether to fill Frame::mmProjectPoints
  local_map(device_tracker& device, map_mirror<map_point>& mirror, settings const& s, bool draws)
      : device_(&device), mirror_(&mirror), quirks_(s.reference_quirks), draws_(draws) {}

  /// Fills the request of a search for `points`, and their slots on the device.
  /// @return number of points that are tested
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
      if (tested) {  // until the result of the device
        point->mbTrackInView = false;
        point->mbTrackInViewR = false;
      }
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

  /// Writes the tracked values of the points in view, and their counters.
  void write_sights(frame_type& frame, std::vector<map_point*> const& points,
                    points_in_view const& seen) {
    constexpr int at_a_time = 256;
    int const drawn = draws_ ? 1 : 0;  // the longest part is started first
    int const parts = (seen.count + at_a_time - 1) / at_a_time;
    device_->helpers().share(drawn + parts, [&](int part) {
      if (part < drawn) {
        draw(frame, points, seen);
      } else {
        int const first = (part - drawn) * at_a_time;
        write_sights(points, seen, first, std::min(first + at_a_time, seen.count));
      }
    });
  }

private:
  bool two_cameras() const { return device_->cameras() == 2; }

  void write_sights(std::vector<map_point*> const& points, points_in_view const& seen, int first,
                    int last) const {
    bool const two = two_cameras();
    for (int k = first; k < last; ++k) {
      prefetch_seen(points, seen, k);
      map_point& p = *points[static_cast<std::size_t>(seen.index[k])];
      sight const& left = seen.by[0][k];
      if (left.level >= 0) {
        p.mbTrackInView = true;
        p.mTrackProjX = left.x;
        p.mTrackProjY = left.y;
        p.mTrackDepth = left.distance;
        p.mnTrackScaleLevel = left.level;
        p.mTrackViewCos = left.cosine;
        if (!two) { p.mTrackProjXR = left.right_x; }
      }
      if (two && seen.by[1][k].level >= 0) {
        sight const& right = seen.by[1][k];
        p.mbTrackInViewR = true;
        p.mTrackProjXR = right.x;
        p.mTrackProjYR = right.y;
        p.mTrackDepthR = right.distance;
        p.mnTrackScaleLevelR = right.level;
        p.mTrackViewCosR = right.cosine;
      }
      p.IncreaseVisible(1);
    }
  }
  /// Records a point that is not tested, but was seen by an earlier test and is searched there.
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
  /// Inserts in the order of the map, so that each node is inserted next to the preceding one.
  void draw(frame_type& frame, std::vector<map_point*> const& points, points_in_view const& seen) {
    using place = typename std::decay_t<decltype(frame.mmProjectPoints)>::mapped_type;
    drawn_.clear();
    for (int k = 0; k < seen.count; ++k) {
      if (seen.by[0][k].level < 0) { continue; }
      drawn_.push_back({points[static_cast<std::size_t>(seen.index[k])]->mnId, k});
    }
    sort_by_id();
    auto& map = frame.mmProjectPoints;
    for (auto const& [id, k] : drawn_) {
      map.insert_or_assign(map.end(), id, place(seen.by[0][k].x, seen.by[0][k].y));
    }
  }
  /// Radix sort by 11 bits, lowest first: a few passes over data that fit into a cache.
  void sort_by_id() {
    unsigned long highest = 0;
    for (auto const& d : drawn_) { highest = std::max(highest, d.first); }
    constexpr unsigned bits = 11;
    other_.resize(drawn_.size());
    for (unsigned shift = 0; shift < 64 && (highest >> shift) != 0; shift += bits) {
      auto const digit = [shift](unsigned long id) { return (id >> shift) & ((1u << bits) - 1); };
      std::array<std::uint32_t, (1u << bits) + 1> start{};
      for (auto const& d : drawn_) { ++start[digit(d.first) + 1]; }
      std::partial_sum(start.begin(), start.end(), start.begin());
      for (auto const& d : drawn_) { other_[start[digit(d.first)]++] = d; }
      std::swap(drawn_, other_);
    }
  }
  /// Map points are scattered over the heap: prefetches a later one while this one is read.
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
  /// Likewise for points in view: also prefetches the end of the object, where the original keeps
  /// its locks.
  static void prefetch_seen(std::vector<map_point*> const& points, points_in_view const& seen,
                            int k) {
#if defined(__GNUC__)
    if (k + 8 < seen.count) {
      map_point* const p = points[static_cast<std::size_t>(seen.index[k + 8])];
      __builtin_prefetch(&p->mTrackProjX, 1);
      __builtin_prefetch(&p->mnTrackScaleLevel, 1);
      __builtin_prefetch(reinterpret_cast<char const*>(p + 1) - 64, 1);
    }
#else
    static_cast<void>(points);
    static_cast<void>(seen);
    static_cast<void>(k);
#endif
  }

  device_tracker* device_;
  map_mirror<map_point>* mirror_;
  bool quirks_;
  bool draws_;
  int* slots_ = nullptr;
  std::vector<int> likely_;  ///< slots of the last local map; most are at the same place again
  std::vector<recorded_sight> recorded_;
  /// Map point, place among those in view.
  std::vector<std::pair<unsigned long, int>> drawn_;
  std::vector<std::pair<unsigned long, int>> other_;
};

}  // namespace orbslam3
}  // namespace ft
