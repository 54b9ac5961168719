// SPDX-License-Identifier: Apache-2.0
// Adjustments of windows whose views are linked by measured motions, or whose centres have a cost:
// derivatives, costs, minima, views that these alone hold, equal bits on both executors.
#include "ft/kernels/window/detail/residual.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/window_scene.hpp"

namespace window_links_test {

using ft::vec3;
using test::adjust;
using test::example_rig;
using test::make_window;
using test::motion;
using test::same_bits;
using test::thorough;
using test::window_result;
using test::window_scene;
using test::window_shape;

template <typename Rig>
window_scene linked(window_shape const& shape, double error, unsigned seed) {
  auto s = make_window(example_rig<Rig>(), shape, seed);
  test::link_views(s, error, seed);
  return s;
}
inline vec3<double> plain(vec3<ft::strict_double> const& v) {
  return {v.x.value, v.y.value, v.z.value};
}

inline vec3<double> unit(int k) { return {k == 0 ? 1.0 : 0, k == 1 ? 1.0 : 0, k == 2 ? 1.0 : 0}; }

TEST(WindowLinks, DerivativesAreThoseOfFiniteDifferences) {
  motion const before = test::turn({0.4, -0.3, 0.9}, {1, -2, 0.5});
  motion const now = test::turn({0.2, -0.1, 0.3}, {0.3, 0.2, 0.5}) * before;
  ft::window_link const link{now * before.inverse(), 2.0, 3.0};
  auto const exact = ft::detail::link_error::of(link, before, now);
  EXPECT_LT(exact.cost().value, 1e-25);
  vec3<double> const q = plain(exact.lever);
  double const h = 1e-5;
  for (int k = 0; k < 12; ++k) {
    auto const error = [&](double by) {
      double step[6] = {};
      step[k % 6] = by;
      motion const a = k < 6 ? ft::detail::stepped_view(before, step) : before;
      motion const b = k < 6 ? now : ft::detail::stepped_view(now, step);
      return ft::detail::link_error::of(link, a, b);
    };
    auto const after = error(h);
    auto const earlier = error(-h);
    double const sign = k < 6 ? -1 : 1;
    bool const turns = k % 6 < 3;
    vec3<double> const axis = unit(k % 3);
    vec3<double> const turn = turns ? ft::scaled(axis, sign) : vec3<double>{};
    vec3<double> shift = turns ? vec3<double>{} : ft::scaled(axis, -sign);
    if (k < 3) { shift = ft::cross(axis, q); }
    auto const check = [&](vec3<double> const& got, vec3<double> const& want) {
      EXPECT_NEAR(got.x / (2 * h), want.x, 1e-8) << k;
      EXPECT_NEAR(got.y / (2 * h), want.y, 1e-8) << k;
      EXPECT_NEAR(got.z / (2 * h), want.z, 1e-8) << k;
    };
    check(plain(after.turn - earlier.turn), turn);
    check(plain(after.shift - earlier.shift), shift);
  }
}

TEST(WindowLinks, WithoutWeightsNothingIsRead) {
  double const nan = std::nan("");
  motion const none{{{nan, nan, nan}}, {nan, nan, nan}};
  auto const T = motion::identity();
  EXPECT_EQ(ft::detail::link_error::of({none, 0, 0}, T, T).cost().value, 0);
  EXPECT_EQ(ft::detail::link_error::of({none, nan, -1}, T, T).cost().value, 0);
  EXPECT_TRUE(std::isnan(ft::detail::link_error::of({none, 1, 0}, T, T).cost().value));
}

template <typename Backend>
class window_links : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Rig>
  window_result one(window_scene const& s, ft::window_params const& params) {
    return adjust(backend.exec, example_rig<Rig>(), {s}, params).front();
  }
  template <typename Rig>
  void check_costs(unsigned seed) {
    auto const rig = example_rig<Rig>();
    auto s = linked<Rig>({9, 3, 250, 7, 0.7, 0.05}, 0.01, seed);
    if (seed % 2 == 0) { test::hold_centres(s, 0.01, seed); }
    auto const r = one<Rig>(s, {});
    ASSERT_EQ(r.outcome.valid, 1);
    double const first = test::judge(rig, s, s.T_cw, s.position).cost;
    double const last = test::judge(rig, s, r.T_cw, r.position).cost;
    EXPECT_GT(test::link_costs(s, r.T_cw), 1.0);
    EXPECT_NEAR(r.outcome.first_cost, first, 1e-9 * first);
    EXPECT_NEAR(r.outcome.last_cost, last, 1e-9 * last);
  }
  /// No small change of a view lowers the cost.
  template <typename Rig>
  void check_minimum(int fixed, unsigned seed) {
    auto const rig = example_rig<Rig>();
    auto s = linked<Rig>({6, fixed, 80, 5, 0.7, 0.04}, 0.01, seed);
    if (fixed == 1) { test::hold_centres(s, 0.01, seed); }
    auto const r = one<Rig>(s, thorough(60));
    ASSERT_EQ(r.outcome.valid, 1);
    double const cost = test::judge(rig, s, r.T_cw, r.position).cost;
    EXPECT_GT(test::least_cost_nearby(rig, s, r), cost * (1 - 1e-9));
  }
  /// A view that sees nothing is as right as floats of pixels leave its neighbours.
  void expect_held(window_scene s) {
    int const blind = 5;
    for (int p = 0; p < s.points(); ++p) { s.seen[s.at(p, blind, 0)].inv_sigma2 = 0; }
    auto const r = one<ft::rectified_rig>(s, thorough(60));
    ASSERT_EQ(r.outcome.valid, 1);
    auto const off = [&](std::vector<motion> const& T_cw) {
      auto const d = T_cw[blind].centre() - s.true_T_cw[blind].centre();
      return std::sqrt(ft::dot(d, d));
    };
    EXPECT_GT(off(s.T_cw), 1e-3);
    EXPECT_LT(off(r.T_cw), 2e-5);
  }
};
TYPED_TEST_SUITE(window_links, test::backends);

TYPED_TEST(window_links, costs_are_those_of_the_rules) {
  for (unsigned seed = 1; seed < 4; ++seed) {
    this->template check_costs<ft::rectified_rig>(seed);
    this->template check_costs<test::fisheye_rig>(seed);
    this->template check_costs<test::three_camera_rig>(seed);
  }
}

TYPED_TEST(window_links, results_are_minima) {
  for (int const fixed : {1, 3}) {
    this->template check_minimum<ft::rectified_rig>(fixed, 20);
    this->template check_minimum<test::fisheye_rig>(fixed, 21);
    this->template check_minimum<test::three_camera_rig>(fixed, 22);
  }
}

TYPED_TEST(window_links, a_view_that_sees_nothing_is_held_by_its_links) {
  this->expect_held(linked<ft::rectified_rig>({8, 2, 150, 8}, 0, 5));
}
TYPED_TEST(window_links, a_view_that_sees_nothing_is_held_by_the_cost_of_its_centre) {
  auto s = make_window(example_rig<ft::rectified_rig>(), {8, 2, 150, 8}, 6);
  test::hold_centres(s, 0, 6);
  this->expect_held(s);
}

TYPED_TEST(window_links, links_without_weights_change_no_bit) {
  auto const s = make_window(example_rig<ft::rectified_rig>(), {9, 3, 250, 7, 0.7, 0.05}, 8);
  auto linked_in_vain = s;
  linked_in_vain.links.assign(s.T_cw.size(), {motion::identity(), 0, 0});
  EXPECT_TRUE(same_bits(this->template one<ft::rectified_rig>(s, {}),
                        this->template one<ft::rectified_rig>(linked_in_vain, {})));
}

TYPED_TEST(window_links, executors_and_batches_agree_to_the_bit) {
  auto const rig = example_rig<ft::rectified_rig>();
  std::vector<window_scene> scenes;
  for (int b = 0; b < 5; ++b) {
    scenes.push_back(
        linked<ft::rectified_rig>({4 + 3 * b, 1 + b % 3, 40 + 111 * b, 5, 1.0, 0.02, 3.0}, 0.01,
                                  30 + static_cast<unsigned>(b)));
  }
  scenes[2].links.clear();
  test::hold_centres(scenes[1], 0.01, 40);
  test::hold_centres(scenes[4], 0.01, 41);
  auto const want = adjust(ft::host_exec(1), rig, scenes, {});
  auto const got = adjust(this->backend.exec, rig, scenes, {});
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    EXPECT_EQ(want[b].outcome.valid, 1) << b;
    EXPECT_TRUE(same_bits(want[b], got[b])) << b;
    EXPECT_TRUE(same_bits(want[b], adjust(this->backend.exec, rig, {scenes[b]}, {}).front())) << b;
  }
}

TYPED_TEST(window_links, a_link_that_is_no_number_is_refused) {
  auto s = linked<ft::rectified_rig>({}, 0.01, 9);
  s.links[3].motion.t.y = std::nan("");
  auto const r = this->template one<ft::rectified_rig>(s, {});
  EXPECT_EQ(r.outcome.valid, 0);
  EXPECT_TRUE(same_bits(r.T_cw, s.T_cw));
}

}  // namespace window_links_test
