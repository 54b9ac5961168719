// SPDX-License-Identifier: Apache-2.0
// The contract, kept by cameras whose model is chosen at run time, and the bits of that model.
#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/core/error.hpp"
#include "tests/camera_contract.hpp"

namespace camera_contract_any_test {

using ft::any_camera;

ft::kannala_brandt<double> fisheye() {
  return {190.97847715128717,     190.9733070521226,     254.93170605935475,
          256.8974428996504,      0.0034823894022493434, 0.0007150348452162257,
          -0.0020532361418706202, 0.00020293673591811182};
}
/// TUM-VI's left camera.
struct any_fisheye_lens : camera_contract::description<any_camera> {
  static constexpr int width = 512;
  static constexpr int height = 512;
  static constexpr bool sees_behind = true;
  static any_camera<double> parameters() { return any_camera<double>::of(fisheye()); }
};

template <typename T>
bool same_bits(T const& a, T const& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}
template <typename Scalar>
bool same_bits(ft::projection<Scalar> const& a, ft::projection<Scalar> const& b) {
  return same_bits(a.pixel, b.pixel) && a.valid == b.valid;
}
template <typename Scalar>
bool same_bits(ft::ray<Scalar> const& a, ft::ray<Scalar> const& b) {
  return same_bits(a.direction, b.direction) && a.valid == b.valid;
}

template <typename Scalar, typename Any, typename Model>
void expect_bits_of(Any const& any_double, Model const& model_double) {
  auto const any = any_double.template cast<Scalar>();
  auto const model = model_double.template cast<Scalar>();
  std::mt19937 random(7);
  std::uniform_real_distribution<double> far(-3, 3), pixel(-50, 800);
  auto const draw = [&](auto& from) {
    return Scalar(static_cast<ft::plain_scalar_t<Scalar>>(from(random)));
  };
  int valid = 0;
  for (int i = 0; i < 500; ++i) {
    ft::vec3<Scalar> const p{draw(far), draw(far), draw(far)};
    auto const seen = any.project(p);
    valid += static_cast<int>(seen.valid);
    EXPECT_TRUE(same_bits(seen, model.project(p))) << i;
    auto const a = any.project_with_jacobian(p);
    auto const b = model.project_with_jacobian(p);
    EXPECT_TRUE(same_bits(a.value, b.value) && same_bits(a.jacobian, b.jacobian)) << i;
    ft::vec2<Scalar> const at{draw(pixel), draw(pixel)};
    EXPECT_TRUE(same_bits(any.unproject(at), model.unproject(at))) << i;
  }
  EXPECT_GT(valid, 100);
}

template <typename Model>
void expect_bits_of(Model const& model) {
  auto const any = any_camera<double>::of(model);
  EXPECT_NO_THROW(any.check());
  expect_bits_of<double>(any, model);
  expect_bits_of<ft::strict_float>(any, model);
}

TEST(any_camera, has_the_bits_of_its_model) {
  expect_bits_of(ft::pinhole<double>{458.654, 457.296, 367.215, 248.375});
  expect_bits_of(fisheye());
  expect_bits_of(
      ft::double_sphere<double>{158.286, 158.274, 254.961, 256.889, -0.172131, 0.593118});
  expect_bits_of(ft::radtan8<double>{
      504.7, 504.8, 325.9, 336.2, {5.16, 3.29, -2e-5, 3e-5, 0.165, 5.49, 5.02, 0.87}});
}

TEST(any_camera, refuses_what_its_model_refuses_and_other_kinds) {
  auto sphere = any_camera<double>::of(ft::double_sphere<double>{158, 158, 255, 256, -0.17, 0.593});
  sphere.more[0] = -1.5;  // xi
  EXPECT_THROW(sphere.check(), ft::bad_argument);
  auto odd = any_camera<double>::of(ft::pinhole<double>{400, 400, 320, 240});
  for (double const kind : {1.0, 0.5, 8.0, -1.0}) {
    odd.kind = kind;
    EXPECT_THROW(odd.check(), ft::bad_argument) << kind;
  }
}

}  // namespace camera_contract_any_test

FT_CAMERA_CONTRACT(any_fisheye, camera_contract_any_test::any_fisheye_lens);
