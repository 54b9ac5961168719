// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry tells of a frame, and its map in host memory.
#pragma once

#include <cstdint>
#include <functional>
#include <ostream>
#include <utility>
#include <vector>

#include "ft/types/errors.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace v0 {

/// The state of a camera after a frame; see tracking_rules.
enum class tracking_state : int {
  initialising,  ///< no map yet: the frame had too few stereo points
  tracking,    ///< the frame's pose comes from the map, or the frame begins a map, or goes on with
               ///< it where an IMU tells
  recovering,  ///< the last frames were not found; each frame tries another place
  lost,        ///< all places were tried without success; the attempts go on
};

/// Where a rig's keypoints get their depths from.
enum class depth_origin : int {
  stereo,       ///< a pair
  depth_image,  ///< an rgbd_rig
  some_pairs,   ///< a multi_rig, whose cameras need not all be pairs
  motion,       ///< a monocular_rig
};

/// A depth of more than so many baselines is distant: its disparity is a small part of a pixel.
inline constexpr float distant_baselines = 1000;

/// What a frame did for the start of a map.
enum class start_outcome : int {
  waiting = 0,   ///< too few keypoints for a first frame
  took_first,    ///< it is the first frame now
  forgot_first,  ///< too few keypoints, or too late: the next frame may become the first one
  few_matches,   ///< likewise
  no_motion,     ///< two views made no reconstruction; the first frame stays
  started,       ///< there is a reconstruction; the next frame may become a first one
};

/// How light an image is, by 1024 pixels that are spread over it.
struct image_light {
  int image = -1;        ///< which one of the rig: 0 = left; -1 = none was looked at
  double mean = 0;       ///< grey value, 0 to 255
  double deviation = 0;  ///< standard deviation of grey values
};

/// What is to be told of a frame, whether it is tracked or not.
enum class tracking_warning : int {
  new_map,              ///< a later map begins, or has in the last second, at a guessed place
  doubtful_pose,        ///< few keypoints agree with the pose: it may be another one
  two_motions,          ///< things move, or are fixed to a camera, in a large part of the images
  images_repeat,        ///< images are those of the frame before while the camera moves, or were
                        ///< and the next ones jump
  stereo_inconsistent,  ///< depths do not agree with the map, hardly any keypoint has one, rows
                        ///< of a pair do not correspond, or the scene repeats along them, so that
                        ///< depths may be others
  depth_scale,          ///< most depths are beyond distant_baselines
  dark,                 ///< an image is nearly black
  bright,               ///< an image is nearly white
  low_texture,          ///< an image has hardly any contrast
  blurred,              ///< too few corners in images that have contrast, or half of the images or
                        ///< more are sharp in one direction only: a motion has smeared them
  imu,                  ///< see imu_warnings()
  imu_not_used,         ///< the IMU could have been used for long, and was not
};
constexpr int tracking_warnings = 12;  ///< kinds

/// A set of them.
struct warning_set {
  unsigned bits = 0;
  bool has(tracking_warning w) const { return (bits >> static_cast<int>(w) & 1u) != 0; }
  void add(tracking_warning w) { bits |= 1u << static_cast<int>(w); }
  bool empty() const { return bits == 0; }
};

/// What the matches and images of a frame say about its pose. Of a frame whose local map was not
/// searched, all that matches tell is 0.
struct frame_facts {
  int matches = 0;  ///< keypoints that were matched, before the pose was optimised
  int flowing = 0;  ///< inliers that the motion since the last frame moved 2 pixels
  int resting = 0;  ///< inliers that it moved by a quarter of a pixel at most
  int common = 0;   ///< of the variance of the inliers' errors, that which neighbours share;
                    ///< 1 / 1024; about 0 at the right pose
  int common_disparity = 0;  ///< likewise, of the errors of their disparities
  int with_disparity = 0;  ///< matches that agree in the left image and have a disparity; of a pair
                           ///< that is not rectified, those of the right camera
  int off_disparity = 0;   ///< of these, those whose disparity, or right image, does not agree
  int fixed = 0;           ///< near keypoints of parts of the images that stay while others move
  int dragged = 0;         ///< of these, those that the scene would have moved 2 pixels, and whose
                           ///< part has stayed for long
  int apart = 0;           ///< matches that agree with another motion than that of the pose, of
                           ///< frames after errors that neighbours share
  int shifted = 0;         ///< inliers that an adjustment of the map, which ended with this frame,
                           ///< has moved by a pixel, by how it moved the camera
  int held_before = 0;     ///< camera_track::held of the last frame
  int evidence = 0;        ///< of the inliers, bits
  int moving = 0;          ///< 1 = the last frame moved against the one before
  int frozen = 0;          ///< 1 = its images repeat those from before a motion of the IMU
  int misfit = 0;          ///< sum of the inliers' chi-square, each at most most_misfit, in 1 / 64
  int rows = 0;            ///< its numbers: two of an inlier, three of one with a disparity
  float stepped = 0;       ///< how far the adjustment of `shifted` moved the camera: metres, or the
                           ///< unit of a map that is not metric
  static constexpr int misfit_one = 64, most_misfit = 16;
};

/// What warnings are decided by, of one frame.
struct tracking_evidence {
  frame_facts facts;      ///< of matches and pose
  int images = 0;         ///< of the rig
  int same = 0;           ///< of these, those with the pixels of the frame before
  int streaked = 0;       ///< and those that are sharp in one direction only
  int textured = 0;       ///< parts of the images with contrast
  int moved = 0;          ///< of these, those with another content than a frame before
  int ambiguous = 0;      ///< of tracking::stereo_points, those whose rows of the right image have
                          ///< another keypoint, elsewhere, that is as near; of rectified pairs
  double rows_apart = 0;  ///< mean row of partners in right images less that in left ones, pixels
  double stereo_share = 0;  ///< of keypoints with a depth
  bool rectified = true;    ///< all of an image but its border is in a pair's other image, too
  double usual_stereo_share = 0;  ///< the same in the frames before; 0 = not known yet
};

/// What is known about a camera after a frame. See explain() in pipelines/explain.hpp.
struct tracking {
  /// Left camera, or a multi_rig's body, to world, metres. The world is the left camera, or the
  /// body, of the first frame with a map. For a frame that was not tracked: where it is thought to
  /// be.
  rigid<double> T_world_camera = rigid<double>::identity();
  /// With ft::loops T_world_camera is T_world_odom * T_odom_camera, whose translation is in units
  /// of odom_scale. T_odom_camera never jumps where a loop is closed: it is the pose that the
  /// odometry tracks. T_world_odom is what loops have corrected so far, REP 105's map to odom.
  rigid<double> T_odom_camera = rigid<double>::identity();
  rigid<double> T_world_odom = rigid<double>::identity();
  /// With ft::loops and one camera without an IMU, whose unit of length drifts: how many units of
  /// the world one of the odometry's is now. T_odom_camera.t is multiplied by it first. Else 1.
  double odom_scale = 1;
  int loops_closed = 0;  ///< whose correction enters with this frame; later ones may follow it
  tracking_state state = tracking_state::initialising;
  /// Lengths are metres. False of a monocular_rig, whose unit it says, until its IMU tells the
  /// scale of the map: in a frame with which an adjustment ends, at whose start all that is known
  /// is scaled about the map's first camera. False again in a new map, and in a loaded
  /// one; but true with ft::loops if its IMU had told the scale.
  bool metric = true;
  bool keyframe = false;  ///< the frame became a keyframe
  int inliers = 0;        ///< keypoints that agree with the pose; 0 for a frame that is not tracked
  int keypoints = 0;      ///< of the left image, or of those of all cameras of a multi_rig
  int stereo_points = 0;  ///< of these, with a depth
  int local_points = 0;   ///< map points that were searched
  int left_out = 0;       ///< map points for which a limit of odometry_params left no room: in the
                          ///< local map; and, with the frame before, among new points, and in an
                          ///< adjustment that began
  int map_points = 0;     ///< in the map before the frame's own keyframe, which brings new ones and
                          ///< takes old ones out
  int maps = 0;           ///< begun so far; the world is that of the first one, as far as known
  int keyframes = 0;      ///< made so far
  /// Row-major 6 x 6 covariance of a small twist x, rotation first, in T_world_camera * exp(x):
  /// rad^2, rad m and m^2. It is the inverse of the Gauss-Newton matrix of the last pose
  /// optimisation without the IMU, times the variance that the inliers' errors have, 1 for a camera
  /// that was found by its words, and up to 1.4 for those of map points, less of a camera at rest.
  /// Errors that points share are not in it: over a second a motion is farther off.
  /// 0 for the frame that begins the first map, whose pose is exact; infinite on the diagonal for a
  /// frame that was not tracked.
  double covariance[36] = {};
  imu_tracking imu;        ///< what the IMU says, if there is one
  bool map_begun = false;  ///< the frame begins a map; if `maps` is above 1, at a guessed place
  int agreed = 0;          ///< keypoints that agree with the pose that was tried last; of a tracked
                           ///< frame as `inliers`, else too few
  std::uint32_t missing_images = 0;  ///< bit i: image i of a rig of several cameras was null
  std::uint32_t missing_depths = 0;  ///< bit c: the depth image of camera c of a mixed_rig was null
  int distant_points = 0;  ///< of stereo_points, those beyond distant_baselines of the rig
  depth_origin depths = depth_origin::stereo;
  /// Number of the map that the pose is in, from 1 on; 0 = there is none yet. With ft::loops of
  /// maps that were joined that of the first one. A loaded map has 1; those that were never joined
  /// with it, and came in its file, have numbers below 0.
  int map_id = 0;
  warning_set warnings;  ///< see warnings_of() in pipelines/tracking_warnings.hpp
  tracking_evidence evidence;
  image_light light;                             ///< of the image with the least contrast
  start_outcome start = start_outcome::waiting;  ///< of one camera that has no map
  int start_matches = 0;                         ///< with the first frame of that start
};

/// A map point in host memory.
struct downloaded_point {
  vec3<float> position;  ///< world, with ft::loops the frame of the odometry, metres
  vec3<float> normal;    ///< mean viewing direction, unit length
  float min_distance;    ///< metres, as in map_points_view
  float max_distance;
  int slot;
  int number;     ///< unique
  int keyframes;  ///< that see it
};

/// A keyframe in host memory.
struct downloaded_keyframe {
  int number;  ///< unique, ascending with time; of a loaded map that goes on the nearer ones to
               ///< where it did are the newer ones
  std::int64_t time_ns;
  rigid<double> T_world_camera;  ///< with ft::loops T_odom_camera
};

/// The map of one camera pair in host memory.
struct odometry_map {
  std::vector<downloaded_point> points;        ///< in the order of their slots
  std::vector<downloaded_keyframe> keyframes;  ///< by number: the trajectory of the map
};

/// A map as it was when odometry::snapshot_map() took it, in host memory: with it the odometry goes
/// on, may be reset, or gone. Any number of threads may write it at the same time.
class map_snapshot {
public:
  /// Writes a part of the file. It sets the stream's state if it fails.
  using writer = std::function<void(std::ostream&)>;

  map_snapshot() = default;
  explicit map_snapshot(std::vector<writer> parts) : parts_(std::move(parts)) {}
  /// Writes what load_map() reads. @throws bad_argument for one that was never taken; error if the
  /// stream fails; std::bad_alloc
  void write(std::ostream& to) const {
    if (parts_.empty()) { throw bad_argument("ft: the snapshot was never taken"); }
    for (writer const& part : parts_) { part(to); }
    to.flush();
    if (!to) { throw error("ft: the map could not be written"); }
  }

private:
  std::vector<writer> parts_;
};

/// The time of one stage.
struct stage_time {
  char const* name;
  /// From the end of all preceding stages to its own end, microseconds, summed over the launches of
  /// this name; 0 if it ended while a preceding stage still ran. For a stage on a side branch of a
  /// device: from the branch's fork.
  double us;
};

/// Results in host memory. Keypoints are left ones; for two unrectified cameras the right ones
/// follow, for a multi_rig those of its other cameras. Keypoint k of camera c has number c *
/// capacity + k.
struct tracked_frame_view {
  int* keypoints = nullptr;  ///< [batch][cameras]
  pose* T_cw = nullptr;      ///< [batch]
  int* matches = nullptr;    ///< [batch] keypoints that the last search matched to a map point
  int* inliers = nullptr;    ///< [batch] of the last pose optimisation; matches if there was none
  float* x = nullptr;        ///< [batch][cameras * capacity] pixels
  float* y = nullptr;        ///< likewise
  int* octave = nullptr;     ///< likewise
  int* holder = nullptr;     ///< likewise: slot of the map point held, -1 = none
  /// [batch][depth_cameras * capacity] of left keypoints, metres, -1 = no stereo match
  float* depth = nullptr;
  /// likewise: in the left camera's frame, or the body's of a multi_rig; 0 = no stereo match
  vec3<float>* point = nullptr;
  int* partner = nullptr;  ///< [batch][cameras * capacity] number of the stereo partner, -1 = none
  unsigned char* in_view =
      nullptr;  ///< [batch][local_points] 1 = passed the frustum test of the local-map search
  int capacity = 0;
  int cameras = 1;
  int depth_cameras = 1;  ///< the first of them, whose keypoints may have a depth
  int local_points = 0;

  FT_INLINE int numbers() const { return cameras * capacity; }
};

/// Memory that a pipeline took, for its whole batch.
struct allocated_bytes {
  std::size_t executor = 0;  ///< memory that its stages work on: on a device, the device's
  std::size_t staging = 0;   ///< memory of images, inputs and results: next to a device, pinned

  friend FT_INLINE allocated_bytes operator+(allocated_bytes const& a, allocated_bytes const& b) {
    return {a.executor + b.executor, a.staging + b.staging};
  }
};

}  // namespace v0
}  // namespace ft
