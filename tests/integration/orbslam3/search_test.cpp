// SPDX-License-Identifier: Apache-2.0
// The shim's searches and pose against plain loops, for every kind of sensor, on frames from the
// CPU; calls alone and mixed with the CPU's own.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::stage;
using ft::orbslam3::stage_mode;

/// Room for what random frames hold.
ft::orbslam3::settings roomy(ft::orbslam3::settings s) {
  s.most_keypoints = 2000;
  return s;
}

/// What a search leaves in a map point.
struct tracked {
  bool in_view, in_view_right;
  int level, level_right, visible;
  float x, y, right_x, right_y, depth, cosine;

  explicit tracked(stand_in::map_point& p)
      : in_view(p.mbTrackInView),
        in_view_right(p.mbTrackInViewR),
        level(p.mnTrackScaleLevel),
        level_right(p.mnTrackScaleLevelR),
        visible(p.visible()),
        x(p.mTrackProjX),
        y(p.mTrackProjY),
        right_x(p.mTrackProjXR),
        right_y(p.mTrackProjYR),
        depth(p.mTrackDepth),
        cosine(p.mTrackViewCos) {}
};
std::vector<tracked> tracked_values(scene const& s) {
  std::vector<tracked> all;
  for (auto const& p : s.map) { all.emplace_back(*p); }
  return all;
}
#if defined(__FMA__)
constexpr bool exact = false;  // of the plain loop; the shim's answers do not depend on it
#else
constexpr bool exact = true;
#endif
/// @param fisheye their projections differ in the last digits: sine and cosine of an arc tangent
void expect_equal(std::vector<tracked> const& got, std::vector<tracked> const& want, bool fisheye) {
  float const pixels = exact && !fisheye ? 0.0f : 1e-3f;
  float const relative = exact ? 0.0f : 1e-6f;
  ASSERT_EQ(got.size(), want.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    ASSERT_EQ(got[i].in_view, want[i].in_view) << i;
    ASSERT_EQ(got[i].in_view_right, want[i].in_view_right) << i;
    ASSERT_EQ(got[i].visible, want[i].visible) << i;
    if (got[i].in_view) {
      ASSERT_EQ(got[i].level, want[i].level) << i;
      ASSERT_NEAR(got[i].x, want[i].x, pixels) << i;
      ASSERT_NEAR(got[i].y, want[i].y, pixels) << i;
      ASSERT_NEAR(got[i].right_x, want[i].right_x, pixels) << i;
      ASSERT_NEAR(got[i].depth, want[i].depth, relative * want[i].depth) << i;
      ASSERT_NEAR(got[i].cosine, want[i].cosine, relative) << i;
    }
    if (got[i].in_view_right) {
      ASSERT_EQ(got[i].level_right, want[i].level_right) << i;
      ASSERT_NEAR(got[i].right_x, want[i].right_x, 1e-3f) << i;
      ASSERT_NEAR(got[i].right_y, want[i].right_y, 1e-3f) << i;
    }
  }
}

class shim_searches : public on_executor {};

TEST_P(shim_searches, in_the_last_frame_are_those_of_a_plain_loop) {
  for (sensor const kind : all_sensors) {
    bool const mono = kind == sensor::monocular || kind == sensor::fisheye_monocular;
    int matches = 0;
    for (unsigned seed = 1; seed <= 6; ++seed) {
      SCOPED_TRACE(std::string(name_of(kind)) + " " + std::to_string(seed));
      scene s(kind, seed);
      s.settings = roomy(s.settings);
      s.settings.reference_quirks = seed % 2 == 0;
      accelerator gpu(make(s.settings), s.settings);
      for (float const th : {7.0f, 15.0f, 30.0f}) {
        stand_in::frame want = s.current;
        int const n = plain_search(s.settings).search_last(want, s.last, th, mono);
        stand_in::frame got = s.current;
        EXPECT_EQ(gpu.search_by_projection(got, s.last, th, mono), n);
        EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
        matches += n;
      }
    }
    EXPECT_GT(matches, 2000) << name_of(kind);
  }
}

TEST_P(shim_searches, in_the_local_map_are_those_of_a_plain_loop) {
  for (sensor const kind : all_sensors) {
    int matches = 0;
    for (unsigned seed = 1; seed <= 6; ++seed) {
      SCOPED_TRACE(std::string(name_of(kind)) + " " + std::to_string(seed));
      scene want(kind, seed);
      scene got(kind, seed);
      want.settings = roomy(want.settings);
      bool const far = seed % 2 == 0;
      // Of earlier frames: for two cameras the limit looks at it where the right one alone sees.
      for (auto* const map : {&want.map, &got.map}) {
        for (std::size_t i = 0; i < map->size(); ++i) {
          (*map)[i]->mTrackDepth = i % 3 == 0 ? 9.0f : 1.0f;
        }
      }
      float const th = static_cast<float>(1 + seed % 3);
      ft::orbslam3::options o;
      o.fills_projected_points = seed != 5;
      accelerator gpu(make(want.settings), want.settings, o);
      plain_search const plain(want.settings);
      int const n = plain.search_local(want.current, want.local_map(), th, far, 5.0f);
      EXPECT_EQ(gpu.search_local_points(got.current, got.local_map(), th, far, 5.0f), n);
      matches += n;
      for (std::size_t i = 0; i < want.current.mvpMapPoints.size(); ++i) {
        auto const* a = want.current.mvpMapPoints[i];
        auto const* b = got.current.mvpMapPoints[i];
        ASSERT_EQ(a == nullptr, b == nullptr) << i;
        if (a != nullptr) { ASSERT_EQ(a->mnId, b->mnId) << i; }
      }
      bool const fisheye = kind == sensor::fisheye_stereo || kind == sensor::fisheye_monocular;
      expect_equal(tracked_values(got), tracked_values(want), fisheye);
      if (!o.fills_projected_points) { want.current.mmProjectPoints.clear(); }
      auto const same_point = [](auto const& a, auto const& b) { return a.first == b.first; };
      EXPECT_TRUE(std::equal(got.current.mmProjectPoints.begin(), got.current.mmProjectPoints.end(),
                             want.current.mmProjectPoints.begin(),
                             want.current.mmProjectPoints.end(), same_point));
    }
    EXPECT_GT(matches, 500) << name_of(kind);
  }
}

TEST_P(shim_searches, in_any_mix_with_the_cpu_give_the_same_frame) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo, sensor::rgbd}) {
    for (int mix = 0; mix < 4; ++mix) {
      SCOPED_TRACE(std::string(name_of(kind)) + " mix " + std::to_string(mix));
      std::vector<unsigned long> answers[2];
      for (bool const with_gpu : {false, true}) {
        scene s(kind, 7);
        s.settings = roomy(s.settings);
        accelerator gpu(make(s.settings), s.settings);
        plain_search const plain(s.settings);
        if (with_gpu && (mix & 1) != 0) {
          gpu.search_by_projection(s.current, s.last, 15, false);
        } else {
          plain.search_last(s.current, s.last, 15, false);
        }
        // The tracker drops some, the same for both.
        for (std::size_t i = 0; i < s.current.mvpMapPoints.size(); i += 7) {
          auto*& p = s.current.mvpMapPoints[i];
          if (p != nullptr) { p->mnLastFrameSeen = s.current.mnId; }
          p = nullptr;
        }
        mark_own_points(s.current);
        auto const local = s.local_map();
        if (with_gpu && (mix & 2) != 0) {
          gpu.search_local_points(s.current, local, 3);
        } else {
          plain.search_local(s.current, local, 3);
        }
        for (auto const* p : s.current.mvpMapPoints) {
          answers[with_gpu ? 1 : 0].push_back(p == nullptr ? 0 : p->mnId);
        }
      }
      EXPECT_EQ(answers[0], answers[1]);
    }
  }
}

TEST_P(shim_searches, look_again_where_refused_points_were_seen_unless_told_not_to) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    for (bool const quirks : {true, false}) {
      for (bool const far : {true, false}) {
        scene s(kind, 4);
        s.settings = roomy(s.settings);
        s.settings.reference_quirks = quirks;
        accelerator gpu(make(s.settings), s.settings);
        plain_search const plain(s.settings);
        auto const local = s.local_map();
        // All points were refused in this frame; an earlier test has seen them where they are.
        stand_in::map_point* in_view = nullptr;
        for (auto* p : local) {
          if (plain.in_frustum(s.current, *p) && !p->isBad()) { in_view = p; }
          p->mnLastFrameSeen = s.current.mnId;
        }
        // Nothing is searched for their sake alone.
        auto const before = s.current.mvpMapPoints;
        EXPECT_EQ(gpu.search_local_points(s.current, local, 1, far, 4.0f), 0);
        EXPECT_EQ(s.current.mvpMapPoints, before);
        // One more that is not to be seen changes nothing.
        in_view->mnLastFrameSeen = s.current.mnId - 1;
        Eigen::Vector3f const place = in_view->GetWorldPos();
        in_view->SetWorldPos({0, 0, -50});
        EXPECT_EQ(gpu.search_local_points(s.current, local, 1, far, 4.0f), 0);
        EXPECT_EQ(s.current.mvpMapPoints, before);
        in_view->SetWorldPos(place);
        stand_in::frame want = s.current;
        std::vector<stand_in::map_point*> const alone{in_view};
        int const n = plain.search_local(want, quirks ? local : alone, 1, far, 4.0f);
        EXPECT_EQ(gpu.search_local_points(s.current, local, 1, far, 4.0f), n);
        EXPECT_EQ(s.current.mvpMapPoints, want.mvpMapPoints);
        if (quirks) { EXPECT_GT(n, far ? 20 : 100); }
      }
    }
  }
}

/// The right camera alone sees points that are turned away from the left one by a little more than
/// 60 degrees. The limit looks at what the left one measured in an earlier frame.
TEST_P(shim_searches, leave_out_far_points_of_a_fisheye_pair_by_the_left_cameras_distance) {
  scene s(sensor::fisheye_stereo, 4);
  s.settings = roomy(s.settings);
  Eigen::Matrix3f R_rl;
  for (int i = 0; i < 9; ++i) { R_rl(i / 3, i % 3) = s.settings.T_rl.R.m[i]; }
  auto const& t = s.settings.T_rl.t;
  auto const pose = s.current.GetPose();
  Eigen::Matrix3f const R_wc = pose.rotationMatrix().transpose();
  Eigen::Vector3f const left = -(R_wc * pose.translation());
  Eigen::Vector3f const right = left - R_wc * (R_rl.transpose() * Eigen::Vector3f(t.x, t.y, t.z));
  int number = 0;
  for (auto& p : s.map) {
    Eigen::Vector3f const from_left = (p->GetWorldPos() - left).normalized();
    Eigen::Vector3f const from_right = (p->GetWorldPos() - right).normalized();
    Eigen::Vector3f const aside = (from_right - from_left.dot(from_right) * from_left).normalized();
    Eigen::Vector3f const normal = 0.499f * from_left + std::sqrt(1 - 0.499f * 0.499f) * aside;
    float const distance = (p->GetWorldPos() - left).norm();
    p->set_view(normal, 0.1f, distance * 2);
    p->mTrackDepth = ++number % 2 == 0 ? 9.0f : 1.0f;
  }
  auto const local = s.local_map();
  accelerator gpu(make(s.settings), s.settings);
  stand_in::frame want = s.current;
  plain_search const plain(s.settings);
  int const n = plain.search_local(want, local, 1, true, 5.0f);
  stand_in::frame without_limit = s.current;
  EXPECT_GT(n, 20);
  EXPECT_GT(plain.search_local(without_limit, local, 1), n + 20);
  int right_alone = 0;
  for (auto const* p : local) {
    right_alone += static_cast<int>(p->mbTrackInViewR && !p->mbTrackInView);
  }
  EXPECT_GT(right_alone, 100);
  EXPECT_EQ(gpu.search_local_points(s.current, local, 1, true, 5.0f), n);
  EXPECT_EQ(s.current.mvpMapPoints, want.mvpMapPoints);
}

TEST_P(shim_searches, find_nothing_in_nothing) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    scene s(kind, 2);
    s.settings = roomy(s.settings);
    accelerator gpu(make(s.settings), s.settings);
    stand_in::frame empty;
    empty.mnId = 50;
    empty.mnMaxX = 640;
    empty.mnMaxY = 480;
    empty.N = 0;
    stand_in::set_no_pair(empty);
    if (s.current.Nleft != -1) { empty.Nleft = empty.Nright = 0; }
    EXPECT_EQ(gpu.search_by_projection(empty, s.last, 7, false), 0);
    EXPECT_EQ(gpu.search_by_projection(s.current, empty, 7, false), 0);
    EXPECT_EQ(gpu.search_local_points(s.current, {}, 1), 0);
    empty.mnId = 51;
    EXPECT_EQ(gpu.search_local_points(empty, s.local_map(), 1), 0);
    EXPECT_EQ(gpu.pose_optimization(empty, stage::pose_last_frame), 0);
    EXPECT_EQ(gpu.pose_optimization(s.current, stage::pose_last_frame), 0);
  }
}

TEST_P(shim_searches, refuse_a_current_frame_that_holds_points) {
  scene s(sensor::stereo, 3);
  s.settings = roomy(s.settings);
  accelerator gpu(make(s.settings), s.settings);
  s.current.mvpMapPoints[5] = s.map[0].get();
  EXPECT_THROW(gpu.search_by_projection(s.current, s.last, 7, false), ft::bad_argument);
}

TEST_P(shim_searches, refuse_a_frame_with_more_keypoints_than_there_is_room_for) {
  scene s(sensor::stereo, 3);  // about 1500 keypoints, room for little more than 1000
  accelerator gpu(make(s.settings), s.settings);
  try {
    gpu.search_local_points(s.current, s.local_map(), 1);
    FAIL() << "taken";
  } catch (ft::bad_argument const& e) {
    EXPECT_NE(std::string(e.what()).find(std::to_string(s.current.N)), std::string::npos);
    EXPECT_NE(std::string(e.what()).find("most_keypoints"), std::string::npos);
  }
}

TEST_P(shim_searches, take_a_local_map_of_any_size) {
  scene s(sensor::stereo, 8, 3000);
  s.settings = roomy(s.settings);
  s.settings.most_keypoints = 6000;
  s.settings.local_points = 10;
  s.settings.map_points = 16;
  accelerator gpu(make(s.settings), s.settings);
  stand_in::frame want = s.current;
  auto const local = s.local_map();
  int const n = plain_search(s.settings).search_local(want, local, 1);
  EXPECT_EQ(gpu.search_local_points(s.current, local, 1), n);
  EXPECT_EQ(s.current.mvpMapPoints, want.mvpMapPoints);
}

TEST_P(shim_searches, of_two_trackers_on_two_threads_do_not_meet) {
  std::vector<std::unique_ptr<ft::orbslam3::device_tracker>> devices;
  for (int i = 0; i < 2; ++i) { devices.push_back(make(roomy(settings_for(sensor::stereo)))); }
  auto const work = [&](unsigned index) {
    scene s(sensor::stereo, 20 + index);
    s.settings = roomy(s.settings);
    accelerator gpu(std::move(devices[index]), s.settings);
    for (int round = 0; round < 5; ++round) {
      stand_in::frame want = s.current;
      stand_in::frame got = s.current;
      auto const local = s.local_map();
      int const n = plain_search(s.settings).search_local(want, local, 2);
      EXPECT_EQ(gpu.search_local_points(got, local, 2), n);
      EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    }
  };
  std::thread other(work, 1u);
  work(0);
  other.join();
}

class shim_pose : public on_executor {};

/// Exact places, a pose that is off, and some observations that are wrong.
TEST_P(shim_pose, is_found_by_every_sensor_and_wrong_observations_are_outliers) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    scene s(kind, 5);
    s.settings = roomy(s.settings);
    accelerator gpu(make(s.settings), s.settings);
    plain_search const plain(s.settings);
    stand_in::frame& f = s.current;
    stand_in::se3 const truth = f.GetPose();
    int held = 0;
    int wrong = 0;
    for (std::size_t i = 0; i < s.map.size() && i < f.mvKeysUn.size(); ++i) {
      auto& p = *s.map[i];
      Eigen::Vector3f const Pc = truth.rotationMatrix() * p.GetWorldPos() + truth.translation();
      auto const pixel = plain_search::project(s.settings.left, Pc);
      bool const is_wrong = i % 9 == 0;
      for (auto* keys : {&f.mvKeysUn, &f.mvKeys}) {
        (*keys)[i].pt.x = pixel.x() + (is_wrong ? 60.0f : 0.0f);
        (*keys)[i].pt.y = pixel.y();
        (*keys)[i].octave = 0;
      }
      if (s.settings.bf > 0) {
        f.mvuRight[i] = i % 2 == 0 ? -1.0f : f.mvKeysUn[i].pt.x - s.settings.bf / Pc.z();
      }
      f.mvpMapPoints[i] = &p;
      f.mvbOutlier[i] = true;  // forgotten by the call
      ++held;
      wrong += static_cast<int>(is_wrong);
    }
    f.SetPose({Eigen::Quaternionf(Eigen::AngleAxisf(0.01f, Eigen::Vector3f::UnitY())) *
                   Eigen::Quaternionf(truth.rotationMatrix()),
               truth.translation() + Eigen::Vector3f(0.03f, 0.01f, -0.02f)});
    auto const start = f.GetPose();
    EXPECT_EQ(gpu.pose_optimization(f, stage::pose_local_map), held - wrong);
    for (int i = 0; i < held; ++i) {
      ASSERT_EQ(f.mvbOutlier[static_cast<std::size_t>(i)], i % 9 == 0) << i;
    }
    EXPECT_LT((f.GetPose().translation() - truth.translation()).norm(), 2e-4f);
    EXPECT_LT((f.GetPose().rotationMatrix() - truth.rotationMatrix()).norm(), 2e-4f);

    ft::orbslam3::options bypass;
    bypass[stage::pose_local_map] = stage_mode::bypass;
    accelerator other(make(s.settings), s.settings, bypass);
    f.SetPose(start);
    EXPECT_EQ(other.pose_optimization(f, stage::pose_local_map), held);
    EXPECT_EQ(f.GetPose().translation(), start.translation());
    EXPECT_EQ(other.pose_optimization(f, stage::pose_last_frame), held - wrong);
  }
}

TEST_P(shim_pose, is_left_alone_with_fewer_than_three_points) {
  scene s(sensor::stereo, 6);
  s.settings = roomy(s.settings);
  accelerator gpu(make(s.settings), s.settings);
  s.current.mvpMapPoints[3] = s.map[1].get();
  s.current.mvpMapPoints[4] = s.map[2].get();
  s.current.mvbOutlier[3] = true;
  auto const before = s.current.GetPose();
  EXPECT_EQ(gpu.pose_optimization(s.current, stage::pose_last_frame), 0);
  EXPECT_FALSE(s.current.mvbOutlier[3]);
  EXPECT_EQ(s.current.GetPose().translation(), before.translation());
}

INSTANTIATE_TEST_SUITE_P(executors, shim_searches, ::testing::ValuesIn(executors()), executor_name);
INSTANTIATE_TEST_SUITE_P(executors, shim_pose, ::testing::ValuesIn(executors()), executor_name);

}  // namespace orbslam3_test
