// SPDX-License-Identifier: Apache-2.0
// Relocalisation's search for a keyframe's points through the shim: against plain loops, mixed with
// other calls, and with input that is refused.
#include <gtest/gtest.h>

#include <cstddef>
#include <functional>
#include <limits>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/frame_fields.hpp"
#include "integration/orbslam3/front_end.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_recovery.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/two_views.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"

namespace orbslam3_test {

namespace recovery_shim {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using front_end = ft::orbslam3::front_end<stand_in::types>;
using ft::orbslam3::stage;

class recovery : public on_executor {};

int never() { throw std::runtime_error("the CPU was asked"); }

/// In turn for the coarse and the narrow search, from a frame that holds nothing and one that holds
/// points, those found left out.
TEST_P(recovery, searches_a_keyframes_points_as_plain_loops_do) {
  int taken = 0;
  int kept = 0;
  for (sensor const kind : all_sensors) {
    for (unsigned const seed : {3u, 4u}) {
      SCOPED_TRACE(std::string(name_of(kind)) + " seed " + std::to_string(seed));
      lost_frame v(kind, seed);
      plain_keyframe_search const plain(v.settings);
      accelerator gpu(make(v.settings), v.settings);
      auto want = v.frame;
      point_set found;
      for (auto const& [th, farthest] : {std::pair{10.0f, 100}, std::pair{3.0f, 64}}) {
        int const n = plain.run(want, v.keyframe, found, th, farthest);
        EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, found, th, farthest), n);
        ASSERT_EQ(v.frame.mvpMapPoints, want.mvpMapPoints);
        taken += n;
        for (std::size_t i = 0; i < want.mvpMapPoints.size(); ++i) {
          auto*& p = want.mvpMapPoints[i];
          if (i % 3 == 0) { p = nullptr; }
          if (p == nullptr) { continue; }
          ++kept;
          if (i % 2 == 0) { found.insert(p); }
        }
        v.frame.mvpMapPoints = want.mvpMapPoints;
      }
    }
  }
  EXPECT_GT(taken, 1000);
  EXPECT_GT(kept, 300);
}

/// Mapping moves points and marks them bad; a keyframe with fewer keypoints follows.
TEST_P(recovery, searches_anew_in_every_call) {
  lost_frame v(sensor::stereo);
  plain_keyframe_search const plain(v.settings);
  accelerator gpu(make(v.settings), v.settings);
  auto const expect_plain = [&](stand_in::key_frame& k) {
    auto want = v.frame;
    auto got = v.frame;
    int const n = plain.run(want, k, {}, 10, 100);
    EXPECT_EQ(gpu.search_keyframe(got, k, point_set{}, 10, 100), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    return n;
  };
  int const all = expect_plain(v.keyframe);
  EXPECT_GT(all, 50);
  for (std::size_t i = 0; i < v.world.map.size(); i += 5) {
    auto& p = *v.world.map[i];
    p.SetWorldPos(p.GetWorldPos() + Eigen::Vector3f(0.5f, 0, 0));
    v.world.map[i + 1]->SetBadFlag();
  }
  int const fewer = expect_plain(v.keyframe);
  EXPECT_LT(fewer, all);
  stand_in::key_frame small = v.keyframe;
  small.mvKeys.resize(40);
  small.mvKeysUn.resize(40);
  small.points.resize(40);
  EXPECT_LT(expect_plain(small), fewer);
  EXPECT_EQ(expect_plain(v.keyframe), fewer);
}

/// The keyframe takes the place of the last frame on the device, which is sent again if it is
/// needed.
TEST_P(recovery, search_leaves_other_calls_their_answers) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    SCOPED_TRACE(name_of(kind));
    lost_frame v(kind);
    accelerator alone(make(v.settings), v.settings);
    accelerator mixed(make(v.settings), v.settings);
    auto want = v.world.current;
    int const n = alone.search_by_projection(want, v.world.last, 7, false);
    int const inliers = alone.pose_optimization(want, stage::pose_last_frame);
    auto got = v.world.current;
    mixed.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100);
    EXPECT_EQ(mixed.search_by_projection(got, v.world.last, 7, false), n);
    auto searched = got;
    EXPECT_GT(mixed.search_keyframe(searched, v.keyframe, point_set{}, 3, 64), 0);
    EXPECT_EQ(mixed.pose_optimization(got, stage::pose_last_frame), inliers);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    EXPECT_EQ(got.mvbOutlier, want.mvbOutlier);
    EXPECT_EQ(got.GetPose().rotationMatrix(), want.GetPose().rotationMatrix());
    EXPECT_EQ(got.GetPose().translation(), want.GetPose().translation());
  }
}

TEST_P(recovery, search_finds_nothing_from_a_pose_that_is_no_number) {
  lost_frame v(sensor::monocular);
  accelerator gpu(make(v.settings), v.settings);
  v.frame.SetPose({Eigen::Matrix3f::Identity(),
                   Eigen::Vector3f(0, std::numeric_limits<float>::quiet_NaN(), 0)});
  EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100), 0);
  EXPECT_EQ(v.held(), 0);
}

TEST_P(recovery, searches_that_do_not_fit_are_the_cpus) {
  lost_frame good(sensor::fisheye_stereo);
  front_end gpu(make(good.settings), good.settings, {});
  struct broken {
    stand_in::frame frame;
    stand_in::key_frame keyframe;
  };
  using change = std::function<void(broken&)>;
  change const spoilt[] = {
      [](broken& v) { v.frame.mDescriptors = {}; },
      [](broken& v) { v.frame.mDescriptors.resize(10); },
      [](broken& v) { v.frame.mvpMapPoints.clear(); },
      [](broken& v) { v.frame.mnMaxX = v.frame.mnMinX; },
      [](broken& v) { v.keyframe.points.pop_back(); },
      [](broken& v) { v.keyframe.mvKeysRight.pop_back(); },
      [](broken& v) {
        v.keyframe.mvKeys.resize(100000);
        v.keyframe.points.resize(100000 + v.keyframe.mvKeysRight.size());
      },
  };
  for (auto const& spoil : spoilt) {
    broken v{good.frame, good.keyframe};
    spoil(v);
    auto const before = v.frame.mvpMapPoints;
    int calls = 0;
    EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100,
                                  [&] {
                                    EXPECT_EQ(v.frame.mvpMapPoints, before);
                                    ++calls;
                                    return 321;
                                  }),
              321);
    EXPECT_EQ(calls, 1);
  }
  EXPECT_GT(gpu.search_keyframe(good.frame, good.keyframe, point_set{}, 10, 100, never), 0);
}

TEST_P(recovery, is_the_cpus_by_option_and_after_a_failure) {
  lost_frame v(sensor::stereo);
  auto const expect_cpu = [&](front_end& gpu) {
    EXPECT_EQ(gpu.search_keyframe(v.frame, v.keyframe, point_set{}, 10, 100, [] { return 5; }), 5);
    EXPECT_EQ(v.held(), 0);
  };
  ft::orbslam3::options o;
  ft::orbslam3::set_modes(o, "search_keyframe", ft::orbslam3::stage_mode::host);
  front_end off(make(v.settings), v.settings, o);
  expect_cpu(off);
  EXPECT_THROW(ft::orbslam3::set_modes(o, "search_keyframe", ft::orbslam3::stage_mode::bypass),
               ft::bad_argument);
  heard said;
  auto device = std::make_unique<watched_device>(make(v.settings));
  device->on_call = [&](std::string const& call) {
    if (call == "search_keyframe") { throw ft::cuda_error("ft: the device is lost"); }
  };
  front_end lost(std::move(device), v.settings, {});
  expect_cpu(lost);
  expect_cpu(lost);
  EXPECT_EQ(said.lines(), 1) << said.text();
  EXPECT_FALSE(lost.uses(stage::extract));
}

INSTANTIATE_TEST_SUITE_P(executors, recovery, ::testing::ValuesIn(executors()), executor_name);

}  // namespace recovery_shim

}  // namespace orbslam3_test
