// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of maps with right images: they have their scale, results are minima by a plain
// reading of the rules, bits are equal on both executors, and what cannot be is refused.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/pipelines/adjust_map.hpp"
#include "ft/pipelines/bundle_files.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/bundles.hpp"
#include "tests/support/map_checks.hpp"
#include "tests/support/refusals.hpp"

namespace adjust_map_stereo_test {

using plain = ft::pinhole<double>;
using lens = ft::radtan4<double>;
using test::one_camera;
using test::plain_cost;
using test::same_bits;
using test::two_lenses;
using test::worst_centre;

template <typename Backend>
class stereo_maps : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Camera>
  ft::map_report adjust(ft::bundle<Camera>& map, ft::map_params const& params = {}) {
    return ft::adjust_map(backend.exec, map, params);
  }
};
TYPED_TEST_SUITE(stereo_maps, test::backends);

inline ft::map_params thorough() {
  ft::map_params params;
  params.enough = 1e-14;
  params.solver_enough = 1e-4;
  return params;
}
inline test::bundle_shape pairs(int views, int points) {
  test::bundle_shape shape{views, points};
  shape.baseline = 0.2;
  return shape;
}

TYPED_TEST(stereo_maps, a_wrong_scale_is_mended) {
  auto shape = pairs(16, 200);
  shape.noise = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    auto made = test::make_bundle(shape, two_lenses(), seed);
    auto const anchor = made.truth.T_cw[0];
    made.map.fixed.clear();  // the first view alone gives the frame
    for (auto& T : made.map.T_cw) {
      T = (T * anchor.inverse()).orthonormalized();
      T.t = ft::scaled(T.t, 1.1);
      T = (T * anchor).orthonormalized();
    }
    for (auto& X : made.map.position) { X = anchor.inverse() * ft::scaled(anchor * X, 1.1); }
    auto without = made.map;
    without.right_x.clear();
    without.baseline.clear();
    auto const report = this->adjust(made.map, thorough());
    EXPECT_EQ(report.outcome, ft::map_outcome::converged);
    EXPECT_EQ(report.last_without_image, 0);
    EXPECT_LT(report.last_cost, 1e-12 * report.first_cost);
    EXPECT_LT(worst_centre(made.map, made.truth), 1e-6);
    this->adjust(without, thorough());
    EXPECT_GT(worst_centre(without, made.truth), 0.05) << "the scale is known without: no test";
  }
}

TYPED_TEST(stereo_maps, costs_are_as_said_and_all_derivatives_end_at_zero) {
  for (double const huber : {0.0, 1.5}) {
    auto map = test::make_bundle(pairs(14, 80), two_lenses(), 4).map;
    map.fixed.assign(14, 0);
    map.fixed[0] = 1;
    double const given = plain_cost(map, huber);
    auto params = thorough();
    params.huber = huber;
    auto const report = this->adjust(map, params);
    EXPECT_NEAR(report.first_cost, given, 1e-9 * given);
    double const least = plain_cost(map, huber);
    EXPECT_NEAR(report.last_cost, least, 1e-9 * least);
    EXPECT_LT(least, 0.1 * given);
    // Newton's step of a coordinate alone, by differences.
    auto const off = [&](auto const& move) {
      double const h = 1e-5;
      auto ahead = map, behind = map;
      move(ahead, h);
      move(behind, -h);
      double const a = plain_cost(ahead, huber), b = plain_cost(behind, huber);
      return (a - b) / (2 * h) / ((a - 2 * least + b) / (h * h));
    };
    for (std::size_t v = 1; v < map.T_cw.size(); ++v) {
      for (int k = 0; k < 6; ++k) {
        EXPECT_NEAR(
            off([&](ft::bundle<lens>& m, double h) {
              ft::vec3<double> const e{k % 3 == 0 ? h : 0, k % 3 == 1 ? h : 0, k % 3 == 2 ? h : 0};
              ft::rigid<double> T{ft::mat3<double>::identity(), e};
              if (k < 3) { T = {test::turned_by(e), {0, 0, 0}}; }
              m.T_cw[v] = T * m.T_cw[v];
            }),
            0, 2e-6)
            << v << ' ' << k;
      }
    }
    for (std::size_t p = 0; p < map.position.size(); ++p) {
      EXPECT_NEAR(off([&](ft::bundle<lens>& m, double h) { m.position[p].x += h; }), 0, 2e-5);
      EXPECT_NEAR(off([&](ft::bundle<lens>& m, double h) { m.position[p].z += h; }), 0, 2e-5);
    }
  }
}

TYPED_TEST(stereo_maps, bits_are_those_of_one_host_thread) {
  for (unsigned seed = 11; seed <= 13; ++seed) {
    test::expect_bits_of_host(this->backend.exec, pairs(30, 500), 12, seed);
  }
}

TYPED_TEST(stereo_maps, without_right_images_nothing_changes) {
  auto one = test::make_bundle({12, 100}, one_camera(), 6).map;
  auto other = one;
  other.baseline = {0.2};
  other.right_x.assign(other.pixel.size(), std::nan(""));
  auto const a = this->adjust(one);
  auto const b = this->adjust(other);
  EXPECT_TRUE(same_bits(one, other));
  EXPECT_EQ(a.last_cost, b.last_cost);
  EXPECT_EQ(a.steps, b.steps);
}

TYPED_TEST(stereo_maps, a_point_of_one_view_needs_a_right_image) {
  auto const made = test::make_bundle(pairs(12, 100), one_camera(), 7);
  auto map = made.map;
  ft::vec3<double> const in_view{0.3, -0.2, 4};
  auto const pixel = map.cameras[0].project(in_view).pixel;
  auto const right = map.cameras[0].project({in_view.x - 0.2, in_view.y, in_view.z}).pixel;
  map.position.push_back(map.T_cw[0].inverse() * ft::vec3<double>{0.35, -0.2, 4.5});
  map.observing_view.push_back(0);  // which is fixed
  map.observed_point.push_back(100);
  map.pixel.push_back(pixel);
  map.sigma.push_back(1);
  map.right_x.push_back(right.x);
  auto without = map;
  this->adjust(map, thorough());
  auto const d = map.T_cw[0] * map.position.back() - in_view;
  EXPECT_LT(std::sqrt(ft::dot(d, d)), 1e-6);
  without.right_x.back() = std::nan("");
  EXPECT_THROW(this->adjust(without), ft::bad_argument);
}

TYPED_TEST(stereo_maps, bad_ones_are_refused) {
  auto const given = test::make_bundle(pairs(6, 20), one_camera(), 14).map;
  using map_type = ft::bundle<plain>;
  auto const refused = [&](auto const& damage, std::string const& part) {
    map_type map = given;
    damage(map);
    test::expect_refused([&] { this->adjust(map); }, part);
  };
  double const infinity = std::numeric_limits<double>::infinity();
  refused([](map_type& m) { m.right_x.pop_back(); }, "`right_x`");
  refused([](map_type& m) { m.baseline.push_back(1); }, "`baseline`");
  refused([](map_type& m) { m.baseline.clear(); }, "no baseline");
  refused([](map_type& m) { m.baseline[0] = 0; }, "no baseline");
  refused([](map_type& m) { m.baseline[0] = -1; }, "baseline is -1");
  refused([](map_type& m) { m.baseline[0] = std::nan(""); }, "(camera 0)");
  refused([&](map_type& m) { m.right_x[3] = infinity; }, "(observation 3)");
  // Nothing is left out silently.
  test::bundle_shape shape = pairs(4, 20);
  auto const map = test::make_bundle(shape, std::vector<lens>{{500, 500, 0, 0, {}}}, 3).map;
  std::ostringstream out;
  EXPECT_THROW(ft::write_bal(out, map), ft::bad_argument);
}

}  // namespace adjust_map_stereo_test
