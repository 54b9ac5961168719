// SPDX-License-Identifier: Apache-2.0
/// @file Tests of host against GPU. Part of tests/camera_contract.hpp.
#pragma once

#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "ft/cameras/camera_model.hpp"
#include "tests/camera_contract/questions.hpp"

namespace camera_contract {
inline namespace FT_ABI {

template <typename Setting>
class camera_on_gpu : public on_executor<Setting> {};
TYPED_TEST_SUITE_P(camera_on_gpu);

/// The same bits; any NaN is as good as another.
inline bool same(double a, double b) {
  return (std::isnan(a) && std::isnan(b)) || (a == b && std::signbit(a) == std::signbit(b));
}

inline bool same(vector a, vector b) { return same(a.x, b.x) && same(a.y, b.y) && same(a.z, b.z); }

TYPED_TEST_P(camera_on_gpu, strict_floats_are_the_same_bits_as_on_the_host) {
  using camera = typename TestFixture::template model_of<ft::strict_float>;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 2);
  auto questions = TestFixture::points();
  for (int i = 0; i < 20000; ++i) {
    question q{random_direction(random),
               {unit(random) * TestFixture::lens::width, unit(random) * TestFixture::lens::height}};
    if (i % 4 == 0) { q.point.z = std::abs(q.point.z); }
    if (i % 50 == 0) { q.point.x = q.point.y = 0; }
    if (i % 50 == 1) { q.point.z = 0; }
    q.point = scaled(q.point, std::pow(10.0, i % 7 - 2));
    questions.push_back(q);
  }
  auto const got = this->template ask<ft::strict_float>(questions);
  auto const c = TestFixture::model().template cast<ft::strict_float>();
  std::vector<answer> want(questions.size());
  ft::for_each_item<ft::per_thread>(ft::host_exec(1), static_cast<int>(questions.size()),
                                    answer_question<camera>{}, c,
                                    static_cast<question const*>(questions.data()), want.data());
  for (std::size_t i = 0; i < questions.size(); ++i) {
    auto const& a = got[i];
    auto const& b = want[i];
    auto const& p = questions[i].point;
    ASSERT_TRUE(a.of_point.valid == b.of_point.valid && a.back.valid == b.back.valid &&
                a.of_pixel.valid == b.of_pixel.valid && a.again.valid == b.again.valid)
        << "validity at " << p.x << ", " << p.y << ", " << p.z;
    ASSERT_TRUE(same(a.of_point.pixel.x, b.of_point.pixel.x) &&
                same(a.of_point.pixel.y, b.of_point.pixel.y) &&
                same(a.with_jacobian.pixel.x, b.with_jacobian.pixel.x) &&
                same(a.with_jacobian.pixel.y, b.with_jacobian.pixel.y) &&
                same(a.again.pixel.x, b.again.pixel.x) && same(a.again.pixel.y, b.again.pixel.y))
        << "pixel of " << p.x << ", " << p.y << ", " << p.z;
    ASSERT_TRUE(same(a.back.direction, b.back.direction)) << "ray back to the point";
    ASSERT_TRUE(same(a.of_pixel.direction, b.of_pixel.direction))
        << "ray of " << questions[i].pixel.x << ", " << questions[i].pixel.y;
    for (std::size_t k = 0; k < 6; ++k) {
      ASSERT_TRUE(same(a.jacobian[k], b.jacobian[k]))
          << "Jacobian at " << p.x << ", " << p.y << ", " << p.z;
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(camera_on_gpu, strict_floats_are_the_same_bits_as_on_the_host);

}  // namespace FT_ABI
}  // namespace camera_contract
