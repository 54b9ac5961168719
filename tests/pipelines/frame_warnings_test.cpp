// SPDX-License-Identifier: Apache-2.0
// What is told of frames that are tracked though their pose may be wrong, and what is left out of
// it: things that are fixed to the camera.
#include "ft/pipelines/tracking_warnings.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/kernels/odometry/frame_facts.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace frame_warnings_test {

using test::at;
using test::room::height;
using test::room::image;
using test::room::stereo_frame;
using test::room::width;
using warning = ft::tracking_warning;
constexpr std::int64_t period = 50'000'000;

std::vector<stereo_frame> const& walk(unsigned seed) {
  static std::vector<stereo_frame> const walks[] = {
      test::room::make_walk(test::room::rig(), 4, 24),
      test::room::make_walk(test::room::rig(), 17, 24)};
  return walks[seed];
}

/// A bonnet: the same pixels in every frame on the lower share of the images, 0.9 m away.
void cover(stereo_frame& f, double share, unsigned noise_seed) {
  static image const paint = test::random_image(width + 200, height, 501);
  constexpr int disparity = 83;
  test::generator noise(noise_seed);
  for (int y = static_cast<int>(height * (1 - share)); y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      auto const grey = [&](int column) {
        int const v = paint[at(y) * at(width + 200) + at(column)] + noise.below(5) - 2;
        return static_cast<std::uint8_t>(std::clamp(v, 0, 255));
      };
      f.left[at(y) * at(width) + at(x)] = grey(x);
      f.right[at(y) * at(width) + at(x)] = grey(x + disparity);
    }
  }
}

struct run {
  std::vector<ft::tracking> all;
  double path = 0;
  double ate = 0;  ///< metres
  int with(warning w) const {
    return static_cast<int>(std::count_if(
        all.begin(), all.end(), [&](ft::tracking const& t) { return t.warnings.has(w); }));
  }
  int warned() const {
    return static_cast<int>(std::count_if(
        all.begin(), all.end(), [](ft::tracking const& t) { return !t.warnings.empty(); }));
  }
};

template <typename Exec>
run track(Exec const& exec, std::vector<stereo_frame> const& frames) {
  ft::odometry<Exec> odo(exec, test::room::rig(), test::room::odometry_params(8192));
  run r;
  std::int64_t time = 0;
  for (stereo_frame const& f : frames) {
    r.all.push_back(
        odo.track({test::room::view(f.left), test::room::view(f.right)}, time += period));
  }
  double squares = 0;
  ft::vec3<float> last{};
  for (std::size_t i = 0; i < frames.size(); ++i) {
    ft::vec3<float> const p = frames[0].T_cw * frames[i].T_cw.inverse().t;
    ft::vec3<float> const step = p - last;
    r.path += static_cast<double>(std::sqrt(ft::dot(step, step)));
    last = p;
    ft::vec3<double> const off = r.all[i].T_world_camera.t - ft::vec3<double>{p.x, p.y, p.z};
    squares += ft::dot(off, off);
  }
  r.ate = std::sqrt(squares / static_cast<double>(frames.size()));
  return r;
}

template <typename Backend>
class FrameWarnings : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(FrameWarnings, test::backends);

TYPED_TEST(FrameWarnings, ACleanWalkHasNone) {
  TypeParam backend;
  for (unsigned seed : {0U, 1U}) {
    run const r = track(backend.exec, walk(seed));
    EXPECT_EQ(r.warned(), 0);
    EXPECT_LT(r.ate, 0.02 * r.path);
    EXPECT_EQ(r.all.back().map_id, 1);
  }
}

TYPED_TEST(FrameWarnings, WhatIsFixedToTheCameraLeavesThePose) {
  TypeParam backend;
  for (double const share : {0.25, 0.4}) {
    SCOPED_TRACE(share);
    for (unsigned seed : {0U, 1U}) {
      auto frames = walk(seed);
      for (std::size_t i = 0; i < frames.size(); ++i) {
        cover(frames[i], share, static_cast<unsigned>(i));
      }
      run const r = track(backend.exec, frames);
      EXPECT_GT(r.with(warning::two_motions), 12);
      EXPECT_LT(r.ate, (share < 0.3 ? 0.02 : 0.05) * r.path);
    }
  }
}

TYPED_TEST(FrameWarnings, ImagesThatRepeatWhileTheCameraMoves) {
  TypeParam backend;
  auto frames = walk(0);
  for (std::size_t i = 12; i < 15; ++i) {
    frames[i].left = frames[11].left;
    frames[i].right = frames[11].right;
  }
  run const both = track(backend.exec, frames);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(both.all[i].warnings.has(warning::images_repeat), i >= 12) << i;
  }
  frames = walk(0);
  for (std::size_t i = 12; i < 15; ++i) { frames[i].left = frames[11].left; }
  run const one = track(backend.exec, frames);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(one.all[i].warnings.has(warning::images_repeat), i >= 12) << i;
  }
}

// The images of a new map repeat before any motion is known: the next ones tell.
TYPED_TEST(FrameWarnings, ImagesThatRepeatAtTheStart) {
  TypeParam backend;
  auto frames = walk(0);
  frames.resize(6);
  frames[1].left = frames[0].left;
  frames[1].right = frames[0].right;
  run const r = track(backend.exec, frames);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(r.all[i].warnings.has(warning::images_repeat), i >= 2) << i;
  }
}

TYPED_TEST(FrameWarnings, ACameraAtRestRepeatsItsImages) {
  TypeParam backend;
  std::vector<stereo_frame> const frames(6, walk(0)[0]);
  EXPECT_EQ(track(backend.exec, frames).warned(), 0);
}

// ---- what they are decided by

TEST(ChanceCounts, AskForMoreOfManyPoints) {
  auto const bits = [](int inliers, int points, double chance) {
    ft::detail::chance_counts n;
    n.points = points;
    n.sampled = 100;
    n.by_chance = static_cast<std::int64_t>(100 * 65536 * chance);
    return n.bits(inliers) / ft::detail::evidence_one;
  };
  EXPECT_GE(bits(20, 25, 0.03), 64);
  EXPECT_LT(bits(20, 900, 0.03), 1) << "27 are matched by chance";
  EXPECT_GE(bits(90, 900, 0.03), 64);
  EXPECT_LT(bits(90, 900, 0.08), 32);
  EXPECT_EQ(bits(0, 900, 0.03), 0);
  EXPECT_EQ(bits(5, 0, 0.03), 0);
  EXPECT_GT(bits(1 << 20, 1 << 20, 0.5), -1) << "no overflow";
  ft::detail::chance_counts none;
  none.points = 600;
  EXPECT_GE(none.bits(500) / ft::detail::evidence_one, 64) << "all were matched before";
}

/// A frame with nothing to tell.
ft::tracking good() {
  ft::tracking t;
  t.state = ft::tracking_state::tracking;
  t.inliers = t.agreed = 300;
  t.keypoints = 800;
  t.stereo_points = 500;
  t.maps = t.map_id = 1;
  t.light = {0, 110, 40};
  t.evidence.facts.matches = 310;
  t.evidence.facts.flowing = 280;
  t.evidence.facts.evidence = 500;
  t.evidence.images = 2;
  t.evidence.textured = 380;
  t.evidence.moved = 350;
  return t;
}

struct judged {
  ft::detail::frame_warnings camera;
  ft::odometry_params params;
  std::int64_t time = 0;
  bool first = true;
  ft::warning_set operator()(ft::tracking t, std::int64_t after = period) {
    camera.judge(t, time += after, first, params);
    first = false;
    for (auto const& said : ft::warnings_of(t, params)) {
      EXPECT_FALSE(said.text.empty()) << ft::name_of(said.warning);
      EXPECT_NE(said.text.back(), '.');
    }
    return t.warnings;
  }
};

TEST(WarningsOfFrames, EachHasItsCause) {
  struct row {
    warning wanted;
    void (*change)(ft::tracking&);
  };
  row const rows[] = {
      {warning::new_map,
       [](ft::tracking& t) {
         t.map_begun = true;
         t.maps = t.map_id = 2;
       }},
      {warning::doubtful_pose, [](ft::tracking& t) { t.evidence.facts.evidence = 31; }},
      {warning::doubtful_pose, [](ft::tracking& t) { t.evidence.facts.common = 257; }},
      {warning::doubtful_pose,
       [](ft::tracking& t) { t.evidence.facts.shifted = t.inliers / 2 + 1; }},
      {warning::two_motions,
       [](ft::tracking& t) { t.evidence.facts.fixed = t.evidence.facts.dragged = 40; }},
      {warning::two_motions, [](ft::tracking& t) { t.evidence.facts.resting = 270; }},
      {warning::images_repeat, [](ft::tracking& t) { t.evidence.same = 1; }},
      {warning::stereo_inconsistent, [](ft::tracking& t) { t.stereo_points = 230; }},
      {warning::stereo_inconsistent,
       [](ft::tracking& t) { t.evidence.facts.common_disparity = 513; }},
      {warning::stereo_inconsistent,
       [](ft::tracking& t) {
         t.evidence.facts.with_disparity = 200;
         t.evidence.facts.off_disparity = 60;
       }},
      {warning::stereo_inconsistent, [](ft::tracking& t) { t.evidence.ambiguous = 63; }},
      {warning::stereo_inconsistent, [](ft::tracking& t) { t.evidence.rows_apart = 1.1; }},
      {warning::stereo_inconsistent, [](ft::tracking& t) { t.evidence.rows_apart = -1.1; }},
      {warning::depth_scale, [](ft::tracking& t) { t.distant_points = 300; }},
      {warning::dark, [](ft::tracking& t) { t.light.mean = 15; }},
      {warning::bright, [](ft::tracking& t) { t.light.mean = 240; }},
      {warning::low_texture, [](ft::tracking& t) { t.light.deviation = 4; }},
      {warning::blurred, [](ft::tracking& t) { t.evidence.streaked = 1; }},  // of two images
      {warning::blurred,
       [](ft::tracking& t) {
         t.keypoints = 119;
         t.stereo_points = 70;
       }},
  };
  for (row const& r : rows) {
    SCOPED_TRACE(ft::name_of(r.wanted));
    judged camera;
    EXPECT_TRUE(camera(good()).empty());
    ft::tracking t = good();
    r.change(t);
    EXPECT_EQ(camera(t).bits, 1U << static_cast<int>(r.wanted));
  }
}

TEST(WarningsOfFrames, APairThatNeverFitsIsNotCalledLate) {
  auto const said = [](double usual) {
    ft::tracking t = good();
    t.evidence.usual_stereo_share = usual;
    return ft::text_of(warning::stereo_inconsistent, t, ft::odometry_params{});
  };
  std::string const exchanged = "are left and right exchanged";
  EXPECT_NE(said(0).find(exchanged), std::string::npos);
  EXPECT_NE(said(0.29).find(exchanged), std::string::npos);
  EXPECT_EQ(said(0.6).find(exchanged), std::string::npos);
  for (double const usual : {0.0, 0.6}) {
    EXPECT_NE(said(usual).find("at the same time"), std::string::npos);
    EXPECT_NE(said(usual).find("and of their lens"), std::string::npos);
  }
}

TEST(WarningsOfFrames, WhatIsRightHasNone) {
  void (*const changes[])(ft::tracking&) = {
      // It hardly moves, and so do the images.
      [](ft::tracking& t) {
        t.evidence.facts.resting = 300;
        t.evidence.moved = 100;
      },
      // It turns about a point in view, which stays where it is.
      [](ft::tracking& t) { t.evidence.facts.fixed = 100; },
      [](ft::tracking& t) {
        t.evidence.facts.common = 256;
        t.evidence.facts.common_disparity = 512;
      },
      [](ft::tracking& t) {
        t.evidence.images = 3;
        t.evidence.streaked = 1;
      },
      [](ft::tracking& t) { t.evidence.ambiguous = 62; },  // an eighth, rounded down
      [](ft::tracking& t) { t.evidence.rows_apart = -1; },
      // Two cameras that look past each other.
      [](ft::tracking& t) {
        t.evidence.rectified = false;
        t.stereo_points = 100;
      },
      // The depths of a sensor err as they please.
      [](ft::tracking& t) {
        t.depths = ft::depth_origin::depth_image;
        t.evidence.facts.common_disparity = 1000;
      }};
  for (auto const& change : changes) {
    judged camera;
    ft::tracking t = good();
    change(t);
    for (int i = 0; i < 3; ++i) { EXPECT_TRUE(camera(t).empty()); }
  }
}

// Errors that neighbours share begin a doubt above their limit; it goes on while they come back to
// half of it, and is told for a second more. What never was above the limit is no doubt.
TEST(WarningsOfFrames, AFaultThatComesAndGoesIsToldInBetween) {
  struct row {
    warning wanted;
    int ft::frame_facts::*share;
    int limit;
  };
  for (row const& r :
       {row{warning::doubtful_pose, &ft::frame_facts::common, 256},
        row{warning::stereo_inconsistent, &ft::frame_facts::common_disparity, 512}}) {
    SCOPED_TRACE(ft::name_of(r.wanted));
    auto const with = [&](int share) {
      ft::tracking t = good();
      t.evidence.facts.*r.share = share;
      return t;
    };
    judged camera;
    for (int i = 0; i < 40; ++i) { EXPECT_TRUE(camera(with(r.limit)).empty()) << "not begun"; }
    EXPECT_TRUE(camera(with(r.limit + 1)).has(r.wanted));
    for (int i = 1; i <= 60; ++i) {  // half of the limit, and more, every 15th frame
      EXPECT_TRUE(camera(with(i % 15 == 0 ? r.limit / 2 + 1 : 0)).has(r.wanted)) << i;
    }
    for (int i = 1; i <= 20; ++i) { EXPECT_TRUE(camera(with(r.limit / 2)).has(r.wanted)) << i; }
    EXPECT_TRUE(camera(with(r.limit / 2)).empty());
    EXPECT_TRUE(camera(with(r.limit)).empty()) << "it is over";
  }
}

TEST(WarningsOfFrames, ACameraThatIsFoundAgainMayBeElsewhere) {
  judged camera;
  EXPECT_TRUE(camera(good()).empty());
  ft::tracking t = good();
  t.state = ft::tracking_state::recovering;
  t.inliers = 0;
  EXPECT_TRUE(camera(t).empty());
  EXPECT_TRUE(camera(good()).has(warning::doubtful_pose));
  EXPECT_TRUE(camera(good(), 1'000'000'000).has(warning::doubtful_pose));
  EXPECT_TRUE(camera(good(), 1).empty());
}

TEST(WarningsOfFrames, ADoubtAboutAPoseStaysForASecond) {
  judged camera;
  ft::tracking t = good();
  t.evidence.facts.evidence = 0;
  EXPECT_TRUE(camera(t).has(warning::doubtful_pose));
  EXPECT_TRUE(camera(good(), 1'000'000'000).has(warning::doubtful_pose));
  EXPECT_FALSE(camera(good(), 1).has(warning::doubtful_pose));
  // and ends with a camera that begins anew
  EXPECT_TRUE(camera(t).has(warning::doubtful_pose));
  camera.first = true;
  EXPECT_TRUE(camera(good()).empty());
}

// One camera at 1 m/s in the unit of its map, and an adjustment that moves it, in a frame of which
// less than a second is known, or more. A motion over a second may be wrong by 2 % of its path,
// three deviations, and 5 cm where the map is metric.
TEST(WarningsOfFrames, OneCameraIsDoubtedWhereAnAdjustmentMovesItFar) {
  struct row {
    float step;
    double deviation;
    bool metric, doubtful;
  };
  row const rows[] = {{0.019f, 0, false, false},      {0.021f, 0, false, true},
                      {0.021f, 0.0071, false, false}, {0.021f, 0.0069, false, true},
                      {0.049f, 0, true, false},       {0.051f, 0, true, true}};
  for (row const& r : rows) {
    for (int const frames : {4, 60}) {
      SCOPED_TRACE(r.step);
      judged camera;
      ft::tracking t = good();
      t.depths = ft::depth_origin::motion;
      t.metric = r.metric;
      for (int i : {21, 28, 35}) { t.covariance[i] = r.deviation * r.deviation / 3; }
      t.map_begun = true;
      for (int i = 0; i < frames; ++i) {
        EXPECT_TRUE(camera(t).empty());
        t.map_begun = false;
        t.T_odom_camera.t.x += 0.05;
      }
      t.evidence.facts.stepped = r.step;
      EXPECT_EQ(camera(t).has(warning::doubtful_pose), r.doubtful) << frames;
    }
  }
}

// Where nothing is known of the speed there is no doubt: of the first frame of a map, the one after
// it, one that was found again, and one whose unit became the metre.
TEST(WarningsOfFrames, OneCameraIsNotDoubtedWhereItsSpeedIsNotKnown) {
  void (*const changes[])(ft::tracking&) = {
      [](ft::tracking& t) { t.map_begun = true; },
      [](ft::tracking& t) { t.metric = true; },
  };
  for (auto const& change : changes) {
    judged camera;
    ft::tracking t = good();
    t.depths = ft::depth_origin::motion;
    t.metric = false;
    t.evidence.facts.stepped = 1;
    EXPECT_TRUE(camera(t).empty()) << "the first frame";
    EXPECT_TRUE(camera(t).empty()) << "no path before it";
    ft::tracking changed = t;
    change(changed);
    EXPECT_TRUE(camera(changed).empty());
    changed.map_begun = false;
    EXPECT_TRUE(camera(changed).empty());
    EXPECT_TRUE(camera(changed).has(warning::doubtful_pose));
  }
}

// The path is broken where a map begins: so are the motions across it.
TEST(WarningsOfFrames, ANewMapIsToldForASecond) {
  judged camera;
  ft::tracking t = good();
  t.maps = t.map_id = 2;
  t.map_begun = true;
  EXPECT_TRUE(camera(t).has(warning::new_map));
  t.map_begun = false;
  EXPECT_TRUE(camera(t, 1'000'000'000).has(warning::new_map));
  EXPECT_TRUE(camera(t, 1).empty());
}

TEST(WarningsOfFrames, ImagesRepeatedIfTheNextOnesJump) {
  ft::tracking same = good();
  same.evidence.same = same.evidence.images;
  same.evidence.facts.flowing = same.evidence.moved = 0;
  ft::tracking slow = good();
  slow.evidence.facts.flowing = slow.inliers / 2;
  for (bool const jumps : {false, true}) {
    judged camera;
    EXPECT_TRUE(camera(good()).empty());
    EXPECT_TRUE(camera(same).empty()) << "it may be at rest";
    EXPECT_EQ(camera(jumps ? good() : slow).has(warning::images_repeat), jumps);
    EXPECT_EQ(camera(good(), 1'000'000'001).has(warning::images_repeat), false);
  }
}

// ---- an IMU that is not used

/// A frame that moves, with samples, whose IMU says nothing.
ft::tracking idle() {
  ft::tracking t = good();
  t.evidence.facts.moving = 1;
  t.imu.samples = ft::integration_status::integrated;
  t.imu.rate_hz = 200;
  return t;
}
ft::tracking used() {
  ft::tracking t = idle();
  t.imu.known = t.imu.predicted = t.imu.optimized = true;
  return t;
}
judged with_imu() {
  judged camera;
  camera.params.imu.present = true;
  return camera;
}
/// Frames of one kind until the warning. @return their number, at most `most`
int until_told(judged& camera, ft::tracking const& t, int most, std::int64_t after = period) {
  for (int n = 1; n <= most; ++n) {
    if (camera(t, after).has(warning::imu_not_used)) { return n; }
  }
  return most;
}
constexpr int never = 1000;

TEST(AnImuThatIsNotUsed, IsToldAfterTwiceTheTimeOfAStart) {
  judged camera = with_imu();
  EXPECT_EQ(ft::longest_unused_s(camera.params.imu, true), 4.0);  // 8 keyframes, 0.25 s
  EXPECT_EQ(until_told(camera, idle(), never), 81);  // the first frame has no time before it
  // It falls back, and does not come back.
  for (int i = 0; i < 100; ++i) { EXPECT_TRUE(camera(used()).empty()); }
  EXPECT_EQ(until_told(camera, idle(), never), 80);
  camera.first = true;
  EXPECT_EQ(until_told(camera, idle(), never), 81);
}

TEST(AnImuThatIsNotUsed, IsNotToldOfWhatCannotBeUsed) {
  void (*const changes[])(ft::tracking&) = {
      [](ft::tracking& t) { t.imu.samples = ft::integration_status::no_samples; },
      [](ft::tracking& t) { t.imu.samples = ft::integration_status::wrong_rate; },
      [](ft::tracking& t) {
        t.state = ft::tracking_state::recovering;
        t.inliers = 0;
      },
      [](ft::tracking& t) { t.inliers = 0; }};
  for (auto const& change : changes) {
    judged camera = with_imu();
    ft::tracking t = idle();
    change(t);
    EXPECT_EQ(until_told(camera, t, never), never);
    EXPECT_EQ(until_told(camera, idle(), never), 80) << "as one that starts late";
    // Told before, it is not while it could not be used; at once when it could again.
    EXPECT_FALSE(camera(t).has(warning::imu_not_used));
    EXPECT_TRUE(camera(idle()).has(warning::imu_not_used));
  }
  judged without;
  EXPECT_EQ(until_told(without, idle(), never), never);
}

TEST(AnImuThatIsNotUsed, IsNotToldOfACameraAtRest) {
  judged camera = with_imu();
  ft::tracking t = idle();
  t.evidence.facts.moving = 0;
  EXPECT_EQ(until_told(camera, t, never), never);
  EXPECT_EQ(until_told(camera, idle(), never), 40);  // half of the time in motion
}

TEST(AnImuThatIsNotUsed, HasTheTimeThatItsKeyframesNeed) {
  judged slow = with_imu();  // two images a second: 16 keyframes
  EXPECT_EQ(until_told(slow, idle(), never, 500'000'000), 17);
  judged one_camera = with_imu();
  ft::tracking t = idle();
  t.metric = false;
  EXPECT_EQ(ft::longest_unused_s(one_camera.params.imu, false), 20.0);  // 40 keyframes
  t.depths = ft::depth_origin::motion;
  EXPECT_EQ(until_told(one_camera, t, never), 401);
  t.metric = true;  // the IMU has told it
  for (int i = 0; i < 20; ++i) { one_camera(t); }
  EXPECT_EQ(until_told(one_camera, t, never), never);
  // Corrected clocks: it begins anew.
  judged clock = with_imu();
  EXPECT_EQ(until_told(clock, idle(), 70), 70);
  t = idle();
  t.imu.time_offset_s = 0.001;
  EXPECT_EQ(until_told(clock, t, never), 80);
}

TEST(AnImuThatIsNotUsed, IsToldOfOneThatIsUsedNowAndThen) {
  judged camera = with_imu();
  int told = 0;
  for (int i = 0; i < 300; ++i) {
    told += camera(i % 4 == 0 ? used() : idle()).has(warning::imu_not_used) ? 1 : 0;
  }
  EXPECT_GT(told, 100);
  camera.first = true;
  for (int i = 0; i < 300; ++i) {
    EXPECT_FALSE(camera(i % 4 != 0 ? used() : idle()).has(warning::imu_not_used)) << i;
  }
}

TEST(AnImuThatIsNotUsed, SaysWhy) {
  struct row {
    ft::integration_status samples;
    ft::initialization_status estimate;
    char const* words;
  };
  using samples = ft::integration_status;
  using estimate = ft::initialization_status;
  row const rows[] = {
      {samples::integrated, estimate::inconsistent, "contradict the images"},
      {samples::contradicted, estimate::little_motion, "contradict the images"},
      {samples::integrated, estimate::little_motion, "the motion is too little"},
      {samples::integrated, estimate::no_integral, "8 keyframes in a row"},
  };
  for (row const& r : rows) {
    judged camera = with_imu();
    ft::tracking t = idle();
    t.imu.samples = r.samples;
    t.imu.estimate = r.estimate;
    ASSERT_LT(until_told(camera, t, never), never);
    t.imu.unused_s = 4;
    std::string const said = ft::text_of(warning::imu_not_used, t, camera.params);
    for (char const* words :
         {r.words, "4 s of tracking", "time_offset_s", "T_bc", "axes", "units"}) {
      EXPECT_NE(said.find(words), std::string::npos) << words << ": " << said;
    }
  }
}

}  // namespace frame_warnings_test
