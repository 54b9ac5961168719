// SPDX-License-Identifier: Apache-2.0
/// @file Reprojection error of an observation, and its derivative.
#pragma once

#include <limits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Reprojection error of one observation, its chi-square and its derivative.
/// @tparam Rig rectified_rig, stereo_rig or multi_rig
/// @tparam Real strict_float or strict_double
/// @tparam Differentiate whether derivative() will be called
template <typename Rig, typename Real = strict_double, bool Differentiate = false>
struct reprojection {
  using plain = plain_scalar_t<Real>;
  static constexpr plain infinitely_far = std::numeric_limits<plain>::infinity();

  Real error[3];         ///< measured minus predicted; the third only with a right column
  int rows;              ///< 2 or 3
  vec3<Real> in_body;    ///< point in the frame of the pose: the left camera's, or the body's
  vec3<Real> in_camera;  ///< point in the frame of the camera that sees it
  Real iz = Real(0);     ///< 1 / z of a rectified pair; the errors in stereo have it as a float
  bool valid = true;     ///< whether the point is in the domain of the camera model

  FT_HOST_DEVICE reprojection(Rig const& rig, rigid<Real> const& T_cw, observation const& o)
      : reprojection(rig, T_cw * vec3<Real>{real(o.point.x), real(o.point.y), real(o.point.z)}, o) {
  }
  /// @param point the observation's, in the frame of the pose
  FT_HOST_DEVICE reprojection(Rig const& rig, vec3<Real> point, observation const& o)
      : in_body(point) {
    in_camera = in_body;
    rows = 2;
    error[2] = Real(0);
    if constexpr (is_monocular_v<Rig>) {
      projection<Real> const p = project(rig.camera.template cast<Real>());
      valid = p.valid;
      error[0] = real(o.u) - p.pixel.x;
      error[1] = real(o.v) - p.pixel.y;
    } else if constexpr (is_mixed_v<Rig>) {
      auto const& c = rig.pair(o.camera);
      in_camera = rig.to_camera(o.camera, in_body);
      projection<Real> const p = project(c.camera.template cast<Real>());
      valid = p.valid;
      error[0] = real(o.u) - p.pixel.x;
      error[1] = real(o.v) - p.pixel.y;
      if (o.right_u >= 0) {
        rows = 3;
        iz = scalar::reciprocal(in_camera.z);
        error[2] = real(o.right_u) - (p.pixel.x - real(c.bf()) * iz);
      }
    } else if constexpr (Rig::rectified) {
      in_camera = rig.to_camera(o.camera, in_body);
      auto const& c = rig.pair(o.camera).camera;
      iz = scalar::reciprocal(in_camera.z);
      bool const stereo = o.right_u >= 0;
      Real const rounded = stereo ? real(static_cast<float>(iz.value)) : iz;
      Real const u = real(c.fx) * in_camera.x * rounded + real(c.cx);
      Real const v = real(c.fy) * in_camera.y * rounded + real(c.cy);
      error[0] = real(o.u) - u;
      error[1] = real(o.v) - v;
      if (stereo) {
        rows = 3;
        error[2] = real(o.right_u) - (u - real(rig.pair(o.camera).bf()) * rounded);
      }
    } else {
      projection<Real> p;
      if (o.camera != 0) {
        in_camera = rig.T_rl.template cast<Real>() * in_body;
        p = project(rig.right.template cast<Real>());
      } else {
        p = project(rig.left.template cast<Real>());
      }
      valid = p.valid;
      error[0] = real(o.u) - p.pixel.x;
      error[1] = real(o.v) - p.pixel.y;
    }
  }

  /// Makes the third error that of the disparity, if there is a right column.
  /// @param root of the weight of a disparity, in those of a pixel
  FT_HOST_DEVICE void take_disparity(Real root) {
    if (rows == 3) { error[2] = root * (error[2] - error[0]); }
  }
  /// The same of what derivative() returns.
  FT_HOST_DEVICE mat3<Real> with_disparity(mat3<Real> P, Real root) const {
    for (int k = 0; k < 3; ++k) { P.m[6 + k] = root * (P.m[6 + k] - P.m[k]); }
    return P;
  }

  /// Infinite without a valid projection: such an observation is an outlier, and a trial pose with
  /// one is refused.
  FT_HOST_DEVICE Real chi2(observation const& o) const {
    if (!valid) { return Real(infinitely_far); }
    return (error[0] * error[0] + error[1] * error[1] + error[2] * error[2]) * real(o.inv_sigma2);
  }

  /// d prediction / d point in the frame of the pose: rows u, v, and the right column.
  FT_HOST_DEVICE mat3<Real> derivative(Rig const& rig, observation const& o) const {
    Real const zero = Real(0);
    if constexpr (is_monocular_v<Rig>) {
      static_assert(Differentiate, "derivative() needs the template argument Differentiate");
      auto const& j = camera_derivative.m;
      return {{j[0], j[1], j[2], j[3], j[4], j[5], zero, zero, zero}};
    } else if constexpr (is_mixed_v<Rig>) {
      static_assert(Differentiate, "derivative() needs the template argument Differentiate");
      auto const& j = camera_derivative.m;
      Real const bf = rows == 3 ? real(rig.pair(o.camera).bf()) : zero;
      mat3<Real> const P{{j[0], j[1], j[2], j[3], j[4], j[5], j[0], j[1], j[2] + bf * (iz * iz)}};
      return rig.derivative_in_body(o.camera, P);
    } else if constexpr (Rig::rectified) {
      auto const& c = rig.pair(o.camera).camera;
      Real const du = real(c.fx) * iz;
      Real const dv = real(c.fy) * iz;
      Real const du_dz = -(du * (in_camera.x * iz));
      Real const dv_dz = -(dv * (in_camera.y * iz));
      Real const bf = real(rig.pair(o.camera).bf());
      mat3<Real> const P{{du, zero, du_dz, zero, dv, dv_dz, du, zero, du_dz + bf * (iz * iz)}};
      return rig.derivative_in_body(o.camera, P);
    } else {
      static_assert(Differentiate, "derivative() needs the template argument Differentiate");
      auto const& j = camera_derivative.m;
      bool const right = o.camera != 0;
      mat3<Real> const R = rig.T_rl.template cast<Real>().R;
      mat3<Real> P;
      for (int r = 0; r < 2; ++r) {
        for (int k = 0; k < 3; ++k) {
          P.m[3 * r + k] =
              right ? j[3 * r] * R.m[k] + j[3 * r + 1] * R.m[3 + k] + j[3 * r + 2] * R.m[6 + k]
                    : j[3 * r + k];
        }
      }
      P.m[6] = P.m[7] = P.m[8] = zero;
      return P;
    }
  }

private:
  FT_HOST_DEVICE static Real real(float v) { return Real(static_cast<plain>(v)); }

  template <typename Camera>
  FT_HOST_DEVICE projection<Real> project(Camera const& camera) {
    if constexpr (Differentiate) {
      auto const seen = camera.project_with_jacobian(in_camera);
      camera_derivative = seen.jacobian;
      return seen.value;
    } else {
      return camera.project(in_camera);
    }
  }

  mat23<Real> camera_derivative;  ///< d pixel / d in_camera, of unrectified cameras
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
