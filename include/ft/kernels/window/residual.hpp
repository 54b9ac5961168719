// SPDX-License-Identifier: Apache-2.0
/// @file Errors of a window's observations, their robust costs and their derivatives.
#pragma once

#include <type_traits>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/pose/solve6.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/types/odometry_params.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using window_real = strict_double;

FT_HOST_DEVICE inline vec3<window_real> to_real(vec3<double> const& v) { return {v.x, v.y, v.z}; }
FT_HOST_DEVICE inline vec3<double> from_real(vec3<window_real> const& v) {
  return {v.x.value, v.y.value, v.z.value};
}
/// Row vector v times A.
FT_HOST_DEVICE inline vec3<window_real> row_times(vec3<window_real> v, mat3<window_real> const& A) {
  return {v.x * A.m[0] + (v.y * A.m[3] + v.z * A.m[6]),
          v.x * A.m[1] + (v.y * A.m[4] + v.z * A.m[7]),
          v.x * A.m[2] + (v.y * A.m[5] + v.z * A.m[8])};
}

/// Cost of a squared weighted error. Source: Huber, "Robust estimation of a location parameter",
/// 1964.
FT_HOST_DEVICE inline window_real robust_cost(window_real chi2, double huber2) {
  window_real const limit = huber2;
  return chi2 <= limit ? chi2 : window_real(2.0) * scalar::sqrt(limit * chi2) - limit;
}
/// Its derivative by chi2.
FT_HOST_DEVICE inline window_real robust_weight(window_real chi2, double huber2) {
  window_real const limit = huber2;
  return chi2 <= limit ? window_real(1.0) : scalar::sqrt(limit / chi2);
}

/// An error of one or two rows: projected minus measured, pixels, and its derivative by the point
/// in the frame of the pose: that of the left camera, or of a multi_rig's body.
struct window_error {
  window_real e[2];
  vec3<window_real> J[2];
  window_real weight;
  bool seen;  ///< whether the point has an image

  FT_HOST_DEVICE window_real chi2() const { return weight * (e[0] * e[0] + e[1] * e[1]); }
  /// At NaN the point has no image.
  FT_HOST_DEVICE bool valid() const { return seen && scalar::is_finite(chi2()); }
};

/// The errors of an observation: first() its pixel's, and for a rectified pair with a right column
/// second() its disparity's, which counts as an observation of its own.
template <typename Rig>
struct window_residual {
  using real = window_real;
  Rig const& rig;
  window_observation const& o;
  vec3<real> x;  ///< point in the frame of the pose, metres

  FT_HOST_DEVICE static real wide(float v) { return real(static_cast<double>(v)); }

  /// @param camera of the rig
  FT_HOST_DEVICE window_error first(int camera) const {
    window_error r;
    r.weight = wide(o.inv_sigma2);
    if constexpr (is_monocular_v<Rig>) {
      static_cast<void>(camera);
      set(r, rig.camera.template cast<real>().project_with_jacobian(x));
    } else if constexpr (Rig::rectified) {
      real const zero = real(0.0);
      vec3<real> const p = rig.to_camera(camera, x);
      auto const& k = rig.pair(camera).camera;
      real const iz = scalar::reciprocal(p.z);
      real const u = wide(k.fx) * (p.x * iz);
      real const v = wide(k.fy) * (p.y * iz);
      r.e[0] = u + wide(k.cx) - wide(o.x);
      r.e[1] = v + wide(k.cy) - wide(o.y);
      r.J[0] = by_body(camera, {wide(k.fx) * iz, zero, -(u * iz)});
      r.J[1] = by_body(camera, {zero, wide(k.fy) * iz, -(v * iz)});
      r.seen = p.z > zero;
    } else if (camera == 0) {
      set(r, rig.left.template cast<real>().project_with_jacobian(x));
    } else {
      auto const T = rig.T_rl.template cast<real>();
      set(r, rig.right.template cast<real>().project_with_jacobian(T * x));
      r.J[0] = row_times(r.J[0], T.R);
      r.J[1] = row_times(r.J[1], T.R);
    }
    return r;
  }
  FT_HOST_DEVICE bool has_second() const {
    return Rig::rectified && !is_monocular_v<Rig> && o.right_x >= 0;
  }
  FT_HOST_DEVICE window_error second(window_params const& params, int camera = 0) const {
    window_error r;
    real const zero = real(0.0);
    r.e[1] = zero;
    r.J[1] = {zero, zero, zero};
    if constexpr (Rig::rectified && !is_monocular_v<Rig>) {
      real const z = rig.to_camera(camera, x).z;
      real const iz = scalar::reciprocal(z);
      real const disparity = wide(rig.pair(camera).bf()) * iz;
      r.weight = wide(o.inv_sigma2) * real(params.disparity_weight);
      r.e[0] = disparity - (wide(o.x) - wide(o.right_x));
      r.J[0] = by_body(camera, {zero, zero, -(disparity * iz)});
      r.seen = z > zero;
    } else {
      r.weight = r.e[0] = zero;
      r.J[0] = r.J[1];
      r.seen = false;
    }
    return r;
  }

private:
  /// A row of the derivative by the point in a camera's frame, to that in the frame of the pose.
  FT_HOST_DEVICE vec3<real> by_body(int camera, vec3<real> row) const {
    if constexpr (std::is_same_v<Rig, rectified_rig>) {
      static_cast<void>(camera);
      return row;
    } else {
      return row_times(row, rig.pair(camera).T_cb.template cast<real>().R);
    }
  }
  FT_HOST_DEVICE void set(window_error& r, projection_with_jacobian<real> const& p) const {
    r.e[0] = p.value.pixel.x - wide(o.x);
    r.e[1] = p.value.pixel.y - wide(o.y);
    r.J[0] = {p.jacobian.m[0], p.jacobian.m[1], p.jacobian.m[2]};
    r.J[1] = {p.jacobian.m[3], p.jacobian.m[4], p.jacobian.m[5]};
    r.seen = p.value.valid;
  }
};

/// Sums over the errors of a point in a view: the curvature A of the cost by the point's position
/// and half its gradient f, along the axes of the world.
struct window_normal {
  symmetric_3<window_real> A;
  vec3<window_real> f;
  window_real cost;
  bool linked;  ///< whether A and f have a term

  FT_HOST_DEVICE static window_normal zero() {
    window_real const z = window_real(0.0);
    return {{z, z, z, z, z, z}, {z, z, z}, z, false};
  }
  /// @param R of T_cw
  FT_HOST_DEVICE void add(window_error const& r, mat3<window_real> const& R,
                          window_params const& params) {
    if (!r.valid()) {
      cost += window_real(params.no_image);
      return;
    }
    window_real const chi2 = r.chi2();
    cost += robust_cost(chi2, params.huber2);
    window_real const w = r.weight * robust_weight(chi2, params.huber2);
    vec3<window_real> const rows[2] = {row_times(r.J[0], R), row_times(r.J[1], R)};
    if (!scalar::is_finite(dot(rows[0], rows[0]) + dot(rows[1], rows[1]))) { return; }
    FT_UNROLL
    for (int k = 0; k < 2; ++k) {
      vec3<window_real> const a = rows[k];
      vec3<window_real> const b = scaled(a, w);
      A.xx += b.x * a.x;
      A.xy += b.x * a.y;
      A.xz += b.x * a.z;
      A.yy += b.y * a.y;
      A.yz += b.y * a.z;
      A.zz += b.z * a.z;
      f = f + scaled(b, r.e[k]);
    }
    linked = true;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
