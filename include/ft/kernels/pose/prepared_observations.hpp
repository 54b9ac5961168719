// SPDX-License-Identifier: Apache-2.0
/// @file The observations of a pose in the form that its sums need.
#pragma once

#include "ft/containers/observations.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/geometry.hpp"
#include "ft/kernels/pose/pose_problem.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Observations with their points in the pose's frame at the start, and their flags. The first
/// 1024 are kept in block scratch. Those beyond are recomputed on every access, and their flags are
/// in the problem's `outlier`. Only the thread of observation i, which is i modulo the group's
/// size, accesses it.
struct prepared_observations {
  static constexpr int size = 1024;

  /// Flag: the observation is an outlier at the pose that the last round found.
  static constexpr unsigned outlier = 1;
  /// Flag: its chi-square at the start is NaN or overflows a sum in float. Excluded from all sums.
  static constexpr unsigned unusable = 2;
  /// The bits above the flags are the number of the camera, of rigs whose pixels have no room.
  static constexpr unsigned flag_bits = 2;

  struct alignas(16) {
    vec3<float> point;  ///< in the pose's frame at the start
    float weight;       ///< 0 = excluded in this round
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

  /// @param point in the pose's frame at the start @param flags 0 or `unusable`
  template <typename Rig>
  FT_HOST_DEVICE void keep(int i, observation const& o, vec3<strict_double> point, unsigned flags) {
    place[i] = {narrowed(point), flags == 0 ? o.inv_sigma2 : 0.0f};
    if constexpr (Rig::searches > 1) { flags |= static_cast<unsigned>(o.camera) << flag_bits; }
    pixel[i] = {o.u, o.v, Rig::rectified ? o.right_u : static_cast<float>(o.camera), flags};
  }

  /// Observation i with its point in the pose's frame at the start; weight 0 if it is excluded.
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
    auto const start = problem.start->template cast<strict_double>();
    o.point = narrowed(start * vec3<strict_double>{static_cast<double>(o.point.x),
                                                   static_cast<double>(o.point.y),
                                                   static_cast<double>(o.point.z)});
    if (problem.outlier[i] != 0) { o.inv_sigma2 = 0; }
    return o;
  }

private:
  FT_HOST_DEVICE static vec3<float> narrowed(vec3<strict_double> p) {
    return {static_cast<float>(p.x.value), static_cast<float>(p.y.value),
            static_cast<float>(p.z.value)};
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
