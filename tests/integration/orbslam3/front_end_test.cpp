// SPDX-License-Identifier: Apache-2.0
// The calls that ORB-SLAM3's files make: by the accelerator, by the CPU's own code, by either after
// a failure; settings from what Tracking has; the tracker that there is.
#include "integration/orbslam3/front_end.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "tests/integration/orbslam3/backends.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/heard.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/scene.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"
#include "tests/integration/orbslam3/watched_device.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

/// As a user's header has it.
struct stand_in::gpu : ft::orbslam3::front_end<stand_in::types> {
  using ft::orbslam3::front_end<stand_in::types>::front_end;
};

namespace orbslam3_test {

using shim = stand_in::gpu;
using ft::orbslam3::stage;
using ft::orbslam3::stage_mode;

stand_in::matrix shifted_image(int shift) {
  auto const pixels = test::random_image(640, 480, 5);
  stand_in::matrix m;
  m.create(480, 640, 0);
  for (int i = 0; i < 640 * 480; ++i) {
    m.data[i] = pixels[static_cast<std::size_t>(i / 640 * 640 + (i + shift) % 640)];
  }
  return m;
}

ft::orbslam3::settings roomy_settings(sensor kind) {
  auto s = settings_for(kind);
  s.most_keypoints = 2000;
  return s;
}

class front_ends : public on_executor {
protected:
  /// A frame of the shim in a constructor whose CPU is another accelerator. @param by_cpu counts
  /// the stages that the CPU's code did
  static stand_in::frame construct_with(shim* gpu, sensor kind, int& by_cpu) {
    auto const s = settings_for(kind);
    ft::orbslam3::accelerator<stand_in::types> cpu(make(s), s);
    stand_in::matrix const left = shifted_image(0);
    stand_in::matrix const right = shifted_image(9);
    stand_in::frame own;  // of the CPU
    own.mnId = 4;
    cpu.extract(left, right, own);
    cpu.compute_stereo(own);
    stand_in::steps by;
    by.features = [&](stand_in::frame& f) {
      auto const extract = [&](int camera, stand_in::matrix const& image) {
        EXPECT_EQ(image.data, camera == 0 ? left.data : right.data);
        by_cpu += static_cast<int>(camera == 0);  // two threads
        (camera == 0 ? f.mvKeys : f.mvKeysRight) = camera == 0 ? own.mvKeys : own.mvKeysRight;
        (camera == 0 ? f.mDescriptors : f.mDescriptorsRight) =
            (camera == 0 ? own.mDescriptors : own.mDescriptorsRight).clone();
        (camera == 0 ? f.monoLeft : f.monoRight) = camera == 0 ? own.monoLeft : own.monoRight;
      };
      ft::orbslam3::extract(gpu, f, extract, left, right);
    };
    by.stereo = [&](stand_in::frame& f) {
      ft::orbslam3::stereo(gpu, f, [&] {
        ++by_cpu;
        f.mvuRight = own.mvuRight;
        f.mvDepth = own.mvDepth;
        f.mvLeftToRightMatch = own.mvLeftToRightMatch;
        f.mvRightToLeftMatch = own.mvRightToLeftMatch;
        f.mvStereo3Dpoints = own.mvStereo3Dpoints;
      });
    };
    return stand_in::construct(kind, 4, by);
  }
};

TEST_P(front_ends, give_the_same_frame_in_every_mix_with_the_cpu) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    int by_cpu_alone = 0;
    stand_in::frame const alone = construct_with(nullptr, kind, by_cpu_alone);
    EXPECT_EQ(by_cpu_alone, 2);
    stand_in::frame want;
    for (int mix = 0; mix < 5; ++mix) {
      SCOPED_TRACE(std::string(name_of(kind)) + " mix " + std::to_string(mix));
      ft::orbslam3::options o;
      if ((mix & 1) != 0) { o[stage::extract] = stage_mode::host; }
      if ((mix & 2) != 0) { o[stage::stereo] = stage_mode::host; }
      o.verify = mix == 4;
      auto const s = settings_for(kind);
      heard quiet;
      shim gpu(make(s), s, o);
      int by_cpu = 0;
      stand_in::frame const got = construct_with(&gpu, kind, by_cpu);
      // Stereo of the CPU's keypoints is the CPU's, and of a rectified pair also the other way
      // round.
      int const expected[] = {0, 2, kind == sensor::stereo ? 2 : 1, 2, 2};
      EXPECT_EQ(by_cpu, expected[mix]);
      EXPECT_EQ(alone.mvDepth, got.mvDepth);
      if (mix == 0) { want = got; }
      ASSERT_GT(got.N, 500);
      EXPECT_EQ(got.N, want.N);
      EXPECT_EQ(got.mvuRight, want.mvuRight);
      EXPECT_EQ(got.mvDepth, want.mvDepth);
      EXPECT_EQ(got.mvLeftToRightMatch, want.mvLeftToRightMatch);
      if (o.verify) {
        std::ostringstream text;
        gpu.print(text);
        EXPECT_NE(text.str().find("1 frames, 0 with differences"), std::string::npos) << text.str();
        EXPECT_TRUE(quiet.has("verify: frame 4: 0 differences")) << quiet.text();
      }
    }
  }
}

TEST_P(front_ends, go_on_with_the_cpu_where_a_call_fails_and_say_so_once) {
  scene s(sensor::stereo, 4);
  s.settings.most_keypoints = 2000;
  plain_search const plain(s.settings);
  for (bool const verify : {false, true}) {
    heard said;
    ft::orbslam3::options o;
    o.detection = ft::orbslam3::change_detection::hooks;
    o.verify = verify;
    auto device = std::make_unique<watched_device>(make(s.settings));
    device->on_call = [](std::string const& call) {
      if (call == "search_last_frame") { throw ft::cuda_error("ft: the device is lost"); }
    };
    shim gpu(std::move(device), s.settings, o);
    ASSERT_TRUE(gpu.uses(stage::search_last_frame));
    stand_in::frame want = s.current;
    int const n = plain.search_last(want, s.last, 15, false);
    for (int round = 0; round < 3; ++round) {
      stand_in::frame got = s.current;
      got.mnId += static_cast<unsigned long>(round);
      EXPECT_EQ(gpu.search_by_projection(got, s.last, 15, false,
                                         [&] {
                                           got.mvpMapPoints = s.current.mvpMapPoints;
                                           return plain.search_last(got, s.last, 15, false);
                                         }),
                n);
      EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
      EXPECT_EQ(gpu.pose_optimization(got, stage::pose_last_frame, [] { return 77; }), 77);
      EXPECT_FALSE(gpu.uses(stage::extract));
    }
    EXPECT_TRUE(said.has("the device is lost"));
    EXPECT_EQ(said.lines(), 1) << said.text();
    EXPECT_EQ(gpu.changes(), nullptr);
    gpu.forget(nullptr);
    gpu.reset();
  }
}

TEST_P(front_ends, that_lose_the_device_between_features_and_stereo_have_a_frame_without_stereo) {
  auto const s = settings_for(sensor::stereo);
  heard said;
  auto device = std::make_unique<watched_device>(make(s));
  device->on_call = [](std::string const& call) {
    if (call == "settle") { throw ft::cuda_error("ft: the device is lost"); }
  };
  shim gpu(std::move(device), s, {});
  int by_cpu = 0;
  stand_in::frame const got = construct_with(&gpu, sensor::stereo, by_cpu);
  EXPECT_EQ(by_cpu, 0);
  EXPECT_EQ(got.mvDepth, std::vector<float>(got.mvKeys.size(), -1.0f));
  stand_in::frame const next = construct_with(&gpu, sensor::stereo, by_cpu);
  EXPECT_EQ(by_cpu, 2);
  EXPECT_NE(next.mvDepth, got.mvDepth);
}

stand_in::matrix grey(int rows, int cols, int type = 0) {
  stand_in::matrix m;
  m.create(rows, cols, type);
  std::memset(m.data, 7, static_cast<std::size_t>(rows) * static_cast<std::size_t>(m.step));
  return m;
}

TEST_P(front_ends, leave_no_descriptors_of_images_without_keypoints) {
  auto const s = settings_for(sensor::stereo);
  shim gpu(make(s), s, {});
  int by_cpu = 0;
  EXPECT_GT(construct_with(&gpu, sensor::stereo, by_cpu).mDescriptors.rows, 500);
  stand_in::frame f;
  gpu.extract(
      f, [&] { ++by_cpu; }, grey(480, 640), grey(480, 640));
  EXPECT_EQ(by_cpu, 0);
  EXPECT_TRUE(f.mvKeys.empty() && f.mvKeysRight.empty());
  for (auto const* m : {&f.mDescriptors, &f.mDescriptorsRight}) {  // as the original's: no columns
    EXPECT_EQ(m->rows, 0);
    EXPECT_EQ(m->cols, 0);
  }
}

TEST_P(front_ends, leave_images_that_do_not_fit_to_the_cpu_and_take_the_next_ones) {
  auto const s = settings_for(sensor::stereo);
  int by_cpu = 0;
  shim fresh(make(s), s, {});
  stand_in::frame const want = construct_with(&fresh, sensor::stereo, by_cpu);
  for (bool const verify : test::both(false)) {
    heard said;
    ft::orbslam3::options o;
    o.verify = verify;
    shim gpu(make(s), s, o);
    std::vector<stand_in::matrix> const images[] = {
        {grey(472, 624), grey(472, 624)},
        {grey(960, 1280), grey(960, 1280)},
        {grey(480, 640), grey(480, 639)},
        {grey(480, 640, 5), grey(480, 640, 5)},
        {grey(480, 640), {}},
    };
    for (int round = 0; round < 2; ++round) {
      for (auto const& pair : images) {
        stand_in::frame f;
        int calls = 0;
        gpu.extract(
            f, [&] { calls = 1; }, pair[0], pair[1]);
        EXPECT_EQ(calls, 1);
        gpu.stereo(f, [&] { calls = 2; });
        EXPECT_EQ(calls, 2);
        int by_cpu_next = 0;
        stand_in::frame const next = construct_with(&gpu, sensor::stereo, by_cpu_next);
        EXPECT_EQ(by_cpu_next, verify ? 2 : 0);
        EXPECT_EQ(next.N, want.N);
        EXPECT_EQ(next.mvuRight, want.mvuRight);
      }
    }
    EXPECT_TRUE(
        said.has("the image is 624x472, the settings say 640x480; ORB-SLAM3's own code "
                 "takes this frame"))
        << said.text();
    EXPECT_TRUE(said.has("the image is 0x0")) << said.text();
    EXPECT_TRUE(said.has("type is 5")) << said.text();
    if (!verify) { EXPECT_EQ(said.lines(), 5) << said.text(); }
    EXPECT_TRUE(gpu.uses(stage::extract));
  }
}

TEST_P(front_ends, leave_a_frame_with_too_many_keypoints_to_the_cpu_and_take_the_next_one) {
  scene s(sensor::stereo, 4);
  s.settings.most_keypoints = 2000;
  plain_search const plain(s.settings);
  heard said;
  shim gpu(make(s.settings), s.settings, {});
  stand_in::frame want = s.current;
  int const n = plain.search_last(want, s.last, 15, false);
  stand_in::frame many = s.current;
  many.mnId += 1;
  for (auto* const keys : {&many.mvKeys, &many.mvKeysUn}) { keys->resize(5000); }
  many.mDescriptors.resize(5000);
  many.mvuRight.resize(5000, -1);
  many.mvpMapPoints.resize(5000);
  many.mvbOutlier.resize(5000);
  for (int round = 0; round < 2; ++round) {
    std::fill(many.mvpMapPoints.begin(), many.mvpMapPoints.end(), nullptr);
    EXPECT_EQ(gpu.search_by_projection(many, s.last, 15, false, [] { return 77; }), 77);
    std::fill_n(many.mvpMapPoints.begin(), 20, s.map.front().get());
    EXPECT_EQ(gpu.pose_optimization(many, stage::pose_last_frame, [] { return 78; }), 78);
    stand_in::frame got = s.current;
    got.mnId += 2 + static_cast<unsigned long>(round);
    EXPECT_EQ(gpu.search_by_projection(got, s.last, 15, false, [] { return -1; }), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
  }
  EXPECT_TRUE(said.has("5000 keypoints in an image, there is room for ")) << said.text();
  EXPECT_EQ(said.lines(), 1) << said.text();
}

TEST_P(front_ends, verify_searches_and_poses_and_keep_the_accelerators_answers) {
  for (sensor const kind : {sensor::stereo, sensor::fisheye_stereo}) {
    std::vector<unsigned long> answers[2];
    for (bool const verify : {false, true}) {
      scene s(kind, 3);
      s.settings.most_keypoints = 2000;
      plain_search const plain(s.settings);
      ft::orbslam3::options o;
      o.verify = verify;
      heard said;
      shim gpu(make(s.settings), s.settings, o);
      auto& f = s.current;
      gpu.search_by_projection(f, s.last, 15, false,
                               [&] { return plain.search_last(f, s.last, 15, false); });
      auto const local = s.local_map();
      gpu.search_local_points(f, local, 2, false, 50,
                              [&] { return plain.search_local(f, local, 2); });
      for (auto const* p : f.mvpMapPoints) {
        answers[verify ? 1 : 0].push_back(p == nullptr ? 0 : p->mnId);
      }
      for (auto* p : local) {
        ASSERT_EQ(p->visible(), 1 + static_cast<int>(p->mbTrackInView || p->mbTrackInViewR));
      }
      std::ostringstream text;
      gpu.print(text);
      EXPECT_EQ(verify, text.str().find("search_local_map: 1 calls, 0 with") != std::string::npos)
          << text.str();
    }
    EXPECT_EQ(answers[0], answers[1]);
  }
}

/// ORBmatcher and Optimizer with a hook at the beginning of each function.
struct hooked_system {
  plain_search plain;
  stand_in::frame const& last;
  std::vector<stand_in::map_point*> const& local;
  int own = 0;  ///< calls of their own code

  int search_last(stand_in::frame& f) {
    if (auto* gpu = ft::orbslam3::hooked(f)) {
      return gpu->search_by_projection(f, last, 15, false, [&] { return search_last(f); });
    }
    ++own;
    return plain.search_last(f, last, 15, false);
  }
  int optimize(stand_in::frame& f) {
    if (auto* gpu = ft::orbslam3::hooked(f)) {
      return gpu->pose_optimization(f, [&] { return optimize(f); });
    }
    ++own;
    return -own;
  }
};

TEST_P(front_ends, are_reached_by_hooks_which_let_the_cpus_own_code_pass) {
  scene s(sensor::stereo, 4);
  s.settings.most_keypoints = 2000;
  auto const local = s.local_map();
  stand_in::extractor extractor(1000, 1.2f, 8, 20, 7);
  s.current.mpORBextractorLeft = &extractor;
  for (bool const verify : {false, true}) {
    heard quiet;
    ft::orbslam3::options o;
    o.verify = verify;
    shim gpu(make(s.settings), s.settings, o);
    hooked_system with{plain_search(s.settings), s.last, local};
    stand_in::frame want = s.current;
    extractor.mpGpu = nullptr;
    int const n = with.search_last(want);
    EXPECT_EQ(with.own, 1);
    extractor.mpGpu = &gpu;
    stand_in::frame got = s.current;
    EXPECT_EQ(with.search_last(got), n);
    EXPECT_EQ(got.mvpMapPoints, want.mvpMapPoints);
    EXPECT_EQ(with.own, verify ? 3 : 1);  // before and after the accelerator
    EXPECT_EQ(ft::orbslam3::hooked(got), &gpu);
    EXPECT_THROW(
        gpu.search_by_bow(*std::make_unique<stand_in::key_frame>(), got,
                          *std::make_unique<std::vector<stand_in::map_point*>>(), 0.7f, true,
                          [&]() -> int {
                            EXPECT_EQ(ft::orbslam3::hooked(got), nullptr);
                            throw std::out_of_range("of the CPU's own code");
                          }),
        std::out_of_range);
    EXPECT_EQ(ft::orbslam3::hooked(got), &gpu) << "also after an exception";
  }
  stand_in::frame without_extractor;
  EXPECT_EQ(ft::orbslam3::hooked(without_extractor), nullptr);
}

/// The search before says which stage a pose is.
TEST_P(front_ends, tell_the_stage_of_a_pose_by_the_search_before) {
  scene s(sensor::stereo, 4);
  s.settings.most_keypoints = 2000;
  auto const local = s.local_map();
  for (auto const by_cpu : {stage::pose_last_frame, stage::pose_local_map, stage::pose_keyframe}) {
    ft::orbslam3::options o;
    o[by_cpu] = stage_mode::host;
    shim gpu(make(s.settings), s.settings, o);
    stand_in::frame f = s.current;
    auto const pose_is = [&](stage expected) {
      int asked = 0;
      gpu.pose_optimization(f, [&] { return ++asked; });
      EXPECT_EQ(asked == 1, expected == by_cpu) << ft::orbslam3::name_of(expected);
    };
    pose_is(stage::pose_keyframe);
    gpu.search_by_projection(f, s.last, 15, false, [] { return 0; });
    pose_is(stage::pose_last_frame);
    gpu.search_local_points(f, local, 1, false, 50, [] { return 0; });
    pose_is(stage::pose_local_map);
    pose_is(stage::pose_keyframe);
    f.mvpMapPoints = s.current.mvpMapPoints;
    gpu.search_by_projection(f, s.last, 15, false, [] { return 0; });
    stand_in::key_frame keyframe;
    std::vector<stand_in::map_point*> matches;
    gpu.search_by_bow(keyframe, f, matches, 0.7f, true, [] { return 0; });
    pose_is(stage::pose_keyframe);
  }
}

/// Of ORB_SLAM3::Map, Atlas and Tracking.
struct followed_map {
  ft::orbslam3::map_changes<stand_in::map_point> mChanges;
};
struct followed_atlas {
  followed_map map;
  std::vector<followed_map*> GetAllMaps() { return {&map}; }
};
class followed_tracking {
public:
  int mSensor = 1;
  std::unique_ptr<stand_in::gpu> mpGpu;
  std::string mGpuVocabulary;

  followed_tracking(stand_in::extractor* left, followed_atlas* atlas, stand_in::camera* camera)
      : mpORBextractorLeft(left), mpAtlas(atlas), mpCamera(camera) {}

protected:
  stand_in::extractor* mpORBextractorLeft;
  followed_atlas* mpAtlas;
  float mbf = 45.8f;
  stand_in::camera* mpCamera;
  stand_in::camera* mpCamera2 = nullptr;
  stand_in::se3 mTlr;
};

TEST(front_end_of_tracking, is_made_at_the_first_image_that_is_not_empty) {
  heard quiet;
  stand_in::extractor extractor(700, 1.2f, 8, 20, 7);
  followed_atlas atlas;
  stand_in::camera pinhole{0, {458, 457, 317, 243}};
  followed_tracking tracking(&extractor, &atlas, &pinhole);
  ft::orbslam3::follow(tracking, stand_in::matrix());
  EXPECT_EQ(extractor.mpGpu, nullptr);
  ft::orbslam3::follow(tracking, shifted_image(0));
  ASSERT_NE(tracking.mpGpu, nullptr) << quiet.text();
  EXPECT_EQ(extractor.mpGpu, tracking.mpGpu.get());
  EXPECT_TRUE(tracking.mpGpu->uses(stage::extract)) << quiet.text();
  EXPECT_FALSE(tracking.mpGpu->uses(stage::pose_local_map)) << "the default";
  stand_in::frame f;
  tracking.mpGpu->extract(
      f, [] { FAIL() << "the CPU is asked"; }, shifted_image(0), shifted_image(9));
  EXPECT_GT(f.N, 300);
  EXPECT_LT(f.N, 800);  // the extractor's 700
  auto const changes = tracking.mpGpu->changes();
  stand_in::map_point point;
  atlas.map.mChanges.push(&point);
  EXPECT_EQ(changes->size(), 1u);
  changes->forget(&point);
  ft::orbslam3::follow(tracking, stand_in::matrix());
  EXPECT_EQ(extractor.mpGpu, tracking.mpGpu.get()) << "it stays";
}

INSTANTIATE_TEST_SUITE_P(executors, front_ends, ::testing::ValuesIn(executors()), executor_name);

TEST(front_end_at_start, leaves_all_to_the_cpu_where_settings_cannot_be) {
  heard said;
  shim gpu([]() -> ft::orbslam3::settings { throw ft::bad_argument("ft: no such camera"); },
           ft::orbslam3::change_detection::hooks);
  EXPECT_TRUE(said.has("no such camera"));
  EXPECT_EQ(said.lines(), 1);
  EXPECT_EQ(gpu.changes(), nullptr);
  for (int i = 0; i < ft::orbslam3::stage_count; ++i) {
    EXPECT_FALSE(gpu.uses(static_cast<stage>(i)));
  }
  stand_in::frame f;
  int calls = 0;
  gpu.extract(
      f, [&] { ++calls; }, shifted_image(0));
  gpu.stereo(f, [&] { ++calls; });
  EXPECT_EQ(gpu.search_local_points(f, {}, 1, false, 0, [] { return 5; }), 5);
  EXPECT_EQ(calls, 2);
  std::ostringstream text;
  gpu.print(text);
  EXPECT_EQ(text.str(), "");
}

TEST(front_end_at_start, takes_hooks_unless_the_environment_compares) {
  for (bool const compare : {false, true}) {
    if (compare) { setenv("FT_ORBSLAM3_COMPARE", "1", 1); }
    ft::orbslam3::options o;
    o.detection = ft::orbslam3::change_detection::hooks;
    o = ft::orbslam3::from_environment(o);
    unsetenv("FT_ORBSLAM3_COMPARE");
    EXPECT_EQ(o.detection == ft::orbslam3::change_detection::compare, compare);
  }
}

TEST(front_end_at_start, leaves_poses_to_the_cpu_unless_the_environment_says_which_stages) {
  heard quiet;
  struct {
    char const* host;
    std::vector<stage> by_cpu;
  } const cases[] = {
      {nullptr,
       {stage::pose_last_frame, stage::pose_local_map, stage::pose_keyframe,
        stage::pose_inertial_last_frame, stage::pose_inertial_last_keyframe}},
      {"none", {}},
      {"extract,transform", {stage::extract, stage::transform}},
  };
  for (auto const& c : cases) {
    if (c.host != nullptr) { setenv("FT_ORBSLAM3_HOST", c.host, 1); }
    shim const gpu([] { return settings_for(sensor::stereo); },
                   ft::orbslam3::change_detection::hooks);
    unsetenv("FT_ORBSLAM3_HOST");
    for (int i = 0; i < ft::orbslam3::stage_count; ++i) {
      auto const s = static_cast<stage>(i);
      bool const by_cpu = std::find(c.by_cpu.begin(), c.by_cpu.end(), s) != c.by_cpu.end();
      EXPECT_EQ(gpu.uses(s), !by_cpu) << ft::orbslam3::name_of(s);
    }
  }
}

TEST(make_tracker, takes_the_host_where_it_is_told_to_and_says_so) {
  setenv("FT_ORBSLAM3_DEVICE", "host", 1);
  heard said;
  auto const tracker = ft::orbslam3::make_tracker(settings_for(sensor::stereo));
  unsetenv("FT_ORBSLAM3_DEVICE");
  EXPECT_GE(tracker->capacity(), 1000);
  EXPECT_TRUE(said.has("ft: tracking on host threads (FT_ORBSLAM3_DEVICE=host)")) << said.text();
}

TEST(make_tracker, takes_what_there_is) {
  heard said;
  auto const tracker = ft::orbslam3::make_tracker(settings_for(sensor::fisheye_stereo));
  EXPECT_EQ(tracker->cameras(), 2);
  EXPECT_TRUE(said.has("ft: tracking on ")) << said.text();
  auto wrong = settings_for(sensor::stereo);
  wrong.levels = 30;
  // A unit that nvcc compiled throws an ft::bad_argument of its own.
  EXPECT_THROW(ft::orbslam3::make_tracker(wrong), std::runtime_error);
}

class settings_of_tracking : public ::testing::Test {
protected:
  ft::orbslam3::extractor_parameters const features{1200, 1.25f, 7, 18, 6};
  stand_in::matrix image = shifted_image(0);
  stand_in::se3 T_lr{Eigen::AngleAxisf(0.1f, Eigen::Vector3f::UnitY()).toRotationMatrix(),
                     {0.1f, 0.02f, 0}};

  template <typename Camera>
  ft::orbslam3::settings of(int sensor, Camera* left, Camera* right = nullptr) {
    return ft::orbslam3::settings_of<stand_in::types>(features, sensor, image, 45.8f,
                                                      static_cast<stand_in::camera*>(left),
                                                      static_cast<stand_in::camera*>(right), T_lr);
  }
};

TEST_F(settings_of_tracking, have_the_extractor_the_image_and_one_pinhole_camera) {
  stand_in::camera pinhole{0, {458, 457, 317, 243}};
  for (int const sensor : {1, 4}) {
    auto const s = of(sensor, &pinhole);
    EXPECT_EQ(s.width, 640);
    EXPECT_EQ(s.height, 480);
    EXPECT_EQ(s.features, 1200);
    EXPECT_EQ(s.scale_factor, 1.25f);
    EXPECT_EQ(s.levels, 7);
    EXPECT_EQ(s.ini_threshold, 18);
    EXPECT_EQ(s.min_threshold, 6);
    EXPECT_EQ(s.images, 2);
    EXPECT_EQ(s.left.kind, ft::orbslam3::lens::pinhole);
    EXPECT_EQ(s.left.values[3], 243);
    EXPECT_EQ(s.bf, 45.8f);
  }
  for (int const sensor : {2, 5}) {
    auto const s = of(sensor, &pinhole);
    EXPECT_EQ(s.images, 1);
    EXPECT_EQ(s.bf, 45.8f);
    EXPECT_EQ(s.most_keypoints, 0);
  }
}

TEST_F(settings_of_tracking, of_one_camera_have_no_baseline_and_room_for_initial_frames) {
  stand_in::camera pinhole{0, {458, 457, 317, 243}};
  stand_in::camera fisheye{1, {280, 281, 322, 239, 0.003f, 0.0007f, -0.002f, 0.0002f}};
  for (auto* camera : {&pinhole, &fisheye}) {
    for (int const sensor : {0, 3}) {
      auto const s = of(sensor, camera);
      EXPECT_EQ(s.images, 1);
      EXPECT_EQ(s.bf, 0);
      EXPECT_EQ(s.most_keypoints, 7200);
    }
  }
  EXPECT_THROW(of(6, &pinhole), ft::bad_argument);
}

TEST_F(settings_of_tracking, of_a_fisheye_pair_have_its_motion_and_lapping_areas) {
  stand_in::fisheye_camera left;
  stand_in::fisheye_camera right;
  left.type = right.type = 1;
  left.parameters = {280, 281, 322, 239, 0.003f, 0.0007f, -0.002f, 0.0002f};
  right.parameters = {279, 280, 318, 241, 0.004f, 0.0006f, -0.0019f, 0.0001f};
  left.mvLappingArea = {100, 600};
  right.mvLappingArea = {10, 500};
  auto const s = of(1, &left, &right);
  EXPECT_EQ(s.images, 2);
  EXPECT_EQ(s.right.values[7], 0.0001f);
  EXPECT_EQ(s.overlap[0][0], 100);
  EXPECT_EQ(s.overlap[0][1], 600);
  EXPECT_EQ(s.overlap[1][0], 10);
  EXPECT_EQ(s.overlap[1][1], 500);
  // What the right camera has at its centre, the left one has at T_lr's translation.
  Eigen::Vector3f const t = T_lr.translation();
  for (int r = 0; r < 3; ++r) {
    float const* const R = s.T_rl.R.m + 3 * r;
    float const moved = r == 0 ? s.T_rl.t.x : r == 1 ? s.T_rl.t.y : s.T_rl.t.z;
    EXPECT_NEAR(R[0] * t.x() + R[1] * t.y() + R[2] * t.z() + moved, 0, 1e-6f);
  }
  EXPECT_THROW(of<stand_in::fisheye_camera>(1, &left), ft::bad_argument);
}

}  // namespace orbslam3_test
