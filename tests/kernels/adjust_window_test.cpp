// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of windows: its derivatives, problems with known answers, costs and outliers by
// a plain reading of the rules, equal bits on both executors and in every batch, problems that
// cannot be adjusted.
#include "ft/kernels/window/adjust_window.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/window_scene.hpp"

namespace adjust_window_test {

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
using rigs = ::testing::Types<ft::rectified_rig, test::fisheye_rig, test::three_camera_rig>;

inline double norm(vec3<double> v) { return std::sqrt(ft::dot(v, v)); }

/// Largest distance of the views' centres and of the points from the truth, metres.
inline double distance_to_truth(window_scene const& s, std::vector<motion> const& T_cw,
                                std::vector<vec3<double>> const& position) {
  double worst = 0;
  for (std::size_t v = 0; v < T_cw.size(); ++v) {
    worst = std::max(worst, norm(T_cw[v].centre() - s.true_T_cw[v].centre()));
    auto const turned = T_cw[v].R * s.true_T_cw[v].R.transposed();
    for (int i = 0; i < 9; ++i) {
      worst = std::max(worst, std::abs(turned.m[i] - (i % 4 == 0 ? 1 : 0)));
    }
  }
  for (int p = 0; p < s.points(); ++p) {
    int views = 0;  // one view and no right column do not say where a point is
    for (int v = 0; v < s.views(); ++v) { views += s.seen[s.at(p, v, 0)].inv_sigma2 > 0; }
    auto const at = static_cast<std::size_t>(p);
    if (views >= 2) { worst = std::max(worst, norm(position[at] - s.true_position[at])); }
  }
  return worst;
}

template <typename Rig>
class window_residual : public ::testing::Test {};
TYPED_TEST_SUITE(window_residual, rigs);

TYPED_TEST(window_residual, derivatives_are_those_of_finite_differences) {
  auto const rig = example_rig<TypeParam>();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1, 1);
  double const h = 1e-6;
  for (int round = 0; round < 50; ++round) {
    vec3<double> const x{unit(random), unit(random), 2 + unit(random)};
    ft::window_observation const o{300, 200, 280, 0.7f};
    auto const error = [&](vec3<double> at, int camera, bool second) {
      ft::detail::window_residual<TypeParam> const r{rig, o, ft::detail::to_real(at)};
      return second ? r.second(ft::window_params{}, camera) : r.first(camera);
    };
    for (int camera = 0; camera < TypeParam::cameras; ++camera) {
      for (int part = 0; part < (TypeParam::rectified ? 2 : 1); ++part) {
        auto const here = error(x, camera, part == 1);
        ASSERT_TRUE(here.valid());
        for (int axis = 0; axis < 3; ++axis) {
          vec3<double> const d{axis == 0 ? h : 0, axis == 1 ? h : 0, axis == 2 ? h : 0};
          auto const after = error(x + d, camera, part == 1);
          auto const before = error(x - d, camera, part == 1);
          for (int row = 0; row < 2; ++row) {
            auto const& J = here.J[row];
            double const got = axis == 0 ? J.x.value : axis == 1 ? J.y.value : J.z.value;
            // A third derivative of 1e3 pixels / m^3 and roundings of 1e-13 pixels, over h.
            EXPECT_NEAR(got, (after.e[row].value - before.e[row].value) / (2 * h), 1e-5)
                << camera << part << axis << row;
          }
        }
      }
    }
  }
}

TYPED_TEST(window_residual, errors_are_those_of_the_equations) {
  auto const rig = example_rig<TypeParam>();
  ft::window_observation const o{310.25f, 190.5f, 282.5f, 0.5f};
  vec3<double> const x{0.3, -0.4, 2.5};
  ft::detail::window_residual<TypeParam> const r{rig, o, ft::detail::to_real(x)};
  for (int camera = 0; camera < TypeParam::cameras; ++camera) {
    auto const want = test::image_of(rig, x, camera);
    auto const got = r.first(camera);
    EXPECT_NEAR(got.e[0].value, want.x - 310.25, 1e-10);
    EXPECT_NEAR(got.e[1].value, want.y - 190.5, 1e-10);
    EXPECT_EQ(got.weight.value, 0.5);
  }
  ASSERT_EQ(r.has_second(), TypeParam::rectified);
  if (TypeParam::rectified) {
    int const last = TypeParam::cameras - 1;
    auto const want = test::image_of(rig, x, last);
    auto const got = r.second(ft::window_params{}, last);
    EXPECT_NEAR(got.e[0].value, want.x - want.right_x - (310.25 - 282.5), 1e-10);
    EXPECT_EQ(got.weight.value, 16 * 0.5);
  }
}

TEST(WindowStep, MovesPointsOfAViewAsTheReducedSystemSays) {
  motion const T = test::turn({0.4, -0.3, 0.9}, {1, -2, 0.5});
  vec3<double> const X{3, 1, -4};
  double const h = 1e-5;
  vec3<double> const d = X - T.centre();
  for (int k = 0; k < 6; ++k) {
    double step[6] = {};
    step[k] = h;
    auto const after = ft::detail::stepped_view(T, step) * X;
    step[k] = -h;
    auto const before = ft::detail::stepped_view(T, step) * X;
    auto const moved = T.R.transposed() * (after - before);
    vec3<double> const axis{k % 3 == 0 ? 1.0 : 0, k % 3 == 1 ? 1.0 : 0, k % 3 == 2 ? 1.0 : 0};
    vec3<double> const want = k < 3 ? ft::cross(axis, d) : axis;
    EXPECT_NEAR(moved.x / (2 * h), want.x, 1e-8) << k;
    EXPECT_NEAR(moved.y / (2 * h), want.y, 1e-8) << k;
    EXPECT_NEAR(moved.z / (2 * h), want.z, 1e-8) << k;
  }
}

template <typename Backend>
class adjust_window_unit : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Rig>
  window_result one(window_scene const& s, ft::window_params const& params) {
    return adjust(backend.exec, example_rig<Rig>(), {s}, params).front();
  }

  template <typename Rig>
  void check_truth(window_shape const& shape, unsigned seed) {
    auto const s = make_window(example_rig<Rig>(), shape, seed);
    ASSERT_GT(distance_to_truth(s, s.T_cw, s.position), 0.02);
    auto const r = one<Rig>(s, thorough(25));
    EXPECT_EQ(r.outcome.valid, 1);
    EXPECT_LE(r.outcome.steps, 25);
    // Pixels are floats, wrong by up to 3e-5, and so are disparities; a metre of depth is 2 pixels
    // of disparity at 5 m.
    EXPECT_LT(distance_to_truth(s, r.T_cw, r.position), 1e-4) << shape.views;
    EXPECT_LT(r.outcome.last_cost, 1e-5 * Rig::searches);  // of all cameras' observations
    for (auto const o : r.outlier) { EXPECT_EQ(o, 0); }
    EXPECT_TRUE(std::equal(
        s.T_cw.begin(), s.T_cw.begin() + s.fixed, r.T_cw.begin(),
        [](motion const& a, motion const& b) { return std::memcmp(&a, &b, sizeof a) == 0; }));
  }

  template <typename Rig>
  void check_judgement(window_shape const& shape, unsigned seed) {
    auto const rig = example_rig<Rig>();
    auto const s = make_window(rig, shape, seed);
    auto const r = one<Rig>(s, {});
    ASSERT_EQ(r.outcome.valid, 1);
    auto const first = test::judge(rig, s, s.T_cw, s.position);
    auto const last = test::judge(rig, s, r.T_cw, r.position);
    EXPECT_NEAR(r.outcome.first_cost, first.cost, 1e-9 * first.cost);
    EXPECT_NEAR(r.outcome.last_cost, last.cost, 1e-9 * last.cost);
    EXPECT_LT(r.outcome.last_cost, 0.95 * r.outcome.first_cost);
    EXPECT_EQ(r.outlier, last.outlier);
    EXPECT_GT(std::count_if(r.outlier.begin(), r.outlier.end(), [](int o) { return o != 0; }), 10);
  }

  /// No small change of a view or a point lowers the cost of a thorough result.
  template <typename Rig>
  void check_minimum(window_shape const& shape, unsigned seed) {
    auto const rig = example_rig<Rig>();
    auto const s = make_window(rig, shape, seed);
    auto const r = one<Rig>(s, thorough(60));
    ASSERT_EQ(r.outcome.valid, 1);
    double const cost = test::judge(rig, s, r.T_cw, r.position).cost;
    EXPECT_GT(test::least_cost_nearby(rig, s, r), cost * (1 - 1e-9));
    for (int p = 0; p < s.points(); p += 7) {
      for (int k = 0; k < 6; ++k) {
        double const step = k % 2 == 0 ? 1e-5 : -1e-5;
        auto position = r.position;
        auto& X = position[static_cast<std::size_t>(p)];
        X = X + vec3<double>{k / 2 == 0 ? step : 0, k / 2 == 1 ? step : 0, k / 2 == 2 ? step : 0};
        EXPECT_GT(test::judge(rig, s, r.T_cw, position).cost, cost * (1 - 1e-9)) << p << " " << k;
      }
    }
  }

  /// One thread, several threads and the executor under test give the same bits.
  template <typename Rig>
  void check_bits(std::vector<window_scene> const& scenes, ft::window_params const& params) {
    auto const rig = example_rig<Rig>();
    auto const want = adjust(ft::host_exec(1), rig, scenes, params);
    auto const threads = adjust(ft::host_exec(3), rig, scenes, params);
    auto const got = adjust(backend.exec, rig, scenes, params);
    for (std::size_t b = 0; b < scenes.size(); ++b) {
      EXPECT_TRUE(same_bits(want[b], threads[b])) << "threads, problem " << b;
      EXPECT_TRUE(same_bits(want[b], got[b])) << "executors, problem " << b;
      EXPECT_EQ(want[b].outcome.valid, 1);
    }
  }

  /// A problem that is not valid keeps its start.
  template <typename Rig>
  void check_refused(window_scene const& s, char const* what,
                     ft::window_params const& params = {}) {
    auto const r = one<Rig>(s, params);
    EXPECT_EQ(r.outcome.valid, 0) << what;
    EXPECT_EQ(r.outcome.steps, 0) << what;
    EXPECT_TRUE(same_bits(r.T_cw, s.T_cw)) << what;
    EXPECT_TRUE(same_bits(r.position, s.position)) << what;
  }

  template <typename Rig>
  void check_refusals() {
    auto const rig = example_rig<Rig>();
    double const nan = std::numeric_limits<double>::quiet_NaN();
    auto const good = make_window(rig, {}, 4);
    for (double const bad : {nan, std::numeric_limits<double>::infinity()}) {
      auto s = good;
      s.T_cw[3].R.m[5] = bad;
      check_refused<Rig>(s, "a view is not finite");
      s = good;
      s.T_cw[0].t.y = bad;
      check_refused<Rig>(s, "a fixed view is not finite");
      s = good;
      s.position[40].z = bad;
      check_refused<Rig>(s, "a point is not finite");
    }
    for (int const fixed : {good.views(), good.views() + 1, -1}) {
      auto s = good;
      s.fixed = fixed;
      check_refused<Rig>(s, "fixed views");
    }
    auto s = good;
    s.position.clear();
    check_refused<Rig>(s, "no points");
    s = good;
    for (auto& o : s.seen) { o.inv_sigma2 = 0; }
    check_refused<Rig>(s, "no observations");
    // Links that outweigh all images, from no fixed view: the last pivot is 0.
    auto loose = good;
    loose.links.assign(good.T_cw.size(), {test::motion::identity(), 0, 0});
    for (auto v = static_cast<std::size_t>(good.fixed) + 1; v < good.T_cw.size(); ++v) {
      loose.links[v] = {good.T_cw[v] * good.T_cw[v - 1].inverse(), std::ldexp(1.0, 200), 0};
    }
    auto undamped = ft::window_params{};
    undamped.first_damping = 0;
    EXPECT_EQ(one<Rig>(loose, ft::window_params{}).outcome.valid, 1);
    auto const r = one<Rig>(loose, undamped);
    EXPECT_EQ(r.outcome.valid, 0);
    EXPECT_TRUE(same_bits(r.T_cw, good.T_cw));
    EXPECT_TRUE(same_bits(r.position, good.position));
  }
};
TYPED_TEST_SUITE(adjust_window_unit, test::backends);

TYPED_TEST(adjust_window_unit, exact_observations_lead_back_to_the_truth) {
  std::vector<window_shape> shapes = {
      {2, 1, 40, 2}, {6, 2, 150, 5}, {10, 4, 300, 8}, {13, 5, 33, 13}};
  if (test::whole_effort()) { shapes.push_back({64, 3, 900, 12}); }
  for (window_shape const& shape : shapes) {
    this->template check_truth<ft::rectified_rig>(shape, 1);
    this->template check_truth<test::fisheye_rig>(shape, 2);
    this->template check_truth<test::three_camera_rig>(shape, 3);
  }
}

TYPED_TEST(adjust_window_unit, costs_and_outliers_are_those_of_the_rules) {
  window_shape shape{9, 3, 250, 7, 0.7, 0.05};
  for (unsigned seed = 10; seed < 13; ++seed) {
    this->template check_judgement<ft::rectified_rig>(shape, seed);
    this->template check_judgement<test::fisheye_rig>(shape, seed);
    this->template check_judgement<test::three_camera_rig>(shape, seed);
  }
}

TYPED_TEST(adjust_window_unit, results_are_minima) {
  window_shape const shape{5, 1, 80, 5, 0.7, 0.04};
  this->template check_minimum<ft::rectified_rig>(shape, 20);
  this->template check_minimum<test::fisheye_rig>(shape, 21);
  this->template check_minimum<test::three_camera_rig>(shape, 22);
}

TYPED_TEST(adjust_window_unit, executors_agree_to_the_bit) {
  std::mt19937 random(30);
  unsigned seed = 1000;
  auto const below = [&](unsigned n) { return static_cast<int>(random() % n); };
  for (int round = 0; round < test::effort(4); ++round) {
    std::vector<window_scene> rectified;
    std::vector<window_scene> fisheye;
    std::vector<window_scene> three;
    for (int b = 0; b < 5; ++b) {
      window_shape const shape{4 + below(10),   1 + below(3), 1 + below(900), 2 + below(6), 1.0,
                               0.02 * below(4), 3.0};
      rectified.push_back(make_window(example_rig<ft::rectified_rig>(), shape, seed++));
      fisheye.push_back(make_window(example_rig<test::fisheye_rig>(), shape, seed++));
      three.push_back(make_window(example_rig<test::three_camera_rig>(), shape, seed));
    }
    ft::window_params params;
    params.steps = 1 + below(6);
    this->template check_bits<ft::rectified_rig>(rectified, params);
    this->template check_bits<test::fisheye_rig>(fisheye, params);
    this->template check_bits<test::three_camera_rig>(three, params);
  }
}

TYPED_TEST(adjust_window_unit, executors_agree_on_the_largest_window) {
  window_shape const shape{64, 1, 1500, 20, 1.0, 0.02};
  this->template check_bits<ft::rectified_rig>(
      {make_window(example_rig<ft::rectified_rig>(), shape, 31)}, {});
}

TYPED_TEST(adjust_window_unit, a_batch_is_its_problems) {
  auto const rig = example_rig<ft::rectified_rig>();
  std::vector<window_scene> scenes;
  for (unsigned b = 0; b < 6; ++b) {
    int const n = static_cast<int>(b);
    scenes.push_back(make_window(rig, {3 + 2 * n, 1 + n % 3, 64 * n + 1, 4, 0.8, 0.03}, 40 + b));
  }
  ft::window_params params;
  params.steps = 5;
  auto const all = adjust(this->backend.exec, rig, scenes, params);
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    auto const alone = adjust(this->backend.exec, rig, {scenes[b]}, params).front();
    EXPECT_TRUE(same_bits(all[b], alone)) << b;
    auto const roomy =
        adjust(this->backend.exec, rig, {scenes[b]}, params, {}, {40, 5000, 1, false}).front();
    EXPECT_TRUE(same_bits(all[b], roomy)) << b;
  }
}

TYPED_TEST(adjust_window_unit, only_selected_problems_are_touched) {
  auto const rig = example_rig<test::fisheye_rig>();
  std::vector<window_scene> scenes;
  for (unsigned b = 0; b < 4; ++b) { scenes.push_back(make_window(rig, {}, 50 + b)); }
  auto const all = adjust(this->backend.exec, rig, scenes, {});
  std::vector<int> const selected{0, 1, 0, 7};
  auto const some = adjust(this->backend.exec, rig, scenes, {}, selected);
  for (std::size_t b = 0; b < scenes.size(); ++b) {
    if (selected[b] != 0) {
      EXPECT_TRUE(same_bits(some[b], all[b])) << b;
      continue;
    }
    EXPECT_EQ(some[b].outcome.valid, -1) << b;
    EXPECT_TRUE(same_bits(some[b].T_cw, scenes[b].T_cw)) << b;
    EXPECT_TRUE(same_bits(some[b].position, scenes[b].position)) << b;
    for (auto const o : some[b].outlier) { EXPECT_EQ(o, 77) << b; }
  }
}

TYPED_TEST(adjust_window_unit, problems_that_cannot_be_adjusted_stay) {
  this->template check_refusals<ft::rectified_rig>();
  this->template check_refusals<test::fisheye_rig>();
}

TYPED_TEST(adjust_window_unit, a_start_far_away_never_becomes_worse) {
  for (unsigned seed = 60; seed < 64; ++seed) {
    window_shape const shape{6, 1, 120, 5, 0.5, 0.3, 40.0};
    auto const rig = example_rig<ft::rectified_rig>();
    auto const s = make_window(rig, shape, seed);
    auto const r = this->template one<ft::rectified_rig>(s, thorough(12));
    ASSERT_EQ(r.outcome.valid, 1);
    EXPECT_LE(r.outcome.last_cost, r.outcome.first_cost);
    EXPECT_NEAR(test::judge(rig, s, r.T_cw, r.position).cost, r.outcome.last_cost,
                1e-9 * r.outcome.last_cost);
  }
}

TYPED_TEST(adjust_window_unit, without_steps_only_outliers_are_marked) {
  auto const rig = example_rig<ft::rectified_rig>();
  auto const s = make_window(rig, {5, 1, 90, 4, 0.5, 0.1}, 70);
  auto const r = this->template one<ft::rectified_rig>(s, thorough(0));
  EXPECT_EQ(r.outcome.valid, 1);
  EXPECT_EQ(r.outcome.steps, 0);
  EXPECT_EQ(r.outcome.first_cost, r.outcome.last_cost);
  EXPECT_TRUE(same_bits(r.T_cw, s.T_cw));
  EXPECT_TRUE(same_bits(r.position, s.position));
  EXPECT_EQ(r.outlier, test::judge(rig, s, s.T_cw, s.position).outlier);
}

TYPED_TEST(adjust_window_unit, the_descent_ends_when_little_is_gained) {
  auto const s = make_window(example_rig<ft::rectified_rig>(), {6, 2, 200, 5, 0.5}, 80);
  ft::window_params params;
  params.steps = 50;
  auto const r = this->template one<ft::rectified_rig>(s, params);
  EXPECT_EQ(r.outcome.valid, 1);
  EXPECT_GE(r.outcome.steps, 2);
  EXPECT_LE(r.outcome.steps, 10);
}

TEST(WindowShapes, AreChecked) {
  ft::window_problem_view problems;
  ft::window_workspace work;
  ft::carver c;
  EXPECT_THROW(ft::carve(c, problems, {65, 10, 1}, 1), ft::bad_argument);
  EXPECT_THROW(ft::carve(c, problems, {0, 10, 1}, 1), ft::bad_argument);
  EXPECT_THROW(ft::carve(c, problems, {10, 0, 1}, 1), ft::bad_argument);
  EXPECT_THROW(ft::carve(c, problems, {10, 10, 17}, 1), ft::bad_argument);
  EXPECT_THROW(ft::carve(c, problems, {10, 10, 1}, 0), ft::bad_argument);
  ft::carve(c, problems, {10, 10, 2}, 1);
  EXPECT_THROW(ft::carve(c, work, problems, 11), ft::bad_argument);
  ft::carve(c, work, problems, 10);
  ft::host_exec const exec(1);
  EXPECT_THROW(
      ft::adjust_window(exec, example_rig<ft::rectified_rig>(), problems, nullptr, {}, work),
      ft::bad_argument);  // two cameras a view
  work.points = 9;
  EXPECT_THROW(
      ft::adjust_window(exec, example_rig<test::fisheye_rig>(), problems, nullptr, {}, work),
      ft::bad_argument);
}

}  // namespace adjust_window_test
