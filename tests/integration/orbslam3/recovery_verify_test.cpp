// SPDX-License-Identifier: Apache-2.0
// Verify of relocalisation's stages: what counts as a difference, and whose answer stays.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <functional>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/lost_frame.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

namespace recovery_verify_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using verifier = ft::orbslam3::verifier<stand_in::types>;
using ft::orbslam3::difference;
using ft::orbslam3::pnp_progress;
using list = std::vector<std::string>;

class recovery_verify : public on_executor {
protected:
  recovery_verify() : v(sensor::stereo) {}
  void SetUp() override {
    on_executor::SetUp();
    if (!IsSkipped()) { gpu = std::make_unique<accelerator>(make(v.settings), v.settings); }
  }
  /// The search, whose CPU's answer `plant` changes. @return what differed
  list searched(std::function<int(stand_in::frame&)> const& plant) {
    list found;
    verifier both(*gpu, [&](difference const& d) { found.emplace_back(d.what); });
    plain_keyframe_search const plain(v.settings);
    auto want = v.frame;
    int const n = plain.run(want, v.keyframe, {}, 10, 100);
    auto f = v.frame;
    int calls = 0;
    EXPECT_EQ(both.search_keyframe(f, v.keyframe, point_set{}, 10, 100,
                                   [&] {
                                     ++calls;
                                     int const cpu = plain.run(f, v.keyframe, {}, 10, 100);
                                     return cpu + plant(f);
                                   }),
              n);
    EXPECT_EQ(calls, found.empty() ? 2 : 4);
    EXPECT_EQ(f.mvpMapPoints, want.mvpMapPoints) << "the accelerator's answer stays";
    return found;
  }
  /// A pose, where the CPU's answer is that of other draws, which `plant` changes.
  list solved(std::function<bool(pose_variables&)> const& plant) {
    list found;
    verifier both(*gpu, [&](difference const& d) { found.emplace_back(d.what); });
    auto const matches = v.matches();
    pnp_progress progress, other;
    other.seed = 1234;
    pose_variables want, to;
    EXPECT_EQ(gpu->solve_pnp(v.frame, matches, progress, want.answer()), 1);
    pnp_progress again;
    int calls = 0;
    EXPECT_TRUE(both.solve_pnp(v.frame, matches, again, to.answer(), [&] {
      ++calls;
      EXPECT_EQ(gpu->solve_pnp(v.frame, matches, other, to.answer()), 1);
      EXPECT_NE(to.T_cw, want.T_cw);
      return plant(to);
    }));
    EXPECT_EQ(calls, 1) << "each call of the CPU's solver goes on";
    EXPECT_EQ(again.done, progress.done);
    EXPECT_EQ(to, want) << "the accelerator's answer stays";
    return found;
  }

  lost_frame v;
  std::unique_ptr<accelerator> gpu;
};

TEST_P(recovery_verify, finds_nothing_where_the_cpu_searches_alike) {
  EXPECT_EQ(searched([](stand_in::frame&) { return 0; }), list{});
}

TEST_P(recovery_verify, finds_each_difference_of_a_search) {
  EXPECT_EQ(searched([](stand_in::frame&) { return 1; }), list{"matches"});
  EXPECT_EQ(searched([](stand_in::frame& f) {
              for (auto*& p : f.mvpMapPoints) {
                if (p == nullptr) { continue; }
                p = nullptr;
                break;
              }
              return 0;
            }),
            list{"map point of keypoint"});
}

TEST_P(recovery_verify, takes_poses_of_other_draws_for_the_same) {
  EXPECT_EQ(solved([](pose_variables&) { return true; }), list{});
}

TEST_P(recovery_verify, finds_each_difference_that_draws_do_not_explain) {
  EXPECT_EQ(solved([](pose_variables&) { return false; }), list{"pose by RANSAC"});
  EXPECT_EQ(solved([](pose_variables& to) {
              to.count /= 3;
              return true;
            }),
            list{"inliers by RANSAC"});
  // About the camera's centre, which stays; then of the centre alone.
  EXPECT_EQ(
      solved([](pose_variables& to) {
        Eigen::Matrix3f const turn =
            Eigen::AngleAxisf(0.2f, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
        to.T_cw.topRows<3>() = (turn * to.T_cw.topRows<3>()).eval();
        return true;
      }),
      list{"degrees between poses by RANSAC"});
  EXPECT_EQ(solved([](pose_variables& to) {
              to.T_cw(2, 3) += 1.5f;
              return true;
            }),
            list{"relative distance of poses by RANSAC"});
}

TEST_P(recovery_verify, keeps_the_cpus_answer_where_the_accelerator_refuses) {
  ft::orbslam3::options o;
  o.verify = true;
  heard said;
  front_end both(make(v.settings), v.settings, o);
  auto const matches = v.matches();
  v.frame.mvLevelSigma2.clear();
  pnp_progress progress;
  pose_variables to;
  EXPECT_TRUE(both.solve_pnp(v.frame, matches, progress, to.answer(), [&] {
    to.count = 42;
    to.T_cw.setOnes();
    return true;
  }));
  EXPECT_EQ(to.count, 42);
  EXPECT_EQ(to.T_cw, Eigen::Matrix4f::Ones());
  v.keyframe.points.pop_back();
  auto* const planted = v.world.map[0].get();
  EXPECT_EQ(both.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100,
                                 [&] {
                                   v.frame.mvpMapPoints[3] = planted;
                                   return 1;
                                 }),
            1);
  EXPECT_EQ(v.frame.mvpMapPoints[3], planted);
  EXPECT_EQ(v.held(), 1);
  std::ostringstream summary;
  both.print(summary);
  EXPECT_NE(
      summary.str().find("verify: solve_pnp: 1 calls, 0 with differences, 0 in all, 1 refused"),
      std::string::npos)
      << summary.str();
  EXPECT_NE(summary.str().find(
                "verify: search_keyframe: 1 calls, 0 with differences, 0 in all, 1 refused"),
            std::string::npos)
      << summary.str();
}

INSTANTIATE_TEST_SUITE_P(executors, recovery_verify, ::testing::ValuesIn(executors()),
                         executor_name);

}  // namespace recovery_verify_shim

}  // namespace orbslam3_test
