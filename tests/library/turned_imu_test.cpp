// SPDX-License-Identifier: Apache-2.0
// An IMU that is turned by up to half a turn from where T_bc says: by how much is told, and the
// samples are turned back.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/any_odometry.hpp"
#include "ft/math/so3.hpp"
#include "ft/pipelines/imu_warnings.hpp"
#include "tests/support/rolling_walk.hpp"

namespace turned_imu_test {

using namespace test::rolling;

constexpr double degree = 3.14159265358979 / 180;
way const long_sway{[](double t) { return sway(t, 1); }, 115, 20};

matrix rotation_of(vector const& turn) {
  return ft::detail::rotation_exp(turn.cast<ft::detail::real64>()).cast<double>();
}
double angle_between(matrix const& a, matrix const& b) {
  matrix const R = a.transposed() * b;
  double const chord = std::sqrt(std::fmax(0, 3 - R.m[0] - R.m[4] - R.m[8]));
  return 2 * std::asin(std::fmin(1, chord / 2));
}

/// Of an IMU in the body. The world's y axis points down. @param step time in frames
ft::imu_measurement sample_at(double step) {
  constexpr double h = 1e-3;
  double const dt = h / long_sway.rate_hz;
  motion const before = long_sway.pose(step - h), now = long_sway.pose(step),
               after = long_sway.pose(step + h);
  matrix const dR = before.R.transposed() * after.R;
  vector const bent = ft::scaled((after.t - now.t) - (now.t - before.t), 1 / (dt * dt));
  vector const force = now.R.transposed() * vector{bent.x, bent.y - 9.81, bent.z};
  vector const rate =
      ft::scaled(vector{dR.m[7] - dR.m[5], dR.m[2] - dR.m[6], dR.m[3] - dR.m[1]}, 1 / (4 * dt));
  auto const period = static_cast<double>(long_sway.time_ns(0));
  return {static_cast<std::int64_t>(std::llround((step + 1) * period)), force.cast<float>(),
          rate.cast<float>()};
}

TEST(turned_imu, is_told_by_how_much_and_turned_back) {
  mounted const left{any::of(ft::pinhole<float>{300, 300, 239.5f, 179.5f}), motion::identity(), 0};
  mounted right = left;
  right.T_cb.t.x = -baseline;
  auto const walk = walk_of({left, right}, long_sway);
  auto p = test::room::odometry_params(4096);
  p.window = {10, 4};
  p.imu.present = true;
  p.imu.keyframe_period_s = 0.2;
  p.imu.initialization.least_keyframes = 8;
  double const third = 170 * degree / std::sqrt(3.0);
  for (vector const turn : {vector{third, -third, third}, {0, 0, 180 * degree}}) {
    auto odo = ft::make_odometry(
        {}, ft::rig_description::rectified_pair(focal, focal, 239.5, 179.5, baseline), p);
    matrix const to_imu = rotation_of(turn).transposed();
    int samples = 0;
    ft::tracking t;
    for (int i = 0; i < long_sway.frames; ++i) {
      for (; samples <= 10 * i; ++samples) {
        ft::imu_measurement s = sample_at(0.1 * samples);
        s.accel = to_imu.cast<float>() * s.accel;
        s.gyro = to_imu.cast<float>() * s.gyro;
        odo.add_imu(s);
      }
      t = odo.track(images_of(walk[at(i)]), long_sway.time_ns(i));
      EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
      if (i == 5) { EXPECT_EQ(ft::dot(t.imu.turn, t.imu.turn), 0) << "not known yet"; }
    }
    EXPECT_GT(t.imu.misalignment.sigma, 0);
    EXPECT_LT(t.imu.misalignment.sigma, 0.2 * degree);
    EXPECT_LT(angle_between(rotation_of(t.imu.misalignment.turn), rotation_of(turn)), 0.2 * degree);
    EXPECT_LT(angle_between(rotation_of(t.imu.turn), rotation_of(turn)), 0.2 * degree);
    EXPECT_TRUE(t.imu.known) << "it begins anew with the samples turned back";
    int told = 0;
    for (std::string const& text : ft::imu_warnings(t.imu, p.imu)) {
      told += text.find("turned by 170 degrees") != std::string::npos ||
              text.find("turned by 180 degrees") != std::string::npos;
    }
    EXPECT_EQ(told, 1);
  }
}

}  // namespace turned_imu_test
