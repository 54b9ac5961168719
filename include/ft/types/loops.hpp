// SPDX-License-Identifier: Apache-2.0
/// @file Settings of loop closing, and what it tells.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace v0 {

/// How an odometry recognises places that it has seen before, and corrects its path there.
struct loop_params {
  bool present = false;
  /// Keyframes that are kept at a time. Before there are more, every second one of the older three
  /// quarters leaves, those first that see a place again: the limit thins the path out, it does not
  /// end it.
  int keyframes = 1000;
  /// Keypoints with a depth that are kept of a keyframe, of all cameras together, at most, spread
  /// evenly.
  int points = 400;
  int recent = 30;  ///< the newest keyframes, which the odometry's own map connects with a frame
  /// Neighbourhoods that are verified for a keyframe, each of three keyframes. With one no place
  /// is compared with another, but by a map that is not joined yet.
  int groups = 2;
  /// Of the keypoints of a keyframe, those whose descriptors are compared with all keyframes'.
  int votes = 128;
  int min_votes = 12;      ///< that find an alike point in a keyframe which is to be verified
  int min_inliers = 40;    ///< matches that agree with the pose of a loop
  float min_share = 0.5f;  ///< and their share of the matches
  /// A loop must not correct more than this share of the path since its keyframe and the rig's
  /// baseline, and
  float max_drift = 0.05f;
  float max_turn = 0.1f;  ///< must not turn it by more than this, rad, and 0.01 rad for each metre
                          ///< of the path. So places that look alike are told apart.
  /// With one camera whose scale drifts: nor change the natural logarithm of its scale by more than
  /// this. What it changes that by is added to max_drift.
  float max_scale_drift = 0.5f;
};

/// Plugged into an odometry whose odometry_params::loops are present: places that were seen before
/// are recognised, and the path is corrected.
///
/// Keyframes are kept with some of their keypoints. The newest one is compared with all that are
/// kept and are not among the newest, one search after the other: by descriptors, then by a pose
/// that most matches agree with. In the same map only points are matched that are where the
/// odometry may have drifted to since, which tells the parts of a facade that repeats apart; where
/// two alike ones are, neither is matched. One camera alone, whose unit drifts, does without. A
/// loop is closed where two neighbouring keyframes say the same of that pose, what it corrects is
/// no more than the odometry may have drifted since, it is less uncertain than that, both views are
/// alike (0.4 rad apart, as seen from what they see), and no other place of those that were
/// verified, that more than half as many matches agree with, contradicts it. A map that a lost
/// camera begins is joined with an older one where two of its keyframes say the same; that of a
/// camera that is not found in a loaded map where two of its first frames do. Before, each frame of
/// such a camera is looked up itself. Then the poses of all keyframes are optimised, with an IMU
/// that knew gravity before the first loop in heading and position alone. One camera alone has a
/// unit of length that drifts: its poses are optimised with a scale each, which the depths that
/// both keyframes know of their common points tell. With an IMU its keyframes are kept from when
/// that has told the scale. That runs beside tracking, on a thread, and on a GPU on a stream of its
/// own. A search takes a number of frames that depends on the number of keyframes alone, one where
/// a camera is looked for that was not found in a loaded map. What it found enters after as many
/// more as the counts of keyframes and loops say that the optimisation takes, which goes on in
/// slices where it has not ended: each of them changes tracking::T_world_odom. A frame that comes
/// sooner waits. The odometry itself is not changed: see tracking::T_odom_camera and T_world_odom.
/// An exception of a search, such as bad_alloc, is thrown by the next track(), of which nothing has
/// changed then.
///
/// With tracking_rules::localize_only nothing of that: a camera that is not found in a loaded map
/// is looked up among its keyframes in the same frame, which waits for it, and tracked in the map
/// around its place, if that is as evident as for any lost camera.
///
/// A keyframe costs its frame a launch and a wait, of one camera two launches.
///
/// The constructor throws bad_argument for parameters out of range, more than one rig, and without
/// odometry_params::loops.
struct loops {};

/// A keyframe that loops have corrected, or a frame that was looked for in a loaded map.
struct placed_keyframe {
  std::int64_t time_ns;
  int map;  ///< number of the map that it is in; of maps that loops have joined, of the first one
  rigid<double> T_odom_camera;   ///< as it was tracked
  rigid<double> T_world_camera;  ///< as it is known now
  double scale;  ///< of the odometry's unit there in the world's, as tracking::odom_scale; else 1
  bool loaded = false;  ///< it came with a loaded map; it is in front of those of this run
};

/// A loop that was closed: an edge between two of placed_keyframes(). When keyframes leave at their
/// limit, the loops of one become those of the keyframe that stands for it.
struct closed_loop {
  int from;  ///< index of the keyframe that was recognised
  int to;    ///< index of the later one, which recognised it
  std::int64_t from_time_ns;
  std::int64_t to_time_ns;
  rigid<double> T_from_to;  ///< as it was measured: points of `to`'s camera to that of `from`
  double scale;  ///< of `to`'s unit in `from`'s, in which T_from_to.t is; else 1, and metres
  int inliers;   ///< matches that agree with it
};

}  // namespace v0
}  // namespace ft
