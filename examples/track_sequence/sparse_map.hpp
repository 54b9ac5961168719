// SPDX-License-Identifier: Apache-2.0
/// @file The host's map: points in slots, keyframes, and the observations between them.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "examples/track_sequence/local_adjustment.hpp"
#include "examples/track_sequence/odometry.hpp"

namespace app {

using orb_words = std::array<std::uint32_t, 8>;

struct map_point {
  std::array<float, 3> position{};  ///< world, metres
  std::array<float, 3> normal{};    ///< mean viewing direction, unit length
  float min_distance = 0, max_distance = 0;
  orb_words orb{};
  int visible = 1;  ///< number of frames that had it in view
  int found = 1;    ///< number of frames that matched it
  bool alive = false;
  int number = 0;                 ///< unique over all points, whatever their slots
  std::vector<int> keyframes;     ///< keyframes that see it, oldest first
  std::vector<orb_words> recent;  ///< descriptors in the last few of them
};

/// A map point at a keypoint: see sighting.
struct seen_point {
  int slot;
  int camera;
  double u, v;
  int octave;
  int number = 0;  ///< of the point, because its slot may be reused
};

struct keyframe {
  rigid_pose T_cw;
  std::vector<int> points;       ///< slots seen
  std::vector<seen_point> seen;  ///< kept while it takes part in adjustments
};

/// One keypoint of a new keyframe.
struct keyframe_feature {
  int slot;                      ///< map point it holds, -1 = none
  std::array<double, 3> camera;  ///< stereo point in the camera frame; z <= 0 = none
  int octave;
  orb_words orb;
};

/// Slots are reused after their point is deleted. When all are in use, the points of the oldest
/// keyframes are deleted.
class sparse_map {
public:
  /// @param scales of the pyramid's levels
  sparse_map(int slots, std::vector<float> scales);

  void clear();
  /// Adds a keyframe: matched features become observations, near unmatched ones become points.
  /// Updates the features' slots.
  /// @param near metres; with fewer than `at_least` near points the nearest are taken
  void insert(rigid_pose const& T_cw, std::vector<keyframe_feature>& features, double near,
              int at_least);
  /// Refines the newest keyframes and their points from the observations of both cameras.
  /// @param seen by the newest one
  void adjust(odometry_options const& rig, std::vector<seen_point> seen);
  /// Slots of the keyframes that share points with a frame, the best keyframes first.
  std::vector<int> local_points(std::vector<int> const& held, int most) const;
  /// Slots of the most recent keyframes.
  std::vector<int> recent_points(int most) const;
  void count_visible(int slot) { ++points_[static_cast<std::size_t>(slot)].visible; }
  void count_found(int slot) { ++points_[static_cast<std::size_t>(slot)].found; }
  /// Removes points that are in view but rarely found.
  void cull();

  bool alive(int slot) const { return slot >= 0 && points_[static_cast<std::size_t>(slot)].alive; }
  map_point const& point(int slot) const { return points_[static_cast<std::size_t>(slot)]; }
  /// Slots of points that are new or have changed since the last call.
  std::vector<int> take_changes();
  int keyframe_count() const { return static_cast<int>(keyframes_.size()); }
  rigid_pose const& last_keyframe_pose() const { return keyframes_.back().T_cw; }
  int point_count() const { return alive_; }
  int observations(int slot) const { return static_cast<int>(point(slot).keyframes.size()); }

private:
  int take_slot();
  void remove(int slot);
  void observe(int slot, int keyframe_id, keyframe_feature const& feature);
  void touch(int slot);
  std::vector<int> collect(std::vector<int> const& keyframe_ids, int most) const;

  std::vector<float> scales_;
  std::vector<map_point> points_;
  std::vector<int> free_;
  std::vector<keyframe> keyframes_;
  std::vector<int> changed_;
  std::vector<unsigned char> is_changed_;
  int points_made_ = 0;
  int oldest_ = 0;  ///< first keyframe whose points may still exist
  int alive_ = 0;
};

}  // namespace app
