// SPDX-License-Identifier: Apache-2.0
/// @file Keyframes and IMU integrals of bodies that move as formulas say.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <random>
#include <vector>

#include "ft/kernels/inertial/initialize.hpp"

namespace moving_body {

using vec = ft::vec3<double>;
using mat = ft::mat3<double>;
using motion = ft::rigid<double>;
using ft::initialization_status;

inline constexpr double G = 9.81;

inline vec scaled(double s, vec v) { return {s * v.x, s * v.y, s * v.z}; }
inline double norm(vec v) { return std::sqrt(ft::dot(v, v)); }
inline ft::vec3<float> narrow(vec v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}
inline ft::mat3<float> narrow(mat const& a) {
  ft::mat3<float> out;
  for (int i = 0; i < 9; ++i) { out.m[i] = static_cast<float>(a.m[i]); }
  return out;
}

/// Rodrigues' formula.
inline mat rotation_of(vec w) {
  double const angle = norm(w);
  double const a = angle < 1e-9 ? 1 : std::sin(angle) / angle;
  double const b = angle < 1e-9 ? 0.5 : (1 - std::cos(angle)) / (angle * angle);
  mat const W{{0, -w.z, w.y, w.z, 0, -w.x, -w.y, w.x, 0}};
  mat const WW = W * W;
  mat out = mat::identity();
  for (int i = 0; i < 9; ++i) { out.m[i] += a * W.m[i] + b * WW.m[i]; }
  return out;
}
/// Axis times angle of a turn below a right angle.
inline vec turn_of(mat const& R) {
  vec const v = scaled(0.5, {R.m[7] - R.m[5], R.m[2] - R.m[6], R.m[3] - R.m[1]});
  double const s = norm(v);
  return s < 1e-12 ? v : scaled(std::asin(std::min(s, 1.0)) / s, v);
}

/// A body whose position, in a world with z up, and attitude are formulas of time.
struct body {
  std::function<vec(double)> place, acceleration;
  std::function<mat(double)> attitude;

  vec velocity(double t) const {
    constexpr double h = 1e-5;
    return scaled(0.5 / h, place(t + h) - place(t - h));
  }
  vec rate(double t) const {
    constexpr double h = 1e-4;
    return scaled(0.5 / h, turn_of(attitude(t - h).transposed() * attitude(t + h)));
  }
  vec force(double t) const { return attitude(t).transposed() * (acceleration(t) + vec{0, 0, G}); }
};

/// Hand-held: swings of half a metre and of thirty degrees.
inline body swinging(double vigour = 1) {
  double const s = vigour;
  body b;
  b.place = [s](double t) {
    return vec{s * 0.5 * std::sin(1.3 * t + 0.3), s * 0.4 * std::sin(1.9 * t + 1.1),
               s * 0.25 * std::sin(2.3 * t + 2.0)};
  };
  b.acceleration = [s](double t) {
    return vec{-s * 0.5 * 1.69 * std::sin(1.3 * t + 0.3), -s * 0.4 * 3.61 * std::sin(1.9 * t + 1.1),
               -s * 0.25 * 5.29 * std::sin(2.3 * t + 2.0)};
  };
  b.attitude = [s](double t) {
    return rotation_of({s * 0.5 * std::sin(1.1 * t), s * 0.4 * std::sin(1.7 * t + 0.7),
                        s * 0.6 * std::sin(0.9 * t + 0.2)});
  };
  return b;
}
inline body resting() {
  body b;
  b.place = b.acceleration = [](double) { return vec{0, 0, 0}; };
  b.attitude = [](double) { return rotation_of({0.2, -0.3, 0.5}); };
  return b;
}
/// Neither acceleration nor turns.
inline body gliding() {
  body b = resting();
  b.place = [](double t) { return vec{0.5 * t, 0.2 * t, 0}; };
  return b;
}

struct sample {
  vec accel, gyro;
};

/// What is measured, and how well.
struct setting {
  body of;
  int keyframes = 12;
  double interval_s = 0.25;
  int steps = 250;  ///< of an interval
  vec bg{0, 0, 0}, ba{0, 0, 0};
  vec integrated_bg{0, 0, 0}, integrated_ba{0, 0, 0};
  double position_noise = 0, rotation_noise = 0;
  bool imu_noise = false;
  double unit_m = 1;  ///< of the poses
  unsigned seed = 1;
};

/// Rotation, velocity and position of one interval, by the midpoint of neighbouring samples.
struct sums {
  mat R = mat::identity();
  vec V{0, 0, 0}, P{0, 0, 0};
};
inline sums integrate(std::vector<sample> const& samples, double dt, vec bg, vec ba) {
  sums s;
  for (std::size_t i = 0; i + 1 < samples.size(); ++i) {
    vec const w = scaled(0.5, samples[i].gyro + samples[i + 1].gyro) - bg;
    mat const next = s.R * rotation_of(scaled(dt, w));
    vec const a = scaled(0.5, s.R * (samples[i].accel - ba) + next * (samples[i + 1].accel - ba));
    s.P = s.P + scaled(dt, s.V) + scaled(0.5 * dt * dt, a);
    s.V = s.V + scaled(dt, a);
    s.R = next;
  }
  return s;
}

inline ft::preintegrated integral_of(std::vector<sample> const& samples, double dt, vec bg,
                                     vec ba) {
  sums const at = integrate(samples, dt, bg, ba);
  ft::preintegrated out{};
  out.dT = static_cast<float>(dt * static_cast<double>(samples.size() - 1));
  out.dR = narrow(at.R);
  out.dV = narrow(at.V);
  out.dP = narrow(at.P);
  constexpr double h = 1e-4;
  for (int axis = 0; axis < 3; ++axis) {
    vec const d{axis == 0 ? h : 0, axis == 1 ? h : 0, axis == 2 ? h : 0};
    auto const set = [axis](ft::mat3<float>& J, vec more, vec less) {
      vec const slope = scaled(0.5 / h, more - less);
      J.m[axis] = static_cast<float>(slope.x);
      J.m[3 + axis] = static_cast<float>(slope.y);
      J.m[6 + axis] = static_cast<float>(slope.z);
    };
    sums const g1 = integrate(samples, dt, bg + d, ba);
    sums const g0 = integrate(samples, dt, bg - d, ba);
    set(out.JRg, turn_of(at.R.transposed() * g1.R), turn_of(at.R.transposed() * g0.R));
    set(out.JVg, g1.V, g0.V);
    set(out.JPg, g1.P, g0.P);
    sums const a1 = integrate(samples, dt, bg, ba + d);
    sums const a0 = integrate(samples, dt, bg, ba - d);
    set(out.JVa, a1.V, a0.V);
    set(out.JPa, a1.P, a0.P);
  }
  out.bias = {narrow(bg), narrow(ba)};
  out.steps = static_cast<int>(samples.size()) - 1;
  out.status = ft::integration_status::integrated;
  return out;
}

inline ft::imu_mount mount() {
  motion const T_bc{rotation_of({0.1, -0.2, 1.4}), {-0.03, 0.06, 0.01}};
  return {T_bc.cast<float>(), T_bc.inverse().cast<float>()};
}

/// The keyframes of a setting, in a world that is turned and moved, and the true state there.
struct recording {
  std::vector<motion> T_wc;
  std::vector<ft::preintegrated> integrals;
  vec gravity;
  std::vector<vec> velocities;
  motion last;  ///< body to world, metres

  ft::initialization_window window() const {
    return {T_wc.data(), integrals.data(), static_cast<int>(T_wc.size()), mount()};
  }
};

inline recording record(setting const& s) {
  std::mt19937 random(s.seed);
  std::normal_distribution<double> normal;
  auto const noise = [&](double sigma) {
    double const x = normal(random);
    double const y = normal(random);
    double const z = normal(random);
    return vec{sigma * x, sigma * y, sigma * z};
  };
  motion const world{rotation_of({1.1, -0.7, 0.4}), {0.3, -2, 1.5}};
  motion const T_bc = mount().T_bc.cast<double>();
  double const dt = s.interval_s / s.steps;
  double const rate = 1 / dt;
  recording out;
  out.gravity = world.R * vec{0, 0, -G};
  std::vector<sample> all;
  for (int i = 0; i <= (s.keyframes - 1) * s.steps; ++i) {
    sample one{s.of.force(i * dt) + s.ba, s.of.rate(i * dt) + s.bg};
    if (s.imu_noise) {  // EuRoC's
      one.accel = one.accel + noise(2e-3 * std::sqrt(rate));
      one.gyro = one.gyro + noise(1.7e-4 * std::sqrt(rate));
    }
    all.push_back(one);
  }
  for (int k = 0; k < s.keyframes; ++k) {
    double const t = k * s.interval_s;
    motion const T_wb = world * motion{s.of.attitude(t), s.of.place(t)};
    out.last = T_wb;
    out.velocities.push_back(world.R * s.of.velocity(t));
    motion T_wc = T_wb * T_bc;
    T_wc.R = T_wc.R * rotation_of(noise(s.rotation_noise));
    T_wc.t = T_wc.t + noise(s.position_noise);
    T_wc.t = scaled(1 / s.unit_m, T_wc.t);
    out.T_wc.push_back(T_wc);
    auto const from = all.begin() + k * s.steps;
    if (k + 1 < s.keyframes) {
      out.integrals.push_back(
          integral_of({from, from + s.steps + 1}, dt, s.integrated_bg, s.integrated_ba));
    }
  }
  return out;
}

inline double tilt(vec a, vec b) {
  return std::asin(std::min(1.0, norm(ft::cross(a, b)) / (norm(a) * norm(b))));
}

/// What a result is off by.
struct errors {
  double gyro, accel, tilt, velocity;
};
inline errors errors_of(ft::inertial_initialization const& got, recording const& r,
                        setting const& s) {
  return {norm(got.newest.bg - s.bg), norm(got.newest.ba - s.ba), tilt(got.gravity, r.gravity),
          norm(got.newest.v - r.velocities.back())};
}

inline setting moving() {
  setting s;
  s.of = swinging();
  s.bg = {0.02, -0.015, 0.01};
  s.ba = {0.05, -0.03, 0.06};
  return s;
}
inline setting noisy_moving(unsigned seed) {
  setting s = moving();
  s.steps = 50;  // 200 Hz
  s.position_noise = 0.003;
  s.rotation_noise = 0.0005;
  s.imu_noise = true;
  s.seed = seed;
  return s;
}

}  // namespace moving_body
