// SPDX-License-Identifier: Apache-2.0
// Initialisation of gravity, velocity and biases on motions whose formulas are known. The integrals
// are made by a plain integration, their derivatives by differences of it.
#include "ft/kernels/inertial/initialize.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/moving_body.hpp"

namespace initialize_inertial_test {

using namespace moving_body;

ft::initialization_params free_bias() {
  ft::initialization_params p;
  p.accel_bias_sigma = 100;  // as good as no prior
  return p;
}

TEST(InitializeInertial, FindsAllWithoutNoise) {
  setting s = moving();
  s.integrated_bg = {0.0199, -0.0149, 0.0101};  // as after a first call
  recording const r = record(s);
  std::vector<vec> velocities(r.T_wc.size());
  auto const got = ft::initialize_window(r.window(), free_bias(), velocities.data());
  EXPECT_EQ(got.status, initialization_status::initialized);
  errors const e = errors_of(got, r, s);
  EXPECT_LT(e.gyro, 2e-6);
  EXPECT_LT(e.accel, 1e-3);
  EXPECT_LT(e.tilt, 1e-4);
  EXPECT_LT(e.velocity, 3e-4);
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    EXPECT_LT(norm(velocities[k] - r.velocities[k]), 3e-4) << k;
  }
  EXPECT_NEAR(norm(got.gravity), G, 1e-6);
  EXPECT_LT(norm(got.newest.p - r.last.t), 1e-6);
  EXPECT_LT(norm(turn_of(got.newest.R.transposed() * r.last.R)), 1e-6);
  EXPECT_LT(got.position_rms, 1e-4);
  EXPECT_LT(got.rotation_rms, 1e-5);
  EXPECT_EQ(got.scale, 1);
  EXPECT_EQ(got.scale_sigma, 0);
}

TEST(InitializeInertial, CorrectsIntegralsThatWereMadeWithoutBias) {
  setting const s = moving();
  recording const r = record(s);
  auto const got = ft::initialize_window(r.window(), free_bias());
  EXPECT_EQ(got.status, initialization_status::initialized);
  errors const e = errors_of(got, r, s);  // of second order in the bias of 0.027 rad/s
  EXPECT_LT(e.gyro, 1e-4);
  EXPECT_LT(e.accel, 0.01);
  EXPECT_LT(e.tilt, 1e-3);
  EXPECT_LT(e.velocity, 3e-3);
}

/// Root of the mean square and largest value.
struct spread {
  double squares = 0, most = 0;
  int count = 0;
  void add(double x) {
    squares += x * x;
    most = std::max(most, x);
    ++count;
  }
  double rms() const { return std::sqrt(squares / count); }
};

// Poses with 3 mm and 0.5 mrad of noise, an IMU like that of EuRoC.
void expect_errors(int keyframes, errors const& rms) {
  spread gyro, accel, tilts, velocity;
  int surprising = 0;
  double const root3 = std::sqrt(3.0);
  for (unsigned seed = 1; seed <= 40; ++seed) {
    setting s = noisy_moving(seed);
    s.keyframes = keyframes;
    recording const r = record(s);
    auto const got = ft::initialize_window(r.window(), {});
    ASSERT_EQ(got.status, initialization_status::initialized) << seed;
    errors const e = errors_of(got, r, s);
    gyro.add(e.gyro);
    accel.add(e.accel);
    tilts.add(e.tilt);
    velocity.add(e.velocity);
    surprising += e.gyro > 3 * root3 * static_cast<double>(got.gyro_bias_sigma) ? 1 : 0;
    surprising += e.tilt > 3 * static_cast<double>(got.tilt_sigma) ? 1 : 0;
    surprising += e.velocity > 3 * static_cast<double>(got.velocity_sigma) ? 1 : 0;
    surprising += e.accel > 3 * root3 * static_cast<double>(got.accel_bias_sigma) ? 1 : 0;
    EXPECT_GT(got.tilt_sigma, 1e-4);
  }
  EXPECT_LE(surprising, 4) << "of 160";
  EXPECT_LT(gyro.rms(), rms.gyro);
  EXPECT_LT(accel.rms(), rms.accel);
  EXPECT_LT(tilts.rms(), rms.tilt);
  EXPECT_LT(velocity.rms(), rms.velocity);
  EXPECT_LT(gyro.most, 3 * rms.gyro);
  EXPECT_LT(accel.most, 3 * rms.accel);
  EXPECT_LT(tilts.most, 3 * rms.tilt);
  EXPECT_LT(velocity.most, 3 * rms.velocity);
}

TEST(InitializeInertial, StaysWithinStatedErrorsWithNoise) {
  expect_errors(12, {8e-4, 0.1, 0.01, 0.02});     // 2.75 s
  expect_errors(21, {5e-4, 0.01, 0.001, 0.011});  // 5 s
}

TEST(InitializeInertial, FindsTheScaleOfOneCamera) {
  ft::initialization_params p;
  p.known_scale = false;
  for (unsigned seed = 1; seed <= 10; ++seed) {
    for (double const unit : {0.4, 2.7}) {
      setting s = noisy_moving(seed);
      s.keyframes = 20;
      s.unit_m = unit;
      p.position_sigma = static_cast<float>(s.position_noise / unit);
      recording const r = record(s);
      auto const got = ft::initialize_window(r.window(), p);
      ASSERT_EQ(got.status, initialization_status::initialized) << seed;
      EXPECT_NEAR(got.scale / unit, 1, 0.02) << seed;
      EXPECT_LT(got.scale_sigma, 0.02) << seed;
      errors const e = errors_of(got, r, s);
      EXPECT_LT(e.tilt, 0.012);
      EXPECT_LT(e.velocity, 0.03);
      EXPECT_LT(norm(got.newest.p - r.last.t), 0.1);
    }
  }
}

TEST(InitializeInertial, AtRestTakesGravityFromTheSpecificForce) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    setting s;
    s.of = resting();
    s.bg = {0.02, -0.015, 0.01};
    s.ba = {0.02, -0.01, 0.03};
    s.steps = 50;
    s.position_noise = 0.001;
    s.rotation_noise = 0.0003;
    s.imu_noise = true;
    s.seed = seed;
    recording const r = record(s);
    auto const got = ft::initialize_window(r.window(), {});
    EXPECT_EQ(got.status, initialization_status::at_rest);
    errors const e = errors_of(got, r, s);
    EXPECT_LT(e.gyro, 5e-4);
    EXPECT_LT(e.velocity, 0.005);
    // A level bias cannot be told from a tilt.
    EXPECT_LT(e.tilt, (norm(s.ba) + 0.01) / G);
    EXPECT_GT(got.accel_bias_sigma, 0.29);
    // The mean force, turned into the world by the first pose, points against gravity.
    mat const R = r.last.R;  // the body does not turn
    vec const up = scaled(-1 / G, got.gravity);
    vec const along = R * got.newest.ba;
    double const true_part = ft::dot(R * s.ba, up);
    EXPECT_NEAR(ft::dot(along, up), true_part, 0.006);
  }
}

TEST(InitializeInertial, TurnsTheWorldUpright) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<vec> ups{{0, 0, 1}, {0, 0, -1}, {1e-9, 0, -1}, {1, 0, 0}, {0, -1, 0}};
  for (int i = 0; i < 50; ++i) { ups.push_back({normal(random), normal(random), normal(random)}); }
  for (vec up : ups) {
    up = scaled(1 / norm(up), up);
    mat const R = ft::detail::turn_upwards({up.x, up.y, up.z});
    vec const turned = R * up;
    EXPECT_LT(norm(turned - vec{0, 0, 1}), 1e-8);
    mat const unit = R * R.transposed();
    for (int i = 0; i < 9; ++i) { EXPECT_NEAR(unit.m[i], i % 4 == 0 ? 1 : 0, 1e-9); }
    double const trace = R.m[0] + R.m[4] + R.m[8];
    EXPECT_NEAR((trace - 1) / 2, up.z, 1e-9);  // it turns by the angle to z, not by more
  }
  setting const s = moving();
  auto const got = ft::initialize_window(record(s).window(), {});
  EXPECT_LT(norm(got.R_up * got.gravity - vec{0, 0, -G}), 1e-6);
}

TEST(InitializeInertial, SaysWhenTheMotionDoesNotSuffice) {
  auto const status_of = [](setting const& s, bool known_scale) {
    ft::initialization_params p;
    p.known_scale = known_scale;
    return ft::initialize_window(record(s).window(), p).status;
  };
  setting s = noisy_moving(1);
  s.of = gliding();
  EXPECT_EQ(status_of(s, true), initialization_status::initialized);
  EXPECT_EQ(status_of(s, false), initialization_status::little_motion) << "any scale fits";
  s.of = resting();
  EXPECT_EQ(status_of(s, false), initialization_status::little_motion);
  s.position_noise = 0;
  s.rotation_noise = 0;
  EXPECT_EQ(status_of(s, false), initialization_status::little_motion) << "no unique solution";
  s = noisy_moving(2);
  s.keyframes = 4;
  s.interval_s = 0.05;
  s.steps = 10;
  EXPECT_EQ(status_of(s, true), initialization_status::little_motion) << "too short";
}

TEST(InitializeInertial, RefusesBadInput) {
  setting const s = noisy_moving(1);
  recording const good = record(s);
  auto const status_of = [&](auto const& change) {
    recording r = good;
    ft::initialization_window w = r.window();
    change(r, w);
    auto const got = ft::initialize_window(w, {});
    EXPECT_FALSE(got.succeeded());
    return got.status;
  };
  double const nan = std::numeric_limits<double>::quiet_NaN();
  using window = ft::initialization_window;
  EXPECT_EQ(status_of([](recording&, window& w) { w.count = 3; }),
            initialization_status::few_keyframes);
  EXPECT_EQ(status_of([](recording&, window& w) { w.count = 0; }),
            initialization_status::few_keyframes);
  EXPECT_EQ(
      status_of([](recording& r, window&) { r.integrals[4].status = ft::integration_status::gap; }),
      initialization_status::no_integral);
  EXPECT_EQ(status_of([](recording& r, window&) { r.integrals[0].steps = 0; }),
            initialization_status::no_integral);
  EXPECT_EQ(status_of([](recording& r, window&) { r.integrals[0].dT = 0; }),
            initialization_status::no_integral);
  EXPECT_EQ(status_of([&](recording& r, window&) { r.T_wc[5].t.y = nan; }),
            initialization_status::not_finite);
  EXPECT_EQ(status_of([&](recording& r, window&) { r.T_wc[0].R.m[4] = nan; }),
            initialization_status::not_finite);
  EXPECT_EQ(status_of([](recording& r, window&) {
              r.integrals[10].JPa.m[8] = std::numeric_limits<float>::infinity();
            }),
            initialization_status::not_finite);
  EXPECT_EQ(status_of([](recording& r, window&) {
              r.integrals[2].dT = std::numeric_limits<float>::quiet_NaN();
            }),
            initialization_status::not_finite);
  // poses of one motion, integrals of another
  recording other = record([] {
    setting o = noisy_moving(1);
    o.of = swinging(0.3);
    return o;
  }());
  EXPECT_EQ(status_of([&](recording& r, window& w) {
              r.integrals = other.integrals;
              w.integrals = r.integrals.data();
            }),
            initialization_status::inconsistent);
  // still images of a moving body
  EXPECT_EQ(status_of([](recording& r, window&) {
              for (auto& T : r.T_wc) { T = r.T_wc[0]; }
            }),
            initialization_status::inconsistent);

  ft::initialization_params bad;
  bad.position_sigma = 0;
  EXPECT_THROW(ft::check(bad), ft::bad_argument);
  bad = {};
  bad.least_keyframes = 2;
  EXPECT_THROW(ft::check(bad), ft::bad_argument);
  bad = {};
  bad.gravity = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(ft::check(bad), ft::bad_argument);
}

std::vector<double> numbers_of(ft::inertial_initialization const& r) {
  std::vector<double> out{
      static_cast<double>(r.status),          r.scale,
      static_cast<double>(r.gyro_bias_sigma), static_cast<double>(r.accel_bias_sigma),
      static_cast<double>(r.tilt_sigma),      static_cast<double>(r.velocity_sigma),
      static_cast<double>(r.scale_sigma),     static_cast<double>(r.position_rms),
      static_cast<double>(r.rotation_rms)};
  for (vec v : {r.gravity, r.newest.p, r.newest.v, r.newest.bg, r.newest.ba}) {
    out.insert(out.end(), {v.x, v.y, v.z});
  }
  out.insert(out.end(), r.R_up.m, r.R_up.m + 9);
  out.insert(out.end(), r.newest.R.m, r.newest.R.m + 9);
  return out;
}

/// Integrals past those that are kept joined are joined anew.
TEST(InitializeInertial, LongWindowsHaveTheirLastVelocities) {
  setting s = noisy_moving(5);
  s.keyframes = ft::detail::initialization_scratch::most_joined + 20;
  recording const r = record(s);
  std::vector<vec> velocities(r.T_wc.size());
  auto const got = ft::initialize_window(r.window(), {}, velocities.data());
  ASSERT_EQ(got.status, initialization_status::initialized);
  for (std::size_t k = 0; k < velocities.size(); ++k) {
    EXPECT_LT(norm(velocities[k] - r.velocities[k]), 0.1) << k;
  }
}

template <typename Backend>
class initialize_inertial_stage : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(initialize_inertial_stage, test::backends);

TYPED_TEST(initialize_inertial_stage, gives_the_bits_of_a_plain_call) {
  TypeParam backend;
  auto const& exec = backend.exec;
  constexpr int capacity = ft::detail::initialization_scratch::most_joined + 10;
  std::vector<recording> recordings;
  for (unsigned seed = 1; seed <= 6; ++seed) {
    setting s = noisy_moving(seed);
    s.keyframes = seed == 1 ? 3 : 2 + 3 * static_cast<int>(seed);  // 3 are too few
    if (seed == 4) { s.of = resting(); }
    if (seed == 6) { s.keyframes = capacity; }
    recordings.push_back(record(s));
  }
  auto const batch = static_cast<int>(recordings.size());
  std::vector<motion> poses(recordings.size() * capacity, motion::identity());
  std::vector<ft::preintegrated> integrals(poses.size());
  std::vector<int> counts;
  for (std::size_t b = 0; b < recordings.size(); ++b) {
    auto const& r = recordings[b];
    std::copy(r.T_wc.begin(), r.T_wc.end(), poses.begin() + static_cast<int>(b) * capacity);
    std::copy(r.integrals.begin(), r.integrals.end(),
              integrals.begin() + static_cast<int>(b) * capacity);
    counts.push_back(static_cast<int>(r.T_wc.size()));
  }
  auto const d_poses = test::to_exec(exec, poses);
  auto const d_integrals = test::to_exec(exec, integrals);
  auto const d_counts = test::to_exec(exec, counts);
  for (bool const known_scale : {true, false}) {
    ft::initialization_params params;
    params.known_scale = known_scale;
    std::vector<vec> velocities(poses.size(), vec{7, 7, 7});
    auto const d_velocities = test::to_exec(exec, velocities);
    auto const d_results =
        test::to_exec(exec, std::vector<ft::inertial_initialization>(recordings.size()));
    ft::initialize_inertial(
        exec, {d_poses.data(), d_integrals.data(), d_counts.data(), capacity, batch, mount()},
        params, d_results.data(), d_velocities.data());
    auto const results = test::from_exec(exec, d_results.data(), recordings.size());
    auto const got = test::from_exec(exec, d_velocities.data(), velocities.size());
    for (std::size_t b = 0; b < recordings.size(); ++b) {
      std::vector<vec> plain(capacity, vec{7, 7, 7});
      auto const expected = ft::initialize_window(recordings[b].window(), params, plain.data());
      EXPECT_EQ(numbers_of(results[b]), numbers_of(expected)) << b;
      EXPECT_EQ(expected.status == initialization_status::few_keyframes, counts[b] < 4);
      for (int k = 0; k < capacity; ++k) {
        vec const& v = got[b * capacity + static_cast<std::size_t>(k)];
        vec const& e = plain[static_cast<std::size_t>(k)];
        EXPECT_TRUE(v.x == e.x && v.y == e.y && v.z == e.z) << b << " " << k;
      }
    }
  }
}

}  // namespace initialize_inertial_test
