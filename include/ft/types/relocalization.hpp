// SPDX-License-Identifier: Apache-2.0
/// @file Settings and results of a relocalisation.
#pragma once

#include <cstdint>

#include "ft/types/poses.hpp"

namespace ft {
inline namespace v0 {

struct words_search_params {
  int max_hamming = 50;  ///< largest Hamming distance of a match, bits, 0 to 255
  /// The best distance is below this times the second best one. Left camera only.
  float ratio = 0.75f;
  bool orientation_check = true;  ///< drops matches whose rotation differs from that of most others
};

/// What is asked of a pose, and how long it is sought.
struct pnp_params {
  int min_inliers = 10;        ///< a pose needs more inliers than this, at least 6
  float min_share = 0.5f;      ///< and than this share of the correspondences
  double confidence = 0.99;    ///< probability that a good sample is drawn
  int max_iterations = 300;    ///< limit of the iterations that the confidence asks for
  int iterations_of_call = 5;  ///< a call without success makes at least as many
};

struct keyframe_search_params {
  float window_radius = 10;       ///< half side of a window at scale 1, pixels
  int max_hamming = 100;          ///< largest Hamming distance of a match, bits
  bool orientation_check = true;  ///< drops matches whose rotation differs from that of most others
};

struct pose_params {
  int rounds = 4;
  /// With fewer observations, outliers included, only the first round is run.
  int enough_observations = 10;
  int steps = 10;   ///< per round
  int trials = 10;  ///< values of the damping tried per step
  /// A round ends with a step whose components are all shorter than this, rad and m. That step is
  /// taken without evaluating its cost. With 0, and where there are too few observations for more
  /// than the first round, every step is evaluated and rounds end as the reference's do.
  float small_step = 1e-4f;
  double chi2_mono = 5.991;    ///< 95 % of 2 degrees of freedom
  double chi2_stereo = 7.815;  ///< 95 % of 3
  /// Weight of a disparity, in those of a pixel, which then takes the place of the right column's
  /// error. 0: the right column is an observation as exact as the left one, as in the reference.
  double disparity_weight = 0;
};

struct frustum_params {
  float min_x = 0, min_y = 0, max_x = 0, max_y = 0;  ///< image bounds, pixels, inclusive
  float min_cosine = 0.5f;
  float log_scale_factor = 0;  ///< natural logarithm of the pyramid's scale factor
  int levels = 0;
};

struct relocalization_params {
  words_search_params words;  ///< of the search that gives each keyframe its matches
  int min_matches = 15;       ///< a keyframe with fewer is no candidate
  pnp_params pnp;
  int rounds = 4;                 ///< calls of the pose solver for each candidate, at most
  int min_inliers = 10;           ///< a pose with fewer after its first optimisation is dropped
  int enough_inliers = 50;        ///< with as many the frame is relocalised
  int narrow_above = 30;          ///< with more, but not enough, the narrow search follows
  keyframe_search_params coarse;  ///< radius 10, distance 100
  keyframe_search_params narrow = {3.0f, 64, true};
  pose_params pose;
  frustum_params frustum;  ///< bounds and levels of the image; the angle is not compared
};

/// What a relocalizer has room for.
struct relocalizer_capacity {
  int keypoints = 0;  ///< of an image of the frame, and of a keyframe
  int keyframe_keypoints = 0;
  int slots = 0;  ///< of the map
  int candidates = 16;
};

/// Steps of a relocalisation, with what each finds.
enum class relocalization_step : int {
  solved,         ///< inliers of the solver's pose, -1 without one
  first_inliers,  ///< after the first optimisation; outliers still hold their points
  coarse_search,  ///< keypoints taken
  second_inliers,
  narrow_search,
  third_inliers,  ///< the outliers hold no points any more
};

struct relocalization {
  bool found = false;
  int candidate = -1;  ///< place in the list of candidates
  int inliers = 0;
  int rounds = 0;  ///< that were begun
  pose T_cw = pose::identity();
};

/// How lost cameras are found by the words of a vocabulary.
struct place_recovery {
  int levels_up = 4;                     ///< see transform_params
  int candidates = 16;                   ///< keyframes that are tried: those that are most alike
  std::uint64_t seed = 0;                ///< of the samples of poses, with the time of the frame
  relocalization_params relocalization;  ///< `frustum` is that of the odometry
};

/// Result of the frustum test of one map point and one camera.
struct visibility {
  float x, y;      ///< projection, pixels
  float right_x;   ///< in the right image of a rectified pair
  float cosine;    ///< of the angle between viewing direction and the point's normal
  float distance;  ///< from the camera's centre, metres: the length in the camera frame
  int level;       ///< predicted octave; -1 = not visible
};

}  // namespace v0
}  // namespace ft
