// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of maps: maps with a known answer, minima by a plain reading of the rules,
// equal bits on both executors, robust kernels, fixed views, images that are lost, maps that are
// refused.
#include "ft/pipelines/adjust_map.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/bundles.hpp"
#include "tests/support/map_checks.hpp"
#include "tests/support/refusals.hpp"

namespace adjust_map_test {

using plain = ft::pinhole<double>;
using test::distance;
using test::one_camera;
using test::plain_cost;
using test::same_bits;
using test::two_lenses;
using test::worst_centre;

template <typename Backend>
class maps : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Camera>
  ft::map_report adjust(ft::bundle<Camera>& map, ft::map_params const& params = {}) {
    return ft::adjust_map(backend.exec, map, params);
  }
};
TYPED_TEST_SUITE(maps, test::backends);

inline ft::map_params thorough() {
  ft::map_params params;
  params.enough = 1e-13;
  params.solver_enough = 1e-3;
  return params;
}

TYPED_TEST(maps, without_noise_they_become_the_truth) {
  test::bundle_shape shape{16, 200};
  shape.noise = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    auto made = test::make_bundle(shape, two_lenses(), seed);
    auto const report = this->adjust(made.map, thorough());
    EXPECT_EQ(report.last_without_image, 0);
    EXPECT_EQ(report.outcome, ft::map_outcome::converged);
    EXPECT_LT(report.last_cost, 1e-12 * report.first_cost);
    EXPECT_LT(worst_centre(made.map, made.truth), 1e-6);
    for (std::size_t p = 0; p < made.truth.position.size(); ++p) {
      ASSERT_LT(distance(made.map.position[p], made.truth.position[p]), 1e-5) << p;
    }
  }
}

TYPED_TEST(maps, costs_are_as_said_and_the_result_is_a_minimum) {
  for (double const huber : {0.0, 1.5}) {
    auto map = test::make_bundle({20, 150}, two_lenses(), 4).map;
    double const given = plain_cost(map, huber);
    auto params = thorough();
    params.huber = huber;
    auto const report = this->adjust(map, params);
    EXPECT_EQ(report.outcome, ft::map_outcome::converged);
    EXPECT_NEAR(report.first_cost, given, 1e-9 * given);
    double const least = plain_cost(map, huber);
    EXPECT_NEAR(report.last_cost, least, 1e-9 * least);
    EXPECT_NEAR(report.last_chi2, plain_cost(map, 0), 1e-9 * report.last_chi2);
    EXPECT_LT(least, 0.1 * given);
    test::random_motions any(4);
    for (int round = 0; round < 30; ++round) {
      auto moved = map;
      for (std::size_t v = 2; v < moved.T_cw.size(); ++v) {
        moved.T_cw[v] = (any(1e-5, 1e-5) * moved.T_cw[v]).orthonormalized();
      }
      for (auto& X : moved.position) { X = X + any.vector(1e-4); }
      EXPECT_GT(plain_cost(moved, huber), least);
    }
  }
}

TYPED_TEST(maps, bits_are_those_of_one_host_thread) {
  for (unsigned seed = 11; seed <= 14; ++seed) {
    test::expect_bits_of_host(this->backend.exec, {30, 700}, 15, seed);
  }
}

TYPED_TEST(maps, the_order_of_observations_does_not_matter) {
  auto one = test::make_bundle({12, 100}, one_camera(), 6).map;
  auto other = one;
  std::vector<std::size_t> order(one.pixel.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::shuffle(order.begin(), order.end(), std::mt19937(6));
  for (std::size_t o = 0; o < order.size(); ++o) {
    other.observing_view[o] = one.observing_view[order[o]];
    other.observed_point[o] = one.observed_point[order[o]];
    other.pixel[o] = one.pixel[order[o]];
    other.sigma[o] = one.sigma[order[o]];
  }
  this->adjust(one);
  this->adjust(other);
  EXPECT_TRUE(same_bits(one, other));
}

TYPED_TEST(maps, fixed_views_stay) {
  auto const given = test::make_bundle({12, 100}, one_camera(), 7).map;
  auto map = given;
  map.fixed.assign(12, 0);
  map.fixed[4] = map.fixed[9] = 1;
  this->adjust(map);
  for (std::size_t v = 0; v < 12; ++v) {
    bool const same = std::memcmp(&map.T_cw[v], &given.T_cw[v], sizeof given.T_cw[v]) == 0;
    EXPECT_EQ(same, v == 4 || v == 9) << v;
  }
  for (bool const none : {true, false}) {  // nothing said, or that none is
    map = given;
    map.fixed.assign(none ? 0 : 12, 0);
    auto const report = this->adjust(map);
    EXPECT_EQ(report.outcome, ft::map_outcome::converged);
    EXPECT_TRUE(std::memcmp(&map.T_cw[0], &given.T_cw[0], sizeof given.T_cw[0]) == 0);
    EXPECT_LT(report.last_cost, 0.01 * report.first_cost);
  }
  map = given;
  map.fixed.assign(12, 1);
  auto const report = this->adjust(map);
  EXPECT_TRUE(same_bits(map.T_cw, given.T_cw));
  EXPECT_FALSE(same_bits(map.position, given.position));
  EXPECT_LT(report.last_cost, report.first_cost);
}

TYPED_TEST(maps, outliers_pull_less_with_a_robust_kernel) {
  test::bundle_shape shape{20, 300};
  shape.track = 8;
  shape.outliers = 0.03;
  auto const made = test::make_bundle(shape, one_camera(), 8);
  auto squares = made.map;
  this->adjust(squares);
  auto robust = made.map;
  ft::map_params params;
  params.huber = 2;
  this->adjust(robust, params);
  EXPECT_LT(worst_centre(robust, made.truth), 0.3 * worst_centre(squares, made.truth));
}

TYPED_TEST(maps, standard_deviations_weigh) {
  // Of two groups of observations that disagree the precise one wins.
  test::bundle_shape shape{10, 120};
  shape.noise = 0;
  auto made = test::make_bundle(shape, one_camera(), 9);
  auto& map = made.map;
  test::random_motions any(9);
  for (std::size_t o = 0; o < map.pixel.size(); ++o) {
    bool const precise = map.observed_point[o] % 2 == 0;
    map.sigma[o] = precise ? 1e-3 : 1e3;
    if (!precise) { map.pixel[o].x += 5 * any.number(); }
  }
  this->adjust(map, thorough());
  EXPECT_LT(worst_centre(map, made.truth), 1e-5);
}

TYPED_TEST(maps, points_without_an_image_are_counted_and_harm_nothing) {
  auto made = test::make_bundle({12, 100}, one_camera(), 10);
  auto clean = made.map;
  auto const want = this->adjust(clean);
  auto map = made.map;
  map.position.push_back({0, 40, 0});  // above all cameras, which look ahead
  map.position.back().x = -1e-3;
  int behind = 0;
  for (int v = 0; v < 12; ++v) {
    if (map.T_cw[static_cast<std::size_t>(v)].R.m[7] * 40 > 0) { continue; }
    map.observing_view.push_back(v);
    map.observed_point.push_back(100);
    map.pixel.push_back({320, 240});
    map.sigma.push_back(1);
    ++behind;
  }
  ASSERT_GE(behind, 2);
  auto const report = this->adjust(map);
  EXPECT_GE(report.first_without_image, 2);
  EXPECT_LE(report.last_without_image, report.first_without_image);
  EXPECT_LT(report.last_cost, want.last_cost + 1e4 * behind + 1);
  EXPECT_LT(worst_centre(map, made.truth), 2 * worst_centre(clean, made.truth) + 1e-3);
}

TYPED_TEST(maps, a_step_keeps_images) {
  // Starts so far off that whole steps would throw points behind their cameras.
  test::bundle_shape shape{14, 300};
  shape.view_error = 0.03;
  shape.point_error = 1;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    auto map = test::make_bundle(shape, one_camera(), seed).map;
    auto const report = this->adjust(map);
    EXPECT_LE(report.last_without_image, report.first_without_image) << seed;
    EXPECT_LT(report.last_cost, 0.01 * report.first_cost) << seed;
  }
}

TYPED_TEST(maps, a_view_that_sees_nothing_stays) {
  auto map = test::make_bundle({12, 100}, one_camera(), 12).map;
  auto without = map;
  auto const lonely = map.T_cw[5];
  map.T_cw.push_back(lonely);
  map.camera_of_view.push_back(0);
  map.fixed.push_back(0);
  this->adjust(map);
  this->adjust(without);
  EXPECT_EQ(std::memcmp(&map.T_cw.back(), &lonely, sizeof lonely), 0);
  EXPECT_TRUE(same_bits(map.position, without.position));
}

TYPED_TEST(maps, limits_are_kept) {
  auto const given = test::make_bundle({12, 100}, one_camera(), 13).map;
  ft::bundle<plain> empty;
  EXPECT_EQ(this->adjust(empty).outcome, ft::map_outcome::converged);
  ft::map_params params;
  params.steps = 0;
  auto map = given;
  auto report = this->adjust(map, params);
  EXPECT_EQ(report.outcome, ft::map_outcome::out_of_steps);
  EXPECT_EQ(report.last_cost, report.first_cost);
  EXPECT_TRUE(same_bits(map, given));
  params.steps = 3;
  params.enough = 0;
  params.solver_steps = 2;
  report = this->adjust(map, params);
  EXPECT_EQ(report.outcome, ft::map_outcome::out_of_steps);
  EXPECT_EQ(report.steps, 3);
  EXPECT_LE(report.solver_steps, 6);
  EXPECT_LT(report.last_cost, report.first_cost);
}

TYPED_TEST(maps, bad_ones_are_refused) {
  auto const given = test::make_bundle({6, 20}, one_camera(), 14).map;
  auto const refused = [&](auto const& damage, std::string const& part) {
    auto map = given;
    damage(map);
    test::expect_refused([&] { this->adjust(map); }, part);
  };
  using map_type = ft::bundle<plain>;
  double const nan = std::numeric_limits<double>::quiet_NaN();
  refused([](map_type& m) { m.observing_view[3] = 6; }, "(observation 3)");
  refused([](map_type& m) { m.observed_point[2] = -1; }, "(observation 2)");
  refused([&](map_type& m) { m.pixel[4].y = nan; }, "pixel is nan, must be finite (observation 4)");
  refused([](map_type& m) { m.sigma[1] = 0; }, "sigma is 0");
  refused([](map_type& m) { m.sigma.pop_back(); }, "`sigma`");
  refused([](map_type& m) { m.pixel.pop_back(); }, "differ in length");
  refused([&](map_type& m) { m.position[7].z = nan; }, "(point 7)");
  refused([](map_type& m) { m.T_cw[2].R.m[4] = 3; }, "(view 2)");
  refused([&](map_type& m) { m.T_cw[2].t.x = nan; }, "translation is nan");
  refused([](map_type& m) { m.camera_of_view[5] = 1; }, "(view 5)");
  refused([](map_type& m) { m.fixed.pop_back(); }, "`fixed`");
  refused([](map_type& m) { m.cameras[0].fx = -1; }, "(camera 0)");
  refused([](map_type& m) { m.cameras.clear(); }, "no camera");
  refused([](map_type& m) { m.position.push_back({1, 2, 3}); }, "less than two views (point 20)");
  refused(
      [](map_type& m) {  // twice from one view is once
        m.position.push_back({1, 2, 3});
        for (int k = 0; k < 2; ++k) {
          m.observing_view.push_back(1);
          m.observed_point.push_back(20);
          m.pixel.push_back({0, 0});
          m.sigma.push_back(1);
        }
      },
      "less than two views (point 20)");
  ft::map_params params;
  auto map = given;
  params.huber = nan;
  EXPECT_THROW(this->adjust(map, params), ft::bad_argument);
  params = {};
  params.solver_steps = 0;
  EXPECT_THROW(this->adjust(map, params), ft::bad_argument);
}

}  // namespace adjust_map_test
