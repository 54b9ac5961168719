// SPDX-License-Identifier: Apache-2.0
/// @file Stage: integrates the measurements of an IMU between two images, with covariance and with
/// derivatives by the biases.
#pragma once

#include "ft/containers/inertial.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/math/so3.hpp"
#include "ft/types/imu.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// How an integral takes its next steps.
struct integral_start {
  int interval;   ///< whose steps; several integrals may take the same ones
  int anew;       ///< 0: runs on from what it is; otherwise begins with `bias`
  imu_bias bias;  ///< ignored when it runs on
};

namespace detail {

/// The part of an integral that each step changes as a whole.
struct integrated_motion {
  strict_float dT;
  strict_mat3f dR;
  strict_vec3f dV, dP, bg, ba, mean_accel, mean_gyro;
};

/// The rest of an integral, and how a step changes it: with E = [covariance | derivatives by the
/// gyro's bias | by the accelerometer's], a step makes A E of it, and the covariance A C A^T. Rows
/// are rotation, velocity, position.
struct integration_scratch {
  static constexpr int columns = 15;
  static constexpr int elements = 9 * columns;

  strict_float E[elements];
  strict_float AE[elements];
  strict_float A[27];  ///< columns of A for rotation; the others are known
  strict_float B[27];  ///< effect of a measurement's noise: gyro on rotation, else accelerometer
};

/// Item: an integral. Threads share the elements of the matrices; all compute the motion.
struct preintegrate_steps {
  using scratch = integration_scratch;
  static constexpr int columns = integration_scratch::columns;
  static constexpr int elements = integration_scratch::elements;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, imu_steps_view const& from,
                                 integral_start const* starts, imu_variances const& noise,
                                 preintegrated* integrals) const {
    integral_start const start = starts[item];
    imu_selection const chosen = from.chosen[start.interval];
    preintegrated& integral = integrals[item];
    bool const anew = start.anew != 0;
    integrated_motion m = anew ? begin(start.bias) : load(integral);
    for (int e = g.rank(); e < elements; e += g.size()) {
      float const* const old = anew ? nullptr : element(integral, e);
      s.E[e] = old == nullptr ? 0.0f : *old;
    }
    imu_step const* const steps = from.of(start.interval);
    FT_NO_UNROLL
    for (int k = 0; k < chosen.steps; ++k) {
      imu_step const step = steps[k];
      advance(g, s, m, step);
      propagate(g, s, step.dt, noise);
    }
    g.sync();
    for (int e = g.rank(); e < elements; e += g.size()) {
      float* const to = element(integral, e);
      if (to != nullptr) { *to = s.E[e].value; }
    }
    for (int k = g.rank(); k < 6; k += g.size()) {
      strict_float walk = anew ? 0.0f : integral.walk[k];
      for (int n = 0; n < chosen.steps; ++n) { walk += strict_float(noise.walk[k]); }
      integral.walk[k] = walk.value;
    }
    if (g.rank() == 0) { store(integral, m, start, chosen); }
  }

private:
  FT_HOST_DEVICE static integrated_motion begin(imu_bias const& bias) {
    strict_vec3f const zero{0.0f, 0.0f, 0.0f};
    return {0.0f,
            strict_mat3f::identity(),
            zero,
            zero,
            bias.gyro.cast<strict_float>(),
            bias.accel.cast<strict_float>(),
            zero,
            zero};
  }
  FT_HOST_DEVICE static integrated_motion load(preintegrated const& from) {
    return {from.dT,
            from.dR.cast<strict_float>(),
            from.dV.cast<strict_float>(),
            from.dP.cast<strict_float>(),
            from.bias.gyro.cast<strict_float>(),
            from.bias.accel.cast<strict_float>(),
            from.mean_accel.cast<strict_float>(),
            from.mean_gyro.cast<strict_float>()};
  }
  FT_HOST_DEVICE static void store(preintegrated& to, integrated_motion const& m,
                                   integral_start const& start, imu_selection const& chosen) {
    to.dT = m.dT.value;
    to.dR = m.dR.cast<float>();
    to.dV = m.dV.cast<float>();
    to.dP = m.dP.cast<float>();
    to.mean_accel = m.mean_accel.cast<float>();
    to.mean_gyro = m.mean_gyro.cast<float>();
    if (start.anew != 0) {
      to.bias = start.bias;
      to.steps = chosen.steps;
      to.status = chosen.status;
    } else {
      to.steps += chosen.steps;
      to.status = joined(to.status, chosen.status);
    }
  }
  /// An integral that lacks an interval never becomes whole again.
  FT_HOST_DEVICE static integration_status joined(integration_status before,
                                                  integration_status now) {
    return usable(before) && now != integration_status::integrated ? now : before;
  }

  /// Where an element of E is in an integral; null for those that are always zero.
  template <typename Integral>
  FT_HOST_DEVICE static auto element(Integral& in, int e) -> decltype(&in.C[0]) {
    int const row = e / columns;
    int const column = e % columns;
    if (column < 9) { return &in.C[9 * row + column]; }
    int const block = row / 3;
    int const at = 3 * (row % 3) + column % 3;
    if (column < 12) { return (block == 0 ? in.JRg : block == 1 ? in.JVg : in.JPg).m + at; }
    return block == 0 ? nullptr : (block == 1 ? in.JVa : in.JPa).m + at;
  }

  /// Moves on by a step, and writes A and B of it.
  template <typename Group>
  FT_HOST_DEVICE static void advance(Group g, scratch& s, integrated_motion& m,
                                     imu_step const& step) {
    strict_float const dt = step.dt;
    strict_float const half_dt2 = strict_float(0.5f) * dt * dt;
    strict_vec3f const x = step.accel.cast<strict_float>() - m.ba;
    strict_vec3f const y = step.gyro.cast<strict_float>() - m.bg;
    strict_vec3f const force = m.dR * x;
    strict_float const whole = m.dT + dt;
    auto const mean = [&](strict_float old, strict_float now) {
      return (m.dT * old + now * dt) / whole;
    };
    m.mean_accel = {mean(m.mean_accel.x, force.x), mean(m.mean_accel.y, force.y),
                    mean(m.mean_accel.z, force.z)};
    m.mean_gyro = {mean(m.mean_gyro.x, y.x), mean(m.mean_gyro.y, y.y), mean(m.mean_gyro.z, y.z)};
    m.dP = m.dP + scaled(m.dV, dt) + scaled(force, half_dt2);
    m.dV = m.dV + scaled(force, dt);
    auto const turn = rotation_exp_and_jacobian(scaled(y, dt));
    strict_mat3f const effect = times_cross(m.dR, x);
    g.sync();  // the step before has been read
    if (g.rank() == 0) {
      strict_mat3f const back = turn.E.transposed();
      FT_UNROLL
      for (int i = 0; i < 9; ++i) {
        s.A[i] = back.m[i];
        s.A[9 + i] = -(effect.m[i] * dt);
        s.A[18 + i] = -(effect.m[i] * half_dt2);
        s.B[i] = turn.Jr.m[i] * dt;
        s.B[9 + i] = m.dR.m[i] * dt;
        s.B[18 + i] = m.dR.m[i] * half_dt2;
      }
    }
    m.dR = nearest_rotation(m.dR * turn.E);
    m.dT = whole;
    g.sync();
  }

  /// A row of A times a column of three blocks, `gap` apart.
  FT_HOST_DEVICE static strict_float row_times(scratch const& s, int row, strict_float dt,
                                               strict_float const* column, int gap) {
    int const block = row / 3;
    strict_float const* const a = s.A + 3 * row;
    strict_float const sum = a[0] * column[0] + (a[1] * column[gap] + a[2] * column[2 * gap]);
    if (block == 0) { return sum; }
    strict_float const velocity = column[(3 + row % 3) * gap];
    if (block == 1) { return sum + velocity; }
    return sum + (dt * velocity + column[(6 + row % 3) * gap]);
  }

  template <typename Group>
  FT_HOST_DEVICE static void propagate(Group g, scratch& s, strict_float dt,
                                       imu_variances const& noise) {
    for (int e = g.rank(); e < elements; e += g.size()) {
      s.AE[e] = row_times(s, e / columns, dt, s.E + e % columns, columns);
    }
    g.sync();
    for (int e = g.rank(); e < elements; e += g.size()) {
      int const row = e / columns;
      int const column = e % columns;
      s.E[e] = column < 9 ? covariance(s, min_of(row, column), max_of(row, column), dt, noise)
                          : derivative(s, row, column);
    }
  }
  FT_HOST_DEVICE static strict_float covariance(scratch const& s, int row, int column,
                                                strict_float dt, imu_variances const& noise) {
    strict_float const old = row_times(s, column, dt, s.AE + columns * row, 1);
    if ((row < 3) != (column < 3)) { return old; }
    float const* const variance = noise.measured + (row < 3 ? 0 : 3);
    strict_float const* const a = s.B + 3 * row;
    strict_float const* const b = s.B + 3 * column;
    auto const term = [&](int k) { return a[k] * strict_float(variance[k]) * b[k]; };
    return old + (term(0) + (term(1) + term(2)));
  }
  FT_HOST_DEVICE static strict_float derivative(scratch const& s, int row, int column) {
    strict_float const old = s.AE[columns * row + column];
    // The gyro's bias acts on the rotation, the accelerometer's on the rest.
    bool const acts = (row < 3) == (column < 12);
    return acts ? old - s.B[3 * row + column % 3] : old;
  }
};

}  // namespace detail

/// Integrates the steps of intervals, each in one integral or several: as those from the last frame
/// and from the last keyframe, which take the same steps. Asynchronous on `exec`; allocates
/// nothing; one launch. Equal bits on every executor. Source: Forster et al., "On-manifold
/// preintegration for real-time visual-inertial odometry", T-RO 2017.
///
/// Without steps an integral that begins is one over no time; its status says why. An integral that
/// runs on keeps the first status that is not usable().
/// @param starts [integrals]
/// @param integrals read where they run on, and written
template <typename Exec>
void preintegrate(Exec const& exec, imu_steps_view const& steps, span<integral_start const> starts,
                  imu_variances const& noise, preintegrated* integrals) {
  constexpr int few = 128;  // of which each has threads for all elements
  if (starts.size <= few) {
    for_each_item<per_block<160>>(exec, starts.size, detail::preintegrate_steps{}, steps,
                                  starts.data, noise, integrals);
  } else {
    for_each_item<per_warp>(exec, starts.size, detail::preintegrate_steps{}, steps, starts.data,
                            noise, integrals);
  }
}

}  // namespace FT_ABI
}  // namespace ft
