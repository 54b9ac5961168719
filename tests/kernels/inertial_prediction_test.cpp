// SPDX-License-Identifier: Apache-2.0
// Prediction of a state from an integral, stored states, and what is made of a calibration: against
// double precision, known motions and refused arguments.
#include "ft/kernels/inertial/predict.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/kernels/inertial/preintegrate.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_inertial.hpp"
#include "tests/support/random.hpp"
#include "tests/support/refusals.hpp"

namespace inertial_prediction_test {

using ft::integration_status;
using test::at;
using test::mat3d;
using test::vec3d;

vec3d random_vector(std::mt19937& random, double size) {
  std::uniform_real_distribution<double> u(-size, size);
  double const x = u(random);
  double const y = u(random);
  return {x, y, u(random)};
}
ft::imu_mount random_mount(std::mt19937& random) {
  return ft::mount_of({test::plain_exp(random_vector(random, 2)), random_vector(random, 0.2)});
}
ft::inertial_state<float> random_state(std::mt19937& random) {
  ft::imu_bias const bias = test::random_bias(random);
  return {test::plain_exp(random_vector(random, 3)).cast<float>(),
          random_vector(random, 5).cast<float>(), random_vector(random, 3).cast<float>(), bias.gyro,
          bias.accel};
}
/// Integrates on the host.
ft::preintegrated integrate(std::vector<ft::imu_step> steps, ft::imu_bias const& bias) {
  int const n = static_cast<int>(steps.size());
  ft::imu_selection chosen{0, n + 1, n, n, integration_status::integrated};
  ft::integral_start const start{0, 1, bias};
  ft::preintegrated out{};
  ft::preintegrate(ft::host_exec(1), {1, n, &chosen, steps.data()}, {&start, 1},
                   ft::variances_of(ft::imu_noise{}), &out);
  return out;
}
float as_float(double v) { return static_cast<float>(v); }

TEST(InertialPrediction, FollowsABodyInTheWorld) {
  std::mt19937 random(1);
  for (int round = 0; round < 100; ++round) {
    auto const from = random_state(random);
    auto const steps = test::shaken_steps(random, 1 + static_cast<int>(random() % 30u), 0.005f);
    ft::imu_bias const bias{from.bg, from.ba};
    auto const got = ft::predict_state(from, integrate(steps, bias));
    // The same steps in the world: rotated force and gravity move the body.
    mat3d R = from.R.cast<double>();
    vec3d p = from.p.cast<double>();
    vec3d v = from.v.cast<double>();
    for (auto const& s : steps) {
      double const dt = static_cast<double>(s.dt);
      vec3d const a = R * (s.accel.cast<double>() - from.ba.cast<double>()) + vec3d{0, 0, -9.81};
      p = p + test::times(dt, v) + test::times(dt * dt / 2, a);
      v = v + test::times(dt, a);
      R = R * test::plain_exp(test::times(dt, (s.gyro.cast<double>() - from.bg.cast<double>())));
    }
    EXPECT_LT(test::angle_of(got.R.cast<double>(), R), 1e-6);
    EXPECT_LT(test::largest(got.p.cast<double>() - p), 2e-6);
    EXPECT_LT(test::largest(got.v.cast<double>() - v), 3e-6);
    EXPECT_EQ(std::memcmp(&got.bg, &from.bg, sizeof got.bg), 0);
    EXPECT_EQ(std::memcmp(&got.ba, &from.ba, sizeof got.ba), 0);
  }
}

TEST(InertialPrediction, TakesTheBiasOfItsStart) {
  std::mt19937 random(2);
  auto from = random_state(random);
  auto const steps = test::shaken_steps(random, 20, 0.005f);
  ft::imu_bias old{from.bg, from.ba};
  old.gyro.x += 1e-3f;
  old.accel.z -= 0.02f;
  auto const other = ft::predict_state(from, integrate(steps, old));
  auto const same = ft::predict_state(from, integrate(steps, {from.bg, from.ba}));
  // 0.02 m/s^2 in 0.1 s are 2e-3 m/s, which the change of bias accounts for.
  EXPECT_LT(test::angle_of(other.R.cast<double>(), same.R.cast<double>()), 1e-6);
  EXPECT_LT(test::largest((other.v - same.v).cast<double>()), 5e-6);
  EXPECT_LT(test::largest((other.p - same.p).cast<double>()), 2e-6);
}

TEST(InertialPrediction, OfABodyAtRestIsRest) {
  // The IMU is mounted upside down: it shows gravity's reaction along -z.
  ft::inertial_state<float> from{};
  from.R = {{1, 0, 0, 0, -1, 0, 0, 0, -1}};
  from.p = {1, 2, 3};
  std::vector<ft::imu_step> const steps(200, {{0, 0, -9.81f}, {0, 0, 0}, 0.005f});
  auto const got = ft::predict_state(from, integrate(steps, {}));
  // 200 sums of speeds up to 10 m/s, each rounded by up to 5e-7.
  EXPECT_LT(test::largest((got.p - from.p).cast<double>()), 2e-5);
  EXPECT_LT(test::largest(got.v.cast<double>()), 4e-5);
  EXPECT_LT(test::angle_of(got.R.cast<double>(), from.R.cast<double>()), 1e-7);
}

TEST(StoredInertialState, IsThePoseOfTheCamera) {
  std::mt19937 random(3);
  for (int round = 0; round < 200; ++round) {
    auto const mount = random_mount(random);
    auto const body = random_state(random);
    auto const stored = ft::stored_state(body, mount);
    auto const& q = stored.q_cw;
    EXPECT_NEAR(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w, 1.0f, 3e-7f);
    EXPECT_GE(q.w, 0.0f);
    // A point of the camera's frame, by way of the body and by way of what is stored.
    vec3d const X = random_vector(random, 1);
    vec3d const world =
        body.R.cast<double>() * (mount.T_bc.R.cast<double>() * X + mount.T_bc.t.cast<double>()) +
        body.p.cast<double>();
    ft::quaternion<double> const wide{static_cast<double>(q.x), static_cast<double>(q.y),
                                      static_cast<double>(q.z), static_cast<double>(q.w)};
    EXPECT_LT(test::largest(wide * world + stored.t_cw.cast<double>() - X), 5e-6);
    auto const back = ft::body_state(stored, mount);
    EXPECT_LT(test::angle_of(back.R.cast<double>(), body.R.cast<double>()), 1e-6);
    EXPECT_LT(test::largest((back.p - body.p).cast<double>()), 3e-6);
    EXPECT_EQ(std::memcmp(&back.v, &body.v, sizeof back.v), 0);
    EXPECT_EQ(std::memcmp(&back.bg, &body.bg, sizeof back.bg), 0);
    EXPECT_EQ(std::memcmp(&back.ba, &body.ba, sizeof back.ba), 0);
  }
}

template <typename Backend>
class InertialPredictions : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(InertialPredictions, test::backends);

TYPED_TEST(InertialPredictions, HaveTheBitsOfPlainCalls) {
  TypeParam backend;
  std::mt19937 random(4);
  auto const mount = random_mount(random);
  std::vector<ft::preintegrated> integrals;
  std::vector<ft::prediction_start> starts;
  for (int i = 0; i < 300; ++i) {
    integrals.push_back(
        integrate(test::shaken_steps(random, 1 + static_cast<int>(random() % 30u), 0.005f), {}));
    starts.push_back({ft::stored_state(random_state(random), mount), (i * 7) % 300});
    // A bias that is far off turns by angles that are computed in another way.
    if (i % 5 == 0) { starts.back().from.bias.gyro.y = as_float(i) - 150; }
  }
  std::vector<ft::predicted_state> want;
  for (auto const& s : starts) {
    auto const body = ft::body_state(s.from, mount);
    want.push_back({ft::stored_state(ft::predict_state(body, integrals[at(s.integral)]), mount),
                    integration_status::integrated});
  }
  auto const d_starts = test::to_exec(backend.exec, starts);
  auto const d_integrals = test::to_exec(backend.exec, integrals);
  ft::buffer<ft::predicted_state, decltype(backend.exec)::space> out(300);
  ft::predict_states(backend.exec, {d_starts.data(), 300}, d_integrals.data(), mount, out.data());
  auto const got = test::from_exec(backend.exec, out.data(), 300);
  EXPECT_EQ(std::memcmp(got.data(), want.data(), got.size() * sizeof got[0]), 0);
}

TYPED_TEST(InertialPredictions, StayWhereNothingIsKnown) {
  TypeParam backend;
  std::mt19937 random(5);
  auto const mount = random_mount(random);
  auto const from = ft::stored_state(random_state(random), mount);
  auto bad_start = from;
  bad_start.v.y = std::numeric_limits<float>::quiet_NaN();
  std::vector<ft::preintegrated> integrals(3,
                                           integrate(test::shaken_steps(random, 10, 0.005f), {}));
  integrals[1].status = integration_status::gap;
  integrals[2].status = integration_status::repeated;
  std::vector<ft::prediction_start> const starts{
      {from, -1}, {from, 0}, {from, 1}, {from, 2}, {bad_start, 0}};
  auto const d_starts = test::to_exec(backend.exec, starts);
  auto const d_integrals = test::to_exec(backend.exec, integrals);
  ft::buffer<ft::predicted_state, decltype(backend.exec)::space> out(5);
  ft::predict_states(backend.exec, {d_starts.data(), 5}, d_integrals.data(), mount, out.data());
  auto const got = test::from_exec(backend.exec, out.data(), 5);
  integration_status const want[] = {integration_status::no_samples, integration_status::integrated,
                                     integration_status::gap, integration_status::repeated,
                                     integration_status::not_finite};
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(got[i].status, want[i]) << i;
    bool const stayed = std::memcmp(&got[i].frame, &starts[i].from, sizeof from) == 0;
    EXPECT_EQ(stayed, !usable(want[i])) << i;
  }
}

bool names(std::string const& message, char const* part) {
  return message.find(part) != std::string::npos;
}

TEST(ImuCalibration, HasTheVariancesOfOneSample) {
  ft::imu_noise const noise{2e-4f, 3e-3f, 4e-5f, 5e-3f, 100};
  auto const v = ft::variances_of(noise);
  for (int i = 0; i < 3; ++i) {
    EXPECT_FLOAT_EQ(v.measured[i], 4e-8f * 100);
    EXPECT_FLOAT_EQ(v.measured[3 + i], 9e-6f * 100);
    EXPECT_FLOAT_EQ(v.walk[i], 1.6e-9f / 100);
    EXPECT_FLOAT_EQ(v.walk[3 + i], 2.5e-5f / 100);
  }
}

TEST(ImuCalibration, RefusesNoiseThatIsNone) {
  auto const with = [](float ft::imu_noise::*member, float value) {
    ft::imu_noise noise;
    noise.*member = value;
    return test::refusal([&] { static_cast<void>(ft::variances_of(noise)); });
  };
  float const nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(names(with(&ft::imu_noise::rate_hz, 0), "rate_hz is 0"));
  EXPECT_TRUE(names(with(&ft::imu_noise::rate_hz, nan), "rate_hz is nan"));
  EXPECT_TRUE(names(with(&ft::imu_noise::gyro, 0), "imu.noise.gyro is 0"));
  EXPECT_TRUE(names(with(&ft::imu_noise::accel, -1), "imu.noise.accel is -1"));
  EXPECT_TRUE(names(with(&ft::imu_noise::gyro_walk, nan), "imu.noise.gyro_walk is nan"));
  EXPECT_TRUE(names(with(&ft::imu_noise::accel_walk, HUGE_VALF), "imu.noise.accel_walk is inf"));
}

TEST(ImuCalibration, MakesARotationOfDigitsThatWereCut) {
  // Of a EuRoC calibration, with its digits cut to four.
  ft::rigid<double> const T{
      {{0.0149, -0.9999, 0.0041, 0.9996, 0.0150, 0.0257, -0.0258, 0.0038, 0.9997}},
      {-0.0216, -0.0647, 0.0098}};
  auto const mount = ft::mount_of(T);
  mat3d const R = mount.T_bc.R.cast<double>();
  mat3d const RtR = R.transposed() * R;
  for (int i = 0; i < 9; ++i) {
    EXPECT_NEAR(RtR.m[i], i % 4 == 0 ? 1.0 : 0.0, 3e-7);
    EXPECT_NEAR(R.m[i], T.R.m[i], 1e-4);
  }
  auto const identity = mount.T_bc.cast<double>() * mount.T_cb.cast<double>();
  EXPECT_LT(test::angle_of(identity.R, mat3d::identity()), 3e-7);
  EXPECT_LT(test::largest(identity.t), 1e-8);
}

TEST(ImuCalibration, RefusesMountsThatAreNone) {
  auto const refused = [](ft::rigid<double> const& T) {
    return test::refusal([&] { static_cast<void>(ft::mount_of(T)); });
  };
  auto T = ft::rigid<double>::identity();
  T.R.m[1] = 0.1;
  EXPECT_TRUE(names(refused(T), "not a rotation"));
  T = ft::rigid<double>::identity();
  T.R.m[8] = -1;
  EXPECT_TRUE(names(refused(T), "reflection"));
  T = ft::rigid<double>::identity();
  T.t.y = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(names(refused(T), "imu.T_bc.t.y is nan"));
}

struct rotate_each {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, ft::vec3<float> const* w,
                                 ft::mat3<float>* out) const {
    auto const r = ft::detail::rotation_exp_and_jacobian(w[i].cast<ft::strict_float>());
    out[3 * i] = r.E.cast<float>();
    out[3 * i + 1] = r.Jr.cast<float>();
    auto const spoilt = ft::scaled(r.E, ft::strict_float(1.004f));
    out[3 * i + 2] = ft::detail::nearest_rotation(spoilt).cast<float>();
  }
};

TYPED_TEST(InertialPredictions, TurnByAnyAngle) {
  TypeParam backend;
  std::mt19937 random(6);
  std::vector<ft::vec3<float>> w{{0, 0, 0}};
  for (double size = 1e-6; size < 20; size *= 1.05) {
    vec3d const axis = random_vector(random, 1);
    w.push_back(test::times(size / test::norm(axis), axis).cast<float>());
  }
  auto const n = w.size();
  auto const d_w = test::to_exec(backend.exec, w);
  ft::buffer<ft::mat3<float>, decltype(backend.exec)::space> d_out(3 * n);
  ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(n), rotate_each{},
                                    static_cast<ft::vec3<float> const*>(d_w.data()), d_out.data());
  auto const out = test::from_exec(backend.exec, d_out.data(), 3 * n);
  std::vector<ft::mat3<float>> plain(3 * n);
  for (std::size_t i = 0; i < n; ++i) {
    ft::no_scratch none;
    rotate_each{}(ft::single_group{}, none, static_cast<int>(i), w.data(), plain.data());
    vec3d const v = w[i].cast<double>();
    double const size = test::norm(v);
    mat3d const R = test::plain_exp(v);
    EXPECT_LT(test::angle_of(out[3 * i].template cast<double>(), R), 3e-7 * (1 + size)) << size;
    EXPECT_LT(test::angle_of(out[3 * i + 2].template cast<double>(), R), 4e-7 * (1 + size)) << size;
    // The Jacobian is the mean of Exp(-s w) over s in [0, 1], here by Simpson's rule. Below 1e-4
    // it counts as the identity.
    mat3d mean{};
    constexpr int parts = 200;
    for (int k = 0; k <= parts; ++k) {
      double const weight = (k == 0 || k == parts ? 1.0 : k % 2 == 1 ? 4.0 : 2.0) / (3 * parts);
      auto const E = test::plain_exp(test::times(-static_cast<double>(k) / parts, v));
      for (std::size_t e = 0; e < 9; ++e) { mean.m[e] += weight * E.m[e]; }
    }
    double const cut = size < 1e-4 ? size : 0;
    for (std::size_t e = 0; e < 9; ++e) {
      EXPECT_NEAR(static_cast<double>(out[3 * i + 1].m[e]), mean.m[e], 1e-6 + cut) << size;
    }
  }
  EXPECT_EQ(std::memcmp(out.data(), plain.data(), out.size() * sizeof out[0]), 0);
}

}  // namespace inertial_prediction_test
