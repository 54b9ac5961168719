// SPDX-License-Identifier: Apache-2.0
/// @file Settings of an odometry and of a frame_tracker.
#pragma once

#include <cstdint>

#include "ft/core/config.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/loops.hpp"
#include "ft/types/orb_params.hpp"

namespace ft {
inline namespace v0 {

struct motion_params {
  /// Time stamps whose distances differ by less than this share count as evenly spaced, and the
  /// motion is repeated bit for bit. Recorded cameras jitter by less.
  double even = 0.05;
  /// A prediction covers at most this many motions; a longer gap needs a wide search.
  double longest = 5;
  /// Seconds after which a camera that is not found is thought to stand still.
  double memory = 1;
};

/// When a frame counts as tracked, when a keyframe is made, and when a map is given up. Numbers are
/// keypoints of one frame, unless said otherwise.
struct tracking_rules {
  int min_stereo_points = 60;   ///< with depth, to begin a map
  int min_motion_inliers = 20;  ///< to trust the pose from the last frame
  int min_inliers = 20;         ///< to call a frame tracked
  int min_recovered = 20;       ///< inliers to call a lost camera found
  int min_evidence = 64;        ///< and what they must say, bits: that a wrong pose matches as many
                                ///< of the points that it should see has a chance of at most
                                ///< 2^-min_evidence
  float first_wide_search = 6;  ///< factor on the search radius in the first round of attempts
  float later_wide_search = 20;  ///< and in the second; the first where no motion is known
  int patience = 5;              ///< frames in a row that have enough points and are not found,
                                 ///< before a new map; before a keyframe where an IMU tells where
                                 ///< the camera is
  int wanted_near_points = 100;  ///< near points that a keyframe should have at least
  int new_near_points = 70;      ///< a keyframe is made if more than this many could be added
  float keep_share = 0.75f;      ///< and if fewer than this share of the last one's are tracked
  float unrectified_keep_share = 0.85f;  ///< the same for two cameras that are not rectified, which
                                         ///< are wide and see a point for longer
  /// A keyframe is made if the last one is older; 0: no such rule. With an IMU it is 0 or
  /// imu_params::keyframe_period_s, which holds.
  double keyframe_period_s = 0;
  float near_depth = 50;  ///< near is what is at most this many baselines away, of its own pair in
                          ///< a rig of several
  float far_depth = 400;  ///< keypoints up to this many baselines away become map points, or up to
                          ///< near_depth if that is more: far ones hold the rotation
  /// Whether a camera that is lost, whose motion is not known yet or that is in doubt is also
  /// searched for by matches anywhere in the image; see match_without_window(). Not where an IMU
  /// tells the motion.
  bool matches_without_window = true;
  float doubtful_share = 0.5f;  ///< in doubt is a camera that finds a smaller share of the
                                ///< keypoints that held a point in the last frame
  int min_support = 15;         ///< matches that must agree with a pose that is found so, from 4 on
  float matched_search = 3;     ///< largest factor on the search radius around it
  motion_params motion;
  /// The camera is tracked in a map of odometry::load_map(), which is not changed: no keyframe
  /// enters it, nothing is adjusted, no loop is looked for, no map begins. A camera that is not
  /// found stays lost. It is searched for near the newest keyframes, and where
  /// odometry::predict() says. With ft::loops, and a map that was made with it, it is then looked
  /// up among all kept keyframes, in each frame that is not found, and the map around its place
  /// takes the place of odometry::map() and download_map(); T_odom_camera jumps there. ft::places
  /// is refused, and an IMU is not used: they need new keyframes.
  bool localize_only = false;
};

struct local_map_params {
  int keyframes = 30;   ///< with most votes, 1 to 64
  int neighbours = 10;  ///< of these the best ones whose neighbours are added, 0 to 32
};

struct window_selection {
  int moving = 8;  ///< newest keyframes, which are adjusted, 1 or more
  int fixed = 5;   ///< keyframes before these, which stay, 0 or more. The views of a
                   ///< window_problem_view are at least moving + fixed
};

/// How windows are adjusted.
struct window_params {
  int steps = 3;            ///< most steps to try, 0 to 1000; each is three launches
  double huber2 = 5.991;    ///< squared weighted error from which its cost grows linearly, above 0
  double outlier2 = 9.21;   ///< squared weighted error of an outlier: 99 % of 2 degrees of freedom;
                            ///< above 0
  double no_image = 100.0;  ///< cost of an observation whose point the camera cannot see, from 0 on
  double disparity_weight = 16.0;  ///< weight of a disparity, in those of a pixel; 0: not used
  double first_damping = 1e-4;     ///< of the first step, relative to the diagonal, from 0 on
  double enough = 1e-4;            ///< ends with a step that lowers the cost by a smaller share
};

/// Rules of a start with one camera.
struct start_rules {
  int min_keypoints = 100;   ///< both frames have more
  int min_matches = 100;     ///< of both frames
  bool inertial = false;     ///< integrals between the frames must not be long
  double longest_gap_s = 1;  ///< between both frames, if inertial
  std::uint64_t seed = 0;    ///< of samples; a camera's n-th attempt adds n
};

struct initial_match_params {
  float window_radius = 100;      ///< half side of a window, pixels
  int max_hamming = 50;           ///< largest Hamming distance of a match, bits, 0 to 255
  float ratio = 0.9f;             ///< the best distance is below this times the second best one
  bool orientation_check = true;  ///< drops matches whose rotation differs from that of most others
};

/// Parameters of reconstruct_two_views().
struct two_view_params {
  static constexpr int most_samples = 1 << 16;

  int samples = 200;   ///< sets of 8 matches; each makes a homography and a fundamental matrix
  float sigma_px = 1;  ///< standard deviation of a keypoint's position
  float homography_ratio = 0.5f;  ///< of scores, above which the homography is taken
  int min_points = 50;
  float min_parallax_deg = 1;
};

struct monocular_start_params {
  start_rules rules;
  initial_match_params matching;
  two_view_params two_views;
};

struct odometry_params {
  orb_params orb;
  tracking_rules rules;
  int map_slots = 1 << 14;         ///< map points at a time, per camera pair
  int keyframes = 128;             ///< at a time; the oldest one leaves
  int local_points = 1 << 13;      ///< points of the local map, at most
  local_map_params local_map;      ///< how these are chosen
  float window_radius = 7;         ///< half side of a search from the last frame, pixels
  int enough_matches = 20;         ///< with fewer, that search is repeated with twice the radius;
                                   ///< 0: never
  window_selection window{10, 5};  ///< keyframes of an adjustment: moving ones, fixed ones
  int window_points = 1 << 12;     ///< points of an adjustment, at most
  window_params adjustment;        ///< how they are adjusted
  int adjustment_delay = 3;        ///< frames after which the result of an adjustment enters
  monocular_start_params start;    ///< of a monocular_rig
  imu_params imu;                  ///< present or not; see inertial
  loop_params loops;               ///< present or not; see ft::loops
  bool own_features = false;       ///< keypoints of the caller are tracked; see ft::own_features
  /// Keypoints that hold map points are moved to where the image looks as it did when the point was
  /// new, which halves the error of a motion over a frame; see align_keypoints(). Not done with
  /// rolling shutters, with distorted images of a camera with depths, and with features of the
  /// caller, whose positions are not those of the images.
  bool align_keypoints = true;
  bool use_graphs = true;       ///< replay recorded graphs; false: enqueue each launch
  bool measure_stages = false;  ///< record stage_times()
  /// Frames whose images odometry::prefetch() may take ahead of their tracking, up to 64. Each
  /// takes the memory of its images and keypoints, and on the host a thread. 0 for a monocular_rig
  int prefetch = 0;
  stereo_overlap overlap[2] = {{0, 1e9f}, {0, 1e9f}};  ///< as in tracker_params
};

struct tracker_params {
  orb_params orb;
  int map_slots = 1 << 16;     ///< map points on the device at a time, per rig
  int local_points = 1 << 13;  ///< points of one local-map search
  int updates = 1 << 13;       ///< map points that one update_map() can send
  float window_radius = 7;     ///< half side at scale 1 of windows from the last frame, pixels
  int enough_matches = 20;  ///< with fewer, the search is repeated with twice the radius; 0: never
  bool optimize_last = true;    ///< pose optimisation after the search from the last frame
  bool optimize_local = true;   ///< and after the search in the local map
  bool use_graphs = true;       ///< replay recorded graphs; false: enqueue each launch
  bool measure_stages = false;  ///< record stage_times()
  /// Columns of the left and the right image that see the same part of the scene, as in
  /// orb_extractor; for pairs that are not rectified. The default is the whole image. If one of the
  /// two lies outside its image, no keypoint has a stereo partner.
  stereo_overlap overlap[2] = {{0, 1e9f}, {0, 1e9f}};
};

}  // namespace v0
}  // namespace ft
