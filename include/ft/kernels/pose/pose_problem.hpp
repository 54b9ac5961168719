// SPDX-License-Identifier: Apache-2.0
/// @file Parameters of pose optimisation, and the problem of a single pose.
#pragma once

#include <cmath>

#include "ft/containers/map_points.hpp"
#include "ft/containers/point_patches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/relocalization.hpp"

namespace ft {
inline namespace FT_ABI {

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
  /// The start in double, a rotation; null: `start`, made orthonormal.
  rigid<double> const* exact_start = nullptr;
  rigid<double>* exact_result = nullptr;  ///< the result before it is rounded; may be null
  /// Whether observations may be of keypoints that were moved to their points' patches. The last
  /// round has a robust loss for these.
  bool aligned = false;
};

// The observations of a pose in the form that its sums need.

namespace detail {

/// Observations and their flags. The first 1024 are kept in block scratch; the flags of those
/// beyond are in the problem's `outlier`. Only the thread of observation i, which is i modulo the
/// group's size, accesses it.
struct prepared_observations {
  static constexpr int size = 1024;

  /// Flag: the observation is an outlier at the pose that the last round found.
  static constexpr unsigned outlier = 1;
  /// Flag: its chi-square at the start is NaN or beyond all reason. Excluded from all sums.
  static constexpr unsigned unusable = 2;
  /// Flag: the keypoint was moved to its point's patch.
  static constexpr unsigned aligned = 4;
  /// The bits above the flags are the number of the camera, of rigs whose pixels have no room.
  static constexpr unsigned flag_bits = 3;

  struct alignas(16) {
    vec3<float> point;  ///< world frame
    float weight;       ///< negated = excluded in this round
  } place[size];
  struct alignas(16) {
    float u, v, third;  ///< column in the right image, or 1 = seen by the right camera
    unsigned flags;
  } pixel[size];

  FT_HOST_DEVICE unsigned flags(int i, pose_problem const& problem) const {
    return i < size ? pixel[i].flags : problem.outlier[i];
  }
  FT_HOST_DEVICE void set_flags(int i, pose_problem const& problem, unsigned flags) {
    if (i < size) {
      pixel[i].flags = flags;
    } else {
      problem.outlier[i] = static_cast<unsigned char>(flags);
    }
  }

  template <typename Rig>
  FT_HOST_DEVICE void keep(int i, observation const& o, pose_problem const& problem,
                           bool is_aligned) {
    unsigned flags = is_aligned ? aligned : 0;
    if (i < size) {
      place[i] = {o.point, o.inv_sigma2};
      if constexpr (Rig::searches > 1) { flags |= static_cast<unsigned>(o.camera) << flag_bits; }
      pixel[i] = {o.u, o.v, Rig::rectified ? o.right_u : static_cast<float>(o.camera), flags};
    } else {
      set_flags(i, problem, flags);
    }
  }
  /// Sets the flags of observation i, and whether it is in the sums.
  FT_HOST_DEVICE void mark(int i, pose_problem const& problem, unsigned flags) {
    set_flags(i, problem, flags);
    if (i >= size) { return; }
    float const weight = ::fabsf(place[i].weight);
    place[i].weight = (flags & (outlier | unusable)) != 0 ? -weight : weight;
  }

  /// Observation i; its weight is negated if it is excluded.
  template <typename Rig>
  FT_HOST_DEVICE observation get(int i, pose_problem const& problem) const {
    if (i < size) {
      auto const at = place[i];
      auto const seen = pixel[i];
      int camera = 0;
      if constexpr (Rig::searches > 1) {
        camera = static_cast<int>(seen.flags >> flag_bits);
      } else if constexpr (!Rig::rectified) {
        camera = static_cast<int>(seen.third);
      }
      return {at.point, seen.u, seen.v, seen.third, at.weight, camera};
    }
    observation o = problem.observations[i];
    if ((problem.outlier[i] & (outlier | unusable)) != 0) { o.inv_sigma2 = -o.inv_sigma2; }
    return o;
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
