// SPDX-License-Identifier: Apache-2.0
// What single camera models promise beyond the contract (camera_contract_test.cpp), and the rigs.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "ft/cameras/camera_model.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/error.hpp"

namespace camera_test {

/// Real calibrations: EuRoC's left camera, TUM-VI's.
inline ft::pinhole<double> ahead() { return {458.654, 457.296, 367.215, 248.375}; }
inline ft::kannala_brandt<double> fisheye() {
  return {190.97847715128717,     190.9733070521226,     254.93170605935475,
          256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
          -0.0020532361418706202, 0.00020293673591811182};
}

// As ft/cameras/camera_model.hpp prints the contract.
template <typename Scalar>
struct my_camera {
  using scalar_type = Scalar;
  static constexpr char const* name = "my_camera";
  static constexpr auto parameters = ft::camera_parameters({{"k", -1, 1}});
  Scalar fx, fy, cx, cy, k;

  FT_HOST_DEVICE ft::projection<Scalar> project(ft::vec3<Scalar> p) const;
  FT_HOST_DEVICE ft::projection_with_jacobian<Scalar> project_with_jacobian(
      ft::vec3<Scalar> p) const;
  FT_HOST_DEVICE ft::ray<Scalar> unproject(ft::vec2<Scalar> pixel) const;
  template <typename U>
  FT_HOST_DEVICE my_camera<U> cast() const {
    return ft::cast_camera<my_camera<U>>(*this);
  }
  void check() const { ft::check_camera(*this); }
};
/// What of it does not depend on the scalar's name.
struct without_scalar_type {
  static constexpr char const* name = "without_scalar_type";
  static constexpr auto parameters = ft::camera_parameters();
  float fx, fy, cx, cy;
};

TEST(camera_model_unit, is_what_keeps_the_printed_contract) {
  EXPECT_TRUE(ft::is_camera_model_v<my_camera<float>>);
  EXPECT_TRUE(ft::assert_camera_model<my_camera<float>>::value);
  EXPECT_TRUE((ft::detail::is_expression<ft::detail::camera_scalar, my_camera<float>>));
  EXPECT_FALSE(ft::is_camera_model_v<without_scalar_type>);
  EXPECT_FALSE((ft::detail::is_expression<ft::detail::camera_scalar, without_scalar_type>));
  EXPECT_TRUE((ft::detail::is_expression<ft::detail::camera_names, without_scalar_type>));
}

TEST(kannala_brandt_unit, beyond_a_right_angle_rays_are_not_valid) {
  // fx = 100 and no distortion: 200 pixels off the centre are 2 rad off the axis, clamped to 90
  // degrees.
  ft::kannala_brandt<double> const c{100, 100, 0, 0, 0, 0, 0, 0};
  EXPECT_TRUE(c.unproject({150, 0}).valid);
  EXPECT_FALSE(c.unproject({200, 0}).valid);
  EXPECT_FALSE(c.unproject({0, -158}).valid);
}

TEST(kannala_brandt_unit, a_radius_that_no_angle_has_gives_no_valid_ray) {
  // theta - 0.2 theta^3 grows up to theta = 1.29 only, where it is 0.861.
  ft::kannala_brandt<double> const c{100, 100, 0, 0, -0.2, 0, 0, 0};
  int valid = 0;
  for (int u = 1; u <= 150; ++u) {
    auto const lifted = c.unproject({static_cast<double>(u), 0});
    if (!lifted.valid) { continue; }
    ++valid;
    EXPECT_NEAR(c.project(lifted.direction).pixel.x, u, 1e-6)
        << "valid, but not the ray of its pixel";
  }
  EXPECT_GE(valid, 85);
}

TEST(kannala_brandt_unit, without_distortion_the_radius_is_the_angle) {
  ft::kannala_brandt<double> const c{100, 200, 10, 20, 0, 0, 0, 0};
  for (double const angle : {0.1, 0.7, 1.5, 2.5}) {
    auto const seen = c.project({3 * std::sin(angle), 0, 3 * std::cos(angle)});
    EXPECT_TRUE(seen.valid);
    EXPECT_NEAR(seen.pixel.x, 10 + 100 * angle, 1e-12 * 1000);
    EXPECT_NEAR(seen.pixel.y, 20, 1e-12);
  }
}

TEST(kannala_brandt_unit, rays_reach_the_plane_one_metre_ahead) {
  auto const c = fisheye();
  int valid = 0;
  for (int u = 0; u < 512; u += 8) {
    auto const lifted = c.unproject({static_cast<double>(u), 100});
    valid += static_cast<int>(lifted.valid);
    if (lifted.valid) { EXPECT_EQ(lifted.direction.z, 1) << u; }
  }
  EXPECT_GT(valid, 50);
}

TEST(kannala_brandt_unit, on_the_axis_the_jacobian_is_a_pinholes) {
  auto const c = fisheye();
  auto const j = c.project_with_jacobian({0, 0, 2}).jacobian;
  double const want[6] = {c.fx / 2, 0, 0, 0, c.fy / 2, 0};
  for (int k = 0; k < 6; ++k) { EXPECT_DOUBLE_EQ(j.m[k], want[k]) << k; }
  auto const lifted = c.unproject({c.cx, c.cy});
  EXPECT_EQ(lifted.direction.x, 0);
  EXPECT_EQ(lifted.direction.y, 0);
}

TEST(pinhole_unit, is_a_division_and_an_offset) {
  ft::pinhole<double> const c{100, 200, 10, 20};
  auto const seen = c.project({1, -2, 4});
  EXPECT_TRUE(seen.valid);
  EXPECT_EQ(seen.pixel.x, 35);
  EXPECT_EQ(seen.pixel.y, -80);
  auto const lifted = c.unproject({35, -80});
  EXPECT_TRUE(lifted.valid);
  EXPECT_EQ(lifted.direction.x, 0.25);
  EXPECT_EQ(lifted.direction.y, -0.5);
  EXPECT_EQ(lifted.direction.z, 1);
}

TEST(rectified_rig_unit, checks_its_baseline) {
  ft::pinhole<float> const c{400, 400, 320, 240};
  auto const rig = ft::rectified_rig::make(c, 0.1f);
  EXPECT_EQ(rig.bf(), 0.1f * 400.0f);
  EXPECT_NO_THROW(rig.check());
  for (float const bad : {0.0f, -0.1f, std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity()}) {
    EXPECT_THROW(ft::rectified_rig::make(c, bad), ft::bad_argument) << bad;
    EXPECT_THROW(ft::rectified_rig::make({bad, 400, 320, 240}, 0.1f), ft::bad_argument) << bad;
    EXPECT_THROW(ft::rectified_rig::make({400, bad, 320, 240}, 0.1f), ft::bad_argument) << bad;
  }
  float const nan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(ft::rectified_rig::make({400, 400, nan, 240}, 0.1f), ft::bad_argument);
  auto broken = rig;
  broken.baseline = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(broken.check(), ft::bad_argument);
}

/// With a float baseline, 9 % of these bf would come back with another last bit.
TEST(rectified_rig_unit, gives_back_what_it_was_made_from_to_the_bit) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> focal(50, 2000);
  std::uniform_real_distribution<float> metres(0.001f, 30);
  for (int i = 0; i < 100000; ++i) {
    ft::pinhole<float> const c{focal(random), 400, 320, 240};
    float const baseline = metres(random);
    auto const from_baseline = ft::rectified_rig::make(c, baseline);
    ASSERT_EQ(from_baseline.baseline_length().value, baseline);
    ASSERT_EQ(from_baseline.bf(), baseline * c.fx);
    float const bf = baseline * 437.3f;
    auto const from_bf = ft::rectified_rig::from_bf(c, bf);
    ASSERT_EQ(from_bf.bf(), bf);
    ASSERT_EQ(from_bf.baseline_length().value, bf / c.fx);
  }
}

TEST(stereo_rig_unit, checks_its_cameras_and_its_motion) {
  using rig_type = ft::stereo_rig<ft::kannala_brandt<float>, ft::pinhole<float>>;
  float const nan = std::numeric_limits<float>::quiet_NaN();
  rig_type const good{fisheye().cast<float>(),
                      ahead().cast<float>(),
                      {ft::mat3<float>::identity(), {-0.3f, 0, 0.4f}}};
  EXPECT_NO_THROW(good.check());
  EXPECT_FLOAT_EQ(good.baseline_length().value, 0.5f);
  auto const refused = [&](auto change) {
    rig_type rig = good;
    change(rig);
    EXPECT_THROW(rig.check(), ft::bad_argument);
  };
  refused([](auto& r) { r.left.fx = -1; });
  refused([](auto& r) { r.right.fy = 0; });
  refused([&](auto& r) { r.left.k1 = nan; });
  refused([&](auto& r) { r.T_rl.t.y = nan; });
  refused([](auto& r) { r.T_rl.t = {0, 0, 0}; });
  refused([&](auto& r) { r.T_rl.R.m[5] = nan; });
  refused([](auto& r) { r.T_rl.R.m[0] = 1.1f; });
  refused([](auto& r) { r.T_rl.R.m[1] = 0.1f; });
  refused([](auto& r) { r.T_rl.R = {{0, 0, 0, 0, 0, 0, 0, 0, 0}}; });
}

TEST(stereo_rig_unit, a_mirror_is_no_rotation) {
  ft::stereo_rig<ft::pinhole<float>, ft::pinhole<float>> rig{
      ahead().cast<float>(), ahead().cast<float>(), {ft::mat3<float>::identity(), {-0.1f, 0, 0}}};
  rig.T_rl.R.m[0] = -1;
  EXPECT_THROW(rig.check(), ft::bad_argument);
}

}  // namespace camera_test
