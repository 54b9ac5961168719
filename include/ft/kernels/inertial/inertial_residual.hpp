// SPDX-License-Identifier: Apache-2.0
/// @file Errors of an integral and of a prior, and their derivatives by the states.
///
/// Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry",
/// T-RO 2017, section VI and its supplement. A state moves by p += R dt, R = R Exp(dr); velocity
/// and biases are added to.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/wide_rotation.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

using wide_state = inertial_state<wide>;

/// First columns of the unknowns: the first state's, then the frame's. The frame's biases are not
/// among them: nothing but the walk sees them, so they are always equal to the first state's. It
/// moves in the frame of its pose T_cw, in which the observations are summed.
namespace unknown {
inline constexpr int r1 = 0;   ///< rotation, in the body's frame
inline constexpr int t1 = 3;   ///< translation, in the body's frame
inline constexpr int v1 = 6;   ///< velocity
inline constexpr int g1 = 9;   ///< gyro bias
inline constexpr int a1 = 12;  ///< accelerometer bias
inline constexpr int r2 = 15;  ///< rotation, in the frame of the pose
inline constexpr int t2 = 18;  ///< translation, in the frame of the pose
inline constexpr int v2 = 21;
inline constexpr int all = 24;
}  // namespace unknown

template <typename U, typename S>
FT_HOST_DEVICE inertial_state<U> cast_state(inertial_state<S> const& s) {
  return {s.R.template cast<U>(), s.p.template cast<U>(), s.v.template cast<U>(),
          s.bg.template cast<U>(), s.ba.template cast<U>()};
}

/// The frame of the pose in the body's, and what a small motion is in either: dr_c = R_cb dr and
/// dt_c = R_cb dt + t_cb x dr_c.
struct pose_mount {
  rigid<wide> T_cb;
  wide_mat3 R_bc;

  FT_HOST_DEVICE static pose_mount of(imu_mount const& mount) {
    rigid<wide> const T = mount.T_cb.cast<wide>();
    return {T, T.R.transposed()};
  }
  FT_HOST_DEVICE rigid<wide> pose_of(wide_state const& body) const {
    wide_mat3 const R = T_cb.R * body.R.transposed();
    return {R, T_cb.t - R * body.p};
  }
  FT_HOST_DEVICE wide_vec3 turn_of_body(wide_vec3 turn) const { return R_bc * turn; }
  FT_HOST_DEVICE wide_vec3 shift_of_body(wide_vec3 turn, wide_vec3 shift) const {
    return R_bc * (shift - cross(T_cb.t, turn));
  }
  /// Entry of the 6 x 6 matrix that maps (dr, dt) to (dr_c, dt_c).
  FT_HOST_DEVICE wide entry(int i, int j) const {
    if (i < 3 && j >= 3) { return 0.0; }
    if (i < 3 || j >= 3) { return T_cb.R.m[3 * (i % 3) + j % 3]; }
    wide_vec3 const column{T_cb.R.m[j], T_cb.R.m[3 + j], T_cb.R.m[6 + j]};
    wide_vec3 const moved = cross(T_cb.t, column);
    return i == 3 ? moved.x : (i == 4 ? moved.y : moved.z);
  }
};

/// Error and derivatives of an integral: rotation, velocity, position.
struct inertial_rows {
  static constexpr int rows = 9;
  static constexpr int columns = unknown::all + 1;  ///< the last one is the error
  wide J[rows][columns];

  /// By a group; it syncs before rows are written.
  template <typename Group>
  FT_HOST_DEVICE void clear(Group g) {
    for (int k = g.rank(); k < rows * columns; k += g.size()) { (&J[0][0])[k] = 0.0; }
  }
  FT_HOST_DEVICE void put(int row, int column, wide_mat3 const& m) {
    FT_UNROLL
    for (int i = 0; i < 3; ++i) {
      FT_UNROLL
      for (int j = 0; j < 3; ++j) { J[row + i][column + j] = m.m[3 * i + j]; }
    }
  }
  FT_HOST_DEVICE void put_error(int row, wide_vec3 e) {
    J[row][unknown::all] = e.x;
    J[row + 1][unknown::all] = e.y;
    J[row + 2][unknown::all] = e.z;
  }
};

/// An integral in double precision, without its covariance.
struct inertial_link {
  wide dT;
  wide_mat3 dR, JRg, JVg, JVa, JPg, JPa;
  wide_vec3 dV, dP, bg, ba;
  wide_vec3 gravity;  ///< in the world

  FT_HOST_DEVICE static inertial_link of(preintegrated const& from, vec3<float> gravity) {
    return {wide(static_cast<double>(from.dT)),
            nearest_rotation(from.dR.cast<wide>()),
            from.JRg.cast<wide>(),
            from.JVg.cast<wide>(),
            from.JVa.cast<wide>(),
            from.JPg.cast<wide>(),
            from.JPa.cast<wide>(),
            from.dV.cast<wide>(),
            from.dP.cast<wide>(),
            from.bias.gyro.cast<wide>(),
            from.bias.accel.cast<wide>(),
            gravity.cast<wide>()};
  }

  /// Rows 0 to 2: the rotation.
  FT_HOST_DEVICE void write_rotation(wide_state const& one, wide_state const& two,
                                     pose_mount const& mount, inertial_rows& out) const {
    wide_vec3 const turn = JRg * (one.bg - bg);
    wide_mat3 const between = one.R.transposed() * two.R;
    wide_mat3 const S = (dR * rotation_exp(turn)).transposed() * between;
    wide_vec3 const error = rotation_log(S);
    wide_mat3 const K = inverse_rotation_jacobian(error);
    wide const minus = -1.0;
    out.put_error(0, error);
    out.put(0, unknown::r1, scaled(K * between.transposed(), minus));
    out.put(0, unknown::g1, scaled(K * (S.transposed() * (rotation_jacobian(turn) * JRg)), minus));
    out.put(0, unknown::r2, K * mount.R_bc);
  }

  /// Rows 3 to 8: velocity and position.
  FT_HOST_DEVICE void write_motion(wide_state const& one, wide_state const& two,
                                   pose_mount const& mount, inertial_rows& out) const {
    wide_mat3 const Rt = one.R.transposed();
    wide_vec3 const dg = one.bg - bg;
    wide_vec3 const da = one.ba - ba;
    wide const half_t2 = wide(0.5) * dT * dT;
    wide_vec3 const velocity = Rt * (two.v - one.v - scaled(gravity, dT));
    wide_vec3 const position = Rt * (two.p - one.p - scaled(one.v, dT) - scaled(gravity, half_t2));
    out.put_error(3, velocity - (dV + JVg * dg + JVa * da));
    out.put_error(6, position - (dP + JPg * dg + JPa * da));
    wide const minus = -1.0;
    out.put(3, unknown::r1, cross_matrix(velocity));
    out.put(3, unknown::v1, scaled(Rt, minus));
    out.put(3, unknown::g1, scaled(JVg, minus));
    out.put(3, unknown::a1, scaled(JVa, minus));
    out.put(3, unknown::v2, Rt);
    out.put(6, unknown::r1, cross_matrix(position));
    out.put(6, unknown::t1, scaled(wide_mat3::identity(), minus));
    out.put(6, unknown::v1, scaled(Rt, -dT));
    out.put(6, unknown::g1, scaled(JPg, minus));
    out.put(6, unknown::a1, scaled(JPa, minus));
    wide_mat3 const shift = Rt * (two.R * mount.R_bc);
    out.put(6, unknown::r2, scaled(shift * cross_matrix(mount.T_cb.t), minus));
    out.put(6, unknown::t2, shift);
  }
};

/// Error of a prior and its derivative, which is block diagonal: `rotation`, `position`, identity.
struct prior_residual {
  wide error[15];
  wide_mat3 rotation;
  wide_mat3 position;

  FT_HOST_DEVICE void set(wide_state const& prior, wide_state const& now) {
    wide_mat3 const Rt = prior.R.transposed();
    wide_mat3 const between = Rt * now.R;
    wide_vec3 const e[5] = {rotation_log(between), Rt * (now.p - prior.p), now.v - prior.v,
                            now.bg - prior.bg, now.ba - prior.ba};
    rotation = inverse_rotation_jacobian(e[0]);
    position = between;
    FT_UNROLL
    for (int k = 0; k < 5; ++k) {
      error[3 * k] = e[k].x;
      error[3 * k + 1] = e[k].y;
      error[3 * k + 2] = e[k].z;
    }
  }

  /// Row i of the transposed derivative times a column of 15 numbers, `stride` apart.
  FT_HOST_DEVICE wide transposed_times(int i, wide const* column, int stride) const {
    if (i >= 6) { return column[stride * i]; }
    auto const& m = i < 3 ? rotation.m : position.m;
    int const k = i < 3 ? 0 : 3;
    wide const* const c = column + stride * k;
    return m[i - k] * c[0] + (m[3 + i - k] * c[stride] + m[6 + i - k] * c[2 * stride]);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
