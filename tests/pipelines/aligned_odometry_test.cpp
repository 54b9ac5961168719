// SPDX-License-Identifier: Apache-2.0
// Keypoints that are moved to where images look as they did: what that gains in a rendered room.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace aligned_odometry_test {

constexpr int frames = 24;

/// Root of the mean squared error of the motions from frame to frame, metres.
template <typename Exec, typename Rig>
double error_of_motions(Exec const& exec, Rig const& rig, bool align,
                        std::vector<test::room::stereo_frame> const& walk) {
  auto params = test::room::odometry_params(4096);
  params.align_keypoints = align;
  ft::odometry<Exec, Rig> odo(exec, rig, params);
  auto const all = test::track_all(odo, walk.size(), 50'000'000,
                                   [&](std::size_t i) { return images_of(walk[i]); });
  double sum = 0;
  for (std::size_t i = 1; i < all.size(); ++i) {
    auto const motion = all[i].T_world_camera.inverse() * all[i - 1].T_world_camera;
    auto const truth =
        walk[i].T_cw.template cast<double>() * walk[i - 1].T_cw.template cast<double>().inverse();
    auto const off = motion.t - truth.t;
    sum += dot(off, off);
  }
  return std::sqrt(sum / (frames - 1));
}

template <typename Backend>
class AlignedOdometry : public test::on_backend<Backend> {
public:
  template <typename Rig>
  double share_of_the_error(Rig const& rig) {
    Backend backend;
    double with = 0, without = 0;
    for (unsigned seed = 0; seed < 3; ++seed) {
      auto const walk = test::room::make_walk(rig, seed, frames);
      with += error_of_motions(backend.exec, rig, true, walk);
      without += error_of_motions(backend.exec, rig, false, walk);
    }
    return with / without;
  }
};
TYPED_TEST_SUITE(AlignedOdometry, test::backends);

TYPED_TEST(AlignedOdometry, ErrsLessFromFrameToFrame) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  EXPECT_LT(this->share_of_the_error(test::room::rig()), 0.65) << "0.46 when it was written";
  EXPECT_LT(this->share_of_the_error(test::room::fisheye()), 0.65) << "0.51";
}

}  // namespace aligned_odometry_test
