// SPDX-License-Identifier: Apache-2.0
// Images in, poses out: a camera that walks through a rendered room, in a batch and alone, lost and
// found again, and what is refused.
#include "ft/pipelines/odometry.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace odometry_test {

using test::error_of;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;

ft::odometry_params params() { return test::room::odometry_params(4096); }

/// Frames of a walk, rendered once per program run. @param seed 0 to 2
template <typename Rig>
std::vector<stereo_frame> const& walk(Rig const& rig, unsigned seed, std::size_t frames = 24) {
  static std::vector<std::vector<stereo_frame>> walks(3);
  auto& w = walks.at(seed);
  if (w.size() < frames) { w = test::room::make_walk(rig, seed, static_cast<int>(frames)); }
  return w;
}

template <typename Exec, typename Rig>
std::vector<ft::tracking> run(Exec const& exec, Rig const& rig, ft::odometry_params const& p,
                              std::vector<stereo_frame> const& frames) {
  ft::odometry<Exec, Rig> odo(exec, rig, p);
  return test::track_all(odo, frames.size(), period,
                         [&](std::size_t i) { return images_of(frames[i]); });
}

template <typename Backend>
class odometry_pipeline : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(odometry_pipeline, test::backends);

template <typename Exec, typename Rig>
void follows_a_walk(Exec const& exec, Rig const& rig, double most) {
  auto const& frames = walk(rig, 0);
  auto const all = run(exec, rig, params(), frames);
  EXPECT_TRUE(all[0].keyframe);
  EXPECT_EQ(all[0].maps, 1);
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(all[i], frames[i], frames[0]), most) << i;
    EXPECT_EQ(all[i].inliers >= 20, i > 0) << i;
    EXPECT_EQ(all[i].left_out, 0) << i;
  }
  EXPECT_GE(all.back().keyframes, 2);
  EXPECT_EQ(all.back().maps, 1);
}

TYPED_TEST(odometry_pipeline, follows_a_walk_with_a_rectified_pair) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  follows_a_walk(backend.exec, test::room::rig(), 0.009);  // 0.013 with the parabola
}

TYPED_TEST(odometry_pipeline, follows_a_walk_with_two_fisheye_cameras) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  follows_a_walk(backend.exec, test::room::fisheye(), 0.03);
}

TYPED_TEST(odometry_pipeline, tells_the_covariance_of_a_pose) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const all = run(backend.exec, test::room::rig(), params(), walk(test::room::rig(), 0));
  auto const& c = all.back().covariance;
  for (int i = 0; i < 6; ++i) {
    // Some hundred points of a pixel's error: below a hundredth of a radian or a decimetre.
    EXPECT_GT(c[7 * i], 0) << i;
    EXPECT_LT(std::sqrt(c[7 * i]), i < 3 ? 0.01 : 0.1) << i;
    for (int j = 0; j < 6; ++j) {
      EXPECT_EQ(c[6 * i + j], c[6 * j + i]);
      EXPECT_LE(c[6 * i + j] * c[6 * i + j], c[7 * i] * c[7 * j] * 1.0001);
    }
  }
  for (double const v : all[0].covariance) { EXPECT_EQ(v, 0.0); }
  // Of a scene without noise, errors are below the quarter of a pixel that the matrix assumes.
  ft::frame_facts const& facts = all.back().evidence.facts;
  EXPECT_GE(facts.rows, 2 * all.back().inliers);
  EXPECT_LE(facts.rows, 3 * all.back().inliers);
  EXPECT_GT(facts.misfit, 0);
  EXPECT_LT(facts.misfit, facts.rows * ft::frame_facts::misfit_one);
}

TEST(variance_of_unit_weight, is_that_of_the_inliers_errors_where_there_are_many) {
  ft::frame_facts facts;
  EXPECT_EQ(ft::detail::variance_of(facts), 1.0) << "nothing is known";
  facts.rows = 6 + 1980;
  facts.misfit = 480 * ft::frame_facts::misfit_one;
  EXPECT_EQ(ft::detail::variance_of(facts), 0.25);
  facts.misfit = 1980 * ft::frame_facts::misfit_one;
  EXPECT_EQ(ft::detail::variance_of(facts), 1.0);
  facts.rows = 3;
  facts.misfit = 0;
  EXPECT_EQ(ft::detail::variance_of(facts), 1.0) << "fewer numbers than a pose has";
}

TEST(variance_of_unit_weight, grows_by_the_errors_of_points_while_the_camera_moves) {
  EXPECT_EQ(ft::detail::variance_with_points(0, 0), 1.0);
  EXPECT_EQ(ft::detail::variance_with_points(80, 80), 1.0);
  EXPECT_EQ(ft::detail::variance_with_points(80, 90), 1.0);
  EXPECT_EQ(ft::detail::variance_with_points(80, 40), 1.1);
  EXPECT_EQ(ft::detail::variance_with_points(80, 0), 1.2);
}

TYPED_TEST(odometry_pipeline, gives_the_same_answers_in_every_run_and_launch_by_launch) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const rig = test::room::rig();
  auto p = params();
  auto const first = run(backend.exec, rig, p, walk(rig, 0));
  test::expect_same(first, run(backend.exec, rig, p, walk(rig, 0)));
  test::expect_same(first, run(backend.exec, rig, p, walk(rig, 0)));
  p.use_graphs = false;
  p.measure_stages = true;
  test::expect_same(first, run(backend.exec, rig, p, walk(rig, 0)));
}

TYPED_TEST(odometry_pipeline, a_batch_gives_what_its_cameras_give_alone) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const frames = test::whole_effort() ? walk(rig, 0).size() : std::size_t{5};
  // On a device, images of nine cameras are uploaded in parts.
  unsigned const batch = TypeParam::exec_type::asynchronous ? 9 : 3;
  std::vector<std::vector<ft::tracking>> alone, together(batch);
  for (unsigned b = 0; b < 3; ++b) {
    auto images = walk(rig, b);
    images.resize(frames);
    alone.push_back(run(backend.exec, rig, params(), images));
  }
  ft::odometry odo(backend.exec, rig, params(), static_cast<int>(batch));
  for (std::size_t i = 0; i < frames; ++i) {
    std::vector<ft::stereo_images> images;
    std::vector<std::int64_t> const times(batch, static_cast<std::int64_t>(i + 1) * period);
    for (unsigned b = 0; b < batch; ++b) { images.push_back(images_of(walk(rig, b % 3)[i])); }
    ft::tracking const* const t = odo.track(images.data(), times.data());
    for (std::size_t b = 0; b < batch; ++b) { together[b].push_back(t[b]); }
  }
  for (std::size_t b = 0; b < batch; ++b) {
    SCOPED_TRACE("camera " + std::to_string(b));
    test::expect_same(together[b], alone[b % 3]);
  }
  EXPECT_FALSE(test::same(alone[0].back(), alone[1].back()));
}

/// A walk in which a number of frames are black.
template <typename Rig>
std::vector<stereo_frame> with_black_frames(Rig const& rig, std::size_t from, std::size_t count) {
  auto frames = walk(rig, 0);
  for (std::size_t i = from; i < from + count; ++i) {
    std::fill(frames[i].left.begin(), frames[i].left.end(), std::uint8_t{0});
    std::fill(frames[i].right.begin(), frames[i].right.end(), std::uint8_t{0});
  }
  return frames;
}

TYPED_TEST(odometry_pipeline, finds_a_lost_camera_again) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const frames = with_black_frames(rig, 10, 8);
  auto const all = run(backend.exec, rig, params(), frames);
  EXPECT_EQ(all[9].state, ft::tracking_state::tracking);
  for (std::size_t i = 10; i < 18; ++i) {
    int const missed = static_cast<int>(i) - 9;
    EXPECT_EQ(all[i].state, missed < ft::recovery_attempts ? ft::tracking_state::recovering
                                                           : ft::tracking_state::lost)
        << i;
    EXPECT_EQ(all[i].inliers, 0);
    EXPECT_TRUE(std::isinf(all[i].covariance[0]));
  }
  // Six attempts are a frame each.
  EXPECT_EQ(all[23].state, ft::tracking_state::tracking);
  EXPECT_EQ(all[23].maps, 1);
  EXPECT_LT(error_of(all[23], frames[23], frames[0]), 0.03);
}

TYPED_TEST(odometry_pipeline, finds_a_camera_that_goes_on_in_the_dark) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const rig = test::room::rig();
  // Three times as fast: 0.16 m and 2.3 degrees a frame.
  auto const walked = test::room::make_walk(rig, 0, 36);
  std::vector<stereo_frame> frames;
  for (std::size_t i = 0; i < walked.size(); i += 3) { frames.push_back(walked[i]); }
  for (std::size_t i = 4; i < 8; ++i) {
    std::fill(frames[i].left.begin(), frames[i].left.end(), std::uint8_t{0});
    std::fill(frames[i].right.begin(), frames[i].right.end(), std::uint8_t{0});
  }
  auto const all = run(backend.exec, rig, params(), frames);
  EXPECT_EQ(all[7].state, ft::tracking_state::recovering);
  // Where it would be if it had gone on, but for what is forgotten.
  EXPECT_LT(error_of(all[7], frames[7], frames[0]), 0.16);
  EXPECT_EQ(all[8].state, ft::tracking_state::tracking);
  EXPECT_EQ(all[8].maps, 1);
  EXPECT_LT(error_of(all[8], frames[8], frames[0]), 0.03);
}

TYPED_TEST(odometry_pipeline, begins_a_new_map_after_a_long_loss) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto p = params();
  p.rules.patience = 3;
  p.rules.min_recovered = 10'000;  // nothing is ever found again
  auto const frames = with_black_frames(rig, 10, 2);
  auto const all = run(backend.exec, rig, p, frames);
  // Lost without features in 10 and 11, with them in 12, 13 and 14.
  EXPECT_EQ(all[13].maps, 1);
  EXPECT_EQ(all[14].maps, 2);
  EXPECT_EQ(all[14].state, ft::tracking_state::tracking);
  EXPECT_TRUE(all[14].keyframe);
  EXPECT_TRUE(std::isinf(all[14].covariance[0]));
  for (std::size_t i = 15; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking);
    EXPECT_GE(all[i].inliers, 20);
  }
}

TYPED_TEST(odometry_pipeline, waits_for_a_frame_with_points) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto frames = with_black_frames(rig, 0, 2);
  frames.resize(3);
  auto const all = run(backend.exec, rig, params(), frames);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::initialising);
    EXPECT_EQ(all[i].maps, 0);
  }
  EXPECT_EQ(all[2].state, ft::tracking_state::tracking);
  EXPECT_TRUE(all[2].keyframe);
}

TYPED_TEST(odometry_pipeline, a_reset_camera_is_as_a_new_one) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const fresh = run(backend.exec, rig, params(), walk(rig, 1));
  ft::odometry odo(backend.exec, rig, params());
  std::int64_t time = 0;
  for (auto const& f : walk(rig, 0)) { odo.track(images_of(f), time += period); }
  EXPECT_FALSE(odo.download_map().points.empty());
  odo.reset();
  EXPECT_TRUE(odo.download_map().points.empty());
  time = 0;
  // The adjustment that was in flight ends in the meantime, so windows differ by a few frames; the
  // map does not see the old one's points.
  for (std::size_t i = 0; i < fresh.size(); ++i) {
    auto const t = odo.track(images_of(walk(rig, 1)[i]), time += period);
    EXPECT_EQ(t.state, ft::tracking_state::tracking);
    EXPECT_EQ(t.maps, 1);
    EXPECT_LT(error_of(t, walk(rig, 1)[i], walk(rig, 1)[0]), 0.02);
    if (i < 3) { EXPECT_TRUE(test::same(t, fresh[i])) << i; }
  }
}

TYPED_TEST(odometry_pipeline, takes_a_prediction_from_outside) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const& frames = walk(rig, 0);
  ft::odometry odo(backend.exec, rig, params());
  odo.track(images_of(frames[0]), period);
  // A jump that the search from the last frame does not cover.
  auto const T =
      frames[0].T_cw.template cast<double>() * frames[23].T_cw.template cast<double>().inverse();
  ft::odometry blind(backend.exec, rig, params());
  blind.track(images_of(frames[0]), period);
  odo.predict(T.orthonormalized());
  auto const t = odo.track(images_of(frames[23]), 2 * period);
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_LT(error_of(t, frames[23], frames[0]), 0.03);
  EXPECT_LT(blind.track(images_of(frames[23]), 2 * period).inliers, t.inliers);
}

TYPED_TEST(odometry_pipeline, tells_its_map) {
  TypeParam backend;
  auto const rig = test::room::rig();
  ft::odometry odo(backend.exec, rig, params());
  std::int64_t time = 0;
  ft::tracking last;
  for (auto const& f : walk(rig, 0)) { last = odo.track(images_of(f), time += period); }
  auto const map = odo.download_map();
  EXPECT_EQ(static_cast<int>(map.points.size()), last.map_points);
  EXPECT_EQ(static_cast<int>(map.keyframes.size()), last.keyframes);
  // The points lie on the walls of the room.
  auto const T_w0 = walk(rig, 0)[0].T_cw.inverse();
  int off = 0;
  for (auto const& p : map.points) {
    auto const at = T_w0 * p.position;
    float const d = std::min({std::abs(std::abs(at.x) - 3), std::abs(std::abs(at.y) - 1.5f),
                              std::abs(at.z + 2), std::abs(at.z - 6)});
    off += static_cast<int>(!(d < 0.3f));
    EXPECT_GE(p.keyframes, 1);
    EXPECT_NEAR(ft::dot(p.normal, p.normal), 1.0f, 1e-4f);
  }
  EXPECT_LT(off, static_cast<int>(map.points.size()) / 10);
  for (std::size_t i = 1; i < map.keyframes.size(); ++i) {
    EXPECT_GT(map.keyframes[i].number, map.keyframes[i - 1].number);
    EXPECT_GT(map.keyframes[i].time_ns, map.keyframes[i - 1].time_ns);
  }
}

TYPED_TEST(odometry_pipeline, refuses_bad_input_and_goes_on) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const& frames = walk(rig, 0);
  auto const good = run(backend.exec, rig, params(), {frames.begin(), frames.begin() + 3});
  ft::odometry odo(backend.exec, rig, params());
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < 3; ++i) {
    std::int64_t const now = static_cast<std::int64_t>(i + 1) * period;
    auto images = images_of(frames[i]);
    if (i > 0) { EXPECT_THROW(odo.track(images, now - period), ft::bad_argument); }
    auto narrow = images;
    narrow.right.width -= 16;
    EXPECT_THROW(odo.track(narrow, now), ft::bad_argument);
    auto none = images;
    none.left.data = nullptr;
    EXPECT_THROW(odo.track(none, now), ft::bad_argument);
    auto T = ft::rigid<double>::identity();
    T.t.x = std::numeric_limits<double>::quiet_NaN();
    EXPECT_THROW(odo.predict(T), ft::bad_argument);
    T = ft::rigid<double>::identity();
    T.R.m[0] = 2;
    EXPECT_THROW(odo.predict(T), ft::bad_argument);
    EXPECT_THROW(odo.predict(ft::rigid<double>::identity(), 1), ft::bad_argument);
    EXPECT_THROW(odo.reset(-1), ft::bad_argument);
    EXPECT_THROW(odo.download_map(1), ft::bad_argument);
    EXPECT_THROW(odo.stage_times(), ft::bad_argument);
    all.push_back(odo.track(images, now));
  }
  test::expect_same(all, good);
}

TYPED_TEST(odometry_pipeline, refuses_parameters_out_of_range) {
  TypeParam backend;
  auto const make = [&](std::function<void(ft::odometry_params&)> const& change, int batch = 1) {
    auto p = params();
    change(p);
    ft::odometry<typename TypeParam::exec_type>(backend.exec, test::room::rig(), p, batch);
  };
  EXPECT_THROW(make([](auto&) {}, 0), ft::bad_argument);
  std::vector<std::function<void(ft::odometry_params&)>> const changes{
      [](auto& p) { p.map_slots = 0; },
      [](auto& p) { p.keyframes = 1; },
      [](auto& p) { p.local_points = 0; },
      [](auto& p) { p.window.moving = 0; },
      [](auto& p) { p.window.fixed = 60; },
      [](auto& p) { p.window_points = 0; },
      [](auto& p) { p.adjustment_delay = 0; },
      [](auto& p) { p.rules.keep_share = std::numeric_limits<float>::quiet_NaN(); },
      [](auto& p) { p.rules.far_depth = std::numeric_limits<float>::quiet_NaN(); },
      [](auto& p) { p.rules.patience = 0; },
      [](auto& p) { p.rules.min_support = 3; },
      [](auto& p) { p.rules.doubtful_share = std::numeric_limits<float>::quiet_NaN(); },
      [](auto& p) { p.rules.matched_search = 0; },
      [](auto& p) { p.rules.min_inliers = 0; },
      [](auto& p) { p.orb.width = 0; },
      [](auto& p) { p.orb.start_features = 5 * p.orb.features; },  // of one camera alone
  };
  for (std::size_t i = 0; i < changes.size(); ++i) {
    EXPECT_THROW(make(changes[i]), ft::bad_argument) << i;
  }
}

TYPED_TEST(odometry_pipeline, says_the_settings_that_it_was_given) {
  TypeParam backend;
  auto p = params();
  p.imu.present = true;
  p.imu.keyframe_period_s = 0.1;
  ft::odometry const odo(backend.exec, test::room::rig(), p, 1, ft::inertial{});
  EXPECT_EQ(odo.params().rules.keyframe_period_s, 0);
  EXPECT_FALSE(odo.params().orb.exact_positions);
  EXPECT_FALSE(odo.params().orb.refine_positions);
  EXPECT_EQ(odo.params().orb.start_features, 0);
  EXPECT_EQ(odo.params().orb.corner_ratio, 0);
}

TYPED_TEST(odometry_pipeline, moves) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const& frames = walk(rig, 0);
  auto const good = run(backend.exec, rig, params(), frames);
  ft::odometry odo(backend.exec, rig, params());
  std::vector<ft::tracking> all;
  std::int64_t time = 0;
  for (auto const& f : frames) {
    all.push_back(odo.track(images_of(f), time += period));
    ft::odometry<typename TypeParam::exec_type> other(std::move(odo));
    EXPECT_THROW(odo.track(images_of(f), time), ft::bad_argument);  // NOLINT: it says so
    odo = std::move(other);
  }
  test::expect_same(all, good);
}

TYPED_TEST(odometry_pipeline, finds_its_place_in_a_saved_map) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const& frames = walk(rig, 0);
  ft::odometry first(backend.exec, rig, params());
  std::stringstream file;
  EXPECT_THROW(first.save_map(file), ft::bad_argument);
  std::int64_t time = 0;
  for (auto const& f : frames) { first.track(images_of(f), time += period); }
  first.save_map(file);
  auto const map = first.download_map();

  ft::odometry second(backend.exec, rig, params());
  second.load_map(file);
  auto const loaded = second.download_map();
  ASSERT_EQ(loaded.points.size(), map.points.size());
  for (std::size_t i = 0; i < map.points.size(); ++i) {
    EXPECT_EQ(std::memcmp(&loaded.points[i], &map.points[i], sizeof map.points[i]), 0) << i;
  }
  ASSERT_EQ(loaded.keyframes.size(), map.keyframes.size());
  ft::tracking t;
  time = 0;
  for (std::size_t i = 20; i < frames.size(); ++i) {
    t = second.track(images_of(frames[i]), time += period);
  }
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_EQ(t.maps, 1);
  EXPECT_LT(error_of(t, frames.back(), frames[0]), 0.03);
}

TYPED_TEST(odometry_pipeline, refuses_a_file_that_is_not_whole) {
  TypeParam backend;
  auto const rig = test::room::rig();
  ft::odometry odo(backend.exec, rig, params());
  odo.track(images_of(walk(rig, 0)[0]), period);
  std::stringstream file;
  odo.save_map(file);
  std::string const good = file.str();
  auto const map = odo.download_map();
  auto const refuse = [&](std::string const& bytes, char const* what) {
    std::stringstream from(bytes);
    EXPECT_THROW(odo.load_map(from), ft::error) << what;
  };
  for (std::size_t const length :
       {std::size_t{0}, std::size_t{10}, std::size_t{30}, good.size() / 2, good.size() - 1}) {
    refuse(good.substr(0, length), "truncated");
  }
  refuse(good + "x", "too long");
  for (std::size_t const at :
       {std::size_t{3}, std::size_t{17}, std::size_t{25}, good.size() / 2, good.size() - 3}) {
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 1);
    refuse(bad, "another byte");
  }
  auto p = params();
  p.map_slots = 4095;
  ft::odometry other(backend.exec, rig, p);
  std::stringstream from(good);
  EXPECT_THROW(other.load_map(from), ft::error);
  auto const after = odo.download_map();
  EXPECT_EQ(after.points.size(), map.points.size());
  EXPECT_EQ(odo.track(images_of(walk(rig, 0)[1]), 2 * period).state, ft::tracking_state::tracking);
}

#if !defined(__CUDACC__)

TEST(OdometryOnTheHost, AllocatesNothingInAFrame) {
  auto const rig = test::room::rig();
  auto const& frames = walk(rig, 0);
  ft::odometry odo(ft::host_exec(1), rig, params());
  std::vector<ft::tracking> all;
  all.reserve(frames.size());
  test::allocation_count const allocations;
  auto const one = std::make_unique<int>(1);
  if (allocations.so_far() == 0) { GTEST_SKIP() << "this program does not count allocations"; }
  std::int64_t time = 0;
  for (auto const& f : frames) { all.push_back(odo.track(images_of(f), time += period)); }
  EXPECT_EQ(allocations.so_far(), *one);
  EXPECT_GE(all.back().keyframes, 2);
}

TEST(OdometryOnTheHost, SaysWhatMemoryItTook) {
  auto const bytes = [](int batch) {
    test::allocation_count const allocations;
    ft::odometry const odo(ft::host_exec(1), test::room::rig(), params(), batch);
    std::size_t const taken = allocations.bytes();
    ft::allocated_bytes const told = odo.memory_bytes();
    std::size_t const all = told.executor + told.staging;
    EXPECT_TRUE(taken == 0 || taken >= all) << "if allocations are counted";
    EXPECT_TRUE(taken == 0 || taken < all + 200'000) << taken - all << " bytes of tables";
    return all;
  };
  std::size_t const one = bytes(1);
  std::size_t const four = bytes(4);
  EXPECT_GT(four, 3 * one);
  EXPECT_LE(four, 4 * one);
}

#else

/// Frames of both executors, one after the other.
template <typename Rig>
void expect_parity(ft::cuda_exec const& device, Rig const& rig, ft::odometry_params const& p,
                   std::vector<stereo_frame> const& frames) {
  test::expect_same(run(device, rig, p, frames), run(ft::host_exec(), rig, p, frames));
}

TEST(OdometryParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  auto const rig = test::room::rig();
  auto const fisheye = test::room::fisheye();
  expect_parity(backend.exec, rig, params(), walk(rig, 0));
  expect_parity(backend.exec, fisheye, params(), walk(fisheye, 0));
  expect_parity(backend.exec, rig, params(), with_black_frames(rig, 10, 8));
  auto small = params();  // points, keyframes and windows that do not fit
  small.map_slots = 700;
  small.local_points = 300;
  small.keyframes = 3;
  small.window = {2, 1};
  small.window_points = 200;
  small.adjustment_delay = 1;
  expect_parity(backend.exec, rig, small, walk(rig, 1));
}

#endif

/// A map that is too small for the walk.
TYPED_TEST(odometry_pipeline, goes_on_when_the_map_is_full) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto p = params();
  p.map_slots = 700;
  p.keyframes = 3;
  p.window = {2, 1};
  p.rules.keep_share = 1;
  auto const all = run(backend.exec, rig, p, walk(rig, 0));
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_LE(all[i].map_points, 700);
    EXPECT_LT(error_of(all[i], walk(rig, 0)[i], walk(rig, 0)[0]), 0.05) << i;
  }
  EXPECT_GT(all.back().keyframes, 3);
}

/// What a keyframe does to the map is told with the frame after it.
TYPED_TEST(odometry_pipeline, tells_of_a_keyframe_with_the_next_frame) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto p = params();
  p.map_slots = 150;
  auto const all = run(backend.exec, rig, p, walk(rig, 0));
  EXPECT_TRUE(all[0].keyframe);
  EXPECT_EQ(all[0].map_points, 0);
  EXPECT_EQ(all[0].left_out, 0);
  EXPECT_EQ(all[1].map_points, 150);
  EXPECT_EQ(all[1].left_out, all[0].stereo_points - 150);
}

}  // namespace odometry_test
