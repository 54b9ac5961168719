// SPDX-License-Identifier: Apache-2.0
/// @file Parameters of pose optimisation, and the problem of a single pose.
#pragma once

#include "ft/containers/observations.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {

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

namespace detail {

/// A limit of chi-square, with the roundings of the reference.
struct pose_limit {
  double robust;  ///< where Huber's loss becomes linear: the square of the limit's root as a float
  float inlier;   ///< for a chi-square that is rounded to float

  FT_HOST_DEVICE static pose_limit of(double chi2) {
    double const root = static_cast<double>(static_cast<float>(square_root(chi2)));
    return {root * root, static_cast<float>(chi2)};
  }
};
struct pose_limits {
  pose_limit mono, stereo;
  float disparity_root;  ///< of the weight of a disparity; 0 = as in pose_params

  FT_HOST_DEVICE static pose_limits of(pose_params const& params) {
    return {pose_limit::of(params.chi2_mono), pose_limit::of(params.chi2_stereo),
            static_cast<float>(square_root(params.disparity_weight))};
  }
};

}  // namespace detail

/// Numbers of the upper triangle of a symmetric 6 x 6 matrix.
inline constexpr int information_terms = 21;

/// The observations of one camera pose, and its results.
struct pose_problem {
  observation const* observations;
  int count;
  pose const* start;       ///< T_cw
  pose* result;            ///< T_cw; `start` if there are fewer than 3 observations
  unsigned char* outlier;  ///< [count]
  int* inliers;
  /// [information_terms] upper triangle by rows of the information matrix, the inverse of the
  /// pose's covariance, 1 / rad^2, 1 / (rad m) and 1 / m^2: that of a small twist x, rotation
  /// first, in T_cw' = exp(x) T_cw. It is the Gauss-Newton approximation of the last round, with
  /// that round's weights, at the last pose whose sums were computed; 0 without a pose. May be
  /// null.
  float* information = nullptr;
};

}  // namespace FT_ABI
}  // namespace ft
