// SPDX-License-Identifier: Apache-2.0
/// @file The values that the frustum test writes into map points, and their comparison.
#pragma once

#include <unordered_map>

#include "integration/orbslam3/map_mirror.hpp"
#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

/// The values that the frustum test writes into a map point.
template <typename MapPoint>
struct tracked_values {
  bool in_view, in_view_right;
  int level, level_right;
  float x, y, depth, cosine, right_x, right_y, depth_right, cosine_right;

  explicit tracked_values(MapPoint const& p)
      : in_view(p.mbTrackInView),
        in_view_right(p.mbTrackInViewR),
        level(p.mnTrackScaleLevel),
        level_right(p.mnTrackScaleLevelR),
        x(p.mTrackProjX),
        y(p.mTrackProjY),
        depth(p.mTrackDepth),
        cosine(p.mTrackViewCos),
        right_x(p.mTrackProjXR),
        right_y(p.mTrackProjYR),
        depth_right(p.mTrackDepthR),
        cosine_right(p.mTrackViewCosR) {}
  void restore(MapPoint& p) const {
    p.mbTrackInView = in_view;
    p.mbTrackInViewR = in_view_right;
    p.mnTrackScaleLevel = level;
    p.mnTrackScaleLevelR = level_right;
    p.mTrackProjX = x;
    p.mTrackProjY = y;
    p.mTrackDepth = depth;
    p.mTrackViewCos = cosine;
    p.mTrackProjXR = right_x;
    p.mTrackProjYR = right_y;
    p.mTrackDepthR = depth_right;
    p.mTrackViewCosR = cosine_right;
  }
};

/// Finds map points that changed without being pushed: a change hook that was forgotten, also where
/// the old value gives the same answers.
template <typename MapPoint>
class hook_watch {
public:
  /// Adds what the device has of a point and the point has no longer. What changes just now is
  /// pushed soon: only what is found in two frames counts, and once for each point.
  void add(difference_log& log, map_mirror<MapPoint>& mirror, MapPoint& p, unsigned long frame) {
    point_fields sent{};
    bool bad = false;
    if (!mirror.copy(&p, sent, bad)) { return; }
    point_fields now = sent;
    bool const is_bad = read_fields(p, now);
    char const* what = nullptr;
    if (bad != is_bad) { what = "bad flag"; }
    if (sent.observed != now.observed) { what = "observations"; }
    if (differ(sent.descriptor, now.descriptor)) { what = "descriptor"; }
    if (differ(sent.normal, now.normal)) { what = "normal"; }
    if (differ(sent.limits, now.limits)) { what = "limits of distance"; }
    if (differ(sent.position, now.position)) { what = "position"; }
    if (what == nullptr) {
      stale_.erase(p.mnId);
      return;
    }
    auto const [known, is_new] = stale_.try_emplace(p.mnId, found{frame, false});
    if (is_new || known->second.told || known->second.frame == frame) { return; }
    known->second.told = true;
    log.add_stale(what, static_cast<long>(p.mnId));
  }

private:
  struct found {
    unsigned long frame;
    bool told;
  };
  std::unordered_map<unsigned long, found> stale_;  ///< by MapPoint::mnId
};

/// Adds what differs between two answers of the CPU and one of the accelerator.
/// @param at index of the point in the local map
template <typename MapPoint>
void compare_tracked(difference_log& log, tolerances const& allowed, long at, bool two_cameras,
                     tracked_values<MapPoint> const (&of)[3]) {
  auto const& [a, b, g] = of;
  double const pixels = allowed.pixels;
  log.compare("point in view", at, a.in_view, b.in_view, g.in_view);
  log.compare("point in right view", at, a.in_view_right, b.in_view_right, g.in_view_right);
  if (a.in_view && g.in_view) {
    log.compare("octave of point", at, a.level, b.level, g.level);
    log.compare("x of point", at, a.x, b.x, g.x, pixels);
    log.compare("y of point", at, a.y, b.y, g.y, pixels);
    log.compare("distance of point", at, a.depth, b.depth, g.depth, allowed.depth);
    log.compare("cosine of point", at, a.cosine, b.cosine, g.cosine, allowed.cosine);
    if (!two_cameras) {
      log.compare("right column of point", at, a.right_x, b.right_x, g.right_x, pixels);
    }
  }
  if (a.in_view_right && g.in_view_right) {
    log.compare("right octave of point", at, a.level_right, b.level_right, g.level_right);
    log.compare("right x of point", at, a.right_x, b.right_x, g.right_x, pixels);
    log.compare("right y of point", at, a.right_y, b.right_y, g.right_y, pixels);
    log.compare("right distance of point", at, a.depth_right, b.depth_right, g.depth_right,
                allowed.depth);
    log.compare("right cosine of point", at, a.cosine_right, b.cosine_right, g.cosine_right,
                allowed.cosine);
  }
}

}  // namespace orbslam3
}  // namespace ft
