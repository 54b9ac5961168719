// SPDX-License-Identifier: Apache-2.0
// Why a frame is not tracked: each reason from an odometry that has it.
#include "ft/pipelines/explain.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/room.hpp"

namespace explain_test {

using reason = ft::tracking_reason;
using test::room::image;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
constexpr auto pixels = static_cast<std::size_t>(test::room::width * test::room::height);

ft::odometry_params params() { return test::room::odometry_params(4096); }

/// Frames of one room, and one of another.
std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 6);
  return frames;
}
stereo_frame const& elsewhere() { return test::room::walk(1)[0]; }

image flat(int grey) { return image(pixels, static_cast<std::uint8_t>(grey)); }
/// Light and dark, without a corner.
image ramp() {
  image out;
  for (std::size_t i = 0; i < pixels; ++i) {
    out.push_back(static_cast<std::uint8_t>(i % test::room::width / 2));
  }
  return out;
}

ft::stereo_images views(image const& left, image const& right) {
  return {test::room::view(left), test::room::view(right)};
}
ft::stereo_images views(stereo_frame const& f) { return views(f.left, f.right); }

template <typename Backend>
class explain : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(explain, test::backends);

void expect(ft::tracking const& t, reason wanted, std::string const& word,
            ft::tracking_rules const& rules = {}) {
  auto const found = ft::explain(t, rules);
  EXPECT_EQ(ft::name_of(found.reason), std::string(ft::name_of(wanted))) << found.text;
  EXPECT_NE(found.text.find(word), std::string::npos) << found.text;
  EXPECT_EQ(found.text.empty(), wanted == reason::none);
}

TYPED_TEST(explain, tracked_frames_need_no_explanation) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params());
  expect(odo.last(), reason::not_started, "no frame was given yet");
  std::int64_t time = 0;
  for (auto const& f : walk()) { expect(odo.track(views(f), time += period), reason::none, ""); }
  EXPECT_FALSE(odo.last().map_begun);
  EXPECT_EQ(odo.last().agreed, odo.last().inliers);
  EXPECT_GE(odo.last().light.image, 0);
  EXPECT_TRUE(odo.last().warnings.empty());
  std::stringstream file;
  odo.save_map(file);
  odo.load_map(file);
  expect(odo.last(), reason::not_started, "since the map was loaded");
  odo.reset();
  expect(odo.last(), reason::not_started, "no frame was given yet");
}

TYPED_TEST(explain, tells_which_image_is_dark_bright_or_uniform) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params());
  auto const& seen = walk()[0];
  std::int64_t time = 0;
  auto const track = [&](image const& left, image const& right) {
    return odo.track(views(left, right), time += period);
  };
  expect(track(flat(3), flat(3)), reason::dark,
         "image 0 is nearly black: its mean grey value is 3");
  expect(track(seen.left, flat(15)), reason::dark, "image 1");
  expect(track(flat(250), seen.right), reason::bright, "image 0");
  expect(track(seen.left, flat(100)), reason::low_texture, "image 1 is almost uniform");
  expect(track(ramp(), ramp()), reason::blurred, "only 0 keypoints");
  // Of two flat images the first one.
  EXPECT_EQ(track(flat(16), flat(16)).light.image, 0);
  EXPECT_EQ(odo.last().light.mean, 16);
  EXPECT_EQ(odo.last().light.deviation, 0);
  expect(odo.last(), reason::low_texture, "deviate by 0.0");  // 16 is not below 16
  // In a map likewise.
  expect(track(seen.left, seen.right), reason::none, "");
  expect(track(flat(0), flat(0)), reason::dark, "image 0");
}

TYPED_TEST(explain, prefetched_frames_have_their_own_light) {
  TypeParam backend;
  auto p = params();
  p.prefetch = 2;
  ft::odometry odo(backend.exec, test::room::rig(), p);
  auto const dark = flat(2);
  auto const bright = flat(251);
  odo.prefetch(views(dark, dark));
  odo.prefetch(views(bright, bright));
  expect(odo.track_prefetched(period), reason::dark, "its mean grey value is 2.0");
  expect(odo.track_prefetched(2 * period), reason::bright, "its mean grey value is 251.0");
}

TYPED_TEST(explain, exchanged_images_are_inconsistent) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params());
  auto const& f = walk()[0];
  auto const t = odo.track(views(f.right, f.left), period);
  EXPECT_EQ(t.state, ft::tracking_state::initialising);
  expect(t, reason::stereo_inconsistent, " of " + std::to_string(t.keypoints) + " keypoints");
  EXPECT_GT(t.keypoints, 500);
  // The right way round, with rules that ask for more.
  auto p = params();
  p.rules.min_stereo_points = 1000;
  p.orb.features = 1200;
  ft::odometry strict(backend.exec, test::room::rig(), p);
  auto const few = strict.track(views(f), period);
  ASSERT_LT(few.stereo_points, 1000);
  expect(few, reason::few_depths, "a map needs 1000", p.rules);
}

TYPED_TEST(explain, another_room_has_few_matches_and_then_a_map_of_its_own) {
  TypeParam backend;
  ft::odometry odo(backend.exec, test::room::rig(), params());
  std::int64_t time = 0;
  auto const first = odo.track(views(walk()[0]), time += period);
  EXPECT_TRUE(first.map_begun);
  expect(first, reason::none, "");
  ft::tracking t;
  for (int i = 0; i < odo.params().rules.patience - 1; ++i) {
    t = odo.track(views(elsewhere()), time += period);
    ASSERT_EQ(t.inliers, 0);
    EXPECT_FALSE(t.map_begun);
    EXPECT_LT(t.agreed, odo.params().rules.min_recovered);
    expect(t, reason::few_matches, std::to_string(t.agreed) + " keypoints agree");
  }
  t = odo.track(views(elsewhere()), time += period);
  ASSERT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_TRUE(t.map_begun);
  expect(t, reason::new_map, "map 2 begins at a guessed place");
  t = odo.track(views(elsewhere()), time += period);
  EXPECT_FALSE(t.map_begun);
  expect(t, reason::none, "");
}

// ---- depth images

using rgbd = ft::rgbd_rig<>;
rgbd depth_rig(float scale) { return rgbd::make(test::room::rig().camera, 0.08, scale); }

TYPED_TEST(explain, depth_images_without_depth_or_in_millimetres) {
  TypeParam backend;
  auto const& f = walk()[0];
  auto const track = [&](rgbd const& rig, int depth) {
    std::vector<std::uint16_t> const depths(pixels, static_cast<std::uint16_t>(depth));
    ft::odometry<typename TypeParam::exec_type, rgbd> odo(backend.exec, rig, params());
    return odo.track({test::room::view(f.left),
                      ft::image_view<std::uint16_t const>{depths.data(), test::room::width,
                                                          test::room::height, test::room::width}},
                     period);
  };
  auto const none = track(depth_rig(0.001f), 0);
  EXPECT_GT(none.keypoints, 500);
  expect(none, reason::no_depth, "0 of " + std::to_string(none.keypoints) + " keypoints");
  expect(track(depth_rig(0.001f), 2000), reason::none, "");
  auto far = depth_rig(0.001f);
  far.max_depth = 1;
  expect(track(far, 2000), reason::no_depth, "max_depth");
  // 2 m, taken for 2000 m: 25,000 baselines.
  auto const t = track(depth_rig(1), 2000);
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_EQ(t.distant_points, t.stereo_points);
  expect(t, reason::depth_scale, "beyond 1000 baselines");
  // 80 m are 1000 baselines, which is not beyond.
  expect(track(depth_rig(1), 80), reason::none, "");
  expect(track(depth_rig(1), 81), reason::depth_scale, "");
}

// ---- one camera, several pairs

TYPED_TEST(explain, one_camera_awaits_motion) {
  TypeParam backend;
  using rig_type = ft::monocular_rig<ft::pinhole<float>>;
  auto p = params();
  p.orb.features = 1000;
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(
      backend.exec, rig_type::make(test::room::rig().camera), p);
  auto const& f = walk()[0];
  auto const dark = flat(0);
  std::int64_t time = 0;
  auto const track = [&](image const& i) { return odo.track(test::room::view(i), time += period); };
  expect(track(dark), reason::dark, "image 0");
  expect(track(f.left), reason::awaits_motion, "first frame of a start");
  expect(track(f.left), reason::awaits_motion, "motion is not clear");
  expect(track(elsewhere().left), reason::awaits_motion, "the start begins again");
}

TYPED_TEST(explain, a_rig_of_several_cameras_is_not_called_exchanged) {
  TypeParam backend;
  auto const pair = test::room::rig();
  using rig_type = ft::multi_rig<2>;
  rig_type const rig{
      {{pair.camera, pair.baseline, ft::pose::identity()}, {pair.camera, 0, ft::pose::identity()}}};
  ft::odometry<typename TypeParam::exec_type, rig_type> odo(backend.exec, rig, params());
  auto const& f = walk()[0];
  auto const t = odo.track({{test::room::view(f.right), test::room::view(f.left),
                             test::room::view(f.left), ft::gray_view{}}},
                           period);
  expect(t, reason::few_depths, "a map needs 60");
  auto const dark = flat(1);
  // Image 3 does not exist, so it is not the dark one.
  auto const blind = odo.track(
      {{test::room::view(dark), test::room::view(dark), test::room::view(dark), ft::gray_view{}}},
      2 * period);
  expect(blind, reason::dark, "image 0");
}

// ---- without an odometry

TEST(explain_names, each_reason_has_its_own) {
  std::set<std::string> names;
  int const count = static_cast<int>(reason::few_matches) + 1;
  for (int i = 0; i < count; ++i) { names.insert(ft::name_of(static_cast<reason>(i))); }
  EXPECT_EQ(names.size(), static_cast<std::size_t>(count));
  EXPECT_STREQ(ft::name_of(reason::few_matches), "few_matches");
  EXPECT_STREQ(ft::name_of(static_cast<reason>(count)), "unknown");
  EXPECT_STREQ(ft::name_of(static_cast<reason>(-1)), "unknown");
}

TEST(explain_names, each_state_has_its_own) {
  std::set<std::string> names;
  for (int i = 0; i < 4; ++i) { names.insert(ft::name_of(static_cast<ft::tracking_state>(i))); }
  EXPECT_EQ(names.size(), 4u);
  EXPECT_STREQ(ft::name_of(ft::tracking_state::lost), "lost");
  EXPECT_STREQ(ft::name_of(static_cast<ft::tracking_state>(4)), "unknown");
}

}  // namespace explain_test
