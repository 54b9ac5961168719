// SPDX-License-Identifier: Apache-2.0
/// @file Frames with a known state, map points and an IMU's integral, as batches of problems.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/inertial.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "tests/support/inertial_poses.hpp"

namespace test {

using inertial_fisheye_rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;

/// Rotation by |w| about w.
inline ft::mat3<double> rotation_about(ft::vec3<double> w) {
  double const d = std::sqrt(dot(w, w));
  if (d == 0) { return ft::mat3<double>::identity(); }
  double const x = w.x / d;
  double const y = w.y / d;
  double const z = w.z / d;
  double const c = std::cos(d);
  double const s = std::sin(d);
  double const k = 1 - c;
  return {{c + x * x * k, x * y * k - z * s, x * z * k + y * s, y * x * k + z * s, c + y * y * k,
           y * z * k - x * s, z * x * k - y * s, z * y * k + x * s, c + z * z * k}};
}

template <typename Rig>
Rig inertial_rig();
template <>
inline ft::rectified_rig inertial_rig<ft::rectified_rig>() {
  return ft::rectified_rig::make({435.2f, 436.1f, 367.2f, 252.3f}, 0.11f);
}
template <>
inline inertial_fisheye_rig inertial_rig<inertial_fisheye_rig>() {
  ft::rigid<double> const T_rl{rotation_about({0.003, 0.03, 0.006}), {-0.1, 0.002, 0.001}};
  return {{190.9f, 190.8f, 254.9f, 256.8f, 0.0034f, 0.0007f, -0.0020f, 0.0002f},
          {190.4f, 190.5f, 252.6f, 255.0f, 0.0040f, -0.0010f, -0.0010f, 0.0001f},
          T_rl.cast<float>()};
}
/// Two pairs and a single camera, none in the frame of the pose.
template <>
inline ft::multi_rig<3> inertial_rig<ft::multi_rig<3>>() {
  auto const place = [](ft::vec3<double> w, ft::vec3<double> t) {
    return ft::rigid<double>{rotation_about(w), t}.cast<float>();
  };
  return {{{{435.2f, 436.1f, 367.2f, 252.3f}, 0.11, place({0, -0.25, 0.03}, {0.1, 0.02, -0.05})},
           {{300.5f, 301.5f, 320.2f, 240.1f}, 0, place({-0.1, 0.03, 0.3}, {-0.2, 0.1, 0.02})},
           {{380.3f, 379.1f, 330.7f, 242.3f}, 0.2, place({0.2, 0.1, 0}, {-0.1, 0.03, 0.04})}}};
}

/// A pixel and, of a rectified pair, the column in the right image.
template <typename Scalar>
struct seen_point {
  ft::vec2<Scalar> pixel;
  Scalar right_u;
};

template <typename T>
ft::vec3<T> moved(ft::rigid<float> const& by, ft::vec3<T> p) {
  auto const m = [&](int k) { return T(static_cast<double>(by.R.m[k])); };
  return {m(0) * p.x + m(1) * p.y + m(2) * p.z + T(static_cast<double>(by.t.x)),
          m(3) * p.x + m(4) * p.y + m(5) * p.z + T(static_cast<double>(by.t.y)),
          m(6) * p.x + m(7) * p.y + m(8) * p.z + T(static_cast<double>(by.t.z))};
}
/// u = fx x / z + cx, v = fy y / z + cy; the right column is u - fx baseline / z.
template <typename T>
seen_point<T> pinhole_pixel(ft::pinhole<float> const& c, double baseline, ft::vec3<T> p) {
  auto const wide = [](float v) { return static_cast<double>(v); };
  T const u = wide(c.fx) * p.x / p.z + wide(c.cx);
  return {{u, wide(c.fy) * p.y / p.z + wide(c.cy)}, u - baseline * wide(c.fx) / p.z};
}
/// Image of a point in the frame of the pose.
template <typename T>
seen_point<T> image_in(ft::rectified_rig const& rig, int, ft::vec3<T> p) {
  return pinhole_pixel(rig.camera, rig.baseline, p);
}
template <typename T>
seen_point<T> image_in(ft::multi_rig<3> const& rig, int camera, ft::vec3<T> p) {
  auto const& c = rig.of[camera];
  return pinhole_pixel(c.camera, c.baseline, moved(c.T_cb, p));
}
template <typename T>
seen_point<T> image_in(inertial_fisheye_rig const& rig, int camera, ft::vec3<T> p) {
  using std::atan2;
  using std::sqrt;
  if (camera != 0) { p = moved(rig.T_rl, p); }
  auto const c = (camera == 0 ? rig.left : rig.right).cast<double>();
  T const radius = sqrt(p.x * p.x + p.y * p.y);
  T const a = atan2(radius, p.z);
  T const a2 = a * a;
  T const r = a * (1.0 + a2 * (c.k1 + a2 * (c.k2 + a2 * (c.k3 + a2 * c.k4))));
  return {{c.fx * r * p.x / radius + c.cx, c.fy * r * p.y / radius + c.cy}, T(-1.0)};
}
/// Whether a camera of the rig has a right image.
inline bool has_right(ft::rectified_rig const&, int) { return true; }
inline bool has_right(ft::multi_rig<3> const& rig, int camera) { return !rig.of[camera].single(); }
inline bool has_right(inertial_fisheye_rig const&, int) { return false; }

/// What a problem is like.
struct inertial_shape {
  int observations = 150;
  bool from_last_frame = false;
  double pixel_noise = 0;
  int outliers_percent = 0;
  double start_error = 0.01;  ///< of the predicted state: rad, m, a tenth of m/s
  int imu_steps = 10;
};

struct true_states {
  ft::inertial_state<double> first, frame;
};

/// Makes problems of one rig, the same for the same seed.
template <typename Rig>
class inertial_scene {
public:
  Rig rig = inertial_rig<Rig>();
  ft::imu_mount mount{};

  explicit inertial_scene(unsigned seed) : random_(seed) {
    ft::rigid<double> const T_cb{rotation_about({1.2, -1.1, 1.3}), {0.05, -0.04, 0.02}};
    mount = {T_cb.inverse().cast<float>(), T_cb.cast<float>()};
  }

  /// Adds a problem. The true states agree with the integral exactly, up to rounding.
  true_states add(inertial_pose_batch& b, inertial_shape const& shape) {
    true_states truth;
    auto& first = truth.first;
    first = {rotation_about(vector(0.6)), vector(2), vector(1), vector(0.01), vector(0.1)};
    auto const stored = ft::stored_state(narrowed(first), mount);
    auto const rounded = ft::body_state(stored, mount);
    first = {rounded.R.cast<double>(), rounded.p.cast<double>(), rounded.v.cast<double>(),
             rounded.bg.cast<double>(), rounded.ba.cast<double>()};
    auto const integral = integrate(shape.imu_steps, {stored.bias.gyro, stored.bias.accel});
    double const t = static_cast<double>(integral.dT);
    ft::vec3<double> const g{0, 0, -static_cast<double>(9.81f)};
    auto const times = [](double s, ft::vec3<double> v) {
      return ft::vec3<double>{s * v.x, s * v.y, s * v.z};
    };
    truth.frame = {first.R * integral.dR.template cast<double>(),
                   first.p + times(t, first.v) + times(t * t / 2, g) +
                       first.R * integral.dP.template cast<double>(),
                   first.v + times(t, g) + first.R * integral.dV.template cast<double>(), first.bg,
                   first.ba};
    b.from_last_frame.push_back(static_cast<int>(shape.from_last_frame));
    b.first.push_back(stored);
    b.integral.push_back(integral);
    b.since_keyframe.push_back(integral);
    b.start.push_back(ft::stored_state(narrowed(disturbed(truth.frame, shape.start_error)), mount));
    b.prior.push_back(prior_of(first));
    b.observations.emplace_back();
    b.distance.emplace_back();
    auto const at = ft::stored_state(narrowed(truth.frame), mount);
    for (int i = 0; i < shape.observations; ++i) { observe(b, at, shape); }
    b.count.push_back(shape.observations);
    return truth;
  }

  double normal() { return std::normal_distribution<double>()(random_); }
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  ft::vec3<double> vector(double size) {
    return {uniform(-size, size), uniform(-size, size), uniform(-size, size)};
  }
  static ft::inertial_state<float> narrowed(ft::inertial_state<double> const& s) {
    return {s.R.cast<float>(), s.p.cast<float>(), s.v.cast<float>(), s.bg.cast<float>(),
            s.ba.cast<float>()};
  }
  ft::inertial_state<double> disturbed(ft::inertial_state<double> s, double by) {
    s.R = s.R * rotation_about(vector(by));
    s.p = s.p + vector(by);
    s.v = s.v + vector(10 * by);
    return s;
  }

private:
  ft::preintegrated integrate(int steps, ft::imu_bias const& bias) {
    std::vector<ft::imu_step> list;
    for (int i = 0; i < steps; ++i) {
      auto const a = vector(1);
      auto const w = vector(0.5);
      list.push_back({(a + ft::vec3<double>{0.3, -0.2, 9.8}).template cast<float>(),
                      w.template cast<float>(), 0.005f});
    }
    ft::imu_selection chosen{0, steps + 1, steps, steps, ft::integration_status::integrated};
    ft::integral_start const start{0, 1, bias};
    ft::imu_variances noise{};
    for (int k = 0; k < 3; ++k) {
      noise.measured[k] = 5.8e-6f;
      noise.measured[3 + k] = 8e-4f;
      noise.walk[k] = 1.9e-12f;
      noise.walk[3 + k] = 4.5e-8f;
    }
    ft::preintegrated out{};
    ft::preintegrate(ft::host_exec(1), {1, steps, &chosen, list.data()}, {&start, 1}, noise, &out);
    return out;
  }

  /// A prior at the state, with correlations.
  ft::inertial_prior prior_of(ft::inertial_state<double> const& state) {
    constexpr double deviation[5] = {2e-3, 5e-3, 2e-2, 1e-3, 2e-2};
    double A[15][15];
    for (auto& row : A) {
      for (double& v : row) { v = 0.2 * normal(); }
    }
    ft::inertial_prior prior{};
    prior.state = state;
    prior.known = 1;
    for (int i = 0; i < 15; ++i) { A[i][i] += 1; }
    for (int i = 0; i < 15; ++i) {
      for (int j = 0; j < 15; ++j) {
        double sum = 0;
        for (int k = 0; k < 15; ++k) { sum += A[i][k] * A[j][k]; }
        prior.information[15 * i + j] = sum / (deviation[i / 3] * deviation[j / 3]);
      }
    }
    return prior;
  }

  void observe(inertial_pose_batch& b, ft::stored_inertial_state const& at,
               inertial_shape const& shape) {
    int const camera = static_cast<int>(uniform(0, Rig::cameras)) % Rig::cameras;
    double const z = uniform(1.5, 20);
    ft::vec3<double> const in_pose{uniform(-0.6, 0.6) * z, uniform(-0.4, 0.4) * z, z};
    ft::rigid<double> const T_cw{
        ft::detail::rotation_of(ft::quaternion<double>{at.q_cw.x, at.q_cw.y, at.q_cw.z, at.q_cw.w}),
        at.t_cw.cast<double>()};
    auto const point = (T_cw.inverse() * in_pose).template cast<float>();
    auto const seen = image_in(rig, camera, T_cw * point.template cast<double>());
    double const scale = std::pow(1.2, std::floor(uniform(0, 4)));
    bool const wrong = uniform(0, 100) < shape.outliers_percent;
    auto const noisy = [&](double v) {
      return static_cast<float>(v + scale * shape.pixel_noise * normal() +
                                (wrong ? uniform(10, 40) : 0));
    };
    bool const stereo = has_right(rig, camera) && uniform(0, 1) < 0.7;
    float const right = noisy(seen.right_u);
    b.observations.back().push_back({point, noisy(seen.pixel.x), noisy(seen.pixel.y),
                                     stereo && right >= 0 ? right : -1.0f,
                                     static_cast<float>(1 / (scale * scale)), camera});
    b.distance.back().push_back(static_cast<float>(std::sqrt(dot(in_pose, in_pose))));
  }

  std::mt19937 random_;
};

inline double length(ft::vec3<double> v) { return std::sqrt(dot(v, v)); }
/// Rotation ft::vec3<double> of a small rotation.
inline ft::vec3<double> turn_of(ft::mat3<double> const& R) {
  auto const& m = R.m;
  return {(m[7] - m[5]) / 2, (m[2] - m[6]) / 2, (m[3] - m[1]) / 2};
}
inline double angle(ft::mat3<double> const& a, ft::mat3<double> const& b) {
  return length(turn_of(a.transposed() * b));
}
inline ft::inertial_state<double> last_state(ft::inertial_pose_result const& r) {
  return r.round_state[std::max(r.rounds, 1) - 1];
}

/// Problems from a keyframe and from the last frame by turns, with noise of 0.8 pixels.
inline inertial_pose_batch noisy_batch(inertial_scene<ft::rectified_rig>& scene, int problems,
                                       inertial_shape shape) {
  inertial_pose_batch b;
  shape.pixel_noise = 0.8;
  for (int i = 0; i < problems; ++i) {
    shape.from_last_frame = i % 2 == 1;
    scene.add(b, shape);
  }
  return b;
}
inline inertial_shape with_outliers(int percent) {
  inertial_shape shape;
  shape.outliers_percent = percent;
  return shape;
}
inline inertial_shape as_tracked() {
  inertial_shape shape = with_outliers(10);
  shape.observations = 200;
  return shape;
}

}  // namespace test
