// SPDX-License-Identifier: Apache-2.0
#include "stereographic.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/camera_contract.hpp"

/// A lens whose image shows 100 degrees off the axis at the middle of each side.
struct stereographic_lens : camera_contract::description<stereographic> {
  static constexpr int width = 640;
  static constexpr int height = 640;
  static constexpr bool sees_behind = true;
  static constexpr double behind_degrees = 110;
  static stereographic<double> parameters() { return {134.1, 134.3, 319.2, 320.9}; }
};

FT_CAMERA_CONTRACT(stereographic, stereographic_lens);

// The contract does not know the formula. This test compares angles off the axis with trigonometry.
TEST(stereographic_test, the_radius_is_twice_the_tangent_of_half_the_angle) {
  stereographic<double> const c{100, 200, 10, 20};
  for (double const angle : {0.1, 0.8, 1.5, 2.4}) {
    auto const seen = c.project({3 * std::sin(angle), 0, 3 * std::cos(angle)});
    EXPECT_TRUE(seen.valid);
    EXPECT_NEAR(seen.pixel.x, 10 + 100 * 2 * std::tan(angle / 2), 1e-10);
    EXPECT_EQ(seen.pixel.y, 20);
  }
}
