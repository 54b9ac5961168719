// SPDX-License-Identifier: Apache-2.0
/// @file Problems of the pose of a frame from its map points and an IMU, and their results.
#pragma once

#include <type_traits>

#include "ft/containers/inertial.hpp"
#include "ft/containers/observations.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Rounds of an optimisation at most.
inline constexpr int inertial_rounds = 4;

/// How a pose with an IMU is optimised.
struct inertial_pose_params {
  /// What the reference does where it slips: in steps from the last frame the biases' walk is that
  /// since the last keyframe; and an integral of a single step, whose covariance has no inverse,
  /// counts with the inverse of its rounding errors.
  bool reference_quirks = false;
  /// A round ends where all components of a step are below this: rad, m, m/s, rad/s, m/s^2.
  double step_tolerance = 1e-10;
  /// The first round that is made, from 0. Earlier rounds tolerate larger errors, for a start that
  /// is further off; the last one has no robust weights.
  int first_round = 0;
  /// Whether `outlier` says at first which observations are left out; otherwise none is.
  bool outliers_given = false;
  /// Whether `next_prior` is written; otherwise marginalize_inertial_poses() writes it, which may
  /// run beside what needs the pose alone.
  bool marginalizes = true;
};

/// What came of an optimisation.
enum class inertial_pose_status : int {
  optimised = 0,
  ended_early,  ///< in a round the information did not determine the state; the last one stands
  no_integral,  ///< refused: the integral is of no samples, or not usable
  no_prior,     ///< refused: from the last frame without its prior
  not_finite,   ///< refused: a number of the input, or the result, is NaN or infinite
};

/// A frame's state from its observations and its IMU.
struct inertial_pose_result {
  stored_inertial_state stored;  ///< of the frame; where it was refused, the predicted one
  inertial_pose_status status;
  int tracked;  ///< observations without outliers, as the reference counts them; 0 if refused
  int inliers;  ///< after the last round, before outliers are taken in again
  int rounds;   ///< that were made
  inertial_state<double> round_state[inertial_rounds];  ///< the first `rounds` are set
  inertial_state<double> first;  ///< of the last keyframe, or of the last frame after all rounds
};
static_assert(std::is_trivially_copyable<inertial_pose_result>::value, "copied between memories");

/// A batch of independent problems, one frame each. Arrays are in the executor's memory and have
/// one entry a problem, but for those with another shape.
struct inertial_poses {
  int problems;
  int capacity;  ///< observations of a problem at most
  // Inputs.
  int const* from_last_frame;          ///< 0: from the last keyframe, whose state is fixed
  stored_inertial_state const* first;  ///< of the last keyframe or the last frame
  stored_inertial_state const* start;  ///< of the frame, predicted
  preintegrated const* integral;       ///< from `first` to the frame
  vec3<float> const* gravity;          ///< in the world, m/s^2. Null: standard_gravity()
  /// From the last keyframe to the frame; read with reference_quirks from the last frame, otherwise
  /// null is allowed.
  preintegrated const* since_keyframe;
  /// Of the last frame: the `next_prior` of its optimisation. Null is allowed if all problems are
  /// from keyframes.
  inertial_prior const* prior;
  observation const* observations;  ///< [problems][capacity]
  /// [problems][capacity] distance of the point from the left camera, metres, as last noted where
  /// it was in view: nearer than 10 m an observation without depth may err more. Null: the distance
  /// from the frame of the pose, as it is judged.
  float const* distance;
  int const* count;  ///< observations
  // Outputs.
  inertial_pose_result* result;
  /// What the optimisation says about the frame; not known if it was refused. May be `prior`.
  inertial_prior* next_prior;
  unsigned char* outlier;  ///< [problems][capacity] 1 = outlier; input with outliers_given
  /// [problems][inertial_rounds][capacity] squared weighted errors by which each round judged the
  /// observations; rounds that were not made are not written
  float* chi2;
};

}  // namespace FT_ABI
}  // namespace ft
