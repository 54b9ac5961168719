// SPDX-License-Identifier: Apache-2.0
// An odometry with loops that only finds itself in a loaded map: anywhere in it, also after it was
// lost, and where a pose is given. The map stays byte for byte; elsewhere the camera stays lost.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace localize_anywhere_test {

using test::at;
using test::load;
using test::same;
using test::saved;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
constexpr int lap = 42;  ///< frames that make the map
constexpr int seen = 2 * lap;

/// Where the camera is after so many frames of the lap. @param up metres above where it was mapped
ft::pose pose_at(float frame, float up = 0) {
  ft::pose T_wc = test::room::on_lap(frame, lap);
  T_wc.t.y = -up;
  return T_wc;
}
template <typename Rig>
stereo_frame see(Rig const& rig, unsigned room, ft::pose const& T_wc) {
  static std::vector<test::room::image> const walls[] = {test::room::make_walls(0),
                                                         test::room::make_walls(1)};
  return test::room::see(rig, walls[room], T_wc.inverse());
}
/// Two frames for each that made the map: that one, and one half way to the next, 5 cm above.
float frame_of(int i) { return 0.5f * static_cast<float>(i); }
ft::pose seen_from(int i) { return pose_at(frame_of(i), i % 2 == 0 ? 0.0f : 0.05f); }
template <typename Rig>
std::vector<stereo_frame> const& walk(Rig const& rig) {
  static std::vector<stereo_frame> const all = [&] {
    std::vector<stereo_frame> made;
    for (int i = 0; i < seen; ++i) { made.push_back(see(rig, 0, seen_from(i))); }
    return made;
  }();
  return all;
}

ft::odometry_params params(bool localize_only) {
  auto p = test::room::odometry_params(8192);
  p.window = {4, 2};
  p.keyframes = 12;  // the map itself is a quarter of the lap
  p.local_map.keyframes = 8;
  p.loops.present = true;
  p.loops.recent = 20;
  p.rules.localize_only = localize_only;
  return p;
}

template <typename Odometry>
ft::tracking track(Odometry& odo, stereo_frame const& f, std::int64_t time) {
  return odo.track(images_of(f), time);
}
/// The map of a lap and a little. @return its file
template <typename Exec, typename Rig>
std::string const& mapped(Exec const& exec, Rig const& rig) {
  static std::string const map = [&] {
    ft::odometry<Exec, Rig> maps(exec, rig, params(false), 1, ft::loops{});
    for (int i = 0; i < lap + 8; ++i) {
      EXPECT_EQ(track(maps, walk(rig)[at(2 * i % seen)], (i + 1) * period).state,
                ft::tracking_state::tracking);
    }
    return saved(maps);
  }();
  return map;
}
struct difference {
  double m, rad;
};
/// From the truth, seen from the keyframe of the loaded map that is nearest in the lap. Keyframes
/// of this map are up to 35 mm from their places.
template <typename Odometry>
difference off(Odometry const& odo, ft::tracking const& told, int i) {
  ft::placed_keyframe nearest{};
  double least = 1e9;
  for (ft::placed_keyframe const& k : odo.placed_keyframes()) {
    auto const frame = static_cast<double>((k.time_ns / period - 1) % lap);
    double const apart = std::remainder(frame - frame_of(i), lap);
    if (std::abs(apart) < least) {
      least = std::abs(apart);
      nearest = k;
    }
  }
  auto const frame = static_cast<float>((nearest.time_ns / period - 1) % lap);
  auto const want = pose_at(frame).inverse().cast<double>() * seen_from(i).cast<double>();
  auto const d = want.inverse() * (nearest.T_world_camera.inverse() * told.T_world_camera);
  double const cosine = (d.R.m[0] + d.R.m[4] + d.R.m[8] - 1) / 2;
  return {std::sqrt(ft::dot(d.t, d.t)), std::acos(cosine > 1 ? 1 : cosine)};
}
template <typename Odometry>
void expect_there(Odometry const& odo, ft::tracking const& told, int i) {
  ASSERT_EQ(told.state, ft::tracking_state::tracking) << i;
  EXPECT_EQ(told.map_id, 1);
  EXPECT_FALSE(told.keyframe || told.map_begun) << i;
  difference const d = off(odo, told, i);
  // Where little of the map is in sight it is as far off as it says.
  double const sigma = std::sqrt(told.covariance[21] + told.covariance[28] + told.covariance[35]);
  EXPECT_LT(sigma, 0.03) << i;
  EXPECT_LT(d.m, std::max(0.03, 3 * sigma)) << i;
  EXPECT_LT(d.rad, 0.0174533) << i;
}

template <typename Backend>
class LocalizeAnywhere : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(LocalizeAnywhere, test::backends);

template <typename Exec, typename Rig>
void starts_anywhere(Exec const& exec, Rig const& rig) {
  std::string const& map = mapped(exec, rig);
  ft::odometry<Exec, Rig> odo(exec, rig, params(true), 1, ft::loops{});
  for (int from = 1; from < seen - 3; from += 8) {  // half way between frames that made the map
    load(odo, map);
    std::int64_t time = 0;
    ft::tracking told;
    for (int i = from; i < from + 3; ++i) { told = track(odo, walk(rig)[at(i)], time += period); }
    expect_there(odo, told, from + 2);
  }
  EXPECT_TRUE(saved(odo) == map) << "the map has changed";
}
TYPED_TEST(LocalizeAnywhere, APairIsFoundInThreeFrames) {
  TypeParam backend;
  starts_anywhere(backend.exec, test::room::rig());
}
TYPED_TEST(LocalizeAnywhere, TwoFisheyeCamerasAreFoundInThreeFrames) {
  TypeParam backend;
  starts_anywhere(backend.exec, test::room::fisheye());
}

TYPED_TEST(LocalizeAnywhere, ItIsTrackedAllAroundAndFoundAgain) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  std::string const& map = mapped(backend.exec, rig);
  odometry odo(backend.exec, rig, params(true), 1, ft::loops{});
  load(odo, map);
  std::int64_t time = 0;
  int lost = 0;
  for (int k = 0; k < seen; ++k) {
    int const i = (seen / 2 + k) % seen;
    ft::tracking const told = track(odo, walk(rig)[at(i)], time += period);
    lost += told.state == ft::tracking_state::tracking ? 0 : 1;
    if (told.state == ft::tracking_state::tracking) { expect_there(odo, told, i); }
  }
  EXPECT_LE(lost, 2);
  // In another room it is lost for as long as that lasts.
  auto const other = test::room::make_walk(rig, 1, 8);
  for (stereo_frame const& f : other) {
    EXPECT_NE(track(odo, f, time += period).state, ft::tracking_state::tracking);
  }
  for (int const from : {12, 50, 31}) {
    ft::tracking told;
    for (int i = from; i < from + 3; ++i) { told = track(odo, walk(rig)[at(i)], time += period); }
    expect_there(odo, told, from + 2);
    for (stereo_frame const& f : other) { track(odo, f, time += period); }
  }
  EXPECT_EQ(odo.last().maps, 1);
  EXPECT_TRUE(saved(odo) == map) << "the map has changed";
}

TYPED_TEST(LocalizeAnywhere, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  std::string const& map = mapped(backend.exec, rig);
  ft::host_exec const host(1);
  odometry odo(backend.exec, rig, params(true), 1, ft::loops{});
  ft::odometry<ft::host_exec> on_host(host, rig, params(true), 1, ft::loops{});
  load(odo, map);
  load(on_host, map);
  std::int64_t time = 0;
  for (int i = 21; i < 60; ++i) {
    auto const& f = walk(rig)[at(i)];
    ft::tracking const a = track(odo, f, time += period), b = track(on_host, f, time);
    EXPECT_EQ(a.state, b.state) << i;
    EXPECT_EQ(a.inliers, b.inliers) << i;
    EXPECT_TRUE(same(a.T_world_camera, b.T_world_camera)) << i;
  }
}

// The path of the map was corrected, by more at its end than where the ring of keyframes begins. A
// frame that became a keyframe is where that is.
TYPED_TEST(LocalizeAnywhere, TheCorrectionIsThatOfThePlaceInTheMap) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry odo(backend.exec, rig, params(true), 1, ft::loops{});
  load(odo, mapped(backend.exec, rig));
  auto const placed = odo.placed_keyframes();
  auto const apart = [](ft::rigid<double> const& a, ft::rigid<double> const& b) {
    auto const d = (a.inverse() * b).t;
    return std::sqrt(ft::dot(d, d));
  };
  auto const newest = placed.back().T_world_camera * placed.back().T_odom_camera.inverse();
  // The keyframe's keypoints were moved to those of keyframes before, a frame's in a loaded map are
  // not.
  constexpr double exact = 0.008;
  double by_place = 0, by_newest = 0;
  ASSERT_GT(placed.size(), 12u);
  for (std::size_t k = placed.size() - 12; k < placed.size(); ++k) {
    load(odo, mapped(backend.exec, rig));
    auto const frame = static_cast<int>((placed[k].time_ns / period - 1) % lap);
    ft::tracking const told = track(odo, walk(rig)[at(2 * frame)], period);
    ASSERT_EQ(told.state, ft::tracking_state::tracking) << k;
    EXPECT_LT(apart(told.T_world_camera, placed[k].T_world_camera), exact) << k;
    EXPECT_LT(apart(told.T_world_camera, told.T_world_odom * told.T_odom_camera), 1e-9) << k;
    by_place += apart(told.T_world_camera, placed[k].T_world_camera);
    by_newest += apart(newest * told.T_odom_camera, placed[k].T_world_camera);
  }
  EXPECT_LT(by_place, 0.75 * by_newest) << "the end of the path is corrected by more";
}

// With too few votes for a place to be recognised by descriptors.
TYPED_TEST(LocalizeAnywhere, APoseThatIsGivenIsTakenFirst) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  auto p = params(true);
  p.loops.min_votes = p.loops.votes;
  odometry odo(backend.exec, rig, p, 1, ft::loops{});
  constexpr int i = 41;
  for (bool const given : {false, true}) {
    load(odo, mapped(backend.exec, rig));
    auto guess =
        pose_at(0).inverse().template cast<double>() * seen_from(i).template cast<double>();
    guess.t.x += 0.03;
    if (given) { odo.predict(guess); }
    ft::tracking const told = track(odo, walk(rig)[at(i)], period);
    if (!given) { EXPECT_NE(told.state, ft::tracking_state::tracking); }
    if (given) { expect_there(odo, told, i); }
  }
}

}  // namespace localize_anywhere_test
