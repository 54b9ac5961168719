// SPDX-License-Identifier: Apache-2.0
// Pose optimisation that is started behind a search: it changes no answer, whatever tracking and
// mapping do in between.
#include "integration/orbslam3/pose_ahead.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/support/effort.hpp"

namespace orbslam3_test {

namespace ahead {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::map_change;
using ft::orbslam3::pose_ahead;
using ft::orbslam3::stage;

ft::pose shifted(float x) {
  ft::pose T = ft::pose::identity();
  T.t.x = x;
  return T;
}

TEST(pose_ahead, is_taken_once_for_the_same_buffer_and_pose) {
  pose_ahead p;
  EXPECT_EQ(p.started(), -1);
  EXPECT_FALSE(p.take(0, {}));
  EXPECT_TRUE(p.expect(pose_ahead::after::last_frame, 1, shifted(2)));
  EXPECT_EQ(p.started(), 1);
  EXPECT_FALSE(p.take(0, shifted(2)));
  EXPECT_FALSE(p.take(1, shifted(3)));
  EXPECT_TRUE(p.take(1, shifted(2)));
  EXPECT_EQ(p.started(), -1);
  EXPECT_FALSE(p.take(1, shifted(2)));
  p.expect(pose_ahead::after::local_map, 1, shifted(2));
  p.changed(0);
  EXPECT_EQ(p.started(), 1);
  p.changed(1);
  EXPECT_EQ(p.started(), -1);
  EXPECT_FALSE(p.take(1, shifted(2)));
}

TEST(pose_ahead, is_not_started_after_searches_that_nobody_optimises) {
  pose_ahead p;
  auto const last = pose_ahead::after::last_frame;
  auto const local = pose_ahead::after::local_map;
  p.expect(last, 0, {});
  p.forget();  // changed: says nothing about what tracking does
  EXPECT_TRUE(p.expect(last, 0, {}));
  p.give_up();
  EXPECT_EQ(p.started(), -1);
  EXPECT_TRUE(p.expect(local, 0, {})) << "each kind of search on its own";
  EXPECT_TRUE(p.take(0, {}));
  EXPECT_FALSE(p.expect(last, 0, {}));
  EXPECT_EQ(p.started(), -1);
  p.give_up();
  EXPECT_FALSE(p.expect(last, 0, {}));
  EXPECT_FALSE(p.take(0, {})) << "it comes again, but was not started";
  EXPECT_TRUE(p.expect(last, 0, {}));
}

TEST(pose_ahead, knows_whether_a_change_moves_a_held_point) {
  pose_ahead p;
  int const holder[] = {-1, 7, 300, -1, 12};
  std::vector<std::uint32_t> words{8, 0, 0, 0, 300, 0, 0, 0};
  map_change change;
  EXPECT_FALSE(p.moves_held(change, words.data(), holder, 5));
  change.count[map_change::position] = 1;
  EXPECT_FALSE(p.moves_held(change, words.data(), holder, 5));
  change.count[map_change::position] = 2;
  EXPECT_TRUE(p.moves_held(change, words.data(), holder, 5));
  EXPECT_FALSE(p.moves_held(change, words.data(), holder, 2)) << "the earlier ones are forgotten";
  words[4] = 1u << 30;
  EXPECT_FALSE(p.moves_held(change, words.data(), holder, 5));
}

/// What happens between a search and the optimisation.
enum class meanwhile {
  nothing,
  other_points_move,
  held_points_move,
  views_change,
  a_match_is_taken_away,
  the_pose_is_set,
  no_optimisation,
  another_search,
  an_optimisation_of_the_last_frame,
};
constexpr int kinds_of_meanwhile = 9;

struct outcome {
  std::vector<std::size_t> points;
  std::vector<bool> outliers;
  std::vector<float> numbers;

  friend bool operator==(outcome const& a, outcome const& b) {
    return a.points == b.points && a.outliers == b.outliers && a.numbers == b.numbers;
  }
};

class poses_ahead : public on_executor {
protected:
  struct hook_into final : stand_in::hooks {
    accelerator* gpu = nullptr;
    void changed(stand_in::map_point* point) override { gpu->map_point_changed(point); }
  };

  static void note(outcome& to, stand_in::frame const& f, int count) {
    for (auto const* p : f.mvpMapPoints) { to.points.push_back(p == nullptr ? 0 : p->mnId); }
    to.outliers.insert(to.outliers.end(), f.mvbOutlier.begin(), f.mvbOutlier.end());
    auto const T = ft::orbslam3::transform_of(f.GetPose());
    to.numbers.insert(to.numbers.end(), T.R.m, T.R.m + 9);
    to.numbers.insert(to.numbers.end(), {T.t.x, T.t.y, T.t.z});
    to.numbers.push_back(static_cast<float>(count));
  }
  static void disturb(meanwhile what, accelerator& gpu, scene& s, stand_in::frame& f) {
    auto const first_held = [&](bool held) {
      for (auto& p : s.map) {
        bool found = false;
        for (auto const* q : f.mvpMapPoints) { found = found || q == p.get(); }
        if (found == held) { return p.get(); }
      }
      return s.map.front().get();
    };
    switch (what) {
      case meanwhile::nothing:
      case meanwhile::no_optimisation:
        break;
      case meanwhile::other_points_move:
        first_held(false)->SetWorldPos({0.5f, 0.25f, 4});
        break;
      case meanwhile::held_points_move: {
        auto* const p = first_held(true);
        p->SetWorldPos(p->GetWorldPos() * 1.01f);
        break;
      }
      case meanwhile::views_change:
        first_held(true)->set_view({0, 0, 1}, 1, 9);
        break;
      case meanwhile::a_match_is_taken_away:
        for (auto*& p : f.mvpMapPoints) {
          if (p != nullptr) {
            p = nullptr;
            break;
          }
        }
        break;
      case meanwhile::the_pose_is_set:
        f.SetPose({f.GetPose().rotationMatrix(),
                   f.GetPose().translation() + Eigen::Vector3f(0.001f, 0, 0)});
        break;
      case meanwhile::another_search:
        f.mvpMapPoints.assign(f.mvpMapPoints.size(), nullptr);
        gpu.search_by_projection(f, s.last, 25, false);
        break;
      case meanwhile::an_optimisation_of_the_last_frame: {
        stand_in::frame last = s.last;
        gpu.pose_optimization(last, stage::pose_relocalization);
        break;
      }
    }
  }
  /// Two frames, in each of which both searches are followed by the same disturbance.
  static outcome track(sensor kind, meanwhile what, bool ahead, bool hooked) {
    scene s(kind, 3);
    s.settings.most_keypoints = 2000;
    s.settings.poses_ahead = ahead;
    ft::orbslam3::options o;
    o.detection =
        hooked ? ft::orbslam3::change_detection::hooks : ft::orbslam3::change_detection::compare;
    hook_into hook;
    accelerator gpu(make(s.settings), s.settings, o);
    hook.gpu = &gpu;
    for (auto& p : s.map) { p->observer = &hook; }
    auto const local = s.local_map();
    bool const mono = kind == sensor::monocular || kind == sensor::fisheye_monocular;
    outcome all;
    for (unsigned long id = 11; id < 14; ++id) {
      stand_in::frame f = s.current;
      f.mnId = id;
      note(all, f, gpu.search_by_projection(f, s.last, 15, mono));
      disturb(what, gpu, s, f);
      if (what != meanwhile::no_optimisation) {
        note(all, f, gpu.pose_optimization(f, stage::pose_last_frame));
      }
      note(all, f, gpu.search_local_points(f, local, 2));
      disturb(what, gpu, s, f);
      if (what != meanwhile::no_optimisation || id == 12) {
        note(all, f, gpu.pose_optimization(f, stage::pose_local_map));
      }
    }
    return all;
  }
};

TEST_P(poses_ahead, change_no_answer) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    for (int i = 0; i < kinds_of_meanwhile; ++i) {
      for (bool const hooked : test::both(i % 2 == 0)) {
        SCOPED_TRACE(std::string(name_of(kind)) + " meanwhile " + std::to_string(i));
        auto const what = static_cast<meanwhile>(i);
        auto const want = track(kind, what, false, hooked);
        ASSERT_GT(want.points.size(), 1000u);
        EXPECT_TRUE(track(kind, what, true, hooked) == want);
      }
    }
  }
}

TEST_P(poses_ahead, are_there_when_tracking_asks) {
  scene s(sensor::stereo, 3);
  s.settings.most_keypoints = 2000;
  accelerator gpu(make(s.settings), s.settings);
  auto const local = s.local_map();
  for (int round = 0; round < 3; ++round) {
    stand_in::frame f = s.current;
    gpu.search_by_projection(f, s.last, 15, false);
    gpu.reset_bytes();
    gpu.pose_optimization(f, stage::pose_last_frame);
    EXPECT_EQ(gpu.bytes().uploads, 0) << "the pose was not started";
    gpu.search_local_points(f, local, 2);
    gpu.reset_bytes();
    gpu.pose_optimization(f, stage::pose_local_map);
    EXPECT_EQ(gpu.bytes().uploads, 0) << "the pose was not started";
    EXPECT_EQ(gpu.bytes().downloads, 1);
  }
}

INSTANTIATE_TEST_SUITE_P(executors, poses_ahead, ::testing::ValuesIn(executors()), executor_name);

}  // namespace ahead

}  // namespace orbslam3_test
