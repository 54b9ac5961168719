// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry keeps of each camera from frame to frame, and the rules of its states.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/map/count_sightings.hpp"
#include "ft/kernels/map/insert_keyframe.hpp"
#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

/// Attempts to find a lost camera, one in each frame with enough stereo points, in turn: at the
/// predicted pose, at the last one and at the newest keyframe's, each with the first radius and
/// then with the later one. After the first frame of a map no motion is known; then the radii
/// change places. A prediction with an IMU is the only place, with both radii by turns.
inline constexpr int recovery_places = 3;
inline constexpr int recovery_attempts = 2 * recovery_places;

/// What a frame searches in the local map.
enum class search_plan : int {
  nothing,
  follow,   ///< from the pose of the search from the last frame
  rejoin,   ///< from the pose that matches anywhere in the image gave a camera that was not lost
  recover,  ///< from one of several poses
};

/// Inputs of a frame from the host, one camera.
struct odometry_input {
  std::int64_t time_ns;
  rigid<double> T_cw;  ///< expected pose, if `predicted`
  int predicted;       ///< 1 = T_cw replaces the motion model's prediction
  int stamp;           ///< of the frame; the next number belongs to it, too
  int reset;           ///< 1 = the camera begins anew
  int window;          ///< 1 = the adjustment in flight ends with this frame
  int looked_up;  ///< 1 = a lost camera is looked up after the frame, and not searched for in it
};

/// What is kept of one camera.
struct camera_track {
  constant_velocity velocity;
  rigid<double> predicted;   ///< T_cw of the current frame
  rigid<double> keyframe;    ///< T_cw of the newest keyframe when it was made
  std::int64_t time_ns;      ///< of the current frame
  std::int64_t interval_ns;  ///< from the last frame to it; 0 = it is the first
  tracking_state state;
  search_plan plan;
  std::int64_t keyframe_ns;  ///< of the newest keyframe
  std::int64_t seen_ns;      ///< of the last frame whose pose comes from the map, or that began one
  int begun;                 ///< 1 = a frame was seen
  int guided;                ///< 1 = `predicted` comes from an IMU
  int looked_up;             ///< of the current frame's odometry_input
  int frozen;                ///< 1 = images that have keypoints repeat since the IMU has moved
  int lost_frames;           ///< in a row
  int lost_with_features;    ///< of these, the last ones in a row with enough stereo points
  int held;                  ///< left keypoints that held a map point in the last tracked frame
  int reference_tracked;     ///< left keypoints with a map point, of the last keyframe
  int maps;                  ///< begun
  int begins;                ///< 1 = the current frame begins a map
  int agreed;                ///< keypoints of the current frame that agree with the pose tried last
  int map_keyframes;         ///< made in this map
  int keyframes;             ///< made in all maps
  frame_facts facts;         ///< of the current frame
  int apart;                 ///< 1 = two motions were found since the map began
  int apart_camera;          ///< whose matches said so
  std::uint64_t apart_blocks;  ///< parts of its image where the other motion had most matches
  std::int64_t apart_ns;       ///< of the last frame that had two, if `apart`
  int moved;                   ///< 1 = most inliers moved 2 pixels since the frame before
  int new_keyframe;            ///< 1 = since the last adjustment was begun
  int adjusting;               ///< 1 = an adjustment is in flight; 2 = one of a map that is gone
  int new_left_out;            ///< map points for which the keyframe of the current frame, or the
                               ///< adjustment that began with it, had no room
  int left_out;                ///< the same of the frame before

  FT_HOST_DEVICE static camera_track initial() {
    camera_track t{};
    t.velocity = constant_velocity::at_rest();
    t.predicted = rigid<double>::identity();
    t.keyframe = rigid<double>::identity();
    return t;
  }
  /// The map is given up.
  FT_HOST_DEVICE void leave_map() {
    if (adjusting != 0) { adjusting = 2; }
    new_keyframe = 0;
    map_keyframes = 0;
    apart = 0;
  }
  FT_HOST_DEVICE bool has_map() const { return state != tracking_state::initialising; }
};

/// The state of all cameras, and what stages decide for those that follow. Executor memory.
struct odometry_state_view {
  camera_track* tracks = nullptr;   ///< [batch]
  rigid<double>* T_cw = nullptr;    ///< [batch] of the last frame, then of the current one
  local_map_mode* mode = nullptr;   ///< [batch] of choose_local_map()
  float* radius_factor = nullptr;   ///< [batch] of the search in the local map
  sightings* counts = nullptr;      ///< [batch] what count_sightings() counts
  keyframe_order* order = nullptr;  ///< [batch] of insert_keyframe()
  std::int64_t* time_ns = nullptr;  ///< [batch] of the current frame
  int* gather = nullptr;            ///< [batch] 1 = an adjustment begins with this frame
  int* apply = nullptr;             ///< [batch] 1 = an adjustment ends with this frame
  int batch = 0;
};

inline void carve(carver& c, odometry_state_view& v, int batch) {
  v.batch = batch;
  c.place({batch}, v.tracks, v.T_cw, v.mode, v.radius_factor, v.counts, v.order, v.time_ns,
          v.gather, v.apply);
}

}  // namespace FT_ABI
}  // namespace ft
