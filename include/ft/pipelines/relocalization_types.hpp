// SPDX-License-Identifier: Apache-2.0
/// @file Parameters, inputs and outputs of a relocalizer.
#pragma once

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/keyframe.hpp"
#include "ft/kernels/words/search_by_words.hpp"

namespace ft {
inline namespace FT_ABI {

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

/// Frame and keyframes, in executor memory. Rows of keypoints are laid out as in frame_view:
/// keypoint k of camera c is number c * capacity + k.
struct relocalization_input {
  frame_view frame;  ///< of one batch entry
  map_points_view map;
  pyramid_geometry geometry;
  word_keypoints_view words;  ///< the frame's, one row
  word_keypoints_view keyframes;
  /// Of the keyframes; image `cameras * row + c` is that of camera c. Octaves are not read.
  soa_view<field::angle, field::octave> keyframe_keypoints;
  int const* holder = nullptr;  ///< [keyframes][numbers] live map point, -1 = none
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

}  // namespace FT_ABI
}  // namespace ft
