// SPDX-License-Identifier: Apache-2.0
/// @file Inputs and outputs of an odometry.
#pragma once

#include <cstdint>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/map/choose_local_map.hpp"
#include "ft/kernels/map/gather_window.hpp"
#include "ft/kernels/odometry/state.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/pipelines/imu_params.hpp"
#include "ft/pipelines/monocular_start.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/relocalization_types.hpp"
#include "ft/pipelines/rig_images.hpp"

namespace ft {
inline namespace FT_ABI {

struct odometry_params {
  orb_params orb;
  tracking_rules rules;
  int map_slots = 1 << 14;         ///< map points at a time, per camera pair
  int keyframes = 128;             ///< at a time; the oldest one leaves
  int local_points = 1 << 13;      ///< points of the local map, at most
  local_map_params local_map;      ///< how these are chosen
  float window_radius = 7;         ///< half side of a search from the last frame, pixels
  int enough_matches = 20;         ///< with fewer, that search is repeated with twice the radius
  window_selection window{10, 5};  ///< keyframes of an adjustment: moving ones, fixed ones
  int window_points = 1 << 12;     ///< points of an adjustment, at most
  window_params adjustment;        ///< how they are adjusted
  int adjustment_delay = 3;        ///< frames after which the result of an adjustment enters
  monocular_start_params start;    ///< of a monocular_rig
  imu_params imu;                  ///< present or not
  bool use_graphs = true;          ///< replay recorded graphs; false: enqueue each launch
  bool measure_stages = false;     ///< record stage_times()
  /// Frames whose images odometry::prefetch() may take ahead of their tracking, up to 64. Each
  /// takes the memory of its images and keypoints, and on the host a thread. 0 for a monocular_rig
  int prefetch = 0;
  stereo_overlap overlap[2] = {{0, 1e9f}, {0, 1e9f}};  ///< as in tracker_params
};

/// How lost cameras are found by the words of a vocabulary.
struct place_recovery {
  int levels_up = 4;                     ///< see transform_params
  int candidates = 16;                   ///< keyframes that are tried: those that are most alike
  std::uint64_t seed = 0;                ///< of the samples of poses, with the time of the frame
  relocalization_params relocalization;  ///< `frustum` is that of the odometry
};

/// Where a rig's keypoints get their depths from.
enum class depth_origin : int {
  stereo,       ///< a pair
  depth_image,  ///< an rgbd_rig
  some_pairs,   ///< a multi_rig, whose cameras need not all be pairs
  motion,       ///< a monocular_rig
};

/// A depth of more than so many baselines is distant: its disparity is a small part of a pixel.
constexpr float distant_baselines = 1000;

/// How light an image is, by 1024 pixels that are spread over it.
struct image_light {
  int image = -1;        ///< which one of the rig: 0 = left; -1 = none was looked at
  double mean = 0;       ///< grey value, 0 to 255
  double deviation = 0;  ///< standard deviation of grey values
};

/// What is to be told of a frame, whether it is tracked or not.
enum class tracking_warning : int {
  new_map,              ///< a later map begins, at a guessed place
  doubtful_pose,        ///< few keypoints agree with the pose: it may be another one
  two_motions,          ///< things move, or are fixed to a camera, in a large part of the images
  images_repeat,        ///< images are those of the frame before while the camera moves
  stereo_inconsistent,  ///< depths do not agree with the map, or hardly any keypoint has one
  depth_scale,          ///< most depths are beyond distant_baselines
  dark,                 ///< an image is nearly black
  bright,               ///< an image is nearly white
  low_texture,          ///< an image has hardly any contrast
  blurred,              ///< too few corners in images that have contrast
  imu,                  ///< see imu_warnings()
};
constexpr int tracking_warnings = 11;  ///< kinds

/// A set of them.
struct warning_set {
  unsigned bits = 0;
  bool has(tracking_warning w) const { return (bits >> static_cast<int>(w) & 1u) != 0; }
  void add(tracking_warning w) { bits |= 1u << static_cast<int>(w); }
  bool empty() const { return bits == 0; }
};

/// What warnings are decided by, of one frame.
struct tracking_evidence {
  frame_facts facts;              ///< of matches and pose
  int images = 0;                 ///< of the rig
  int same = 0;                   ///< of these, those with the pixels of the frame before
  int textured = 0;               ///< parts of the images with contrast
  int moved = 0;                  ///< of these, those with another content than before
  double stereo_share = 0;        ///< of keypoints with a depth
  double usual_stereo_share = 0;  ///< the same in the frames before; 0 = not known yet
};

/// What is known about a camera after a frame. See explain() in pipelines/explain.hpp.
struct tracking {
  /// Left camera, or a multi_rig's body, to world, metres. The world is the left camera, or the
  /// body, of the first frame with a map. For a frame that was not tracked: where it is thought to
  /// be.
  rigid<double> T_world_camera = rigid<double>::identity();
  tracking_state state = tracking_state::initialising;
  /// Lengths are metres. False of a monocular_rig, whose unit it says, until its IMU tells the
  /// scale of the map: in a frame with which an adjustment ends, at whose start all that is known
  /// is scaled about the map's first camera. False again in a new or a loaded map.
  bool metric = true;
  bool keyframe = false;  ///< the frame became a keyframe
  int inliers = 0;        ///< keypoints that agree with the pose; 0 for a frame that is not tracked
  int keypoints = 0;      ///< of the left image, or of those of all cameras of a multi_rig
  int stereo_points = 0;  ///< of these, with a depth
  int local_points = 0;   ///< map points that were searched
  int left_out = 0;       ///< map points for which a limit of odometry_params left no room: in the
                          ///< local map, among new points, in an adjustment that began
  int map_points = 0;     ///< in the map
  int maps = 0;           ///< begun so far; the world is that of the first one, as far as known
  int keyframes = 0;      ///< made so far
  /// Row-major 6 x 6 covariance of a small twist x, rotation first, in T_world_camera * exp(x):
  /// rad^2, rad m and m^2. It is the inverse of the Gauss-Newton matrix of the last pose
  /// optimisation without the IMU, with its robust weights: errors of keypoints, not of map points.
  /// 0 for the frame that begins the first map, whose pose is exact; infinite on the diagonal for a
  /// frame that was not tracked.
  double covariance[36] = {};
  imu_tracking imu;        ///< what the IMU says, if there is one
  bool map_begun = false;  ///< the frame begins a map; if `maps` is above 1, at a guessed place
  int agreed = 0;          ///< keypoints that agree with the pose that was tried last; of a tracked
                           ///< frame as `inliers`, else too few
  int distant_points = 0;  ///< of stereo_points, those beyond distant_baselines of the rig
  depth_origin depths = depth_origin::stereo;
  int map_id = 0;  ///< number of the map that the pose is in, from 1 on; 0 = there is none yet
  warning_set warnings;  ///< see warnings_of() in pipelines/tracking_warnings.hpp
  tracking_evidence evidence;
  image_light light;                             ///< of the image with the least contrast
  start_outcome start = start_outcome::waiting;  ///< of one camera that has no map
  int start_matches = 0;                         ///< with the first frame of that start
};

/// A map point in host memory.
struct downloaded_point {
  vec3<float> position;  ///< world, metres
  vec3<float> normal;    ///< mean viewing direction, unit length
  float min_distance;    ///< metres, as in map_points_view
  float max_distance;
  int slot;
  int number;     ///< unique
  int keyframes;  ///< that see it
};

/// A keyframe in host memory.
struct downloaded_keyframe {
  int number;  ///< unique, ascending with time
  std::int64_t time_ns;
  rigid<double> T_world_camera;
};

/// The map of one camera pair in host memory.
struct odometry_map {
  std::vector<downloaded_point> points;        ///< in the order of their slots
  std::vector<downloaded_keyframe> keyframes;  ///< oldest first: the trajectory of the map
};

}  // namespace FT_ABI
}  // namespace ft
