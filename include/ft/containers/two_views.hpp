// SPDX-License-Identifier: Apache-2.0
/// @file What two images of one camera tell: the motion between them, and points.
#pragma once

#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/core/memory.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// What came of a reconstruction.
enum class two_view_status : int {
  reconstructed = 0,
  bad_match,        ///< a match is not a keypoint of the second image
  too_few_matches,  ///< fewer than 8
  bad_camera,       ///< a focal length is not positive, or a value is not finite
  not_finite,       ///< a keypoint, matched or not, is not finite
  degenerate,       ///< the matched keypoints of an image are on one line, or all in one place
  no_model,         ///< no sample has a model that any match agrees with
  no_motion,        ///< the homography is one of a rotation, or one without a unique motion
  too_few_points,   ///< no motion puts enough points in front of both cameras
  ambiguous,        ///< several motions do
  little_parallax,  ///< the rays of the points are almost parallel
};

/// Which relation of matched pixels a reconstruction is from.
enum class two_view_model : int {
  none = 0,
  homography,   ///< x2 ~ H x1: a plane, or a rotation
  fundamental,  ///< x2^T F x1 = 0: a general scene
};

/// A reconstruction. Without one, T_21 is the identity.
struct two_view_result {
  static constexpr int most_motions = 8;

  two_view_status status;
  two_view_model model;
  pose T_21;  ///< first camera to second; the translation has length 1
  int matches;
  int inliers;                      ///< matches that agree with the model in both directions
  int points;                       ///< good ones of the motion; 0 without a reconstruction
  int triangulated;                 ///< those of them whose rays are not almost parallel
  float parallax;                   ///< degrees, of the motion with most points
  float score_H;                    ///< of the best homography
  float score_F;                    ///< of the best fundamental matrix
  float ratio;                      ///< score_H / (score_H + score_F)
  int sample_H;                     ///< number of the sample with the best homography, or -1
  int sample_F;                     ///< likewise of the fundamental matrix
  int motions;                      ///< that the model leaves possible: 4, 8 or 0
  int points_of[most_motions];      ///< good points of each motion
  float parallax_of[most_motions];  ///< of each motion, degrees
  mat3<float> H_21;                 ///< the best homography, in pixels, of any scale; or 0
  mat3<float> F_21;                 ///< the best fundamental matrix, likewise
};
static_assert(std::is_trivially_copyable<two_view_result>::value, "copied between spaces");

/// Bits about a keypoint of the first image.
struct two_view_flag {
  static constexpr unsigned inlier = 1;        ///< its match agrees with the model
  static constexpr unsigned point = 2;         ///< it has a good point
  static constexpr unsigned triangulated = 4;  ///< and its rays are not almost parallel
};

/// Reconstructions of a batch of pairs.
struct two_view_reconstructions {
  int pairs = 0;
  int capacity = 0;                   ///< keypoints of a first image
  two_view_result* result = nullptr;  ///< [pairs]
  vec3<float>* point = nullptr;       ///< [pairs][capacity] in the first camera's frame; or 0
  std::uint8_t* flags = nullptr;      ///< [pairs][capacity] bits of two_view_flag
};
static_assert(std::is_trivially_copyable<two_view_reconstructions>::value, "passed to kernels");

inline void carve(carver& c, two_view_reconstructions& v, int pairs, int capacity) {
  v.pairs = pairs;
  v.capacity = capacity;
  c.place({pairs}, v.result);
  c.place({pairs, capacity}, v.point, v.flags);
}

}  // namespace FT_ABI
}  // namespace ft
