// SPDX-License-Identifier: Apache-2.0
// The verify mode sees no difference where there is none, and each that is planted; options and
// statistics.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/verify.hpp"
#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::difference;
using ft::orbslam3::stage;
using ft::orbslam3::stage_mode;
using verifier = ft::orbslam3::verifier<stand_in::types>;

class verify_mode : public on_executor {
protected:
  /// A scene, both sides, and what was reported.
  struct bench {
    explicit bench(sensor kind, unsigned seed = 3)
        : world(kind, seed),
          settings([&] {
            world.settings.most_keypoints = 2000;
            return world.settings;
          }()),
          gpu(make(settings), settings),
          plain(settings),
          both(gpu, [this](difference const& d) { found.push_back(d); }) {}
    scene world;
    ft::orbslam3::settings settings;
    accelerator gpu;
    plain_search plain;
    std::vector<difference> found;
    verifier both;
  };
};

TEST_P(verify_mode, finds_no_difference_between_equal_searches_and_keeps_counters_right) {
  for (sensor const kind : all_sensors) {
    SCOPED_TRACE(name_of(kind));
    bench b(kind);
    auto& f = b.world.current;
    b.both.search_by_projection(f, b.world.last, 15, false,
                                [&] { return b.plain.search_last(f, b.world.last, 15, false); });
    auto const local = b.world.local_map();
    b.both.search_local_points(f, local, 2, false, 50,
                               [&] { return b.plain.search_local(f, local, 2); });
    EXPECT_EQ(b.both.differences(), 0);
    for (difference const& d : b.found) { ADD_FAILURE() << d; }
    for (auto* p : local) {
      ASSERT_EQ(p->visible(), 1 + static_cast<int>(p->mbTrackInView || p->mbTrackInViewR));
    }
  }
}

TEST_P(verify_mode, reports_a_match_that_differs_by_keypoint_and_points) {
  bench b(sensor::stereo);
  auto& f = b.world.current;
  std::size_t planted = 0;
  int const kept = b.both.search_by_projection(f, b.world.last, 15, false, [&] {
    int const n = b.plain.search_last(f, b.world.last, 15, false);
    while (f.mvpMapPoints[planted] == nullptr) { ++planted; }
    f.mvpMapPoints[planted] = nullptr;
    return n;
  });
  ASSERT_EQ(b.found.size(), 1u);
  EXPECT_EQ(b.found[0].index, static_cast<long>(planted));
  EXPECT_EQ(b.found[0].where, stage::search_last_frame);
  EXPECT_EQ(b.found[0].frame, f.mnId);
  EXPECT_EQ(b.found[0].cpu, -1);
  EXPECT_EQ(b.found[0].gpu, static_cast<double>(f.mvpMapPoints[planted]->mnId));
  EXPECT_GT(kept, 0);
  std::ostringstream text;
  text << b.found[0];
  EXPECT_NE(text.str().find("frame 11, search_last_frame: map point of keypoint " +
                            std::to_string(planted) + ": CPU -1"),
            std::string::npos)
      << text.str();
}

/// Mapping takes a point away between the calls: the CPU's two answers differ, and the accelerator
/// has one of them.
TEST_P(verify_mode, counts_nothing_that_one_of_the_cpus_two_answers_has) {
  for (bool const first : {true, false}) {
    bench b(sensor::stereo);
    auto& f = b.world.current;
    int calls = 0;
    auto const cpu = [&] {
      int n = b.plain.search_last(f, b.world.last, 15, false);
      if ((++calls == 1) == first) {
        for (auto*& p : f.mvpMapPoints) {
          if (p == nullptr) { continue; }
          p = nullptr;
          --n;
          break;
        }
      }
      return n;
    };
    int const n = b.both.search_by_projection(f, b.world.last, 15, false, cpu);
    EXPECT_EQ(calls, 2);
    EXPECT_EQ(b.both.differences(), 0);
    stand_in::frame again = b.world.current;
    again.mvpMapPoints.assign(again.mvpMapPoints.size(), nullptr);
    EXPECT_EQ(b.plain.search_last(again, b.world.last, 15, false), n);
    EXPECT_EQ(f.mvpMapPoints, again.mvpMapPoints);  // the accelerator's answer stays
  }
}

/// Mapping changes the map before and after the accelerator's call, so that its answer is neither
/// of the CPU's; then it rests.
TEST_P(verify_mode, counts_nothing_that_changes_of_the_map_explain) {
  bench b(sensor::stereo);
  auto& f = b.world.current;
  int calls = 0;
  int const n = b.both.search_by_projection(f, b.world.last, 15, false, [&] {
    int const found = b.plain.search_last(f, b.world.last, 15, false);
    ++calls;
    return calls <= 6 ? found + calls : found;
  });
  EXPECT_EQ(calls, 8);
  EXPECT_EQ(b.both.differences(), 0);
  EXPECT_GT(n, 0);
  // It never rests: no difference is shown.
  f.mvpMapPoints.assign(f.mvpMapPoints.size(), nullptr);
  b.both.search_by_projection(f, b.world.last, 15, false, [&] {
    return b.plain.search_last(f, b.world.last, 15, false) + ++calls;
  });
  EXPECT_EQ(b.both.differences(), 0);
  // One that is gone when the call is made again: no difference, and not hidden.
  f.mvpMapPoints.assign(f.mvpMapPoints.size(), nullptr);
  calls = 0;
  b.both.search_by_projection(f, b.world.last, 15, false, [&] {
    return b.plain.search_last(f, b.world.last, 15, false) + (++calls <= 2 ? 1 : 0);
  });
  EXPECT_EQ(calls, 4);
  EXPECT_EQ(b.both.differences(), 0);
  std::ostringstream summary;
  b.both.summary(summary);
  EXPECT_NE(summary.str().find("search_last_frame: 3 calls, 0 with differences, 0 in all, "
                               "2 unconfirmed\n"),
            std::string::npos)
      << summary.str();
}

/// Pushes changes, but not of those points that are left out.
struct some_hooks final : stand_in::hooks {
  explicit some_hooks(accelerator& to) : gpu(&to) {}
  void changed(stand_in::map_point* p) override {
    if (on) { gpu->changes().push(p); }
  }
  accelerator* gpu;
  bool on = true;
};

TEST_P(verify_mode, finds_a_forgotten_hook_also_where_answers_are_the_same) {
  scene s(sensor::stereo, 3);
  s.settings.most_keypoints = 2000;
  ft::orbslam3::options o;
  o.detection = ft::orbslam3::change_detection::hooks;
  accelerator gpu(make(s.settings), s.settings, o);
  plain_search const plain(s.settings);
  std::vector<std::string> told;
  verifier both(gpu, [&](difference const& d) {
    std::ostringstream text;
    text << d;
    told.push_back(text.str());
  });
  some_hooks hooks(gpu);
  for (auto& p : s.map) { p->observer = &hooks; }
  auto const local = s.local_map();
  auto const track = [&] {
    told.clear();
    ++s.current.mnId;
    s.current.mvpMapPoints.assign(s.current.mvpMapPoints.size(), nullptr);
    for (auto& p : s.map) { p->mnLastFrameSeen = 0; }
    both.search_local_points(s.current, local, 1, false, 50,
                             [&] { return plain.search_local(s.current, local, 1); });
  };
  using list = std::vector<std::string>;
  track();
  track();
  EXPECT_EQ(told, list{});
  // The smallest change there is.
  stand_in::map_point& p = *local[7];
  Eigen::Vector3f const old = p.GetWorldPos();
  auto const moved = [&](bool pushed) {
    hooks.on = pushed;
    Eigen::Vector3f at = p.GetWorldPos();
    at.x() = std::nextafter(at.x(), 1e30f);
    p.SetWorldPos(at);
    hooks.on = true;
  };
  moved(true);
  track();
  track();
  EXPECT_EQ(told, list{}) << "a change that was pushed";
  moved(false);
  track();
  EXPECT_EQ(told, list{}) << "it may be pushed soon";
  track();
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0], "frame " + std::to_string(s.current.mnId) +
                         ", search_local_map: position of map point " + std::to_string(p.mnId) +
                         " changed without a hook");
  track();
  EXPECT_EQ(told, list{}) << "once is enough";
  moved(true);
  moved(false);
  track();
  p.SetWorldPos(old);
  track();
  EXPECT_EQ(told, list{}) << "pushed late";
}

TEST_P(verify_mode, has_a_line_for_each_frame_and_a_summary) {
  bench b(sensor::stereo);
  std::ostringstream lines;
  b.both.print_frames(lines);
  auto& f = b.world.current;
  for (int k = 0; k < 3; ++k) {
    f.mnId = static_cast<unsigned long>(20 + k);
    f.mvpMapPoints.assign(f.mvpMapPoints.size(), nullptr);
    b.both.search_by_projection(f, b.world.last, 15, false, [&] {
      return b.plain.search_last(f, b.world.last, 15, false) + (k == 1 ? 2 : 0);
    });
  }
  std::ostringstream summary;
  b.both.summary(summary);
  EXPECT_EQ(lines.str().find("verify: frame 20: 0 differences\nverify: frame 21: 1 differences; "
                             "frame 21, search_last_frame: matches: CPU "),
            0u)
      << lines.str();
  EXPECT_NE(lines.str().find("verify: frame 22: 0 differences\n"), std::string::npos);
  EXPECT_EQ(summary.str(),
            "verify: 3 frames, 1 with differences\n"
            "verify: search_last_frame: 3 calls, 1 with differences, 1 in all\n");
}

TEST_P(verify_mode, reports_tracked_values_and_counts_that_differ) {
  bench b(sensor::fisheye_stereo);
  auto& f = b.world.current;
  auto const local = b.world.local_map();
  b.both.search_local_points(f, local, 2, false, 50, [&] {
    int const n = b.plain.search_local(f, local, 2);
    int changed = 0;
    for (auto* p : local) {
      if (!p->mbTrackInView || !p->mbTrackInViewR) { continue; }
      ++changed;
      if (changed == 1) { p->mnTrackScaleLevel += 1; }
      if (changed == 2) { p->mTrackProjX += 0.01f; }
      if (changed == 3) { p->mTrackProjXR += 0.01f; }
    }
    return n + 1;
  });
  std::vector<std::string> what;
  for (difference const& d : b.found) { what.emplace_back(d.what); }
  std::sort(what.begin(), what.end());
  EXPECT_EQ(what, (std::vector<std::string>{"matches", "octave of point", "right x of point",
                                            "x of point"}));
}

TEST_P(verify_mode, reports_poses_inliers_and_outliers_that_differ) {
  bench b(sensor::stereo);
  auto& f = b.world.current;
  b.plain.search_last(f, b.world.last, 15, false);
  auto other = f;
  accelerator reference(make(b.settings), b.settings);
  int const inliers = reference.pose_optimization(other, stage::pose_last_frame);
  auto const cpu = [&](float shift, int more, bool flip) {
    return [&, shift, more, flip] {
      f.mvbOutlier = other.mvbOutlier;
      for (std::size_t i = 0; flip && i < f.mvbOutlier.size(); ++i) {
        if (f.mvpMapPoints[i] == nullptr) { continue; }
        f.mvbOutlier[i] = !f.mvbOutlier[i];
        break;
      }
      f.SetPose({other.GetPose().rotationMatrix(),
                 other.GetPose().translation() + Eigen::Vector3f(0, shift, 0)});
      return inliers + more;
    };
  };
  auto const start = f.GetPose();
  b.both.pose_optimization(f, stage::pose_last_frame, cpu(0, 0, false));
  EXPECT_EQ(b.both.differences(), 0);
  f.SetPose(start);
  b.both.pose_optimization(f, stage::pose_last_frame, cpu(0.001f, 1, true));
  EXPECT_EQ(b.both.differences(), 3);
}

TEST_P(verify_mode, reports_features_and_stereo_that_differ) {
  auto const s = settings_for(sensor::stereo);
  accelerator gpu(make(s), s);
  std::vector<difference> found;
  verifier both(gpu, [&](difference const& d) { found.push_back(d); });
  stand_in::matrix image;
  image.create(480, 640, 0);
  for (int i = 0; i < 640 * 480; ++i) {
    image.data[i] = static_cast<unsigned char>((i % 640 / 11 * 7919 ^ i / 640 / 9 * 104729) % 251);
  }
  stand_in::frame want;
  gpu.extract(image, image, want);
  gpu.compute_stereo(want);
  ASSERT_GT(want.N, 100);
  stand_in::frame f;
  both.extract(
      f,
      [&] {
        f = want;
        f.mDescriptors = want.mDescriptors.clone();
      },
      image, image);
  EXPECT_EQ(both.differences(), 0);
  both.extract(
      f,
      [&] {
        f = want;
        f.mvKeys[4].angle += 1;
        f.mDescriptorsRight = want.mDescriptorsRight.clone();
        f.mDescriptorsRight.data[32 * 9 + 5] ^= 1;
      },
      image, image);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].index, 4);
  EXPECT_EQ(found[1].index, 9);
  // Two keypoints change places; one is elsewhere.
  found.clear();
  auto const exchange_rows = [](stand_in::matrix& m, int i, int j) {
    std::swap_ranges(m.data + 32 * i, m.data + 32 * (i + 1), m.data + 32 * j);
  };
  both.extract(
      f,
      [&] {
        f = want;
        std::swap(f.mvKeys[3], f.mvKeys[30]);
        f.mDescriptors = want.mDescriptors.clone();
        exchange_rows(f.mDescriptors, 3, 30);
      },
      image, image);
  ASSERT_EQ(found.size(), 1u);
  std::ostringstream order;
  order << found[0];
  EXPECT_EQ(order.str(), "frame 0, extract: left keypoints: same set, other order: 2");
  found.clear();
  both.extract(
      f,
      [&] {
        f = want;
        f.mvKeysRight[8].pt.x += 1.5f;
      },
      image, image);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].what, std::string("keypoint of the CPU alone"));
  EXPECT_EQ(found[0].index, 8);
  EXPECT_EQ(found[1].what, std::string("keypoint of the GPU alone"));
  EXPECT_EQ(found[1].index, 8);
  auto const before = both.differences();
  both.stereo(f, [&] {
    f.mvuRight = want.mvuRight;
    f.mvDepth = want.mvDepth;
  });
  EXPECT_EQ(both.differences(), before);
  both.stereo(f, [&] {
    f.mvuRight = want.mvuRight;
    f.mvDepth = want.mvDepth;
    f.mvuRight[7] += 0.1f;
  });
  EXPECT_EQ(both.differences(), before + 1);
}

INSTANTIATE_TEST_SUITE_P(executors, verify_mode, ::testing::ValuesIn(executors()), executor_name);

TEST(shim_options, come_from_the_environment) {
  setenv("FT_ORBSLAM3_HOST", "extract,stereo", 1);
  setenv("FT_ORBSLAM3_BYPASS", "pose_local_map", 1);
  setenv("FT_ORBSLAM3_VERIFY", "0", 1);
  setenv("FT_ORBSLAM3_PROJECTED_POINTS", "0", 1);
  auto const o = ft::orbslam3::from_environment();
  for (char const* name : {"HOST", "BYPASS", "VERIFY", "PROJECTED_POINTS"}) {
    unsetenv((std::string("FT_ORBSLAM3_") + name).c_str());
  }
  EXPECT_EQ(o[stage::extract], stage_mode::host);
  EXPECT_EQ(o[stage::stereo], stage_mode::host);
  EXPECT_EQ(o[stage::search_last_frame], stage_mode::device);
  EXPECT_EQ(o[stage::pose_local_map], stage_mode::bypass);
  EXPECT_FALSE(o.verify);
  EXPECT_FALSE(o.fills_projected_points);
}

TEST(shim_options, take_all_stages_at_once_and_refuse_unknown_ones) {
  ft::orbslam3::options o;
  ft::orbslam3::set_modes(o, "all", stage_mode::host);
  for (auto const mode : o.modes) { EXPECT_EQ(mode, stage_mode::host); }
  ft::orbslam3::set_modes(o, "", stage_mode::device);
  EXPECT_EQ(o[stage::extract], stage_mode::host);
  EXPECT_THROW(ft::orbslam3::set_modes(o, "extract,steero", stage_mode::host), ft::bad_argument);
  EXPECT_THROW(ft::orbslam3::set_modes(o, "extract", stage_mode::bypass), ft::bad_argument);
  EXPECT_THROW(ft::orbslam3::set_modes(o, "pose_keyframe", stage_mode::bypass), ft::bad_argument);
  ft::orbslam3::set_modes(o, "pose_keyframe", stage_mode::device);
  EXPECT_EQ(o[stage::pose_keyframe], stage_mode::device);
  EXPECT_EQ(o[stage::pose_local_map], stage_mode::host);
  ft::orbslam3::set_modes(o, "all,none", stage_mode::bypass);
  EXPECT_EQ(o[stage::pose_keyframe], stage_mode::device);
  EXPECT_EQ(o[stage::extract], stage_mode::host);
  EXPECT_EQ(o[stage::pose_last_frame], stage_mode::bypass);
}

}  // namespace orbslam3_test
