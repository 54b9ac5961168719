// SPDX-License-Identifier: Apache-2.0
/// @file How an initialisation of a body with an IMU is solved. Not API.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/inertial/initialization.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// What the threads of a group share.
struct initialization_scratch {
  static constexpr int most_unknowns = 13;
  static constexpr int most_threads = 32;
  static constexpr int most_joined = 64;
  least_squares<3> gyro;
  least_squares<most_unknowns> equations;
  strict_vec3d residual[most_threads];   ///< of intervals
  joined_integrals joined[most_joined];  ///< from the first keyframe to the first of the others
};

/// The steps of an initialisation. Members are what the steps hand on. All threads of a group take
/// the same steps with the same numbers; they share the equations, and what takes long.
template <typename Group>
struct inertial_initializer {
  using scratch = initialization_scratch;
  static constexpr int most_unknowns = scratch::most_unknowns;
  static constexpr int refinements = 5;  ///< at most
  /// A smaller change, rad/s or m/s^2, is the last one: the next would be about a thousandth of it.
  static constexpr double step_tolerance = 1e-4;
  using system = least_squares<most_unknowns>;

  /// Factors of the unknowns, 0 at first.
  struct unknown_row {
    real64 x[most_unknowns];
    FT_HOST_DEVICE unknown_row() {
      for (int i = 0; i < most_unknowns; ++i) { x[i] = 0.0; }
    }
  };

  /// Places of the unknowns.
  enum : int { velocity = 0, position = 3, bias = 6, direction = 9 };

  Group g;
  scratch& s;
  initialization_window const& in;
  initialization_params const& params;
  strict_mat3d R_cb;
  strict_vec3d t_cb;
  bool resting;
  strict_vec3d gyro_bias, gravity;
  strict_vec3d basis[3];  ///< of the changes of gravity, m/s^2 each
  int directions;         ///< how many of them: 3 at first, then 2
  real64 scale;
  real64 x[most_unknowns];

  FT_HOST_DEVICE inertial_initializer(Group group, scratch& shared,
                                      initialization_window const& window,
                                      initialization_params const& p)
      : g(group), s(shared), in(window), params(p) {
    static_assert(Group::max_threads <= scratch::most_threads, "one residual each");
    R_cb = in.mount.T_cb.R.template cast<real64>();
    t_cb = in.mount.T_cb.t.template cast<real64>();
    gyro_bias = gravity = {0.0, 0.0, 0.0};
    resting = false;
    directions = 3;
    basis[0] = {1.0, 0.0, 0.0};
    basis[1] = {0.0, 1.0, 0.0};
    basis[2] = {0.0, 0.0, 1.0};
    scale = 1.0;
    for (int i = 0; i < most_unknowns; ++i) { x[i] = 0.0; }
  }

  FT_HOST_DEVICE int pose_of(int k) const { return resting ? 0 : k; }
  FT_HOST_DEVICE strict_mat3d camera_rotation(int k) const {
    return in.T_wc[pose_of(k)].R.template cast<real64>();
  }
  FT_HOST_DEVICE strict_mat3d rotation(int k) const { return camera_rotation(k) * R_cb; }
  /// The camera's position from its first one, in the unit of the poses.
  FT_HOST_DEVICE strict_vec3d camera(int k) const {
    return in.T_wc[pose_of(k)].t.template cast<real64>() - in.T_wc[0].t.template cast<real64>();
  }
  /// From the camera's position to the body's, metres.
  FT_HOST_DEVICE strict_vec3d lever(int k) const { return camera_rotation(k) * t_cb; }
  FT_HOST_DEVICE int unknowns() const {
    return direction + directions + (scale_is_sought() ? 1 : 0);
  }
  FT_HOST_DEVICE bool scale_is_sought() const { return !params.known_scale; }

  FT_HOST_DEVICE initialization_status check_input() const {
    if (in.count < params.least_keyframes) { return initialization_status::few_keyframes; }
    bool missing = false;
    bool finite = true;
    for (int k = g.rank(); k < in.count; k += g.size()) {
      real64 sum = dot(camera(k), camera(k));
      for (int i = 0; i < 9; ++i) { sum += in.T_wc[k].R.m[i]; }
      if (k + 1 < in.count) {
        missing = missing || !has_integral(in.integrals[k]);
        sum += sum_of_numbers(in.integrals[k]);
      }
      finite = finite && scalar::is_finite(sum);
    }
    if (g.any(missing)) { return initialization_status::no_integral; }
    return g.any(!finite) ? initialization_status::not_finite : initialization_status::initialized;
  }
  FT_HOST_DEVICE static bool has_integral(preintegrated const& p) {
    return usable(p.status) && p.steps >= 1 && !(p.dT <= 0);
  }
  /// Not finite if one of them is not.
  FT_HOST_DEVICE static real64 sum_of_numbers(preintegrated const& p) {
    strict_vec3d const v = p.dV.template cast<real64>() + p.dP.template cast<real64>() +
                           p.bias.gyro.template cast<real64>() +
                           p.bias.accel.template cast<real64>();
    real64 sum = real64(static_cast<double>(p.dT)) + (v.x + (v.y + v.z));
    for (int i = 0; i < 9; ++i) {
      sum += static_cast<double>(p.dR.m[i]) + static_cast<double>(p.JRg.m[i]);
      sum += static_cast<double>(p.JVg.m[i]) + static_cast<double>(p.JVa.m[i]);
      sum += static_cast<double>(p.JPg.m[i]) + static_cast<double>(p.JPa.m[i]);
    }
    return sum;
  }

  FT_HOST_DEVICE void find_rest() {
    if (scale_is_sought()) { return; }
    bool still = true;
    real64 const angle = static_cast<double>(params.rest_angle);
    strict_mat3d const first = camera_rotation(0);
    for (int k = 1 + g.rank(); k < in.count; k += g.size()) {
      still = still && norm_of(camera(k)) <= real64(static_cast<double>(params.rest_distance));
      strict_mat3d const R = camera_rotation(k);
      real64 sum = 0.0;
      for (int i = 0; i < 9; ++i) { sum += (R.m[i] - first.m[i]) * (R.m[i] - first.m[i]); }
      // the sum is 8 sin^2 of half the angle
      still = still && sum <= real64(2.0) * angle * angle;
    }
    resting = !g.any(!still);
  }

  /// Gauss-Newton on the rotations of all intervals.
  FT_HOST_DEVICE bool find_gyro_bias(inertial_initialization& out) {
    auto& equations = s.gyro;
    real64 squares = 0.0;
    FT_NO_UNROLL
    for (int step = 0; step <= refinements; ++step) {
      equations.begin(g, 3);
      squares = 0.0;
      FT_NO_UNROLL
      for (int first = 0; first + 1 < in.count; first += g.size()) {
        add_rotations(first, squares);
      }
      if (!equations.factor(g)) { return false; }
      if (step == refinements) { break; }
      real64 d[3] = {equations.b[0], equations.b[1], equations.b[2]};
      equations.solve(d);
      strict_vec3d const change{d[0], d[1], d[2]};
      gyro_bias = gyro_bias + change;
      if (dot(change, change) < real64(step_tolerance * step_tolerance)) { break; }
      g.sync();
    }
    real64 const rms = scalar::sqrt(squares / real64(3.0 * (in.count - 1)));
    // two poses bound an interval
    real64 const given = real64(1.4142135623730951 * params.rotation_sigma);
    real64 sum = 0.0;
    for (int i = 0; i < 3; ++i) {
      real64 const row[3] = {i == 0 ? 1.0 : 0.0, i == 1 ? 1.0 : 0.0, i == 2 ? 1.0 : 0.0};
      sum += equations.variance(row);
    }
    out.rotation_rms = static_cast<float>(rms.value);
    out.gyro_bias_sigma =
        static_cast<float>((max_of(given, rms) * scalar::sqrt(sum / real64(3.0))).value);
    return true;
  }

  /// Intervals `first` and following, one a thread, then added in their order. Ends with a sync.
  FT_HOST_DEVICE void add_rotations(int first, real64& squares) const {
    int const own = first + g.rank();
    if (own + 1 < in.count) {
      strict_mat3d const seen = rotation(own).transposed() * rotation(own + 1);
      strict_mat3d const off = rotation_at(in.integrals[own], gyro_bias).transposed() * seen;
      s.residual[g.rank()] = rotation_log(off);
    }
    g.sync();
    int const last = min_of(first + g.size(), in.count - 1);
    FT_NO_UNROLL
    for (int k = first; k < last; ++k) {
      strict_mat3d const J = in.integrals[k].JRg.template cast<real64>();
      strict_vec3d const r = s.residual[k - first];
      for (int i = 0; i < 3; ++i) {
        real64 const row[3] = {J.m[3 * i], J.m[3 * i + 1], J.m[3 * i + 2]};
        s.gyro.add(g, row, component(r, i), 1.0);
      }
      squares += dot(r, r);
    }
    g.sync();
  }

  /// Joins the integrals at the gyroscope's bias, which stays from then on. Ends with a sync.
  FT_HOST_DEVICE void join_integrals() {
    g.sync();  // the last ones may still be read
    joined_integrals joined = joined_integrals::none();
    FT_NO_UNROLL
    for (int k = 0; k < min_of(in.count, scratch::most_joined); ++k) {
      if (k > 0) { joined.append(in.integrals[k - 1], rotation(k - 1), gyro_bias); }
      if (g.rank() == 0) { s.joined[k] = joined; }
    }
    g.sync();
  }
  /// The integrals up to keyframe k, after join_integrals(). @param before those up to k - 1
  FT_HOST_DEVICE joined_integrals joined_up_to(int k, joined_integrals const& before) const {
    if (k < scratch::most_joined) { return s.joined[k]; }
    joined_integrals joined = before;
    joined.append(in.integrals[k - 1], rotation(k - 1), gyro_bias);
    return joined;
  }

  /// Row of one axis of a keyframe's position, and its right-hand side.
  FT_HOST_DEVICE real64 fill_row(joined_integrals const& joined, int k, int axis,
                                 real64 (&row)[most_unknowns]) const {
    row[velocity + axis] = joined.T;
    row[position + axis] = 1.0;
    for (int j = 0; j < 3; ++j) { row[bias + j] = joined.E.m[3 * axis + j]; }
    real64 const fall = real64(0.5) * joined.T * joined.T;
    for (int j = 0; j < directions; ++j) { row[direction + j] = fall * component(basis[j], axis); }
    real64 const seen = component(camera(k), axis);
    real64 right =
        component(lever(k), axis) - component(joined.D, axis) - fall * component(gravity, axis);
    if (scale_is_sought()) {
      row[direction + directions] = -seen;
    } else {
      right += seen;
    }
    return right;
  }

  /// Builds the system, and sums the squares that the last solution leaves. Ends with a sync.
  FT_HOST_DEVICE real64 build() const {
    system& equations = s.equations;
    g.sync();  // the last one may still be read
    equations.begin(g, unknowns());
    real64 const sigma = scale * real64(static_cast<double>(params.position_sigma));
    real64 const weight = real64(1.0) / (sigma * sigma);
    real64 squares = 0.0;
    joined_integrals joined = joined_integrals::none();
    FT_NO_UNROLL
    for (int k = 0; k < in.count; ++k) {
      joined = joined_up_to(k, joined);
      for (int axis = 0; axis < 3; ++axis) {
        unknown_row row;
        real64 const right = fill_row(joined, k, axis, row.x);
        equations.add(g, row.x, right, weight);
        real64 off = right;
        for (int i = 0; i < unknowns(); ++i) { off -= row.x[i] * x[i]; }
        squares += off * off;
      }
    }
    real64 const prior = static_cast<double>(params.accel_bias_sigma);
    for (int i = 0; i < 3; ++i) {
      equations.pull_to_zero(g, bias + i, real64(1.0) / (prior * prior));
    }
    if (resting) {
      // it can have moved by the distance of rest
      real64 const slow =
          real64(static_cast<double>(max_of(params.rest_distance, 1e-6f))) / joined.T;
      for (int i = 0; i < 3; ++i) {
        equations.pull_to_zero(g, velocity + i, real64(1.0) / (slow * slow));
      }
    }
    g.sync();
    return squares;
  }

  /// Gravity on its sphere, and two directions to change it in.
  FT_HOST_DEVICE bool set_gravity(strict_vec3d found) {
    real64 const length = norm_of(found);
    real64 const G = static_cast<double>(params.gravity);
    if (!(length > real64(0.1) * G)) { return false; }
    gravity = scaled(found, G / length);
    strict_vec3d const a{scalar::abs(found.x), scalar::abs(found.y), scalar::abs(found.z)};
    strict_vec3d const other = a.x <= a.y && a.x <= a.z ? strict_vec3d{1.0, 0.0, 0.0}
                               : a.y <= a.z             ? strict_vec3d{0.0, 1.0, 0.0}
                                                        : strict_vec3d{0.0, 0.0, 1.0};
    strict_vec3d const side = cross(gravity, other);
    basis[0] = scaled(side, G / norm_of(side));
    basis[1] = scaled(cross(gravity, basis[0]), real64(1.0) / G);
    directions = 2;
    return true;
  }

  /// Velocity, gravity, bias, scale. Leaves the system of the solution, factored.
  FT_HOST_DEVICE bool solve(real64& squares) {
    system& equations = s.equations;
    join_integrals();
    FT_NO_UNROLL
    for (int step = 0; step <= refinements; ++step) {
      build();
      real64 next[most_unknowns];
      for (int i = 0; i < most_unknowns; ++i) { next[i] = equations.b[i]; }
      if (!equations.factor(g)) { return false; }
      equations.solve(next);
      strict_vec3d pull = gravity;
      for (int j = 0; j < directions; ++j) { pull = pull + scaled(basis[j], next[direction + j]); }
      if (scale_is_sought()) { scale = next[direction + directions]; }
      strict_vec3d const before = gravity;
      if (!(scale > real64(0.0)) || !set_gravity(pull)) { return false; }
      for (int i = 0; i < direction; ++i) { x[i] = next[i]; }
      for (int i = direction; i < most_unknowns; ++i) { x[i] = 0.0; }
      if (scale_is_sought()) { x[direction + directions] = scale; }
      strict_vec3d const change = gravity - before;
      if (dot(change, change) < real64(step_tolerance * step_tolerance)) { break; }
    }
    squares = build();
    return equations.factor(g);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
