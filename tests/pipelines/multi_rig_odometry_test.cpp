// SPDX-License-Identifier: Apache-2.0
// Odometry with rigs of several cameras, in a rendered room.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "ft/cameras/multi_rig.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/multi_rig_walk.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/room.hpp"

namespace multi_rig_odometry_test {

using test::error_of;
using test::room::at;
using test::room::image;
using namespace test::rigs;

template <typename Backend>
class multi_rig_odometry : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(multi_rig_odometry, test::backends);

ft::odometry_params odometry_params() { return test::room::odometry_params(8192); }

template <typename Odometry>
typename Odometry::images_type views_of(rig_frame const& f) {
  std::vector<ft::gray_view> views;
  for (image const& i : f.images) { views.push_back(test::room::view(i)); }
  typename Odometry::images_type images;
  if constexpr (sizeof images == 2 * sizeof views[0]) {
    images = {views[0], views[1]};
  } else {
    std::copy(views.begin(), views.end(), images.of);
  }
  return images;
}

template <typename Exec, typename Rig>
std::vector<ft::tracking> follow(Exec const& exec, Rig const& rig,
                                 std::vector<rig_frame> const& walk, int prefetch = 0) {
  using odometry_type = ft::odometry<Exec, Rig>;
  auto params = odometry_params();
  params.prefetch = prefetch;
  odometry_type odo(exec, rig, params);
  auto const images_of = views_of<odometry_type>;
  return test::track_all(odo, walk.size(), 50'000'000,
                         [&](std::size_t i) { return images_of(walk[i]); });
}

double rms_of(std::vector<ft::tracking> const& seen, std::vector<rig_frame> const& walk) {
  double sum = 0;
  for (std::size_t f = 0; f < seen.size(); ++f) {
    double const e = error_of(seen[f].T_world_camera, walk[f].T_cw, walk[0].T_cw);
    sum += e * e;
  }
  return std::sqrt(sum / static_cast<double>(seen.size()));
}

TYPED_TEST(multi_rig_odometry, of_one_pair_has_the_bits_of_a_rectified_rig) {
  TypeParam backend;
  ft::multi_rig<1> const one{{pair_at(ft::pose::identity())}};
  auto const walk = make_walk(one, 0, 16);
  auto const a = follow(backend.exec, one, walk);
  auto const b = follow(backend.exec, test::room::rig(), walk);
  EXPECT_GE(a.back().keyframes, 2);
  for (std::size_t f = 0; f < a.size(); ++f) {
    ft::tracking of_rig = a[f];
    EXPECT_EQ(of_rig.depths, ft::depth_origin::some_pairs);
    of_rig.depths = b[f].depths;
    EXPECT_TRUE(test::same(of_rig, b[f])) << f;
  }
}

TYPED_TEST(multi_rig_odometry, of_two_pairs_is_as_exact_as_the_better_one) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  auto const rig = two_pairs();
  auto const walk = make_walk(rig, 0, 16);
  auto const both = follow(backend.exec, rig, walk);
  double alone[2] = {};
  for (std::size_t c = 0; c < 2; ++c) {
    auto part = walk;
    for (auto& f : part) { f.images = {f.images[2 * c], f.images[2 * c + 1]}; }
    alone[c] = rms_of(follow(backend.exec, ft::multi_rig<1>{{rig.of[c]}}, part), part);
  }
  for (std::size_t f = 0; f < both.size(); ++f) {
    EXPECT_EQ(both[f].state, ft::tracking_state::tracking) << f;
    EXPECT_EQ(both[f].left_out, 0) << f;
  }
  EXPECT_GE(both.back().keyframes, 2);
  double const rms = rms_of(both, walk);
  EXPECT_LT(rms, 0.01);
  EXPECT_LE(rms, std::min(alone[0], alone[1]));
  this->RecordProperty("rms_mm", std::to_string(1000 * rms));
  this->RecordProperty("rms_mm_alone",
                       std::to_string(1000 * alone[0]) + " " + std::to_string(1000 * alone[1]));
}

TYPED_TEST(multi_rig_odometry, goes_on_while_one_pair_is_black) {
  TypeParam backend;
  auto const rig = two_pairs();
  auto const whole = make_walk(rig, 1, 12);
  for (std::size_t c = 0; c < 2; ++c) {
    auto const walk = blackened(whole, c);
    auto const seen = follow(backend.exec, rig, walk);
    for (std::size_t f = 0; f < seen.size(); ++f) {
      EXPECT_EQ(seen[f].state, ft::tracking_state::tracking) << "pair " << c << " frame " << f;
      EXPECT_EQ(seen[f].maps, 1);
      EXPECT_LT(error_of(seen[f].T_world_camera, walk[f].T_cw, walk[0].T_cw), 0.03);
    }
  }
}

TYPED_TEST(multi_rig_odometry, goes_on_while_cameras_miss_images) {
  TypeParam backend;
  auto const rig = two_pairs();
  auto const walk = make_walk(rig, 1, 12);
  auto const black = blackened(walk, 1);
  using odometry_type = ft::odometry<typename TypeParam::exec_type, ft::multi_rig<2>>;
  auto params = odometry_params();
  odometry_type null(backend.exec, rig, params);
  odometry_type dark(backend.exec, rig, params);
  params.prefetch = 2;
  odometry_type ahead(backend.exec, rig, params);
  auto const given = [&](std::size_t f) {
    auto images = views_of<odometry_type>(walk[f]);
    if (f > 0) { images.of[2] = images.of[3] = {}; }
    return images;
  };
  auto const early = test::track_all(ahead, walk.size(), 50'000'000, given);
  std::int64_t time = 0;
  for (std::size_t f = 0; f < walk.size(); ++f) {
    time += 50'000'000;
    auto const missing = null.track(given(f), time);
    auto const there = dark.track(views_of<odometry_type>(black[f]), time);
    EXPECT_EQ(missing.state, ft::tracking_state::tracking) << f;
    EXPECT_LT(error_of(missing.T_world_camera, walk[f].T_cw, walk[0].T_cw), 0.03) << f;
    EXPECT_TRUE(test::same(missing, early[f])) << f;
    EXPECT_EQ(
        std::memcmp(&missing.T_world_camera, &there.T_world_camera, sizeof there.T_world_camera), 0)
        << f;
    EXPECT_EQ(missing.inliers, there.inliers) << f;
    EXPECT_EQ(missing.missing_images, f > 0 ? 0b1100u : 0u) << f;
    EXPECT_EQ(missing.evidence.images, f > 0 ? 2 : 4) << f;
    EXPECT_FALSE(missing.warnings.has(ft::tracking_warning::dark)) << f;
    EXPECT_EQ(there.warnings.has(ft::tracking_warning::dark), f > 0) << f;
  }
  typename odometry_type::images_type const none{};
  EXPECT_THROW(null.track(none, time + 1), ft::bad_argument);
  odometry_type blind(backend.exec, rig, odometry_params());
  auto one_image = views_of<odometry_type>(walk[0]);
  one_image.of[0] = one_image.of[2] = one_image.of[3] = {};
  auto const why = ft::explain(blind.track(one_image, 1));
  EXPECT_EQ(why.reason, ft::tracking_reason::images_missing) << why.text;
  EXPECT_NE(why.text.find("image 0, image 2, image 3"), std::string::npos) << why.text;
}

TYPED_TEST(multi_rig_odometry, goes_on_while_images_are_missing_by_turns) {
  TypeParam backend;
  auto const rig = two_pairs();
  auto const walk = make_walk(rig, 0, 16);
  using odometry_type = ft::odometry<typename TypeParam::exec_type, ft::multi_rig<2>>;
  odometry_type odo(backend.exec, rig, odometry_params());
  std::int64_t time = 0;
  for (std::size_t f = 0; f < walk.size(); ++f) {
    auto images = views_of<odometry_type>(walk[f]);
    if (f > 0) { images.of[f % 4] = {}; }
    auto const t = odo.track(images, time += 50'000'000);
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << f;
    EXPECT_EQ(t.maps, 1) << f;
    EXPECT_TRUE(t.warnings.empty()) << f << " " << t.warnings.bits;
    EXPECT_LT(error_of(t.T_world_camera, walk[f].T_cw, walk[0].T_cw), 0.02) << f;
  }
}

TYPED_TEST(multi_rig_odometry, gives_the_bits_of_the_host) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  TypeParam backend;
  ft::multi_rig<3> const rig{{pair_at(turned(0.1f, {0.1f, 0.02f, 0.2f})),
                              single_at(turned(-0.1f, {-0.2f, 0, 0.1f})),
                              pair_at(turned(1.4f, {0.3f, 0, -0.1f}))}};
  auto const walk = make_walk(rig, 2, 12);
  auto const here = follow(backend.exec, rig, walk);
  test::expect_same(follow(backend.exec, rig, walk, 2), here);
  auto const host = follow(ft::host_exec{}, rig, walk);
  for (std::size_t f = 0; f < here.size(); ++f) {
    EXPECT_TRUE(test::same(here[f], host[f])) << f;
    EXPECT_LT(error_of(here[f].T_world_camera, walk[f].T_cw, walk[0].T_cw), 0.02) << f;
  }
}

/// Bodies on a circle of 1.2 m, looking outwards.
std::vector<rig_frame> round(ft::multi_rig<2> const& rig, int lap, int frames) {
  std::vector<ft::pose> T_bw;
  for (int i = 0; i < frames; ++i) {
    float const yaw = 6.2831853f * static_cast<float>(i) / static_cast<float>(lap);
    T_bw.push_back(turned(yaw, {0.6f * std::sin(yaw), 0, 1.2f + 0.6f * std::cos(yaw)}));
  }
  return make_walk(rig, 0, T_bw);
}

// Between the pairs there is a third of a turn: what one saw the other one sees 14 frames later.
TYPED_TEST(multi_rig_odometry, a_lap_is_closed_by_either_pair) {
  TypeParam backend;
  using odometry_type = ft::odometry<typename TypeParam::exec_type, ft::multi_rig<2>>;
  constexpr int lap = 42, frames = lap + 8;
  ft::multi_rig<2> const rig{
      {pair_at(turned(0.1f, {0.1f, 0.02f, 0.1f})), pair_at(turned(2.1f, {0.1f, 0, -0.1f}))}};
  auto const walk = round(rig, lap, frames);
  auto params = odometry_params();
  // Of 400, 500, 600, 700, 800, 1000, 1200, 1500 the first loop is as early with 500, 700 and 800.
  params.orb.features = 700;
  params.window = {4, 2};
  params.keyframes = 12;  // the odometry itself has forgotten where it began
  params.local_map.keyframes = 8;
  params.loops.present = true;
  params.loops.recent = 6;
  params.loops.max_drift = 0.2f;  // the way is short: an odometry as it should be needs no loop
  odometry_type odo(backend.exec, rig, params, 1, ft::loops{});
  int closed = 0, first = frames;
  ft::tracking last;
  for (int i = 0; i < frames; ++i) {
    last = odo.track(views_of<odometry_type>(walk[at(i)]), (i + 1) * std::int64_t{50'000'000});
    ASSERT_EQ(last.state, ft::tracking_state::tracking) << i;
    closed += last.loops_closed;
    if (last.loops_closed > 0) { first = std::min(first, i); }
  }
  EXPECT_GT(closed, 0);
  EXPECT_LT(first, 28) << "the pairs do not recognise what the other one saw";
  EXPECT_LT(error_of(last.T_world_camera, walk.back().T_cw, walk[0].T_cw), 0.03);
  for (auto const& k : odo.placed_keyframes()) {
    auto const i = at(k.time_ns / 50'000'000 - 1);
    EXPECT_LT(error_of(k.T_world_camera, walk[i].T_cw, walk[0].T_cw), 0.035) << i;
  }
}

TYPED_TEST(multi_rig_odometry, needs_a_pair) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type, ft::multi_rig<1>>;
  ft::multi_rig<1> const alone{{single_at(ft::pose::identity())}};
  EXPECT_THROW(odometry(backend.exec, alone, odometry_params()), ft::bad_argument);
}

}  // namespace multi_rig_odometry_test
