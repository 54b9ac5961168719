// SPDX-License-Identifier: Apache-2.0
// Links between the keyframes of an adjustment: a motion with a known answer, what is not known,
// equal bits on both executors.
#include "ft/kernels/odometry/link_window.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstring>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/plain_map.hpp"

namespace link_window_test {

using motion = ft::rigid<double>;
using vector = ft::vec3<double>;

constexpr int batch = 3;
constexpr int positions = 4;  // a ring: the keyframes are numbers 3 to 6
constexpr int views = 4;
constexpr int first_number = 3;
constexpr float dT = 0.25f;

struct arrays {
  ft::keyframes_view keyframes;
  ft::inertial_view imu;
  ft::window_problem_view problem;
  ft::window_sources_view sources;
  int* flags = nullptr;
};

ft::vec3<float> narrow(vector const& v) { return v.cast<float>(); }

/// Cameras that move on at a constant velocity, and turn at a constant rate.
template <typename Exec>
struct room {
  Exec const& exec;
  ft::inertial_linking how;
  vector gravity{0.3, 9.8, -0.2};
  test::mirrored<Exec, arrays> data;
  std::vector<motion> T_cw;  ///< [batch * views]

  explicit room(Exec const& on, unsigned seed)
      : exec(on), data([](ft::carver& c, arrays& v) {
          carve(c, v.keyframes, {positions, 1, 1}, batch);
          carve(c, v.imu, {positions, 1, 1}, batch);
          carve(c, v.problem, {views, 1, 1, true}, batch);
          carve(c, v.sources, {views, 1, 1, false}, 1, batch);
          v.flags = c.take<int>(batch);
        }) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> of(-1, 1);
    auto const any = [&] { return vector{of(random), of(random), of(random)}; };
    motion const T_bc = test::turn({0.3, -0.2, 1.1}, {0.05, -0.02, 0.03});
    how.mount = {T_bc.cast<float>(), T_bc.inverse().cast<float>()};
    for (int b = 0; b < batch; ++b) { fill(b, any(), any(), T_bc, test::turn(any(), any())); }
  }
  void fill(int b, vector const& rate, vector const& velocity, motion const& T_bc, motion T_wb) {
    arrays const& v = data.host;
    v.flags[b] = b == 2 ? 0 : 1;
    v.problem.view_count[b] = views;
    ft::inertial_track& t = v.imu.tracks[b];
    t = ft::inertial_track::initial();
    t.estimates = b == 1 ? 0 : 1;
    t.gravity = narrow(gravity);
    t.bias = {{0.01f, -0.02f, 0.03f}, {0.1f, 0.2f, -0.3f}};
    motion const turned = test::turn(ft::scaled(rate, static_cast<double>(dT)), {0, 0, 0});
    for (int i = 0; i < views; ++i) {
      int const number = first_number + i;
      std::ptrdiff_t const at = v.imu.at(b, v.keyframes.position(number));
      v.sources.keyframe[v.problem.view(b, i)] = number;
      v.problem.T_cw[v.problem.view(b, i)] = (T_wb * T_bc).inverse();
      v.problem.link[v.problem.view(b, i)] = {motion::identity(), 7, 7};
      T_cw.push_back(v.problem.T_cw[v.problem.view(b, i)]);
      v.imu.motion[at] = {narrow(velocity), 1, 0, narrow(rate)};
      // The interval up to the next keyframe; the integral is kept there.
      auto const down = T_wb.R.transposed() * gravity;
      ft::preintegrated p{};
      p.dT = dT;
      p.dR = turned.R.cast<float>();
      p.dV = narrow(ft::scaled(down, -static_cast<double>(dT)));
      p.dP = narrow(ft::scaled(down, -0.5 * static_cast<double>(dT * dT)));
      p.bias = t.bias;
      p.mean_gyro = narrow(rate) - t.bias.gyro;
      for (int k = 0; k < 9; ++k) { p.C[10 * k] = k < 3 ? 1e-8f : k < 6 ? 1e-6f : 4e-6f; }
      p.status = ft::integration_status::integrated;
      if (i + 1 < views) { v.imu.between[v.imu.at(b, v.keyframes.position(number + 1))] = p; }
      T_wb = {T_wb.R * turned.R, T_wb.t + ft::scaled(velocity, static_cast<double>(dT))};
    }
  }
  ft::preintegrated& integral(int b, int view) {
    arrays const& v = data.host;
    return v.imu.between[v.imu.at(b, v.keyframes.position(first_number + view))];
  }
  ft::keyframe_motion& moved(int b, int view) {
    arrays const& v = data.host;
    return v.imu.motion[v.imu.at(b, v.keyframes.position(first_number + view))];
  }
  /// Between two views of an entry, rad.
  double angle(int b) const {
    auto const at = static_cast<std::size_t>(b * views);
    auto const R = T_cw[at + 1].R * T_cw[at].R.transposed();
    return std::acos((R.m[0] + R.m[4] + R.m[8] - 1) / 2);
  }
  /// What centres of the first entry cost that are off by so much.
  double cost(std::vector<vector> const& by) const {
    ft::window_problem_view const& p = data.host.problem;
    std::vector<vector> off;
    for (std::size_t v = 0; v < views; ++v) {
      off.push_back(T_cw[v].centre() - p.centre_goal[v] + (by.empty() ? vector{} : by[v]));
    }
    double sum = 0;
    for (std::size_t i = 0; i < views * views; ++i) {
      sum += p.centre_information[i] * ft::dot(off[i / views], off[i % views]);
    }
    return sum;
  }
  /// [batch * views]
  std::vector<ft::window_link> link() {
    data.push(exec);
    arrays const& there = data.device;
    ft::link_windows(exec, there.flags, there.keyframes, how, there.problem, there.sources,
                     there.imu);
    data.pull(exec);
    return {data.host.problem.link, data.host.problem.link + batch * views};
  }
};

template <typename Backend>
class LinkWindows : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(LinkWindows, test::backends);

TYPED_TEST(LinkWindows, MeasureTheMotionBetweenKeyframes) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 1);
  auto const links = r.link();
  double const time = static_cast<double>(dT);
  for (std::size_t i = 1; i < views; ++i) {
    motion const want = r.T_cw[i] * r.T_cw[i - 1].inverse();
    for (int k = 0; k < 9; ++k) { EXPECT_NEAR(links[i].motion.R.m[k], want.R.m[k], 1e-6) << i; }
    EXPECT_NEAR(links[i].motion.t.x, want.t.x, 3e-6) << i;
    EXPECT_NEAR(links[i].motion.t.y, want.t.y, 3e-6) << i;
    EXPECT_NEAR(links[i].motion.t.z, want.t.z, 3e-6) << i;
    double const turn = 3e-8 + std::pow(5e-3 * time, 2);
    EXPECT_NEAR(links[i].rotation_weight * turn, 1, 1e-5) << i;
    EXPECT_EQ(links[i].translation_weight, 0) << "the cost of centres has it";
  }
  EXPECT_LT(r.cost({}), 1e-3) << "the path that was measured";
  EXPECT_LT(r.cost({{0.01, 0, 0}, {0.02, 0, 0}, {0.03, 0, 0}, {0.04, 0, 0}}), 1e-3)
      << "at another velocity";
  EXPECT_GT(r.cost({{0, 0, 0}, {0.01, 0, 0}, {0, 0, 0}, {0, 0, 0}}), 1);
}

TYPED_TEST(LinkWindows, CostABentPathByWhatBendsIt) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 6);
  r.integral(0, 1).status = ft::integration_status::gap;  // three views are left
  r.link();
  double const T = static_cast<double>(dT);
  auto const square = [](double x) { return x * x; };
  double const tilt = ft::dot(r.gravity, r.gravity) * square(1e-3);
  double const pp = 4e-6 + tilt * square(0.5 * T * T) + square(3e-3);
  double const pv = tilt * 0.5 * T * T * T;
  double const vv = 1e-6 + tilt * square(T);
  double const turned = square(0.1 * r.angle(0)) + square(1e-4);
  // What bends them: errors of both positions and of the velocity, and of the acceleration.
  double const variance =
      2 * pp / square(T) - 2 * pv / T + vv + square(0.1 * T) + square(0.5 * T) * turned;
  for (vector const& by : {vector{0.01, 0, 0}, vector{0, -0.02, 0.005}}) {
    double const want = ft::dot(by, by) / square(T) / variance;
    EXPECT_NEAR(r.cost({{}, {}, {}, by}) / want, 1, 2e-3);
    EXPECT_NEAR(r.cost({by, {}, {}, by}) / want, 1, 2e-3) << "nothing joins the first";
  }
}

TYPED_TEST(LinkWindows, LeaveOutWhatTheImagesMovedOtherwise) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 7);
  r.integral(0, 1).dP.x += 1;  // a metre that no camera has seen
  auto const links = r.link();
  EXPECT_GT(links[1].rotation_weight, 0);
  EXPECT_LT(r.cost({}), 1e-3);
  EXPECT_LT(r.cost({{0, 2, 0}, {}, {0.1, 0, 0}, {0.2, 0, 0}}), 1e-3) << "nothing joins the first";
  EXPECT_GT(r.cost({{}, {}, {0.1, 0, 0}, {}}), 1);
}

TYPED_TEST(LinkWindows, SayNothingOfWhatIsNotKnown) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 2);
  r.integral(0, 1).status = ft::integration_status::gap;
  r.moved(0, 1).moves = 0;
  r.integral(0, 3).dP.x = NAN;
  auto const links = r.link();
  EXPECT_EQ(links[1].rotation_weight, 0) << "a gap";
  EXPECT_EQ(links[1].translation_weight, 0) << "a gap";
  EXPECT_GT(links[2].rotation_weight, 0);
  EXPECT_EQ(links[2].translation_weight, 0) << "no velocity";
  EXPECT_EQ(links[3].rotation_weight, 0) << "not a number";
  EXPECT_EQ(links[3].translation_weight, 0) << "not a number";
  for (std::size_t i = 1; i < views; ++i) {
    EXPECT_EQ(links[views + i].rotation_weight, 0) << "no estimate yet";
    EXPECT_EQ(links[2 * views + i].rotation_weight, 7) << "not asked for";
  }
  r.data.host.imu.tracks[0].doubted = 1;
  EXPECT_EQ(r.link()[2].rotation_weight, 0) << "many matches have outvoted it";
}

TYPED_TEST(LinkWindows, AreWeakerWhileTheOffsetOfTheClocksIsNotKnown) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 3);
  auto const at_once = r.link();
  float const sigma = 0.01f, faster = 0.5f;  // the rate of turning changes by so much, rad/s
  r.data.host.imu.tracks[0].clock_sigma = sigma;
  r.moved(0, 2).rate.y += faster;
  auto const links = r.link();
  EXPECT_NEAR(links[1].rotation_weight / at_once[1].rotation_weight, 1, 1e-9) << "a constant rate";
  double const more = std::pow(static_cast<double>(sigma * faster), 2);
  for (std::size_t const i : {std::size_t{2}, std::size_t{3}}) {
    EXPECT_NEAR(1 / links[i].rotation_weight - 1 / at_once[i].rotation_weight, more, 1e-4 * more);
    EXPECT_EQ(links[i].translation_weight, at_once[i].translation_weight);
  }
}

TYPED_TEST(LinkWindows, TakeTheMeanRateForOneThatIsUnknown) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 5);
  auto const at_once = r.link();
  float const sigma = 0.01f;
  r.data.host.imu.tracks[0].clock_sigma = sigma;
  ft::vec3<float> const mean = r.moved(0, 0).rate;
  r.moved(0, 0).rate = ft::inertial_track::no_rate();
  auto const one = r.link();
  EXPECT_NEAR(one[1].rotation_weight / at_once[1].rotation_weight, 1, 1e-9);
  r.moved(0, 1).rate = ft::inertial_track::no_rate();
  auto const both = r.link();
  // Nothing tells that the rate did not change: by as much as it was.
  double const more = std::pow(static_cast<double>(sigma), 2) * dot(mean, mean);
  EXPECT_NEAR(1 / both[1].rotation_weight - 1 / at_once[1].rotation_weight, more, 1e-4 * more);
  EXPECT_NEAR(both[2].rotation_weight / at_once[2].rotation_weight, 1, 1e-9);
}

TYPED_TEST(LinkWindows, SayNothingWhereTheImagesTurnedOtherwise) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec, 4);
  motion& pose = r.data.host.problem.T_cw[r.data.host.problem.view(0, 2)];
  motion const was = pose;
  pose = test::turn({0.006, 0, 0}, {0, 0, 0}) * was;
  EXPECT_GT(r.link()[2].rotation_weight, 0) << "as far as the errors of poses explain";
  pose = test::turn({0.03, 0, 0}, {0, 0, 0}) * was;
  auto const links = r.link();
  EXPECT_EQ(links[2].rotation_weight, 0);
  EXPECT_EQ(links[2].translation_weight, 0);
  EXPECT_EQ(links[3].rotation_weight, 0) << "from there on it is the other way";
  EXPECT_GT(links[1].rotation_weight, 0);
}

TYPED_TEST(LinkWindows, ExecutorsAgreeToTheBit) {
  TypeParam backend;
  ft::host_exec const host(1);
  for (unsigned seed = 10; seed < 20; ++seed) {
    room<ft::host_exec> a(host, seed);
    room<typename TypeParam::exec_type> b(backend.exec, seed);
    for (int k = 1; k < views; ++k) {
      auto const any = static_cast<float>(seed * static_cast<unsigned>(k) % 7);
      a.integral(0, k).C[60] = b.integral(0, k).C[60] = 1e-6f * any;
    }
    if (seed % 3 == 0) {
      a.integral(0, 2).status = b.integral(0, 2).status = ft::integration_status::gap;
    }
    auto const want = a.link();
    auto const got = b.link();
    auto const& p = a.data.host.problem;
    auto const& q = b.data.host.problem;
    EXPECT_EQ(
        std::memcmp(p.centre_information, q.centre_information, 2 * views * views * sizeof(double)),
        0)
        << seed;
    EXPECT_EQ(std::memcmp(p.centre_goal, q.centre_goal, 2 * views * sizeof(vector)), 0) << seed;
    EXPECT_EQ(std::memcmp(want.data(), got.data(), want.size() * sizeof(want[0])), 0) << seed;
    EXPECT_GT(want[1].rotation_weight, 0);
  }
}

}  // namespace link_window_test
