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
  real64 gyro_axis[3], gyro_work[3];
  least_squares<most_unknowns> equations;
  strict_vec3d residual[most_threads];   ///< of intervals
  joined_integrals joined[most_joined];  ///< from the first keyframe to the first of the others
  joined_integrals after;                ///< the same, to a keyframe behind those
  least_squares<5> sum;                  ///< of several windows
  inertial_initialization found;         ///< for callers

  // What the steps of one window hand on.
  int resting;
  int directions;  ///< of the changes of gravity: 3 at first, then 2
  strict_vec3d gyro_bias, gravity;
  strict_vec3d basis[3];  ///< the directions, m/s^2 each
  real64 scale;
  real64 squares;  ///< that the last solution leaves
  real64 x[most_unknowns];

  /// Rows of the axes of a keyframe's position and of the next one's, their right-hand sides
  /// behind.
  real64 rows[2][3][most_unknowns + 1];
  static constexpr int most_variances = 10;
  real64 asked[most_variances][most_unknowns], work[most_variances][most_unknowns];
  real64 variance[most_variances];  ///< of `asked` . x
};

/// The steps of an initialisation, which all threads of a group take. What a step finds is in the
/// memory that they share.
template <typename Group>
struct inertial_initializer {
  using scratch = initialization_scratch;
  static constexpr int most_unknowns = scratch::most_unknowns;
  static constexpr int refinements = 5;  ///< at most
  /// A smaller change, rad/s or m/s^2, is the last one: the next would be about a thousandth of it.
  static constexpr double step_tolerance = 1e-4;
  using system = least_squares<most_unknowns>;

  /// Places of the unknowns.
  enum : int { velocity = 0, position = 3, bias = 6, direction = 9 };

  Group g;
  scratch& s;
  initialization_window const& in;
  initialization_params const& params;

  /// Ends with a sync.
  FT_HOST_DEVICE inertial_initializer(Group group, scratch& shared,
                                      initialization_window const& window,
                                      initialization_params const& p)
      : g(group), s(shared), in(window), params(p) {
    static_assert(Group::max_threads <= scratch::most_threads, "one residual each");
    g.sync();  // an earlier window's may still be read
    if (g.rank() == 0) {
      s.gyro_bias = s.gravity = {0.0, 0.0, 0.0};
      s.resting = 0;
      s.directions = 3;
      s.basis[0] = {1.0, 0.0, 0.0};
      s.basis[1] = {0.0, 1.0, 0.0};
      s.basis[2] = {0.0, 0.0, 1.0};
      s.scale = 1.0;
      for (int i = 0; i < most_unknowns; ++i) { s.x[i] = 0.0; }
    }
    g.sync();
  }

  FT_HOST_DEVICE int pose_of(int k) const { return s.resting != 0 ? 0 : k; }
  FT_HOST_DEVICE strict_mat3d camera_rotation(int k) const {
    return in.T_wc[pose_of(k)].R.template cast<real64>();
  }
  FT_HOST_DEVICE strict_mat3d rotation(int k) const {
    return camera_rotation(k) * in.mount.T_cb.R.template cast<real64>();
  }
  /// The camera's position from its first one, in the unit of the poses.
  FT_HOST_DEVICE strict_vec3d camera(int k) const {
    return in.T_wc[pose_of(k)].t.template cast<real64>() - in.T_wc[0].t.template cast<real64>();
  }
  /// From the camera's position to the body's, metres.
  FT_HOST_DEVICE strict_vec3d lever(int k) const {
    return camera_rotation(k) * in.mount.T_cb.t.template cast<real64>();
  }
  FT_HOST_DEVICE int unknowns() const {
    return direction + s.directions + (scale_is_sought() ? 1 : 0);
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

  /// Ends with a sync.
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
    bool const resting = !g.any(!still);
    if (g.rank() == 0) { s.resting = resting ? 1 : 0; }
    g.sync();
  }

  /// Gauss-Newton on the rotations of all intervals. Ends with a sync.
  FT_HOST_DEVICE bool find_gyro_bias(inertial_initialization& out) {
    auto& equations = s.gyro;
    FT_NO_UNROLL
    for (int step = 0; step <= refinements; ++step) {
      equations.begin(g, 3);
      if (g.rank() == 0) { s.squares = 0.0; }
      FT_NO_UNROLL
      for (int first = 0; first + 1 < in.count; first += g.size()) { add_rotations(first); }
      if (!equations.factor(g)) { return false; }
      if (step == refinements) { break; }
      bool ends = false;
      if (g.rank() == 0) {
        equations.solve();
        strict_vec3d const change{equations.x[0], equations.x[1], equations.x[2]};
        s.gyro_bias = s.gyro_bias + change;
        ends = dot(change, change) < real64(step_tolerance * step_tolerance);
      }
      if (g.any(ends)) { break; }
    }
    if (g.rank() == 0) { describe_rotations(out); }
    g.sync();
    return true;
  }
  /// A thread's part.
  FT_HOST_DEVICE void describe_rotations(inertial_initialization& out) {
    real64 const rms = scalar::sqrt(s.squares / real64(3.0 * (in.count - 1)));
    // two poses bound an interval
    real64 const given = real64(1.4142135623730951 * params.rotation_sigma);
    real64 sum = 0.0;
    FT_NO_UNROLL
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) { s.gyro_axis[j] = i == j ? 1.0 : 0.0; }
      sum += s.gyro.variance(s.gyro_axis, s.gyro_work);
    }
    out.rotation_rms = static_cast<float>(rms.value);
    out.gyro_bias_sigma =
        static_cast<float>((max_of(given, rms) * scalar::sqrt(sum / real64(3.0))).value);
  }

  /// Intervals `first` and following, one a thread, then added in their order. Ends with a sync.
  FT_HOST_DEVICE void add_rotations(int first) const {
    int const own = first + g.rank();
    if (own + 1 < in.count) {
      strict_mat3d const seen = rotation(own).transposed() * rotation(own + 1);
      strict_mat3d const off = rotation_at(in.integrals[own], s.gyro_bias).transposed() * seen;
      s.residual[g.rank()] = rotation_log(off);
    }
    g.sync();
    int const last = min_of(first + g.size(), in.count - 1);
    FT_NO_UNROLL
    for (int k = first; k < last; ++k) {
      strict_vec3d const r = s.residual[k - first];
      FT_NO_UNROLL
      for (int i = 0; i < 3; ++i) {
        float const* const J = in.integrals[k].JRg.m + 3 * i;
        auto const row = [&](int j) { return real64(static_cast<double>(J[j])); };
        s.gyro.add(g, row, component(r, i), 1.0);
      }
      if (g.rank() == 0) { s.squares += dot(r, r); }
    }
    g.sync();
  }

  /// Joins the integrals at the gyroscope's bias, which stays from then on. Ends with a sync.
  FT_HOST_DEVICE void join_integrals() {
    g.sync();  // the last ones may still be read
    joined_integrals joined = joined_integrals::none();
    FT_NO_UNROLL
    for (int k = 0; k < min_of(in.count, scratch::most_joined); ++k) {
      if (k > 0) { joined.append(in.integrals[k - 1], rotation(k - 1), s.gyro_bias); }
      if (g.rank() == 0) { s.joined[k] = joined; }
    }
    g.sync();
  }
  /// The integrals up to keyframe k, after join_integrals() and the call for k - 1.
  FT_HOST_DEVICE joined_integrals const& joined_up_to(int k) const {
    if (k < scratch::most_joined) { return s.joined[k]; }
    if (g.rank() == 0) {
      if (k == scratch::most_joined) { s.after = s.joined[k - 1]; }
      s.after.append(in.integrals[k - 1], rotation(k - 1), s.gyro_bias);
    }
    g.sync();
    return s.after;
  }

  /// Factor of an unknown in the row of an axis of a keyframe's position.
  FT_HOST_DEVICE real64 factor_of(joined_integrals const& joined, int k, int axis,
                                  int unknown) const {
    if (unknown == velocity + axis) { return joined.T; }
    if (unknown == position + axis) { return 1.0; }
    if (unknown < bias) { return 0.0; }
    if (unknown < direction) { return joined.E.m[3 * axis + unknown - bias]; }
    if (unknown < direction + s.directions) {
      return fall_of(joined) * component(s.basis[unknown - direction], axis);
    }
    if (scale_is_sought() && unknown == direction + s.directions) {
      return -component(camera(k), axis);
    }
    return 0.0;
  }
  FT_HOST_DEVICE static real64 fall_of(joined_integrals const& joined) {
    return real64(0.5) * joined.T * joined.T;
  }
  FT_HOST_DEVICE real64 right_of(joined_integrals const& joined, int k, int axis) const {
    real64 right = component(lever(k), axis) - component(joined.D, axis) -
                   fall_of(joined) * component(s.gravity, axis);
    if (!scale_is_sought()) { right += component(camera(k), axis); }
    return right;
  }
  /// Rows of keyframe k.
  FT_HOST_DEVICE void fill_rows(joined_integrals const& joined, int k) const {
    constexpr int columns = most_unknowns + 1;
    for (int i = g.rank(); i < 3 * columns; i += g.size()) {
      int const axis = i / columns, column = i % columns;
      s.rows[k % 2][axis][column] =
          column == most_unknowns ? right_of(joined, k, axis) : factor_of(joined, k, axis, column);
    }
  }
  /// Adds what the last solution leaves of keyframe k. A thread's part.
  FT_HOST_DEVICE void add_squares(int k) const {
    FT_NO_UNROLL
    for (int axis = 0; axis < 3; ++axis) {
      auto const& row = s.rows[k % 2][axis];
      real64 off = row[most_unknowns];
      for (int i = 0; i < unknowns(); ++i) { off -= row[i] * s.x[i]; }
      s.squares += off * off;
    }
  }

  /// Builds the system, and sums the squares that the last solution leaves. Ends with a sync.
  FT_HOST_DEVICE void build() const {
    system& equations = s.equations;
    g.sync();  // the last one may still be read
    equations.begin(g, unknowns());
    real64 const sigma = s.scale * real64(static_cast<double>(params.position_sigma));
    real64 const weight = real64(1.0) / (sigma * sigma);
    if (g.rank() == g.size() - 1) { s.squares = 0.0; }
    real64 T = 0.0;
    FT_NO_UNROLL
    for (int k = 0; k < in.count; ++k) {
      joined_integrals const& joined = joined_up_to(k);
      T = joined.T;
      fill_rows(joined, k);
      g.sync();
      FT_NO_UNROLL
      for (int axis = 0; axis < 3; ++axis) {
        auto const& row = s.rows[k % 2][axis];
        equations.add(
            g, [&](int i) { return row[i]; }, row[most_unknowns], weight);
      }
      if (g.rank() == g.size() - 1) { add_squares(k); }
    }
    real64 const prior = static_cast<double>(params.accel_bias_sigma);
    for (int i = 0; i < 3; ++i) {
      equations.pull_to_zero(g, bias + i, real64(1.0) / (prior * prior));
    }
    if (s.resting != 0) {
      // it can have moved by the distance of rest
      real64 const slow = real64(static_cast<double>(max_of(params.rest_distance, 1e-6f))) / T;
      for (int i = 0; i < 3; ++i) {
        equations.pull_to_zero(g, velocity + i, real64(1.0) / (slow * slow));
      }
    }
    g.sync();
  }

  /// Gravity on its sphere, and two directions to change it in. A thread's part.
  FT_HOST_DEVICE bool set_gravity(strict_vec3d found) {
    real64 const length = norm_of(found);
    real64 const G = static_cast<double>(params.gravity);
    if (!(length > real64(0.1) * G)) { return false; }
    strict_vec3d const gravity = scaled(found, G / length);
    strict_vec3d const a{scalar::abs(found.x), scalar::abs(found.y), scalar::abs(found.z)};
    strict_vec3d const other = a.x <= a.y && a.x <= a.z ? strict_vec3d{1.0, 0.0, 0.0}
                               : a.y <= a.z             ? strict_vec3d{0.0, 1.0, 0.0}
                                                        : strict_vec3d{0.0, 0.0, 1.0};
    strict_vec3d const side = cross(gravity, other);
    s.gravity = gravity;
    s.basis[0] = scaled(side, G / norm_of(side));
    s.basis[1] = scaled(cross(gravity, s.basis[0]), real64(1.0) / G);
    s.directions = 2;
    return true;
  }

  /// Velocity, gravity, bias, scale. Leaves the system of the solution, factored, and the squares
  /// that it leaves. Ends with a sync.
  FT_HOST_DEVICE bool solve() {
    system& equations = s.equations;
    join_integrals();
    FT_NO_UNROLL
    for (int step = 0; step <= refinements; ++step) {
      build();
      if (!equations.factor(g)) { return false; }
      bool failed = false, ends = false;
      if (g.rank() == 0) { failed = !take_solution(ends); }
      if (g.any(failed)) { return false; }
      if (g.any(ends)) { break; }
    }
    build();
    return equations.factor(g);
  }

private:
  /// A thread's part. @param ends whether gravity hardly changed
  FT_HOST_DEVICE bool take_solution(bool& ends) {
    system& equations = s.equations;
    equations.solve();
    real64 const* const next = equations.x;
    strict_vec3d pull = s.gravity;
    for (int j = 0; j < s.directions; ++j) {
      pull = pull + scaled(s.basis[j], next[direction + j]);
    }
    if (scale_is_sought()) { s.scale = next[direction + s.directions]; }
    strict_vec3d const before = s.gravity;
    if (!(s.scale > real64(0.0)) || !set_gravity(pull)) { return false; }
    for (int i = 0; i < direction; ++i) { s.x[i] = next[i]; }
    for (int i = direction; i < most_unknowns; ++i) { s.x[i] = 0.0; }
    if (scale_is_sought()) { s.x[direction + s.directions] = s.scale; }
    strict_vec3d const change = s.gravity - before;
    ends = dot(change, change) < real64(step_tolerance * step_tolerance);
    return true;
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
