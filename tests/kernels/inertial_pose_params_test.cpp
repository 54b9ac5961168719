// SPDX-License-Identifier: Apache-2.0
// How a pose with an IMU is optimised: where rounds end, with which one they begin, and what is
// left out at first.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <limits>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/inertial_scene.hpp"

namespace inertial_pose_params_test {

using test::angle;
using test::as_tracked;
using test::inertial_pose_batch;
using test::inertial_scene;
using test::last_state;
using test::length;
using test::noisy_batch;

template <typename Backend>
class inertial_params : public test::on_backend<Backend> {
protected:
  Backend backend;

  void run(inertial_scene<ft::rectified_rig> const& scene, inertial_pose_batch& b,
           ft::inertial_pose_params const& params = {}) {
    test::optimize(backend.exec, scene.rig, scene.mount, params, b);
  }
};
TYPED_TEST_SUITE(inertial_params, test::backends);

TYPED_TEST(inertial_params, a_larger_step_tolerance_gives_nearly_the_same_state) {
  inertial_scene<ft::rectified_rig> scene(15);
  inertial_pose_batch b = noisy_batch(scene, 6, as_tracked());
  inertial_pose_batch coarse = b;
  inertial_pose_batch single = b;
  this->run(scene, b);
  ft::inertial_pose_params params;
  params.step_tolerance = 1e-6;
  this->run(scene, coarse, params);
  params.step_tolerance = std::numeric_limits<double>::infinity();  // one step a round
  this->run(scene, single, params);
  double most = 0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    auto const want = last_state(b.result[i]);
    auto const got = last_state(coarse.result[i]);
    EXPECT_EQ(coarse.result[i].tracked, b.result[i].tracked);
    EXPECT_LT(length(got.p - want.p), 1e-5);
    EXPECT_LT(length(got.v - want.v), 1e-5);
    EXPECT_LT(angle(got.R, want.R), 1e-5);
    most = std::max(most, length(last_state(single.result[i]).p - want.p));
  }
  EXPECT_GT(most, 1e-6);
}

TYPED_TEST(inertial_params, fewer_rounds_are_enough_where_the_start_is_good) {
  inertial_scene<ft::rectified_rig> scene(15);
  inertial_pose_batch b = noisy_batch(scene, 6, as_tracked());
  inertial_pose_batch late = b;
  this->run(scene, b);
  ft::inertial_pose_params params;
  params.first_round = 2;
  this->run(scene, late, params);
  for (std::size_t i = 0; i < b.size(); ++i) {
    EXPECT_EQ(late.result[i].rounds, 2);
    EXPECT_LT(length(last_state(late.result[i]).p - last_state(b.result[i]).p), 1e-3);
    EXPECT_NEAR(late.result[i].tracked, b.result[i].tracked, 3);
  }
}

TYPED_TEST(inertial_params, bad_parameters_are_refused) {
  inertial_scene<ft::rectified_rig> scene(15);
  inertial_pose_batch b = noisy_batch(scene, 1, {});
  auto const refuses = [&](ft::inertial_pose_params const& p) {
    EXPECT_THROW(this->run(scene, b, p), ft::bad_argument);
  };
  for (double const wrong : {-1e-9, std::numeric_limits<double>::quiet_NaN()}) {
    ft::inertial_pose_params params;
    params.step_tolerance = wrong;
    refuses(params);
  }
  for (int const wrong : {-1, ft::inertial_rounds}) {
    ft::inertial_pose_params params;
    params.first_round = wrong;
    refuses(params);
  }
}

TYPED_TEST(inertial_params, outliers_that_are_given_take_no_part_at_first) {
  inertial_scene<ft::rectified_rig> scene(15);
  inertial_pose_batch b = noisy_batch(scene, 6, as_tracked());
  inertial_pose_batch all = b;
  ft::inertial_pose_params params;
  this->run(scene, b, params);
  params.first_round = ft::inertial_rounds - 1;
  this->run(scene, all, params);
  params.outliers_given = true;
  inertial_pose_batch given = b;
  this->run(scene, given, params);
  for (std::size_t i = 0; i < b.size(); ++i) {
    auto const want = last_state(b.result[i]).p;
    double const error = length(last_state(given.result[i]).p - want);
    EXPECT_EQ(given.result[i].rounds, 1);
    EXPECT_LT(error, 1e-3);
    // Outliers have no robust weights in the last round.
    EXPECT_GT(length(last_state(all.result[i]).p - want), 10 * error);
    EXPECT_NEAR(given.result[i].tracked, b.result[i].tracked, 3);
  }
}

}  // namespace inertial_pose_params_test
