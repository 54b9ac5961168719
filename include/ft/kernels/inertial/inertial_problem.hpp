// SPDX-License-Identifier: Apache-2.0
/// @file Problems of the pose of a frame from its map points and an IMU, and their results.
#pragma once

#include <type_traits>

#include "ft/containers/inertial.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/math/so3.hpp"
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
  // Inputs that may be left out.
  int const* number = nullptr;   ///< [problems][capacity] keypoint of an observation
  float const* moves = nullptr;  ///< [problems][numbers] of keypoints, as in frames_in_map
  int numbers = 0;               ///< keypoints of a frame at most
};

// Errors of an integral and of a prior, and their derivatives by the states.
//
// Source: Forster et al., "On-manifold preintegration for real-time visual-inertial odometry",
// T-RO 2017, section VI and its supplement. A state moves by p += R dt, R = R Exp(dr); velocity
// and biases are added to.

namespace detail {

using wide_state = inertial_state<real64>;

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
  rigid<real64> T_cb;
  strict_mat3d R_bc;

  FT_HOST_DEVICE static pose_mount of(imu_mount const& mount) {
    rigid<real64> const T = mount.T_cb.cast<real64>();
    return {T, T.R.transposed()};
  }
  FT_HOST_DEVICE rigid<real64> pose_of(wide_state const& body) const {
    strict_mat3d const R = T_cb.R * body.R.transposed();
    return {R, T_cb.t - R * body.p};
  }
  FT_HOST_DEVICE strict_vec3d turn_of_body(strict_vec3d turn) const { return R_bc * turn; }
  FT_HOST_DEVICE strict_vec3d shift_of_body(strict_vec3d turn, strict_vec3d shift) const {
    return R_bc * (shift - cross(T_cb.t, turn));
  }
  /// Entry of the 6 x 6 matrix that maps (dr, dt) to (dr_c, dt_c).
  FT_HOST_DEVICE real64 entry(int i, int j) const {
    if (i < 3 && j >= 3) { return 0.0; }
    if (i < 3 || j >= 3) { return T_cb.R.m[3 * (i % 3) + j % 3]; }
    strict_vec3d const column{T_cb.R.m[j], T_cb.R.m[3 + j], T_cb.R.m[6 + j]};
    strict_vec3d const moved = cross(T_cb.t, column);
    return i == 3 ? moved.x : (i == 4 ? moved.y : moved.z);
  }
};

/// Error and derivatives of an integral: rotation, velocity, position.
struct inertial_rows {
  static constexpr int rows = 9;
  static constexpr int columns = unknown::all + 1;  ///< the last one is the error
  real64 J[rows][columns];

  /// By a group; it syncs before rows are written.
  template <typename Group>
  FT_HOST_DEVICE void clear(Group g) {
    for (int k = g.rank(); k < rows * columns; k += g.size()) { (&J[0][0])[k] = 0.0; }
  }
  FT_HOST_DEVICE void put(int row, int column, strict_mat3d const& m) {
    FT_UNROLL
    for (int i = 0; i < 3; ++i) {
      FT_UNROLL
      for (int j = 0; j < 3; ++j) { J[row + i][column + j] = m.m[3 * i + j]; }
    }
  }
  FT_HOST_DEVICE void put_error(int row, strict_vec3d e) {
    J[row][unknown::all] = e.x;
    J[row + 1][unknown::all] = e.y;
    J[row + 2][unknown::all] = e.z;
  }
};

/// An integral in double precision, without its covariance.
struct inertial_link {
  real64 dT;
  strict_mat3d dR, JRg, JVg, JVa, JPg, JPa;
  strict_vec3d dV, dP, bg, ba;
  strict_vec3d gravity;  ///< in the world

  FT_HOST_DEVICE static inertial_link of(preintegrated const& from, vec3<float> gravity) {
    return {real64(static_cast<double>(from.dT)),
            nearest_rotation(from.dR.cast<real64>()),
            from.JRg.cast<real64>(),
            from.JVg.cast<real64>(),
            from.JVa.cast<real64>(),
            from.JPg.cast<real64>(),
            from.JPa.cast<real64>(),
            from.dV.cast<real64>(),
            from.dP.cast<real64>(),
            from.bias.gyro.cast<real64>(),
            from.bias.accel.cast<real64>(),
            gravity.cast<real64>()};
  }

  /// Rows 0 to 2: the rotation.
  FT_HOST_DEVICE void write_rotation(wide_state const& one, wide_state const& two,
                                     pose_mount const& mount, inertial_rows& out) const {
    strict_vec3d const turn = JRg * (one.bg - bg);
    strict_mat3d const between = one.R.transposed() * two.R;
    strict_mat3d const S = (dR * rotation_exp(turn)).transposed() * between;
    strict_vec3d const error = rotation_log(S);
    strict_mat3d const K = inverse_rotation_jacobian(error);
    real64 const minus = -1.0;
    out.put_error(0, error);
    out.put(0, unknown::r1, scaled(K * between.transposed(), minus));
    out.put(0, unknown::g1, scaled(K * (S.transposed() * (rotation_jacobian(turn) * JRg)), minus));
    out.put(0, unknown::r2, K * mount.R_bc);
  }

  /// Rows 3 to 8: velocity and position.
  FT_HOST_DEVICE void write_motion(wide_state const& one, wide_state const& two,
                                   pose_mount const& mount, inertial_rows& out) const {
    strict_mat3d const Rt = one.R.transposed();
    strict_vec3d const dg = one.bg - bg;
    strict_vec3d const da = one.ba - ba;
    real64 const half_t2 = real64(0.5) * dT * dT;
    strict_vec3d const velocity = Rt * (two.v - one.v - scaled(gravity, dT));
    strict_vec3d const position =
        Rt * (two.p - one.p - scaled(one.v, dT) - scaled(gravity, half_t2));
    out.put_error(3, velocity - (dV + JVg * dg + JVa * da));
    out.put_error(6, position - (dP + JPg * dg + JPa * da));
    real64 const minus = -1.0;
    out.put(3, unknown::r1, cross_matrix(velocity));
    out.put(3, unknown::v1, scaled(Rt, minus));
    out.put(3, unknown::g1, scaled(JVg, minus));
    out.put(3, unknown::a1, scaled(JVa, minus));
    out.put(3, unknown::v2, Rt);
    out.put(6, unknown::r1, cross_matrix(position));
    out.put(6, unknown::t1, scaled(strict_mat3d::identity(), minus));
    out.put(6, unknown::v1, scaled(Rt, -dT));
    out.put(6, unknown::g1, scaled(JPg, minus));
    out.put(6, unknown::a1, scaled(JPa, minus));
    strict_mat3d const shift = Rt * (two.R * mount.R_bc);
    out.put(6, unknown::r2, scaled(shift * cross_matrix(mount.T_cb.t), minus));
    out.put(6, unknown::t2, shift);
  }
};

/// Error of a prior and its derivative, which is block diagonal: `rotation`, `position`, identity.
struct prior_residual {
  real64 error[15];
  strict_mat3d rotation;
  strict_mat3d position;

  FT_HOST_DEVICE void set(wide_state const& prior, wide_state const& now) {
    strict_mat3d const Rt = prior.R.transposed();
    strict_mat3d const between = Rt * now.R;
    strict_vec3d const e[5] = {rotation_log(between), Rt * (now.p - prior.p), now.v - prior.v,
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
  FT_HOST_DEVICE real64 transposed_times(int i, real64 const* column, int stride) const {
    if (i >= 6) { return column[stride * i]; }
    auto const& m = i < 3 ? rotation.m : position.m;
    int const k = i < 3 ? 0 : 3;
    real64 const* const c = column + stride * k;
    return m[i - k] * c[0] + (m[3 + i - k] * c[stride] + m[6 + i - k] * c[2 * stride]);
  }
};

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
