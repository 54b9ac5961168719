// SPDX-License-Identifier: Apache-2.0
// Cameras of a batch whose keyframes come at different frames: while some are adjusted on the
// odometry's thread, others gather their windows. A search for loops beside frames. A program of
// its own, which ThreadSanitizer checks; oneTBB, which is not built for it, has no part in an
// executor of one thread.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace odometry_threads_test {

constexpr int cameras = 4;
constexpr int frames = 9;
constexpr std::int64_t period = 50'000'000;

ft::odometry_params params() {
  auto p = test::room::odometry_params(2048);
  p.orb.features = 300;
  p.rules.keep_share = 0.95f;  // many keyframes
  p.adjustment.steps = 4;
  return p;
}

std::vector<test::room::stereo_frame> const& shared_walk() {
  static auto const walk = test::room::make_walk(test::room::rig(), 0, frames);
  return walk;
}

/// Camera b begins to walk after b frames at rest.
std::vector<ft::stereo_images> images_of(std::vector<test::room::stereo_frame> const& walk, int b) {
  std::vector<ft::stereo_images> images;
  for (int i = 0; i < frames; ++i) {
    auto const& f = walk[static_cast<std::size_t>(i > b ? i - b : 0)];
    images.push_back(images_of(f));
  }
  return images;
}

TEST(OdometryThreads, CamerasThatSelectKeyframesAtDifferentFramesDoNotMeet) {
  auto const rig = test::room::rig();
  auto const& walk = shared_walk();
  ft::host_exec const exec(1);
  std::vector<std::vector<ft::stereo_images>> images;
  for (int b = 0; b < cameras; ++b) { images.push_back(images_of(walk, b)); }
  std::vector<std::vector<ft::tracking>> together(cameras);
  int apart = 0;
  ft::odometry<ft::host_exec> batch(exec, rig, params(), cameras);
  for (int i = 0; i < frames; ++i) {
    std::vector<ft::stereo_images> now;
    for (auto const& of : images) { now.push_back(of[static_cast<std::size_t>(i)]); }
    std::vector<std::int64_t> const times(cameras, (i + 1) * period);
    ft::tracking const* const t = batch.track(now.data(), times.data());
    int keyframes = 0;
    for (int b = 0; b < cameras; ++b) {
      together[static_cast<std::size_t>(b)].push_back(t[b]);
      keyframes += t[b].keyframe ? 1 : 0;
    }
    apart += keyframes > 0 && keyframes < cameras ? 1 : 0;
  }
  EXPECT_GE(apart, 3);
#if !FT_TEST_TSAN  // one camera has nobody to meet
  for (int b = 0; b < cameras; ++b) {
    SCOPED_TRACE("camera " + std::to_string(b));
    ft::odometry<ft::host_exec> alone(exec, rig, params());
    std::vector<ft::tracking> answers;
    std::int64_t time = 0;
    for (auto const& image : images[static_cast<std::size_t>(b)]) {
      answers.push_back(alone.track(image, time += period));
    }
    EXPECT_GE(answers.back().keyframes, 3);
    test::expect_same(together[static_cast<std::size_t>(b)], answers);
  }
#endif
}

/// There and back, with a reset and an end in the middle of a search.
TEST(OdometryThreads, ASearchForLoopsDoesNotMeetTheFramesBesideIt) {
  auto const rig = test::room::rig();
  auto const& walk = shared_walk();
  auto p = params();
  p.loops.present = true;
  p.loops.recent = 3;
  p.loops.max_drift = 1;  // the way is short: an odometry as it should be needs no loop
  ft::odometry<ft::host_exec> odo(ft::host_exec(1), rig, p, 1, ft::loops{});
  int closed = 0;
  for (int round = 0; round < 2; ++round) {
    for (int i = 0; i < 2 * frames; ++i) {
      auto const& f = walk[static_cast<std::size_t>(i < frames ? i : 2 * frames - 1 - i)];
      closed += odo.track(images_of(f), (i + 1) * period).loops_closed;
      if (round == 1 && i == frames) { return; }
    }
    EXPECT_GT(closed, 0);
    odo.reset();
  }
}

}  // namespace odometry_threads_test
