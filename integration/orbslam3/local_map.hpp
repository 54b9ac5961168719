// SPDX-License-Identifier: Apache-2.0
/// @file The points of a frame as slots of the device and back: those that its keypoints hold, and
/// those of its local map, with the results of the frustum test.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <mutex>
#include <type_traits>
#include <utility>
#include <vector>

#include "integration/orbslam3/frame_exchange.hpp"
#include "integration/orbslam3/helper_threads.hpp"
#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft::orbslam3 {

/// Map points are scattered over the heap: reads of later ones are begun early.
/// @tparam Writes 1: the place will be written
template <int Writes = 0>
void prefetch(void const* at) {
#if defined(__GNUC__)
  __builtin_prefetch(at, Writes);
#else
  static_cast<void>(at);
#endif
}

/// The map points that a frame's keypoints hold, as slots of the device and back.
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

template <typename Types>
class local_map {
public:
  using frame_type = typename Types::frame;
  using map_point = typename Types::map_point;

  /// @param draws whether mmProjectPoints are filled
  local_map(device_tracker& device, map_mirror<map_point>& mirror, settings const& s, bool draws)
      : device_(&device), mirror_(&mirror), quirks_(s.reference_quirks), drawn_(draws ? 1 : 0) {}

  /// Fills the request of a search for `points`, and their slots on the device.
  /// @return number of points that are tested
  int gather(search_request& request, frame_type const& frame,
             std::vector<map_point*> const& points, bool far_points, float far_threshold) {
    int const n = static_cast<int>(points.size());
    gathering const all{frame, points, far_points, far_threshold};
    slots_ = device_->local_slots(n);
    likely_.resize(points.size(), -1);
    auto const count = static_cast<std::size_t>((n + at_a_time - 1) / at_a_time);
    if (parts_.size() < count) { parts_.resize(count); }
    device_->helpers().share(static_cast<int>(count), [&](int i) {
      gather_part(all, i * at_a_time, std::min((i + 1) * at_a_time, n), parts_[index(i)]);
    });
    recorded_.clear();
    bool changed = false;
    int tested = 0;
    for (std::size_t p = 0; p < count; ++p) {
      part& own = parts_[p];
      for (int const i : own.unknown) {
        likely_[index(i)] = mirror_->visit(points[index(i)], likely_[index(i)]);
        take(all, i, own);
      }
      changed = changed || own.changed;
      tested += own.tested;
      recorded_.insert(recorded_.end(), own.recorded.begin(), own.recorded.end());
    }
    request.slots_changed = changed;
    request.inputs.slots = n;
    request.recorded = static_cast<int>(recorded_.size());
    if (request.recorded > 0) {
      std::memcpy(device_->recorded_sights(request.recorded), recorded_.data(),
                  recorded_.size() * sizeof(recorded_sight));
    }
    return tested;
  }

  /// Writes the tracked values of the points in view, and their counters. @return their number
  int write_sights(frame_type& frame, std::vector<map_point*> const& points,
                   local_sights const& seen) {
    int const n = static_cast<int>(points.size());
    int const count = (n + at_a_time - 1) / at_a_time;
    device_->helpers().share(drawn_ + count, [&](int i) {
      if (i < drawn_) { return draw(frame, seen, n); }  // the longest part is started first
      int const first = (i - drawn_) * at_a_time;
      parts_[index(i - drawn_)].in_view =
          write_sights(points, seen, first, std::min(first + at_a_time, n));
    });
    int in_view = 0;
    for (int p = 0; p < count; ++p) { in_view += parts_[index(p)].in_view; }
    return in_view;
  }

private:
  static constexpr int at_a_time = 256;  ///< points

  struct gathering {
    frame_type const& frame;
    std::vector<map_point*> const& points;
    bool far_points;
    float far_threshold;
  };
  /// Result for a run of points.
  struct alignas(64) part {
    bool changed;
    int tested;
    int in_view;
    std::vector<int> unknown;  ///< points that the mirror has to look at
    std::vector<recorded_sight> recorded;
  };

  static std::size_t index(int i) { return static_cast<std::size_t>(i); }
  bool two_cameras() const { return device_->cameras() == 2; }

  void gather_part(gathering const& all, int first, int last, part& own) {
    own.changed = false;
    own.tested = 0;
    own.unknown.clear();
    own.recorded.clear();
    for (int i = first; i < last; ++i) {
      prefetch_soon(all.points, i);
      if (mirror_->keep(likely_[index(i)], all.points[index(i)])) {
        take(all, i, own);
      } else {
        own.unknown.push_back(i);
      }
    }
  }
  /// Takes point i, whose slot is known.
  void take(gathering const& all, int i, part& own) {
    map_point* const point = all.points[index(i)];
    int const slot = likely_[index(i)];
    bool const bad = mirror_->bad(slot);
    bool const tested = !bad && point->mnLastFrameSeen != all.frame.mnId;
    if (tested) {  // until the result of the device
      point->mbTrackInView = false;
      point->mbTrackInViewR = false;
    }
    replace(slots_[i], tested ? slot : -1, own.changed);
    own.tested += static_cast<int>(tested);
    bool const far = all.far_points && point->mTrackDepth > all.far_threshold;
    if (tested && far && two_cameras()) {
      own.recorded.push_back({i, recorded_sight::not_right_alone, slot, {}});
    }
    if (!tested && !bad && !far && quirks_) { record(*point, i, slot, own.recorded); }
  }

  int write_sights(std::vector<map_point*> const& points, local_sights const& seen, int first,
                   int last) const {
    bool const two = two_cameras();
    int in_view = 0;
    for (int k = first; k < last; ++k) {
      if (k + 8 < last && is_seen(seen, k + 8)) { prefetch_written(points[index(k + 8)]); }
      if (!is_seen(seen, k)) { continue; }
      ++in_view;
      map_point& p = *points[index(k)];
      visibility const& left = seen.by[0][k];
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
        visibility const& right = seen.by[1][k];
        p.mbTrackInViewR = true;
        p.mTrackProjXR = right.x;
        p.mTrackProjYR = right.y;
        p.mTrackDepthR = right.distance;
        p.mnTrackScaleLevelR = right.level;
        p.mTrackViewCosR = right.cosine;
      }
      p.IncreaseVisible(1);
    }
    return in_view;
  }
  bool is_seen(local_sights const& seen, int k) const {
    return seen.by[0][k].level >= 0 || (two_cameras() && seen.by[1][k].level >= 0);
  }
  /// Records a point that is not tested, but was seen by an earlier test and is searched there.
  void record(map_point const& p, int at, int slot, std::vector<recorded_sight>& to) const {
    if (p.mbTrackInView) {
      to.push_back({at,
                    0,
                    slot,
                    {p.mTrackProjX, p.mTrackProjY, p.mTrackProjXR, p.mTrackViewCos, p.mTrackDepth,
                     p.mnTrackScaleLevel}});
    }
    if (two_cameras() && p.mbTrackInViewR) {
      to.push_back({at,
                    1,
                    slot,
                    {p.mTrackProjXR, p.mTrackProjYR, 0.0f, p.mTrackViewCosR, p.mTrackDepthR,
                     p.mnTrackScaleLevelR}});
    }
  }
  /// Of equal numbers the last one counts, as in the original. In order, nodes are put at the end.
  void draw(frame_type& frame, local_sights const& seen, int points) {
    in_order_.clear();
    for (int k = 0; k < points; ++k) {
      if (seen.by[0][k].level >= 0) { in_order_.emplace_back(mirror_->id(likely_[index(k)]), k); }
    }
    std::sort(in_order_.begin(), in_order_.end());
    auto& drawn = frame.mmProjectPoints;
    using place = typename std::decay_t<decltype(drawn)>::mapped_type;
    for (auto const& [id, k] : in_order_) {
      visibility const& left = seen.by[0][k];
      drawn.insert_or_assign(drawn.end(), id, place(left.x, left.y));
    }
  }
  static void prefetch_soon(std::vector<map_point*> const& points, int i) {
    auto const soon = static_cast<std::size_t>(i) + 8;
    if (soon >= points.size()) { return; }
    prefetch(&points[soon]->mnId);
    prefetch(&points[soon]->mnLastFrameSeen);
  }
  /// Also the end of the object, where the original keeps its locks.
  static void prefetch_written(map_point* p) {
    prefetch<1>(&p->mTrackProjX);
    prefetch<1>(&p->mnTrackScaleLevel);
    prefetch<1>(reinterpret_cast<char const*>(p + 1) - 64);
  }

  device_tracker* device_;
  map_mirror<map_point>* mirror_;
  bool quirks_;
  int drawn_;  ///< parts of the work that fill mmProjectPoints: 1 or 0
  int* slots_ = nullptr;
  std::vector<int> likely_;  ///< slots of the last local map; most are at the same place again
  std::vector<recorded_sight> recorded_;
  std::vector<part> parts_;
  std::vector<std::pair<std::size_t, int>>
      in_order_;  ///< number of a point in view, its place in the local map
};

}  // namespace ft::orbslam3
