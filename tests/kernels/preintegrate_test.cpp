// SPDX-License-Identifier: Apache-2.0
// Preintegration: motion against double precision, derivatives against differences of that, the
// covariance against drawn noise; running on, statuses, equal bits.
#include "ft/kernels/inertial/preintegrate.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "ft/kernels/inertial/predict.hpp"
#include "ft/kernels/inertial/stored_state.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_inertial.hpp"
#include "tests/support/random.hpp"

namespace preintegrate_test {

using ft::integration_status;
using test::at;
using test::mat3d;
using test::vec3d;

using steps_of_interval = std::vector<ft::imu_step>;

ft::imu_variances noise() { return ft::variances_of({1.7e-4f, 2e-3f, 2e-5f, 3e-3f, 200.0f}); }

struct intervals {
  std::vector<ft::imu_selection> chosen;
  std::vector<ft::imu_step> steps;
  int capacity = 0;

  explicit intervals(std::vector<steps_of_interval> const& lists) {
    for (auto const& l : lists) { capacity = std::max(capacity, static_cast<int>(l.size())); }
    steps.resize(lists.size() * at(capacity));
    for (std::size_t i = 0; i < lists.size(); ++i) {
      int const n = static_cast<int>(lists[i].size());
      std::copy(lists[i].begin(), lists[i].end(), steps.begin() + static_cast<long>(i) * capacity);
      chosen.push_back(
          {0, n + 1, n, n, n > 0 ? integration_status::integrated : integration_status::no_steps});
    }
  }
  ft::imu_steps_view view() {
    return {static_cast<int>(chosen.size()), capacity, chosen.data(), steps.data()};
  }
};

/// Runs the stage. @param before integrals that run on, else their content does not matter
template <typename Exec>
std::vector<ft::preintegrated> run(Exec const& exec, intervals const& in,
                                   std::vector<ft::integral_start> const& starts,
                                   std::vector<ft::preintegrated> const& before) {
  auto const chosen = test::to_exec(exec, in.chosen);
  auto const steps = test::to_exec(exec, in.steps);
  auto const d_starts = test::to_exec(exec, starts);
  auto const integrals = test::to_exec(exec, before);
  ft::preintegrate(exec,
                   {static_cast<int>(in.chosen.size()), in.capacity, chosen.data(), steps.data()},
                   {d_starts.data(), static_cast<int>(starts.size())}, noise(), integrals.data());
  return test::from_exec(exec, integrals.data(), before.size());
}
/// One new integral.
template <typename Exec>
ft::preintegrated integrate(Exec const& exec, steps_of_interval const& steps,
                            ft::imu_bias const& bias) {
  ft::preintegrated garbage;
  std::memset(static_cast<void*>(&garbage), 0xff, sizeof garbage);
  return run(exec, intervals({steps}), {{0, 1, bias}}, {garbage})[0];
}

void expect_same_bits(std::vector<ft::preintegrated> const& a,
                      std::vector<ft::preintegrated> const& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(std::memcmp(&a[i], &b[i], sizeof a[i]), 0) << "integral " << i;
  }
}

template <typename Backend>
class Preintegration : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(Preintegration, test::backends);

TYPED_TEST(Preintegration, IsThatInDoublePrecision) {
  TypeParam backend;
  std::mt19937 random(1);
  for (int const count : {1, 2, 10, 20, 140, 190}) {
    for (int round = 0; round < test::effort(10); ++round) {
      auto const steps = test::shaken_steps(random, count, 0.005f);
      ft::imu_bias const bias = test::random_bias(random);
      auto const got = integrate(backend.exec, steps, bias);
      auto const want = test::integrate_plainly(steps, test::widened(bias));
      // A float's rounding error, 6e-8, adds up over the steps: of angles up to 2 rad, speeds up to
      // 10 m/s and ways up to 5 m.
      double const n = count;
      EXPECT_NEAR(static_cast<double>(got.dT), want.dT, 6e-8 * n);
      EXPECT_LT(test::angle_of(got.dR.template cast<double>(), want.dR), 2e-7 * (1 + n / 4));
      EXPECT_LT(test::largest(got.dV.template cast<double>() - want.dV), 1e-6 * (1 + n / 4));
      EXPECT_LT(test::largest(got.dP.template cast<double>() - want.dP), 1e-6 * (1 + n / 8));
      EXPECT_EQ(got.steps, count);
      EXPECT_EQ(got.status, integration_status::integrated);
      EXPECT_EQ(std::memcmp(&got.bias, &bias, sizeof bias), 0);
    }
  }
}

TYPED_TEST(Preintegration, FollowsMotionsThatAreKnown) {
  TypeParam backend;
  ft::imu_bias const bias{{0.01f, -0.02f, 0.03f}, {0.1f, 0.2f, -0.3f}};
  // Without rotation: v = a t, p = a t^2 / 2.
  steps_of_interval const straight(100, {{1.1f, -1.8f, 2.7f}, bias.gyro, 0.01f});
  auto const moved = integrate(backend.exec, straight, bias);
  EXPECT_LT(test::largest(moved.dV.template cast<double>() - vec3d{1, -2, 3}), 1e-5);
  EXPECT_LT(test::largest(moved.dP.template cast<double>() - vec3d{0.5, -1, 1.5}), 1e-5);
  EXPECT_LT(test::angle_of(moved.dR.template cast<double>(), mat3d::identity()), 1e-7);
  EXPECT_LT(test::largest(moved.mean_accel.template cast<double>() - vec3d{1, -2, 3}), 1e-5);
  // With a constant rate: the rotation by rate times time, also by several turns.
  for (float const rate : {0.001f, 0.5f, 8.0f, 300.0f}) {
    steps_of_interval const turning(50, {bias.accel, {rate + 0.01f, -0.02f, 0.03f}, 0.01f});
    auto const turned = integrate(backend.exec, turning, bias);
    double const whole = static_cast<double>(rate) * 0.5;
    EXPECT_LT(test::angle_of(turned.dR.template cast<double>(), test::plain_exp({whole, 0, 0})),
              2e-6 * (1 + whole))
        << rate;
    EXPECT_NEAR(static_cast<double>(turned.mean_gyro.x), static_cast<double>(rate),
                1e-6 * static_cast<double>(1 + rate));
  }
}

TYPED_TEST(Preintegration, KeepsItsRotationOrthonormal) {
  TypeParam backend;
  std::mt19937 random(2);
  auto const got =
      integrate(backend.exec, test::shaken_steps(random, 2000, 0.005f), test::random_bias(random));
  mat3d const R = got.dR.template cast<double>();
  mat3d const RtR = R.transposed() * R;
  for (int i = 0; i < 9; ++i) { EXPECT_NEAR(RtR.m[i], i % 4 == 0 ? 1.0 : 0.0, 5e-7); }
}

/// Derivatives of an integral by one component of a bias, as central differences.
struct differences {
  vec3d r, v, p;
};
differences differentiate(steps_of_interval const& steps, test::plain_bias const& bias,
                          bool by_gyro, int component) {
  double const h = 1e-5;
  test::plain_bias low = bias;
  test::plain_bias high = bias;
  auto const move = [&](test::plain_bias& b, double by) {
    vec3d& v = by_gyro ? b.gyro : b.accel;
    (component == 0 ? v.x : component == 1 ? v.y : v.z) += by;
  };
  move(low, -h);
  move(high, h);
  auto const a = test::integrate_plainly(steps, low);
  auto const b = test::integrate_plainly(steps, high);
  auto const m = test::integrate_plainly(steps, bias).dR.transposed();
  double const s = 1 / (2 * h);
  return {test::times(s, test::plain_log(m * b.dR) - test::plain_log(m * a.dR)),
          test::times(s, b.dV - a.dV), test::times(s, b.dP - a.dP)};
}
vec3d column(ft::mat3<float> const& J, int k) {
  auto const d = [](float v) { return static_cast<double>(v); };
  return {d(J.m[k]), d(J.m[3 + k]), d(J.m[6 + k])};
}

TYPED_TEST(Preintegration, HasTheDerivativesOfDifferences) {
  TypeParam backend;
  std::mt19937 random(3);
  for (int const count : {1, 2, 10, 60}) {
    for (int round = 0; round < test::effort(5); ++round) {
      auto const steps = test::shaken_steps(random, count, 0.005f);
      ft::imu_bias const bias = test::random_bias(random);
      auto const got = integrate(backend.exec, steps, bias);
      double const T = static_cast<double>(got.dT);
      for (int k = 0; k < 3; ++k) {
        auto const g = differentiate(steps, test::widened(bias), true, k);
        auto const a = differentiate(steps, test::widened(bias), false, k);
        EXPECT_LT(test::largest(column(got.JRg, k) - g.r), 3e-6 * T);
        EXPECT_LT(test::largest(column(got.JVg, k) - g.v), 3e-5 * T * T + 1e-9);
        EXPECT_LT(test::largest(column(got.JPg, k) - g.p), 3e-5 * T * T * T + 1e-9);
        EXPECT_LT(test::largest(column(got.JVa, k) - a.v), 3e-6 * T);
        EXPECT_LT(test::largest(column(got.JPa, k) - a.p), 3e-6 * T * T + 1e-9);
        EXPECT_LT(test::largest(a.r), 1e-9);  // so there is no derivative of dR by it
      }
    }
  }
}

/// Errors of an integral with drawn noise, in the order of C.
using error_vector = std::array<double, 9>;
error_vector draw_error(std::mt19937& random, steps_of_interval const& steps,
                        test::plain_bias const& bias, test::plain_integral const& exact) {
  std::normal_distribution<double> normal;
  auto const drawn = [&](float const* variance) {
    auto const one = [&](int k) {
      return std::sqrt(static_cast<double>(variance[k])) * normal(random);
    };
    double const x = one(0);
    double const y = one(1);
    return vec3d{x, y, one(2)};
  };
  ft::imu_variances const v = noise();
  test::plain_integral noisy;
  for (auto const& s : steps) {
    vec3d const rate = s.gyro.cast<double>() - bias.gyro + drawn(v.measured);
    noisy.add(s.accel.cast<double>() - bias.accel + drawn(v.measured + 3), rate,
              static_cast<double>(s.dt));
  }
  vec3d const r = test::plain_log(exact.dR.transposed() * noisy.dR);
  vec3d const dv = noisy.dV - exact.dV;
  vec3d const dp = noisy.dP - exact.dP;
  return {r.x, r.y, r.z, dv.x, dv.y, dv.z, dp.x, dp.y, dp.z};
}

/// e^T C^-1 e, where C = L L^T.
double squared_length(std::array<double, 81> const& L, error_vector e) {
  double sum = 0;
  for (std::size_t i = 0; i < 9; ++i) {
    for (std::size_t j = 0; j < i; ++j) { e[i] -= L[9 * i + j] * e[j]; }
    e[i] /= L[9 * i + i];
    sum += e[i] * e[i];
  }
  return sum;
}
std::array<double, 81> cholesky(ft::preintegrated const& integral) {
  std::array<double, 81> L{};
  for (std::size_t i = 0; i < 9; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double s = static_cast<double>(integral.C[9 * i + j]);
      for (std::size_t k = 0; k < j; ++k) { s -= L[9 * i + k] * L[9 * j + k]; }
      L[9 * i + j] = i == j ? std::sqrt(s) : s / L[9 * j + j];
    }
  }
  return L;
}

TYPED_TEST(Preintegration, HasTheCovarianceOfDrawnNoise) {
  TypeParam backend;
  std::mt19937 random(4);
  auto const steps = test::shaken_steps(random, 30, 0.005f);
  ft::imu_bias const bias = test::random_bias(random);
  auto const integral = integrate(backend.exec, steps, bias);
  auto const C = [&](std::size_t i, std::size_t j) {
    return static_cast<double>(integral.C[9 * i + j]);
  };
  auto const L = cholesky(integral);
  auto const exact = test::integrate_plainly(steps, test::widened(bias));
  int const draws = test::effort(20000);
  double const n = draws;
  std::array<double, 81> sum{};
  double lengths = 0;
  for (int d = 0; d < draws; ++d) {
    auto const e = draw_error(random, steps, test::widened(bias), exact);
    for (std::size_t i = 0; i < 81; ++i) { sum[i] += e[i / 9] * e[i % 9]; }
    lengths += squared_length(L, e);
  }
  // The mean of n products of two normal variables has this standard deviation. Each of 45 is
  // within five with a probability of 0.9999994.
  for (std::size_t i = 0; i < 9; ++i) {
    for (std::size_t j = 0; j < 9; ++j) {
      double const deviation = std::sqrt((C(i, i) * C(j, j) + C(i, j) * C(i, j)) / n);
      EXPECT_NEAR(sum[9 * i + j] / n, C(i, j), 5 * deviation) << i << " " << j;
    }
  }
  // Squared lengths are chi-squared with 9 degrees: mean 9, variance 18. This sees directions in
  // which C is small.
  EXPECT_NEAR(lengths / n, 9, 5 * std::sqrt(18 / n));
}

TYPED_TEST(Preintegration, CountsTheWalkOfTheBiasesByStep) {
  TypeParam backend;
  std::mt19937 random(5);
  auto const got = integrate(backend.exec, test::shaken_steps(random, 37, 0.005f), {});
  // (2e-5 / sqrt(200))^2 and (3e-3 / sqrt(200))^2 a step.
  for (int k = 0; k < 6; ++k) {
    double const each = k < 3 ? 2e-12 : 4.5e-8;
    EXPECT_NEAR(static_cast<double>(got.walk[k]), 37 * each, 1e-5 * 37 * each);
  }
  for (int i = 0; i < 9; ++i) {
    for (int j = 0; j < 9; ++j) { EXPECT_EQ(got.C[9 * i + j], got.C[9 * j + i]); }
  }
}

TYPED_TEST(Preintegration, RunsOnAsIfItHadNotStopped) {
  TypeParam backend;
  std::mt19937 random(6);
  std::vector<steps_of_interval> parts;
  steps_of_interval all;
  for (int const count : {10, 1, 7, 20, 10}) {
    parts.push_back(test::shaken_steps(random, count, 0.005f));
    all.insert(all.end(), parts.back().begin(), parts.back().end());
  }
  ft::imu_bias const bias = test::random_bias(random);
  std::vector<ft::preintegrated> running(2);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    // The integral from the last frame begins with each interval, that from the keyframe once.
    running = run(backend.exec, intervals({parts[i]}),
                  {{0, 1, bias}, {0, static_cast<int>(i == 0), bias}}, running);
    expect_same_bits({running[0]}, {integrate(backend.exec, parts[i], bias)});
  }
  expect_same_bits({running[1]}, {integrate(backend.exec, all, bias)});
}

TYPED_TEST(Preintegration, WithoutStepsIsOneOverNoTimeThatSaysWhy) {
  TypeParam backend;
  std::mt19937 random(7);
  ft::imu_bias const bias = test::random_bias(random);
  for (auto const why :
       {integration_status::no_samples, integration_status::one_sample,
        integration_status::no_steps, integration_status::unordered, integration_status::not_finite,
        integration_status::gap, integration_status::wrong_rate, integration_status::too_many}) {
    intervals none(std::vector<steps_of_interval>(1));
    none.chosen[0].status = why;
    ft::preintegrated garbage;
    std::memset(static_cast<void*>(&garbage), 0xff, sizeof garbage);
    auto const got = run(backend.exec, none, {{0, 1, bias}}, {garbage})[0];
    ft::preintegrated want{};
    want.dR = ft::mat3<float>::identity();
    want.bias = bias;
    want.status = why;
    expect_same_bits({got}, {want});
    EXPECT_FALSE(usable(got.status));
  }
}

TYPED_TEST(Preintegration, ThatLacksAnIntervalStaysUnusable) {
  TypeParam backend;
  std::mt19937 random(8);
  intervals good({test::shaken_steps(random, 10, 0.005f)});
  intervals bad(std::vector<steps_of_interval>(1));
  bad.chosen[0].status = integration_status::gap;
  intervals twice = good;
  twice.chosen[0].status = integration_status::repeated;
  auto const step = [&](intervals const& in, std::vector<ft::preintegrated> const& before,
                        int anew) {
    return run(backend.exec, in, {{0, anew, {}}}, before);
  };
  auto i = step(good, {ft::preintegrated{}}, 1);
  EXPECT_EQ(i[0].status, integration_status::integrated);
  i = step(twice, i, 0);
  EXPECT_EQ(i[0].status, integration_status::repeated);
  i = step(good, i, 0);
  EXPECT_EQ(i[0].status, integration_status::repeated);
  EXPECT_TRUE(usable(i[0].status));
  i = step(bad, i, 0);
  EXPECT_EQ(i[0].status, integration_status::gap);
  i = step(good, i, 0);
  EXPECT_EQ(i[0].status, integration_status::gap);
  EXPECT_EQ(i[0].steps, 40);
  i = step(good, i, 1);
  EXPECT_EQ(i[0].status, integration_status::integrated);
  EXPECT_EQ(i[0].steps, 10);
}

TYPED_TEST(Preintegration, OfManyIntervalsHasTheBitsOfPlainCalls) {
  TypeParam backend;
  std::mt19937 random(9);
  std::vector<steps_of_interval> lists;
  std::vector<ft::integral_start> starts;
  for (int i = 0; i < 500; ++i) {
    lists.push_back(test::shaken_steps(random, static_cast<int>(random() % 25u), 0.005f));
    if (i % 7 == 0) {  // angles on both sides of where Exp is computed in another way
      for (auto& s : lists.back()) { s.gyro.x *= i % 2 == 0 ? 300.0f : 1e-3f; }
    }
  }
  for (int i = 0; i < 1000; ++i) {
    starts.push_back({i / 2, static_cast<int>(random() % 2u), test::random_bias(random)});
  }
  intervals in(lists);
  std::vector<ft::preintegrated> before;
  for (int i = 0; i < 1000; ++i) {
    before.push_back(i < 500 ? ft::preintegrated{} : before[at(i - 500)]);
    before.back().dR = ft::mat3<float>::identity();
    before.back().dV = test::random_bias(random).accel;
  }
  auto want = before;
  for (int i = 0; i < 1000; ++i) {
    ft::detail::integration_scratch scratch;
    ft::detail::preintegrate_steps{}(ft::single_group{}, scratch, i, in.view(), starts.data(),
                                     noise(), want.data());
  }
  expect_same_bits(run(backend.exec, in, starts, before), want);
}

TYPED_TEST(Preintegration, OfNothingDoesNothing) {
  TypeParam backend;
  EXPECT_TRUE(run(backend.exec, intervals(std::vector<steps_of_interval>()), {}, {}).empty());
}

TEST(ChangeOfBias, IsIntegrationWithTheOtherBias) {
  std::mt19937 random(10);
  ft::host_exec const exec(1);
  for (int round = 0; round < 50; ++round) {
    auto const steps = test::shaken_steps(random, 20, 0.005f);
    ft::imu_bias const old = test::random_bias(random);
    ft::imu_bias other = old;
    ft::imu_bias const by = test::random_bias(random);
    float const share = 0.1f;  // 2e-3 rad/s, 0.02 m/s^2
    other.gyro =
        other.gyro + ft::vec3<float>{share * by.gyro.x, share * by.gyro.y, share * by.gyro.z};
    other.accel =
        other.accel + ft::vec3<float>{share * by.accel.x, share * by.accel.y, share * by.accel.z};
    auto const integral = integrate(exec, steps, old);
    auto const got = ft::change_bias(integral, other);
    auto const want = test::integrate_plainly(steps, test::widened(other));
    // Second order: (2e-3 rad/s * 0.1 s)^2 is 4e-8.
    EXPECT_LT(test::angle_of(got.dR.cast<double>(), want.dR), 1e-6);
    EXPECT_LT(test::largest(got.dV.cast<double>() - want.dV), 3e-6);
    EXPECT_LT(test::largest(got.dP.cast<double>() - want.dP), 1e-6);
    // And the old bias gives back the integral.
    auto const same = ft::change_bias(integral, old);
    EXPECT_LT(test::angle_of(same.dR.cast<double>(), integral.dR.cast<double>()), 2e-7);
    EXPECT_EQ(std::memcmp(&same.dV, &integral.dV, sizeof same.dV), 0);
    EXPECT_EQ(std::memcmp(&same.dP, &integral.dP, sizeof same.dP), 0);
    EXPECT_EQ(same.turn.x, 0.0f);
  }
}

}  // namespace preintegrate_test
