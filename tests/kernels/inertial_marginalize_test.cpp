// SPDX-License-Identifier: Apache-2.0
// What a pose with an IMU leaves to the next frame, by a stage of its own.
#include "ft/kernels/inertial/optimize_inertial_pose.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>
#include <limits>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/inertial_scene.hpp"

namespace inertial_marginalize_test {

using ft::inertial_pose_status;
using test::inertial_pose_batch;
using test::inertial_scene;

template <typename Backend>
class inertial_marginalization : public test::on_backend<Backend> {
protected:
  Backend backend;

  template <typename Rig>
  inertial_pose_batch solved(inertial_scene<Rig> const& scene, inertial_pose_batch b,
                             bool in_two_stages, bool quirks = false) {
    ft::inertial_pose_params params;
    params.marginalizes = !in_two_stages;
    params.reference_quirks = quirks;
    test::optimize(backend.exec, scene.rig, scene.mount, params, b);
    return b;
  }

  template <typename Rig>
  void check_two_stages_like_one() {
    inertial_scene<Rig> scene(21);
    inertial_pose_batch problems;
    for (int i = 0; i < test::effort(8); ++i) {
      test::inertial_shape shape;
      shape.pixel_noise = 0.8;
      shape.from_last_frame = i % 2 == 1;
      shape.observations = i == 3 ? 0 : 30 + 50 * i;
      shape.outliers_percent = 5 * i;
      scene.add(problems, shape);
    }
    for (bool const quirks : {false, true}) {
      auto const one = solved(scene, problems, false, quirks);
      auto const two = solved(scene, problems, true, quirks);
      EXPECT_EQ(one.outlier, two.outlier);
      for (std::size_t i = 0; i < one.size(); ++i) {
        ASSERT_EQ(one.result[i].status, inertial_pose_status::optimised) << i;
        EXPECT_EQ(two.result[i].status, inertial_pose_status::optimised) << i;
        EXPECT_EQ(two.next_prior[i].known, 1) << i;
        EXPECT_EQ(
            std::memcmp(&one.result[i].stored, &two.result[i].stored, sizeof one.result[i].stored),
            0)
            << i;
        EXPECT_EQ(std::memcmp(&one.next_prior[i].state, &two.next_prior[i].state,
                              sizeof one.next_prior[i].state),
                  0)
            << i;
        EXPECT_EQ(std::memcmp(one.next_prior[i].information, two.next_prior[i].information,
                              sizeof one.next_prior[i].information),
                  0)
            << i;
      }
    }
  }
};
TYPED_TEST_SUITE(inertial_marginalization, test::backends);

TYPED_TEST(inertial_marginalization, two_stages_give_the_bits_of_one_with_a_rectified_pair) {
  this->template check_two_stages_like_one<ft::rectified_rig>();
}
TYPED_TEST(inertial_marginalization, two_stages_give_the_bits_of_one_with_two_fisheye_cameras) {
  this->template check_two_stages_like_one<test::inertial_fisheye_rig>();
}
TYPED_TEST(inertial_marginalization, two_stages_give_the_bits_of_one_with_three_cameras) {
  this->template check_two_stages_like_one<ft::multi_rig<3>>();
}

TYPED_TEST(inertial_marginalization, what_was_refused_leaves_nothing) {
  inertial_scene<ft::rectified_rig> scene(22);
  inertial_pose_batch b;
  for (int i = 0; i < 3; ++i) {
    test::inertial_shape shape;
    shape.from_last_frame = true;
    scene.add(b, shape);
  }
  b.integral[0].status = ft::integration_status::gap;
  b.prior[1].known = 0;
  auto const after = this->solved(scene, b, true);
  EXPECT_EQ(after.result[0].status, inertial_pose_status::no_integral);
  EXPECT_EQ(after.result[1].status, inertial_pose_status::no_prior);
  EXPECT_EQ(after.next_prior[0].known, 0);
  EXPECT_EQ(after.next_prior[1].known, 0);
  EXPECT_EQ(after.next_prior[2].known, 1);
}

TYPED_TEST(inertial_marginalization, bad_arguments_are_refused) {
  inertial_scene<ft::rectified_rig> scene(24);
  auto const refuses = [&](ft::inertial_poses const& poses, ft::imu_mount const& mount) {
    EXPECT_THROW(ft::marginalize_inertial_poses(this->backend.exec, scene.rig, mount, poses),
                 ft::bad_argument);
  };
  ft::inertial_poses none{};
  EXPECT_NO_THROW(ft::marginalize_inertial_poses(this->backend.exec, scene.rig, scene.mount, none));
  ft::imu_mount nowhere = scene.mount;
  nowhere.T_cb.t.x = std::numeric_limits<float>::quiet_NaN();
  refuses(none, nowhere);
  none.problems = -1;
  refuses(none, scene.mount);
}

}  // namespace inertial_marginalize_test
