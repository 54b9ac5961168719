// SPDX-License-Identifier: Apache-2.0
/// @file The observations of a pose in the form that its sums need.
#pragma once

#include <cmath>

#include "ft/containers/observations.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/pose/pose_problem.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
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
  /// The bits above the flags are the number of the camera, of rigs whose pixels have no room.
  static constexpr unsigned flag_bits = 2;

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
  FT_HOST_DEVICE void keep(int i, observation const& o, pose_problem const& problem) {
    unsigned flags = 0;
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
    if (problem.outlier[i] != 0) { o.inv_sigma2 = -o.inv_sigma2; }
    return o;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
