// SPDX-License-Identifier: Apache-2.0
/// @file Reprojection error of an observation in double precision, and its derivative, for poses
/// with an IMU.
///
/// Other than pose/detail/reprojection.hpp there is no rounding to float but for the angles of a
/// Kannala-Brandt camera, and a point behind a camera has an error like any other.
#pragma once

#include <limits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Pixel and derivative of a camera model at a point in the camera's frame. Any model of ft's.
template <typename Camera>
FT_HOST_DEVICE projection_with_jacobian<real64> wide_projection(Camera const& camera,
                                                                strict_vec3d p) {
  return camera.template cast<real64>().project_with_jacobian(p);
}
/// Pinhole: defined behind the camera, too.
FT_HOST_DEVICE inline projection_with_jacobian<real64> wide_projection(pinhole<float> const& camera,
                                                                       strict_vec3d p) {
  auto const c = camera.cast<real64>();
  real64 const iz = scalar::reciprocal(p.z);
  real64 const du = c.fx * iz;
  real64 const dv = c.fy * iz;
  return {{{du * p.x + c.cx, dv * p.y + c.cy}, true},
          {{du, real64(0.0), -(du * (p.x * iz)), real64(0.0), dv, -(dv * (p.y * iz))}}};
}
/// Kannala-Brandt: the angles are floats, as in the reference.
FT_HOST_DEVICE inline projection_with_jacobian<real64> wide_projection(
    kannala_brandt<float> const& camera, strict_vec3d p) {
  auto const c = camera.cast<real64>();
  auto const rounded = [](real64 v) {
    return real64(static_cast<double>(static_cast<float>(v.value)));
  };
  real64 const r2 = p.x * p.x + p.y * p.y;
  real64 const radius = scalar::sqrt(r2);
  if (!(radius > real64(0.0))) {
    return {{{c.cx, c.cy}, p.z > real64(0.0)},
            {{c.fx / p.z, real64(0.0), real64(0.0), real64(0.0), c.fy / p.z, real64(0.0)}}};
  }
  real64 const theta = rounded(strict_atan2(rounded(scalar::sqrt(rounded(r2))), rounded(p.z)));
  real64 const psi = rounded(strict_atan2(rounded(p.y), rounded(p.x)));
  sine_and_cosine const at = strict_sin_cos(psi);
  real64 const one = 1.0;
  real64 const t2 = theta * theta;
  real64 const r = theta * (one + t2 * (c.k1 + t2 * (c.k2 + t2 * (c.k3 + t2 * c.k4))));
  real64 const dr =
      one +
      t2 * (real64(3.0) * c.k1 +
            t2 * (real64(5.0) * c.k2 + t2 * (real64(7.0) * c.k3 + t2 * (real64(9.0) * c.k4))));
  // Per metre, `along` is the change of r along the direction in the image, and `across` is the
  // motion of the image perpendicular to it.
  real64 const across = r / radius;
  real64 const turn = dr / (r2 + p.z * p.z);
  real64 const along = turn * p.z;
  real64 const mixed = (along - across) * (at.cosine * at.sine);
  real64 const cc = at.cosine * at.cosine;
  real64 const ss = at.sine * at.sine;
  return {{{c.fx * r * at.cosine + c.cx, c.fy * r * at.sine + c.cy}, true},
          {{c.fx * (along * cc + across * ss), c.fx * mixed, -(c.fx * (turn * p.x)), c.fy * mixed,
            c.fy * (along * ss + across * cc), -(c.fy * (turn * p.y))}}};
}

/// Error of one observation, measured minus predicted, and the derivative of the prediction by the
/// point in the frame of the pose: the left camera's, or that of a multi_rig.
/// @tparam Rig rectified_rig, stereo_rig or multi_rig
template <typename Rig>
struct visual_residual {
  static constexpr double infinite = std::numeric_limits<double>::infinity();

  real64 error[3];       ///< the third only with a right column
  int rows = 2;          ///< 2 or 3
  strict_vec3d in_pose;  ///< point in the frame of the pose
  real64 z;              ///< of the point in the frame of its camera
  strict_mat3d P;        ///< derivative: rows u, v and the right column
  real64 chi2;           ///< weighted; infinite if there is no projection

  FT_HOST_DEVICE visual_residual(Rig const& rig, rigid<real64> const& T_cw, observation const& o) {
    in_pose = T_cw * o.point.template cast<real64>();
    strict_vec3d in_camera = in_pose;
    projection_with_jacobian<real64> seen;
    if constexpr (Rig::rectified) {
      in_camera = rig.to_camera(o.camera, in_pose);
      seen = wide_projection(rig.pair(o.camera).camera, in_camera);
    } else if (o.camera != 0) {
      in_camera = rig.T_rl.template cast<real64>() * in_pose;
      seen = wide_projection(rig.right, in_camera);
    } else {
      seen = wide_projection(rig.left, in_camera);
    }
    z = in_camera.z;
    error[0] = widened_float(o.u) - seen.value.pixel.x;
    error[1] = widened_float(o.v) - seen.value.pixel.y;
    error[2] = real64(0.0);
    FT_UNROLL
    for (int k = 0; k < 6; ++k) { P.m[k] = seen.jacobian.m[k]; }
    P.m[6] = P.m[7] = P.m[8] = real64(0.0);
    if constexpr (Rig::rectified) {
      if (o.right_u >= 0) { add_right_column(rig, o, seen.value.pixel.x, z); }
      P = rig.derivative_in_body(o.camera, P);
    } else if (o.camera != 0) {
      P = P * rig.T_rl.template cast<real64>().R;
    }
    real64 const sum = error[0] * error[0] + error[1] * error[1] + error[2] * error[2];
    chi2 = sum * widened_float(o.inv_sigma2);
    // Written so that a NaN has no projection.
    if (!(seen.value.valid && chi2 < real64(1e30))) { chi2 = real64(infinite); }
  }

  FT_HOST_DEVICE bool usable() const { return chi2 < real64(infinite); }

private:
  FT_HOST_DEVICE static real64 widened_float(float v) { return static_cast<double>(v); }

  FT_HOST_DEVICE void add_right_column(Rig const& rig, observation const& o, real64 u,
                                       real64 depth) {
    rows = 3;
    real64 const iz = scalar::reciprocal(depth);
    real64 const shift = widened_float(rig.pair(o.camera).bf()) * iz;
    error[2] = widened_float(o.right_u) - (u - shift);
    P.m[6] = P.m[0];
    P.m[7] = P.m[1];
    P.m[8] = P.m[2] + shift * iz;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
