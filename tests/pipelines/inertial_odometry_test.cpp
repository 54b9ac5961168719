// SPDX-License-Identifier: Apache-2.0
// An odometry with an IMU: a camera that walks through a rendered room, with samples computed from
// the walk's own formula; blindness, and what is refused.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/inertial_walk.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace inertial_odometry_test {

using namespace test::inertial_walk;

/// Tracks all frames, with 200 samples a second.
template <typename Exec>
std::vector<ft::tracking> run_frames(Exec const& exec, std::vector<stereo_frame> const& frames,
                                     int prefetch = 0) {
  auto p = params();
  p.prefetch = prefetch;
  ft::odometry<Exec> odo(exec, test::room::rig(), p, 1, ft::inertial{});
  auto const images_of = [&](int i) {
    return test::room::images_of(frames[static_cast<std::size_t>(i)]);
  };
  std::vector<ft::tracking> all;
  int samples = 0;
  for (int i = 0; i < frame_count; ++i) {
    while (samples <= 4 * i) { odo.add_imu(sample_at(0.25 * samples++)); }
    if (prefetch > 0) {
      odo.prefetch(images_of(i));
      all.push_back(odo.track_prefetched((i + 1) * period));
    } else {
      all.push_back(odo.track(images_of(i), (i + 1) * period));
    }
  }
  return all;
}

/// The same. @param blind frames that are black
template <typename Exec>
std::vector<ft::tracking> run(Exec const& exec, std::vector<int> const& blind = {}) {
  auto frames = walk();
  for (int const i : blind) {
    auto& f = frames[static_cast<std::size_t>(i)];
    f.left.assign(f.left.size(), 0);
    f.right.assign(f.right.size(), 0);
  }
  return run_frames(exec, frames);
}

constexpr int first_frozen = 30, last_frozen = 35;
/// The walk, of which frames have the images of the one before them.
std::vector<stereo_frame> frozen_walk(bool right = true) {
  auto frames = walk();
  for (std::size_t i = first_frozen; i <= last_frozen; ++i) {
    frames[i].left = frames[i - 1].left;
    if (right) { frames[i].right = frames[i - 1].right; }
  }
  return frames;
}

/// @param ahead_ns of the IMU's clock, in its samples' times and as it is said to be
template <typename Exec>
std::vector<ft::tracking> run_ahead(Exec const& exec, std::int64_t ahead_ns, double offset_s) {
  auto p = params();
  p.imu.time_offset_s = offset_s;
  ft::odometry<Exec> odo(exec, test::room::rig(), p, 1, ft::inertial{});
  std::vector<ft::tracking> all;
  int samples = 0;
  for (int i = 0; i < frame_count; ++i) {
    auto const& f = walk()[static_cast<std::size_t>(i)];
    for (; samples <= 4 * i; ++samples) {
      auto s = sample_at(0.25 * samples);
      s.time_ns += ahead_ns;
      odo.add_imu(s);
    }
    all.push_back(odo.track(images_of(f), (i + 1) * period));
  }
  return all;
}

double length(vector const& v) { return std::sqrt(ft::dot(v, v)); }
double error_of(ft::tracking const& t, int frame) {
  auto const& f = walk()[static_cast<std::size_t>(frame)];
  return length(t.T_world_camera.t - f.T_cw.cast<double>().inverse().t);
}

bool warns_of_unused_imu(ft::tracking const& t) {
  return t.warnings.has(ft::tracking_warning::imu_not_used);
}

template <typename Backend>
class inertial_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(inertial_odometry, test::backends);

// The walk turns at a constant rate, which tells nothing of the clocks.
TYPED_TEST(inertial_odometry, an_offset_that_is_given_gives_the_answers_of_equal_clocks) {
  TypeParam backend;
  auto const equal = run_ahead(backend.exec, 0, 0);
  for (std::int64_t const ms : {-100, -5, 2, 10, 30, 100}) {
    auto const ahead = run_ahead(backend.exec, ms * 1'000'000, static_cast<double>(ms) * 1e-3);
    for (std::size_t i = 0; i < equal.size(); ++i) {
      auto const &a = equal[i], &b = ahead[i];
      EXPECT_EQ(std::memcmp(&a.T_world_camera, &b.T_world_camera, sizeof a.T_world_camera), 0) << i;
      EXPECT_EQ(a.imu.samples, b.imu.samples);
      EXPECT_EQ(a.imu.known, b.imu.known);
      EXPECT_EQ(a.imu.newest_s, b.imu.newest_s);
      EXPECT_NEAR(b.imu.time_offset_s, static_cast<double>(ms) * 1e-3, 1e-12);
      EXPECT_FALSE(b.imu.clock.known);
    }
  }
}

TYPED_TEST(inertial_odometry, finds_gravity_velocity_and_biases) {
  TypeParam backend;
  auto const all = run(backend.exec);
  EXPECT_FALSE(all.front().imu.known);
  EXPECT_EQ(all.front().imu.samples, ft::integration_status::unordered);  // no time has passed
  auto const& last = all.back();
  ASSERT_TRUE(last.imu.known);
  EXPECT_TRUE(last.imu.predicted);
  EXPECT_TRUE(last.imu.optimized);
  EXPECT_EQ(last.imu.samples, ft::integration_status::integrated);
  // Less than a second of a smooth walk: gravity within 2 degrees, biases within some sigma.
  vector const down{0, gravity, 0};
  EXPECT_LT(length(last.imu.gravity - down), 0.35);
  EXPECT_NEAR(length(last.imu.gravity), gravity, 1e-3);
  auto const gyro = last.imu.bias.gyro;
  EXPECT_NEAR(static_cast<double>(gyro.x), gyro_bias.x, 3e-3);
  EXPECT_NEAR(static_cast<double>(gyro.y), gyro_bias.y, 3e-3);
  EXPECT_NEAR(static_cast<double>(gyro.z), gyro_bias.z, 3e-3);
  // The body moves around the camera by less than 2 cm/s.
  EXPECT_LT(length(last.imu.velocity - true_velocity()), 0.1);
  for (int i = 0; i < frame_count; ++i) {
    EXPECT_EQ(all[static_cast<std::size_t>(i)].state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(all[static_cast<std::size_t>(i)], i), 0.02) << i;
    EXPECT_FALSE(warns_of_unused_imu(all[static_cast<std::size_t>(i)])) << i;
  }
}

/// x and y of the IMU are exchanged: its state is never known, and the poses are those of the
/// images.
TYPED_TEST(inertial_odometry, says_that_an_imu_with_wrong_axes_is_not_used) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  ft::tracking last;
  int samples = 0;
  for (int i = 0; i < frame_count; ++i) {
    while (samples <= 4 * i) {
      auto m = sample_at(0.25 * samples++);
      std::swap(m.accel.x, m.accel.y);
      std::swap(m.gyro.x, m.gyro.y);
      odo.add_imu(m);
    }
    auto const& f = walk()[static_cast<std::size_t>(i)];
    last = odo.track(images_of(f), (i + 1) * period);
    EXPECT_LT(error_of(last, i), 0.02) << i;
    double const limit = ft::longest_unused_s(params().imu, true);
    EXPECT_EQ(warns_of_unused_imu(last), last.imu.unused_s > limit - 1e-6) << i;
    EXPECT_FALSE(warns_of_unused_imu(last) && i * seconds < limit - 1e-6) << i;
  }
  EXPECT_TRUE(warns_of_unused_imu(last));
  EXPECT_FALSE(last.imu.optimized);
}

TYPED_TEST(inertial_odometry, prefetch_changes_no_answer) {
  TypeParam backend;
  auto const all = run_frames(backend.exec, walk(), 1);
  EXPECT_TRUE(all.back().imu.optimized);
  test::expect_same(all, run(backend.exec));
}

TYPED_TEST(inertial_odometry, bridges_black_images) {
  TypeParam backend;
  std::vector<int> blind;
  for (int i = 30; i < 36; ++i) { blind.push_back(i); }
  auto const all = run(backend.exec, blind);
  ASSERT_TRUE(all[29].imu.known);
  for (int i = 30; i < 36; ++i) {
    auto const& t = all[static_cast<std::size_t>(i)];
    EXPECT_NE(t.state, ft::tracking_state::tracking) << i;
    EXPECT_TRUE(t.imu.predicted) << i;
    EXPECT_FALSE(t.imu.optimized) << i;
    EXPECT_LT(error_of(t, i), 0.05) << i;
  }
  for (int i = 37; i < frame_count; ++i) {
    auto const& t = all[static_cast<std::size_t>(i)];
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(t, i), 0.03) << i;
  }
  EXPECT_EQ(all.back().maps, 1);
}

void expect_that_the_imu_leads(std::vector<ft::tracking> const& all) {
  ASSERT_TRUE(all[first_frozen - 1].imu.known);
  for (int i = first_frozen; i < frame_count; ++i) {
    auto const& t = all[static_cast<std::size_t>(i)];
    EXPECT_LT(error_of(t, i), 0.02) << i;
    EXPECT_EQ(t.state == ft::tracking_state::tracking, i > last_frozen) << i;
    if (i > last_frozen) { continue; }
    EXPECT_TRUE(t.warnings.has(ft::tracking_warning::images_repeat)) << i;
    EXPECT_EQ(ft::explain(t).reason, ft::tracking_reason::images_repeat) << i;
    EXPECT_FALSE(t.keyframe) << i;
    EXPECT_TRUE(t.imu.predicted) << i;
  }
  EXPECT_EQ(all.back().maps, 1);
  EXPECT_TRUE(all.back().imu.optimized);
}

// A driver that repeats its images: all of them agree that the camera stands still.
TYPED_TEST(inertial_odometry, leads_where_images_repeat) {
  TypeParam backend;
  expect_that_the_imu_leads(run_frames(backend.exec, frozen_walk()));
  expect_that_the_imu_leads(run_frames(backend.exec, frozen_walk(), 1));
}

// The IMU falls silent meanwhile: where the camera is nobody knows, and no image says it.
TYPED_TEST(inertial_odometry, repeated_images_say_nothing_without_samples_either) {
  TypeParam backend;
  auto const frames = frozen_walk();
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  auto const track = [&](int i) {
    auto const& f = frames[static_cast<std::size_t>(i)];
    return odo.track(images_of(f), (i + 1) * period);
  };
  ft::tracking t;
  for (int i = 0; i <= last_frozen; ++i) {
    for (int k = i == 0 ? 0 : 4 * i - 3; k <= 4 * i; ++k) {
      if (i < first_frozen + 2) { odo.add_imu(sample_at(0.25 * k)); }
    }
    t = track(i);
    EXPECT_EQ(t.state == ft::tracking_state::tracking, i < first_frozen) << i;
  }
  EXPECT_FALSE(t.imu.predicted);
  auto const why = ft::explain(t);
  EXPECT_EQ(why.reason, ft::tracking_reason::images_repeat);
  EXPECT_NE(why.text.find("the pose is a guess"), std::string::npos) << why.text;
  odo.reset();
  EXPECT_EQ(track(last_frozen).state, ft::tracking_state::tracking) << "a map begins";
}

// Keypoints are of the left image, so it is as if there were none.
TYPED_TEST(inertial_odometry, leads_where_the_left_image_repeats) {
  TypeParam backend;
  expect_that_the_imu_leads(run_frames(backend.exec, frozen_walk(false)));
}

// So do images of a camera that stands still, in which there is no noise here.
TYPED_TEST(inertial_odometry, tracks_repeated_images_of_a_camera_at_rest) {
  TypeParam backend;
  auto p = params();
  ft::odometry odo(backend.exec, test::room::rig(), p, 1, ft::inertial{});
  auto const& f = walk().front();
  int samples = 0;
  bool known = false;
  for (int i = 0; i < frame_count; ++i) {
    for (; samples <= 4 * i; ++samples) {
      auto s = sample_at(0);
      s.time_ns = period + samples * period / 4;
      s.gyro = narrow(gyro_bias);
      s.accel = narrow(mount().R.transposed() * vector{0, -gravity, 0} + accel_bias);
      odo.add_imu(s);
    }
    auto const t = odo.track(images_of(f), (i + 1) * period);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(t, 0), 0.01) << i;
    known = t.imu.known;
  }
  EXPECT_TRUE(known);
}

/// Images upside down have depths, and nothing in them is known.
TYPED_TEST(inertial_odometry, goes_on_with_its_map_where_nothing_is_known) {
  TypeParam backend;
  auto frames = walk();
  int const first = 30;
  int const last = first + ft::tracking_rules{}.patience - 1;
  for (int i = first; i <= last; ++i) {
    auto& f = frames[static_cast<std::size_t>(i)];
    std::reverse(f.left.begin(), f.left.end());
    std::reverse(f.right.begin(), f.right.end());
    f.left.swap(f.right);  // turned by half a circle
  }
  auto const all = run_frames(backend.exec, frames);
  auto const at = [&](int i) { return all[static_cast<std::size_t>(i)]; };
  for (int i = first; i < last; ++i) { EXPECT_EQ(at(i).inliers, 0) << i; }
  EXPECT_EQ(at(last - 1).state, ft::tracking_state::recovering);
  EXPECT_EQ(at(last).state, ft::tracking_state::tracking);
  EXPECT_TRUE(at(last).keyframe);
  EXPECT_EQ(at(last).inliers, 0);
  EXPECT_GT(at(last + 1).map_points, at(last).map_points);
  EXPECT_TRUE(std::isinf(at(last).covariance[0]));
  EXPECT_EQ(ft::explain(at(first)).reason, ft::tracking_reason::few_matches);
  EXPECT_EQ(ft::explain(at(last)).reason, ft::tracking_reason::imu_only);
  EXPECT_EQ(ft::explain(all.back()).reason, ft::tracking_reason::none);
  for (int i = first; i < frame_count; ++i) {
    EXPECT_EQ(at(i).maps, 1) << i;
    EXPECT_TRUE(at(i).imu.predicted) << i;
    EXPECT_LT(error_of(at(i), i), 0.03) << i;
  }
  EXPECT_EQ(all.back().state, ft::tracking_state::tracking);
  EXPECT_GT(all.back().inliers, 50);
}

TYPED_TEST(inertial_odometry, works_without_samples) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  for (int i = 0; i < 12; ++i) {
    auto const& f = walk()[static_cast<std::size_t>(i)];
    auto const t = odo.track(images_of(f), (i + 1) * period);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_FALSE(t.imu.known);
    EXPECT_EQ(t.imu.samples, ft::integration_status::no_samples);
  }
}

TYPED_TEST(inertial_odometry, takes_samples_from_another_thread) {
  TypeParam backend;
  auto const want = run(backend.exec);
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  std::atomic<int> frame{-1}, added{-1};
  std::thread imu([&] {  // a frame ahead, while the frame before is tracked
    int samples = 0;
    for (int i = 0; i < frame_count; ++i) {
      while (frame < i - 1) { std::this_thread::yield(); }
      while (samples <= 4 * i) { odo.add_imu(sample_at(0.25 * samples++)); }
      added = i;
    }
  });
  for (int i = 0; i < frame_count; ++i) {
    while (added < i) { std::this_thread::yield(); }
    frame = i;
    auto const& f = walk()[static_cast<std::size_t>(i)];
    auto const t = odo.track(images_of(f), (i + 1) * period);
    auto const& w = want[static_cast<std::size_t>(i)];
    EXPECT_EQ(std::memcmp(&t.T_world_camera, &w.T_world_camera, sizeof t.T_world_camera), 0) << i;
  }
  imu.join();
}

// Without the samples of three frames no velocity is known, until keyframes tell it again.
TYPED_TEST(inertial_odometry, a_gap_in_the_samples_harms_no_pose) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  bool known = false;
  for (int i = 0; i < frame_count; ++i) {
    for (int k = i == 0 ? 0 : 4 * i - 3; k <= 4 * i; ++k) {
      if (i < 30 || i >= 33) { odo.add_imu(sample_at(0.25 * k)); }
    }
    auto const& f = walk()[static_cast<std::size_t>(i)];
    auto const t = odo.track(images_of(f), (i + 1) * period);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(t, i), 0.02) << i;
    if (i == 29) { known = t.imu.known; }
    if (i == 32 || i == 34) { EXPECT_FALSE(t.imu.predicted) << i; }
  }
  EXPECT_TRUE(known);
}

// The keyframes after a gap are enough, although the adjustment has older ones, too.
TYPED_TEST(inertial_odometry, an_early_gap_delays_what_is_known_no_longer_than_it_must) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  ft::tracking last;
  for (int i = 0; i < frame_count; ++i) {
    for (int k = i == 0 ? 0 : 4 * i - 3; k <= 4 * i; ++k) {
      if (i < 12 || i >= 15) { odo.add_imu(sample_at(0.25 * k)); }
    }
    auto const& f = walk()[static_cast<std::size_t>(i)];
    last = odo.track(images_of(f), (i + 1) * period);
    if (i < 20) { EXPECT_FALSE(last.imu.known) << i; }
  }
  EXPECT_TRUE(last.imu.known);
  EXPECT_LT(error_of(last, frame_count - 1), 0.02);
}

TYPED_TEST(inertial_odometry, cameras_of_a_batch_have_imus_of_their_own) {
  TypeParam backend;
  auto const want = run(backend.exec);
  ft::odometry odo(backend.exec, test::room::rig(), params(), 2, ft::inertial{});
  int samples = 0;
  for (int i = 0; i < frame_count; ++i) {
    while (samples <= 4 * i) { odo.add_imu(sample_at(0.25 * samples++), 1); }
    auto const& f = walk()[static_cast<std::size_t>(i)];
    ft::stereo_images const image = images_of(f);
    ft::stereo_images const images[2] = {image, image};
    std::int64_t const times[2] = {(i + 1) * period, (i + 1) * period};
    ft::tracking const* const t = odo.track(images, times);
    EXPECT_FALSE(t[0].imu.known) << i;
    auto const& w = want[static_cast<std::size_t>(i)];
    EXPECT_EQ(std::memcmp(&t[1].T_world_camera, &w.T_world_camera, sizeof w.T_world_camera), 0)
        << i;
  }
}

TYPED_TEST(inertial_odometry, begins_anew_after_a_reset) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const want = run(backend.exec);
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  for (int round = 0; round < 2; ++round) {
    int samples = 0;
    for (int i = 0; i < frame_count; ++i) {
      while (samples <= 4 * i) { odo.add_imu(sample_at(0.25 * samples++)); }
      auto const& f = walk()[static_cast<std::size_t>(i)];
      auto const t = odo.track(images_of(f), (i + 1) * period);
      auto const& w = want[static_cast<std::size_t>(i)];
      EXPECT_EQ(t.imu.known, w.imu.known) << i;
      EXPECT_EQ(std::memcmp(&t.imu.bias, &w.imu.bias, sizeof w.imu.bias), 0) << i;
    }
    odo.reset();
  }
}

TYPED_TEST(inertial_odometry, refuses_bad_input_and_goes_on) {
  TypeParam backend;
  auto const rig = test::room::rig();
  ft::odometry without(backend.exec, rig, test::room::odometry_params(4096));
  EXPECT_THROW(without.add_imu(sample_at(0)), ft::bad_argument);
  EXPECT_THROW(ft::odometry(backend.exec, rig, params()), ft::bad_argument) << "no part";
  EXPECT_THROW(
      ft::odometry(backend.exec, rig, test::room::odometry_params(4096), 1, ft::inertial{}),
      ft::bad_argument)
      << "no IMU";
  ft::odometry odo(backend.exec, rig, params(), 1, ft::inertial{});
  EXPECT_THROW(odo.add_imu(sample_at(0), 1), ft::bad_argument);
  auto p = params();
  p.imu.T_bc.R.m[0] = 2;
  EXPECT_THROW(ft::odometry(backend.exec, rig, p, 1, ft::inertial{}), ft::bad_argument);
  p = params();
  p.imu.noise.gyro = 0;
  EXPECT_THROW(ft::odometry(backend.exec, rig, p, 1, ft::inertial{}), ft::bad_argument);
  p = params();
  p.imu.initialization.least_keyframes = p.window.moving + p.window.fixed + 1;
  EXPECT_THROW(ft::odometry(backend.exec, rig, p, 1, ft::inertial{}), ft::bad_argument);
  p = params();
  p.imu.initialization.known_scale = false;
  EXPECT_THROW(ft::odometry(backend.exec, rig, p, 1, ft::inertial{}), ft::bad_argument);
}

// A sample that is doubled, comes late or cannot be is as one that is missing.
TYPED_TEST(inertial_odometry, a_bad_sample_is_left_out_and_counted) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params(), 1, ft::inertial{});
  float const inf = std::numeric_limits<float>::infinity();
  ft::tracking last;
  for (int i = 0; i < frame_count; ++i) {
    for (int k = i == 0 ? 0 : 4 * i - 3; k <= 4 * i; ++k) {
      auto m = sample_at(0.25 * k);
      if (k % 30 == 5) { m.gyro.y = k % 60 == 5 ? 1e7f : inf; }
      odo.add_imu(m);
      if (k % 30 == 15) { odo.add_imu(m); }
      if (k % 30 == 25) { odo.add_imu(sample_at(0.25 * (k - 1))); }
    }
    auto const& f = walk()[static_cast<std::size_t>(i)];
    last = odo.track(images_of(f), (i + 1) * period);
    EXPECT_EQ(last.state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(last, i), 0.02) << i;
  }
  EXPECT_TRUE(last.imu.optimized);
  EXPECT_EQ(last.imu.left_out.out_of_range, 6);
  EXPECT_EQ(last.imu.left_out.disordered, 5 + 5);
  EXPECT_NEAR(last.imu.rate_hz, 80, 1e-6);
  odo.reset();
  odo.add_imu(sample_at(0));  // time begins anew
  auto const& f = walk().front();
  last = odo.track(images_of(f), period);
  EXPECT_EQ(last.imu.left_out.disordered, 0);
}

TYPED_TEST(inertial_odometry, times_of_images_and_samples_may_be_any) {
  TypeParam backend;
  constexpr auto least = std::numeric_limits<std::int64_t>::min();
  constexpr auto most = std::numeric_limits<std::int64_t>::max();
  auto p = params();
  p.imu.waiting = 8;
  ft::odometry odo(backend.exec, test::room::rig(), p, 1, ft::inertial{});
  auto const& f = walk().front();
  ft::stereo_images const images = images_of(f);
  for (int i = 0; i < 100; ++i) { odo.add_imu(sample_at(0.25 * i)); }  // a clock that is ahead
  for (std::int64_t const time : {least, least + 1, std::int64_t{-1}, std::int64_t{0}, most}) {
    auto const t = odo.track(images, time);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << time;
    EXPECT_LT(error_of(t, 0), 0.01) << time;
    EXPECT_FALSE(t.imu.known);
    EXPECT_EQ(t.imu.left_out.crowded_out, 92);
    EXPECT_EQ(t.imu.newest_s > 0, time < most) << time;
  }
  EXPECT_THROW(odo.track(images, most), ft::bad_argument);
  EXPECT_THROW(odo.track(images, least), ft::bad_argument);
  EXPECT_EQ(odo.last().state, ft::tracking_state::tracking);
}

#if defined(__CUDACC__)

TEST(InertialOdometryParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  for (int fault = 0; fault < 3; ++fault) {
    auto const tracked = [&](auto const& exec) {
      return fault == 0   ? run(exec)
             : fault == 1 ? run(exec, {30, 31, 32, 33})
                          : run_frames(exec, frozen_walk());
    };
    auto const host = tracked(ft::host_exec());
    auto const device = tracked(backend.exec);
    for (std::size_t i = 0; i < host.size(); ++i) {
      EXPECT_EQ(std::memcmp(&host[i].T_world_camera, &device[i].T_world_camera,
                            sizeof host[i].T_world_camera),
                0)
          << i;
      EXPECT_EQ(std::memcmp(&host[i].imu.bias, &device[i].imu.bias, sizeof(ft::imu_bias)), 0) << i;
      EXPECT_EQ(std::memcmp(&host[i].imu.velocity, &device[i].imu.velocity, sizeof(vector)), 0)
          << i;
    }
  }
}

#endif

}  // namespace inertial_odometry_test
