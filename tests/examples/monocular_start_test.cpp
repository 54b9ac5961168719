// SPDX-License-Identifier: Apache-2.0
// One camera on a real sequence: the left images of KITTI, with the odometry's default settings.
#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <cmath>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"
#include "ft/cameras/monocular_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/sequence.hpp"

namespace {

using rig_type = ft::monocular_rig<ft::pinhole<float>>;

TEST(MonocularStart, KittiBeginsAtOnceAndIsFollowed) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  auto const sequence = seq::sequence::open(shared + "/data/kitti_0926_stereo");
  auto const& left = sequence.rig().left;
  auto const narrow = [](double v) { return static_cast<float>(v); };
  ft::odometry_params params;
  params.orb.width = left.width;
  params.orb.height = left.height;
  ft::odometry<ft::host_exec, rig_type> odometry(
      ft::host_exec(),
      rig_type::make({narrow(left.fx), narrow(left.fy), narrow(left.cx), narrow(left.cy)}), params);
  EXPECT_EQ(odometry.params().orb.start_features, 0);  // as it was given; five times `features`
  constexpr int frames = 30;
  int begin = -1;
  std::vector<Eigen::Vector3d> seen, truth;
  for (int i = 0; i < frames; ++i) {
    auto const frame = sequence.load(i);
    auto const t =
        odometry.track(ft::gray_view{frame.left.pixels.data(), left.width, left.height, left.width},
                       frame.time_ns);
    bool const looked = begin < 0;
    EXPECT_EQ(t.keypoints > 2 * params.orb.features, looked) << i;
    if (begin < 0 && t.state == ft::tracking_state::tracking) { begin = i; }
    if (begin < 0) { continue; }
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_EQ(t.maps, 1) << i;
    auto const at = seq::interpolate(sequence.ground_truth(), frame.time_ns);
    ASSERT_TRUE(at.has_value()) << i;
    auto const& p = t.T_world_camera.t;
    seen.push_back({p.x, p.y, p.z});
    truth.push_back(at->translation());
  }
  ASSERT_GE(begin, 1);
  EXPECT_LE(begin, 5);
  auto const n = static_cast<Eigen::Index>(seen.size());
  Eigen::Matrix3Xd from(3, n), to(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    from.col(i) = seen[static_cast<std::size_t>(i)];
    to.col(i) = truth[static_cast<std::size_t>(i)];
  }
  Eigen::Matrix4d const T = Eigen::umeyama(from, to, true);
  double sum = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    sum += ((T * from.col(i).homogeneous()).head<3>() - to.col(i)).squaredNorm();
  }
  double const path = (to.col(n - 1) - to.col(0)).norm();
  EXPECT_GT(path, 15);
  EXPECT_LT(std::sqrt(sum / static_cast<double>(n)), 0.005 * path);
}

}  // namespace
