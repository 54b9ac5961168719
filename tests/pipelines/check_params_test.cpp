// SPDX-License-Identifier: Apache-2.0
// Settings are checked by check(), which names what is wrong; what contradicts itself is refused.
#include "ft/pipelines/check_params.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <string>

namespace check_params_test {

template <typename Params>
std::string refusal(Params const& p) {
  try {
    ft::check(p);
  } catch (ft::bad_argument const& e) { return e.what(); }
  return "";
}

ft::odometry_params with_imu() {
  ft::odometry_params p;
  p.imu.present = true;
  return p;
}

TEST(check_params, takes_the_defaults) {
  EXPECT_EQ(refusal(ft::orb_params{}), "");
  EXPECT_EQ(refusal(ft::tracker_params{}), "");
  EXPECT_EQ(refusal(ft::odometry_params{}), "");
  EXPECT_EQ(refusal(with_imu()), "");
  EXPECT_EQ(refusal(ft::tracking_rules{}), "");
  EXPECT_EQ(refusal(ft::place_recovery{}), "");
}

TEST(check_params, names_the_value_and_the_limits) {
  ft::odometry_params p;
  p.window.fixed = -1;
  EXPECT_EQ(refusal(p), "ft: window.fixed is -1, must be in [0, 54]");
  p = {};
  p.orb.ini_threshold = 256;  // what is nested is checked, too
  EXPECT_EQ(refusal(p), "ft: ini_threshold is 256, must be in [0, 255]");
  ft::place_recovery places;
  places.relocalization.pnp.min_share = 2;
  EXPECT_EQ(refusal(places), "ft: min_share is 2, must be in [0, 1]");
}

TEST(check_params, refuses_periods_that_are_none) {
  for (double const period : {-1.0, 1e7, std::numeric_limits<double>::quiet_NaN(),
                              std::numeric_limits<double>::infinity()}) {
    ft::odometry_params p;
    p.rules.keyframe_period_s = period;
    EXPECT_NE(refusal(p).find("rules.keyframe_period_s is "), std::string::npos) << period;
  }
}

/// With an IMU its period holds: another one in the rules would be ignored.
TEST(check_params, refuses_two_periods_of_keyframes) {
  auto p = with_imu();
  p.imu.keyframe_period_s = 0.5;
  EXPECT_EQ(refusal(p), "");
  p.rules.keyframe_period_s = 0.5;
  EXPECT_EQ(refusal(p), "");
  p.rules.keyframe_period_s = 0.75;
  std::string const said = refusal(p);
  EXPECT_NE(said.find("rules.keyframe_period_s"), std::string::npos) << said;
  EXPECT_NE(said.find("is 0.75, must be in [0.5, 0.5]"), std::string::npos) << said;
  p.imu.present = false;
  EXPECT_EQ(refusal(p), "");
}

TEST(check_params, asks_nothing_of_an_imu_that_is_not_there) {
  ft::odometry_params p;
  p.imu.samples = 0;
  EXPECT_EQ(refusal(p), "");
  p.imu.present = true;
  EXPECT_EQ(refusal(p), "ft: imu.samples is 0, must be in [2, 1048576]");
}

}  // namespace check_params_test
