// SPDX-License-Identifier: Apache-2.0
/// @file Tests of a model alone. Part of tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <random>
#include <string>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "tests/camera_contract/questions.hpp"

namespace camera_contract {
inline namespace FT_ABI {

template <typename Setting>
class camera_model : public on_executor<Setting> {
protected:
  using base = on_executor<Setting>;
  using lens = typename base::lens;

  template <typename Scalar>
  void check_round_trip(double tolerance) {
    auto const questions = base::pixels();
    auto const got = this->template ask<Scalar>(questions);
    std::size_t valid = 0;
    for (std::size_t i = 0; i < got.size(); ++i) {
      if (got[i].of_pixel.valid == 0) { continue; }
      ++valid;
      auto const& p = questions[i].pixel;
      ASSERT_EQ(got[i].again.valid, 1) << "the ray of " << p.x << ", " << p.y << " has no pixel";
      ASSERT_NEAR(got[i].again.pixel.x, p.x, tolerance) << p.x << ", " << p.y;
      ASSERT_NEAR(got[i].again.pixel.y, p.y, tolerance) << p.x << ", " << p.y;
    }
    EXPECT_GE(static_cast<double>(valid), lens::least_share * static_cast<double>(got.size()))
        << "pixels of the image that have a ray";
  }

  template <typename Scalar>
  void check_rays(double pixels) {
    double const tolerance = 10 * pixels / base::functions().focal();
    auto questions = base::points();
    std::size_t const shown = questions.size();
    std::mt19937 random(1);
    for (int i = 0; i < 1000; ++i) { questions.push_back({random_direction(random), {1, 1}}); }
    auto const c = base::functions();
    auto const got = this->template ask<Scalar>(questions);
    for (std::size_t i = 0; i < got.size(); ++i) {
      auto const& p = questions[i].point;
      if (i < shown) {
        ASSERT_EQ(got[i].of_point.valid, 1) << p.x << ", " << p.y << ", " << p.z;
        ASSERT_EQ(got[i].back.valid, 1) << p.x << ", " << p.y << ", " << p.z;
      } else if (got[i].of_point.valid == 0 || !c.in_image(got[i].of_point.pixel) ||
                 got[i].back.valid == 0) {
        continue;
      }
      ASSERT_LT(angle_between(got[i].back.direction, p), tolerance)
          << "the point " << p.x << ", " << p.y << ", " << p.z << " is seen at "
          << got[i].of_point.pixel.x << ", " << got[i].of_point.pixel.y << ", whose ray is "
          << got[i].back.direction.x << ", " << got[i].back.direction.y << ", "
          << got[i].back.direction.z;
    }
  }

  template <typename Scalar>
  void check_behind() {
    std::vector<vector> straight{{0, 0, -1}, {0, 0, -5}, {0, 0, 0}};
    std::vector<vector> behind;
    std::mt19937 random(2);
    for (int i = 0; i < 300; ++i) {
      vector d = random_direction(random);
      d.z = i < 20 ? 0 : -std::abs(d.z);
      behind.push_back(d);
    }
    for (auto const& a : this->template ask<Scalar>(base::in_directions(straight))) {
      EXPECT_EQ(a.of_point.valid, 0) << "straight behind, and in the centre, no pixel is right";
      EXPECT_TRUE(std::isfinite(a.of_point.pixel.x) && std::isfinite(a.of_point.pixel.y));
    }
    auto const got = this->template ask<Scalar>(base::in_directions(behind));
    for (std::size_t i = 0; i < got.size(); ++i) {
      auto const& seen = got[i].of_point;
      if (!lens::sees_behind) {
        ASSERT_EQ(seen.valid, 0)
            << "z = " << behind[i].z << " has a valid pixel. A lens that sees behind its plane "
            << "says so in its description: sees_behind = true, and with behind_degrees, an angle "
            << "above 90 that it sees";
      }
      ASSERT_TRUE(std::isfinite(seen.pixel.x) && std::isfinite(seen.pixel.y))
          << "a pixel that is not valid is still a number; z = " << behind[i].z;
    }
    if (!lens::sees_behind) { return; }
    std::vector<vector> seen;
    for (int i = 0; i < 8; ++i) {
      seen.push_back(direction(lens::behind_degrees * pi / 180, i * pi / 4));
    }
    for (auto const& a : this->template ask<Scalar>(base::in_directions(seen))) {
      EXPECT_EQ(a.of_point.valid, 1)
          << "no valid pixel " << lens::behind_degrees << " degrees off the axis: the description "
          << "says sees_behind = true and behind_degrees = " << lens::behind_degrees;
    }
  }

  template <typename Scalar>
  void check_outward_walk(double slack) {
    constexpr int azimuths = 36;
    constexpr int steps = 719;
    std::vector<vector> walk{{0, 0, 1}};
    for (int a = 0; a < azimuths; ++a) {
      for (int s = 1; s <= steps; ++s) {
        walk.push_back(direction(s * pi / (steps + 1), a * 2 * pi / azimuths));
      }
    }
    auto const got = this->template ask<Scalar>(base::in_directions(walk));
    auto const centre = got[0].of_point.pixel;
    for (int a = 0; a < azimuths; ++a) {
      double farthest = 0;
      double its_degrees = 0;
      for (int s = 1; s <= steps; ++s) {
        auto const& seen = got[at(1 + a * steps + s - 1)].of_point;
        double const degrees = 180.0 * s / (steps + 1);
        ASSERT_TRUE(std::isfinite(seen.pixel.x) && std::isfinite(seen.pixel.y)) << degrees;
        if (seen.valid == 0) { continue; }
        double const radius = std::hypot(seen.pixel.x - centre.x, seen.pixel.y - centre.y);
        ASSERT_GT(radius, farthest - slack)
            << degrees << " degrees off the axis a valid pixel is no farther out than at "
            << its_degrees << ": two directions share it (azimuth " << a * 360 / azimuths << ")";
        farthest = radius;
        its_degrees = degrees;
      }
    }
  }

  template <typename Scalar>
  void check_points_without_a_number() {
    std::vector<vector> bad;
    for (double const v : {nan, infinity, -infinity}) {
      for (double const z : {-1.0, 0.0, 1.0}) {
        for (vector const p : {vector{v, 0.2, z}, {0.1, v, z}, {v, v, z}, {v, 0, z}}) {
          bad.push_back(p);
        }
      }
      bad.push_back({v, v, v});
    }
    for (vector const p : {vector{0.1, 0.2, nan},
                           {0, 0, nan},
                           {0.1, 0.2, -infinity},
                           {infinity, 0.1, infinity},
                           {nan, 0.1, infinity}}) {
      bad.push_back(p);
    }
    auto const got = this->template ask<Scalar>(base::in_directions(bad));
    for (std::size_t i = 0; i < bad.size(); ++i) {
      EXPECT_FALSE(got[i].of_point.usable())
          << bad[i].x << ", " << bad[i].y << ", " << bad[i].z << " became the pixel "
          << got[i].of_point.pixel.x << ", " << got[i].of_point.pixel.y;
    }
    // Infinitely far ahead is on the axis, or nowhere.
    auto const far = this->template ask<Scalar>(base::in_directions({{0, 0, 1}, {1, 1, infinity}}));
    if (far[1].of_point.usable()) {
      EXPECT_EQ(far[1].of_point.pixel.x, far[0].of_point.pixel.x);
      EXPECT_EQ(far[1].of_point.pixel.y, far[0].of_point.pixel.y);
    }
  }

  template <typename Scalar>
  void check_pixels_without_a_number() {
    std::vector<question> bad;
    for (double const v : {nan, infinity, -infinity}) {
      for (ft::vec2<double> const p : {ft::vec2<double>{v, 1}, {1, v}, {v, v}}) {
        bad.push_back({{0, 0, 1}, p});
      }
    }
    auto const got = this->template ask<Scalar>(bad);
    for (std::size_t i = 0; i < bad.size(); ++i) {
      EXPECT_EQ(got[i].of_pixel.valid, 0) << bad[i].pixel.x << ", " << bad[i].pixel.y;
    }
  }

  template <typename Scalar>
  void check_refusals() {
    auto const good = base::model().template cast<Scalar>();
    EXPECT_NO_THROW(good.check());
    auto const refused = [&](int i, double value) {
      EXPECT_THROW(with_parameter(good, i, value).check(), ft::bad_argument)
          << "parameter " << i << " = " << value;
    };
    for (int i = 0; i < 2; ++i) {
      for (double const focal : {0.0, -1.0, 1e9}) { refused(i, focal); }
    }
    using model = typename base::template model_of<Scalar>;
    for (int i = 0; i < ft::num_params_v<model>; ++i) {
      for (double const value : {nan, infinity, -infinity}) { refused(i, value); }
      // The limits are in double; a float next to one is beyond it by more than a rounding.
      auto const& limits = model::parameters.of[i];
      double const both[] = {limits.low, limits.high};
      for (double const limit : both) {
        if (!std::isfinite(limit)) { continue; }
        double const beyond = 1e-3 * (1 + std::abs(limit));
        refused(i, limit == limits.low ? limit - beyond : limit + beyond);
      }
    }
  }
};
TYPED_TEST_SUITE_P(camera_model);

TYPED_TEST_P(camera_model, keeps_the_contract) {
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<float>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<double>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<ft::strict_float>>);
  EXPECT_TRUE(ft::is_camera_model_v<typename TestFixture::template model_of<ft::strict_double>>);
  EXPECT_GT(std::string(TestFixture::template model_of<float>::name).size(), 0u);
}

TYPED_TEST_P(camera_model, holds_its_parameters_and_nothing_else) {
  using narrow = typename TestFixture::template model_of<float>;
  using wide = typename TestFixture::template model_of<double>;
  using strict = typename TestFixture::template model_of<ft::strict_float>;
  ASSERT_GE(ft::num_params_v<narrow>, 4);
  EXPECT_EQ(sizeof(narrow), sizeof(float) * static_cast<std::size_t>(ft::num_params_v<narrow>));
  EXPECT_EQ(sizeof(wide), sizeof(double) * static_cast<std::size_t>(ft::num_params_v<wide>));
  EXPECT_EQ(sizeof(strict), sizeof(float) * static_cast<std::size_t>(ft::num_params_v<strict>));
}

TYPED_TEST_P(camera_model, the_first_parameters_are_fx_fy_cx_cy) {
  auto const c = TestFixture::model();
  vector const p{0.1, 0.07, 1};
  auto const seen = c.project(p).pixel;
  double const u = seen.x - parameter(c, 2);
  double const v = seen.y - parameter(c, 3);
  auto const near = [&](int i, double by, double want_u, double want_v) {
    auto const other = with_parameter(c, i, i < 2 ? parameter(c, i) * by : parameter(c, i) + by);
    auto const got = other.project(p).pixel;
    EXPECT_NEAR(got.x, want_u, 1e-9) << "parameter " << i;
    EXPECT_NEAR(got.y, want_v, 1e-9) << "parameter " << i;
  };
  near(0, 2, seen.x + u, seen.y);
  near(1, 2, seen.x, seen.y + v);
  near(2, 3, seen.x + 3, seen.y);
  near(3, 3, seen.x, seen.y + 3);
}

TYPED_TEST_P(camera_model, a_cast_keeps_the_parameters) {
  auto const in_float = TestFixture::lens::parameters().template cast<float>();
  auto const there = in_float.template cast<double>().template cast<ft::strict_double>();
  auto const back = there.template cast<ft::strict_float>().template cast<float>();
  EXPECT_EQ(std::memcmp(&back, &in_float, sizeof back), 0);
  auto const c = TestFixture::lens::parameters();
  for (int i = 0; i < ft::num_params_v<typename TestFixture::template model_of<float>>; ++i) {
    EXPECT_EQ(parameter(in_float, i), static_cast<double>(static_cast<float>(parameter(c, i))))
        << "parameter " << i;
  }
}

TYPED_TEST_P(camera_model, calibrations_that_cannot_be_throw) {
  this->template check_refusals<float>();
  this->template check_refusals<double>();
}

TYPED_TEST_P(camera_model, a_pixel_survives_the_round_trip) {
  using data = typename TestFixture::lens;
  this->template check_round_trip<double>(data::double_pixels);
  this->template check_round_trip<ft::strict_double>(data::double_pixels);
  this->template check_round_trip<float>(data::float_pixels);
  this->template check_round_trip<ft::strict_float>(data::float_pixels);
}

TYPED_TEST_P(camera_model, a_pixel_outside_the_image_has_its_own_ray_or_none) {
  auto const questions = TestFixture::pixels(1.5);
  auto const got = this->template ask<double>(questions);
  double const tolerance = 1e3 * TestFixture::lens::double_pixels;
  for (std::size_t i = 0; i < got.size(); ++i) {
    if (got[i].of_pixel.valid == 0) { continue; }
    auto const& p = questions[i].pixel;
    ASSERT_EQ(got[i].again.valid, 1) << p.x << ", " << p.y;
    ASSERT_NEAR(got[i].again.pixel.x, p.x, tolerance) << p.x << ", " << p.y;
    ASSERT_NEAR(got[i].again.pixel.y, p.y, tolerance) << p.x << ", " << p.y;
  }
}

TYPED_TEST_P(camera_model, a_ray_points_at_its_point) {
  using data = typename TestFixture::lens;
  this->template check_rays<double>(data::double_pixels);
  this->template check_rays<ft::strict_double>(data::double_pixels);
  this->template check_rays<float>(data::float_pixels);
  this->template check_rays<ft::strict_float>(data::float_pixels);
}

TYPED_TEST_P(camera_model, float_and_double_agree) {
  auto const questions = TestFixture::points();
  auto const wide = this->template ask<double>(questions);
  auto const narrow = this->template ask<float>(questions);
  auto const strict = this->template ask<ft::strict_float>(questions);
  double const tolerance = TestFixture::lens::float_pixels;
  for (std::size_t i = 0; i < questions.size(); ++i) {
    for (sight const& got : std::vector<sight>{narrow[i].of_point, strict[i].of_point}) {
      ASSERT_EQ(got.valid, wide[i].of_point.valid);
      ASSERT_NEAR(got.pixel.x, wide[i].of_point.pixel.x, tolerance);
      ASSERT_NEAR(got.pixel.y, wide[i].of_point.pixel.y, tolerance);
    }
  }
}

TYPED_TEST_P(camera_model, the_jacobian_is_the_derivative) {
  using data = typename TestFixture::lens;
  auto questions = TestFixture::points();
  for (vector const p : {vector{0, 0, 2}, {1e-7, -2e-7, 1}, {1e-4, 3e-5, 1}}) {
    questions.push_back({p, {1, 1}});
  }
  if (data::sees_behind) {
    questions.push_back({direction((90 + data::behind_degrees) / 2 * pi / 180, 0.3), {1, 1}});
  }
  auto const c = TestFixture::model();
  auto const got = this->template ask<double>(questions);
  auto const narrow = this->template ask<float>(questions);
  for (std::size_t i = 0; i < questions.size(); ++i) {
    vector const p = questions[i].point;
    double const h = 1e-6 * length(p);
    double numeric[6];
    double largest = 0;
    for (int k = 0; k < 3; ++k) {
      vector ahead = p;
      vector behind = p;
      (k == 0 ? ahead.x : k == 1 ? ahead.y : ahead.z) += h;
      (k == 0 ? behind.x : k == 1 ? behind.y : behind.z) -= h;
      auto const a = c.project(ahead).pixel;
      auto const b = c.project(behind).pixel;
      numeric[k] = (a.x - b.x) / (2 * h);
      numeric[3 + k] = (a.y - b.y) / (2 * h);
      largest = std::max({largest, std::abs(numeric[k]), std::abs(numeric[3 + k])});
    }
    for (std::size_t k = 0; k < 6; ++k) {
      ASSERT_NEAR(got[i].jacobian[k], numeric[k], 1e-6 * largest)
          << "entry " << k << " at " << p.x << ", " << p.y << ", " << p.z;
      ASSERT_NEAR(narrow[i].jacobian[k], got[i].jacobian[k], 1e-4 * largest)
          << "entry " << k << " in float at " << p.x << ", " << p.y << ", " << p.z;
    }
  }
}

TYPED_TEST_P(camera_model, the_jacobian_comes_with_the_projection) {
  using data = typename TestFixture::lens;
  auto questions = TestFixture::points();
  std::mt19937 random(5);
  for (int i = 0; i < 300; ++i) { questions.push_back({random_direction(random), {1, 1}}); }
  for (double const bad : {nan, infinity}) { questions.push_back({{bad, 0.1, 1}, {1, 1}}); }
  auto const expect_agreement = [](std::vector<answer> const& got, double tolerance) {
    for (answer const& a : got) {
      ASSERT_EQ(a.with_jacobian.usable(), a.of_point.usable());
      if (!a.of_point.usable()) { continue; }
      ASSERT_NEAR(a.with_jacobian.pixel.x, a.of_point.pixel.x, tolerance);
      ASSERT_NEAR(a.with_jacobian.pixel.y, a.of_point.pixel.y, tolerance);
    }
  };
  expect_agreement(this->template ask<double>(questions), data::double_pixels);
  expect_agreement(this->template ask<ft::strict_double>(questions), data::double_pixels);
  expect_agreement(this->template ask<float>(questions), data::float_pixels);
  expect_agreement(this->template ask<ft::strict_float>(questions), data::float_pixels);
}

TYPED_TEST_P(camera_model, the_axis_is_seen_at_the_principal_point) {
  auto const c = TestFixture::model();
  question const q{{0, 0, 2}, {parameter(c, 2), parameter(c, 3)}};
  std::vector<answer> const answers{this->template ask<double>({q})[0],
                                    this->template ask<float>({q})[0],
                                    this->template ask<ft::strict_float>({q})[0]};
  for (answer const& got : answers) {
    EXPECT_EQ(got.of_point.valid, 1);
    EXPECT_NEAR(got.of_point.pixel.x, q.pixel.x, 1e-4);
    EXPECT_NEAR(got.of_point.pixel.y, q.pixel.y, 1e-4);
    EXPECT_EQ(got.of_pixel.valid, 1);
    EXPECT_LT(angle_between(got.of_pixel.direction, {0, 0, 1}), 1e-6);
    for (double const entry : got.jacobian) { EXPECT_TRUE(std::isfinite(entry)); }
  }
}

TYPED_TEST_P(camera_model, behind_the_camera) {
  this->template check_behind<double>();
  this->template check_behind<float>();
  this->template check_behind<ft::strict_float>();
}

TYPED_TEST_P(camera_model, no_two_directions_share_a_pixel) {
  this->template check_outward_walk<double>(0);
  this->template check_outward_walk<ft::strict_float>(TestFixture::lens::float_pixels);
}

TYPED_TEST_P(camera_model, a_point_that_is_no_number_has_no_pixel) {
  this->template check_points_without_a_number<float>();
  this->template check_points_without_a_number<ft::strict_float>();
  this->template check_points_without_a_number<double>();
}

TYPED_TEST_P(camera_model, a_pixel_that_is_no_number_has_no_ray) {
  this->template check_pixels_without_a_number<float>();
  this->template check_pixels_without_a_number<ft::strict_float>();
  this->template check_pixels_without_a_number<double>();
}

TYPED_TEST_P(camera_model, a_very_far_or_near_point_has_its_own_pixel_or_none) {
  auto const questions = TestFixture::points();
  for (double const scale : {1e-6, 1e6, 1e30}) {
    auto moved = questions;
    for (auto& q : moved) { q.point = scaled(q.point, scale); }
    auto const got = this->template ask<float>(moved);
    auto const want = this->template ask<double>(questions);
    for (std::size_t i = 0; i < got.size(); ++i) {
      if (!got[i].of_point.usable()) { continue; }
      ASSERT_NEAR(got[i].of_point.pixel.x, want[i].of_point.pixel.x,
                  TestFixture::lens::float_pixels)
          << "at " << scale << " times the distance";
      ASSERT_NEAR(got[i].of_point.pixel.y, want[i].of_point.pixel.y,
                  TestFixture::lens::float_pixels)
          << "at " << scale << " times the distance";
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(camera_model, keeps_the_contract, holds_its_parameters_and_nothing_else,
                            the_first_parameters_are_fx_fy_cx_cy, a_cast_keeps_the_parameters,
                            calibrations_that_cannot_be_throw, a_pixel_survives_the_round_trip,
                            a_pixel_outside_the_image_has_its_own_ray_or_none,
                            a_ray_points_at_its_point, float_and_double_agree,
                            the_jacobian_is_the_derivative, the_jacobian_comes_with_the_projection,
                            the_axis_is_seen_at_the_principal_point, behind_the_camera,
                            no_two_directions_share_a_pixel, a_point_that_is_no_number_has_no_pixel,
                            a_pixel_that_is_no_number_has_no_ray,
                            a_very_far_or_near_point_has_its_own_pixel_or_none);

}  // namespace FT_ABI
}  // namespace camera_contract
