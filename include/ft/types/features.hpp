// SPDX-License-Identifier: Apache-2.0
/// @file Keypoints that the caller has found, and the part of an odometry that takes them.
#pragma once

#include "ft/core/config.hpp"

namespace ft {
inline namespace v0 {

/// Keypoints of an image from any detector. Their descriptors have 256 bits and are compared by
/// their Hamming distance, as OpenCV's ORB and BRIEF; or they are those of FT_DESCRIPTOR, see
/// containers/keypoints.hpp. Arrays without gaps, in host memory or all `on_device`; they are read
/// during the call that takes them.
struct image_features {
  int count = 0;
  /// [count][2] column and row, pixels, in [0, width) x [0, height); 0 is the middle of the first
  /// one.
  float const* positions = nullptr;
  void const* descriptors = nullptr;  ///< [count][descriptor_bytes]
  int descriptor_bytes = 32;          ///< those of ft::descriptor
  /// [count] pyramid level, 0 to orb_params::levels - 1: a position has a standard deviation of
  /// scale_factor^octave pixels, and keypoints of a map point are searched on the levels that its
  /// distance lets expect. Null: by `deviation`; without that, 0.
  int const* octave = nullptr;
  /// [count] standard deviation of a position, pixels, above 0, instead of an octave: the one whose
  /// deviation is nearest is taken. Null where octaves are given.
  float const* deviation = nullptr;
  /// [count] degrees, [0, 360]. Matches whose angles changed otherwise than those of most others
  /// are dropped. Null: all angles are 0, so that none is.
  float const* angle = nullptr;
  /// [count] finite. Of more keypoints than odometry::capacity() those with the highest scores are
  /// taken, the lower index first of equal ones; they keep their order. Null: the first ones.
  float const* score = nullptr;

  // Of the left image of a rectified pair, or the image of an rgbd_rig. With one of these, partners
  // are not searched and the right image's features are not read.

  /// [count] column in the right image, pixels; NaN, negative, not left of the keypoint's column,
  /// or before the first pixel of its octave's level: no partner. Not of an rgbd_rig
  float const* right_x = nullptr;
  /// [count] along the camera's axis, metres, below 1e10; 0, negative, infinite or NaN: no depth.
  /// The one that is null of both follows from the other.
  float const* depth = nullptr;

  /// How positions and right columns are counted. False: where the image has them. True: in the
  /// pixels of the octave's level, times its scale, as OpenCV's ORB, orb_extractor and
  /// odometry::keypoints() count; depths are then those of the disparity there. No difference on
  /// octave 0.
  bool level_positions = false;
  /// The arrays lie in the executor's memory, on a GPU in that of the odometry's device, and
  /// `descriptors` are aligned as ft::descriptor. Kernels read them there after what wait_for() was
  /// told of, so nothing is known of their numbers before: keypoints with a number out of range are
  /// left out, where those in host memory throw bad_argument. tracking::keypoints counts what was
  /// taken. Arrays of another GPU throw bad_argument.
  bool on_device = false;
};

/// The features of a frame.
struct given_features {
  image_features left;   ///< or of the only image
  image_features right;  ///< of a rectified pair
};

/// Plugs odometry::track(given_features) into an odometry with odometry_params::own_features: an
/// argument of its constructor. A program without it compiles nothing of it.
///
///     params.own_features = true;
///     ft::odometry odo(exec, rig, params, 1, ft::own_features{});
///     ft::tracking const t = odo.track(ft::given_features{left, right}, time_ns);
///
/// Of a rectified_rig, an rgbd_rig or a monocular_rig; others throw bad_argument: keypoints of a
/// distorted_pair are found in rectified images and given to a rectified_rig. A left keypoint
/// without given partner gets the right one with the nearest descriptor among those of its rows
/// and octaves, one more or less, up to the disparity of a point a baseline away; without an image
/// the columns stay as they are given. Mixes with track() of images.
struct own_features {};

}  // namespace v0
}  // namespace ft
