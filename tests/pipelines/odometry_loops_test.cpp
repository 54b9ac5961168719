// SPDX-License-Identifier: Apache-2.0
// An odometry with loops: a camera on a circle is recognised where it began, the odometry itself is
// not changed, corrections enter when they must, and what cannot have loops is refused.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <string>
#include <vector>

#include "ft/cameras/multi_rig.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace odometry_loops_test {

using test::at;
using test::same;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
constexpr int lap = 42;
constexpr int frames = lap + 12;

ft::pose pose_at(int i) { return test::room::on_lap(static_cast<float>(i), lap); }
template <typename Rig>
stereo_frame see(Rig const& rig, int i) {
  static auto const walls = test::room::make_walls(0);
  return test::room::see(rig, walls, pose_at(i).inverse());
}
template <typename Rig>
std::vector<stereo_frame> const& walk(Rig const& rig) {
  static std::vector<stereo_frame> const all = [&] {
    std::vector<stereo_frame> made;
    for (int i = 0; i < frames; ++i) { made.push_back(see(rig, i)); }
    return made;
  }();
  return all;
}

ft::odometry_params params(bool with_loops = true) {
  auto p = test::room::odometry_params(8192);
  p.window = {4, 2};
  p.keyframes = 12;  // the odometry itself has forgotten where it began
  p.local_map.keyframes = 8;
  p.loops.present = with_loops;
  p.loops.recent = 20;
  return p;
}

struct answers {
  std::vector<ft::tracking> told;
  std::vector<ft::placed_keyframe> placed;
  std::vector<ft::closed_loop> loops;
  int closed = 0;
};
template <typename Odometry, typename Rig>
answers run(Odometry& odo, Rig const& rig, int count = frames) {
  answers a;
  for (int i = 0; i < count; ++i) {
    auto const& f = walk(rig)[at(i)];
    a.told.push_back(odo.track(images_of(f), (i + 1) * period));
    a.closed += a.told.back().loops_closed;
  }
  a.placed = odo.placed_keyframes();
  a.loops = odo.closed_loops();
  return a;
}
/// How far the camera is from its place, metres. The world is the first frame's camera.
double off(ft::rigid<double> const& T_world_camera, int i) {
  auto const want = pose_at(0).inverse().cast<double>() * pose_at(i).cast<double>();
  auto const d = T_world_camera.t - want.t;
  return std::sqrt(ft::dot(d, d));
}

/// The loops that were told are those of a lap, and their motions are the true ones.
void expect_true_loops(answers const& a) {
  EXPECT_EQ(static_cast<int>(a.loops.size()), a.closed);
  for (ft::closed_loop const& l : a.loops) {
    ASSERT_TRUE(l.from >= 0 && l.from < l.to && at(l.to) < a.placed.size());
    EXPECT_EQ(l.from_time_ns, a.placed[at(l.from)].time_ns);
    EXPECT_EQ(l.to_time_ns, a.placed[at(l.to)].time_ns);
    EXPECT_GE(l.inliers, params().loops.min_inliers);
    EXPECT_EQ(l.scale, 1);
    auto const place = [](std::int64_t time_ns) {
      return pose_at(static_cast<int>(time_ns / period) - 1).template cast<double>();
    };
    auto const want = place(l.from_time_ns).inverse() * place(l.to_time_ns);
    auto const d = l.T_from_to.t - want.t;
    EXPECT_LT(std::sqrt(ft::dot(d, d)), 0.03) << l.from << " to " << l.to;
  }
}

template <typename Backend>
class OdometryLoops : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(OdometryLoops, test::backends);

template <typename Exec, typename Rig>
void closes_a_lap(Exec const& exec, Rig const& rig) {
  ft::odometry<Exec, Rig> odo(exec, rig, params(), 1, ft::loops{});
  ft::odometry<Exec, Rig> plain(exec, rig, params(false));
  answers const with = run(odo, rig);
  answers const without = run(plain, rig);
  EXPECT_GT(with.closed, 0);
  EXPECT_TRUE(without.placed.empty() && without.loops.empty());
  expect_true_loops(with);
  ASSERT_GT(with.placed.size(), 20u);
  int before = 0;
  for (int i = 0; i < frames; ++i) {
    ft::tracking const& t = with.told[at(i)];
    ASSERT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_TRUE(same(t.T_odom_camera, without.told[at(i)].T_world_camera)) << i;
    EXPECT_TRUE(same(without.told[at(i)].T_odom_camera, without.told[at(i)].T_world_camera)) << i;
    auto const product = (t.T_world_odom * t.T_odom_camera).t - t.T_world_camera.t;
    EXPECT_LT(std::sqrt(ft::dot(product, product)), 1e-12) << i;
    if (t.loops_closed > 0 && before == 0) { before = i; }
  }
  // Nothing is closed before the camera is back, less the frames that see the same things.
  EXPECT_GT(before, lap - 8);
  EXPECT_LT(off(with.told.back().T_world_camera, frames - 1), 0.03);
  for (auto const& k : with.placed) {
    int const i = static_cast<int>(k.time_ns / period) - 1;
    auto const d = k.T_odom_camera.t - with.told[at(i)].T_odom_camera.t;
    EXPECT_EQ(ft::dot(d, d), 0) << i;
    EXPECT_LT(off(k.T_world_camera, i), 0.035) << i;
  }
}
TYPED_TEST(OdometryLoops, ARectifiedPairIsRecognisedWhereItBegan) {
  TypeParam backend;
  closes_a_lap(backend.exec, test::room::rig());
}
TYPED_TEST(OdometryLoops, TwoFisheyeCamerasAreRecognisedWhereTheyBegan) {
  TypeParam backend;
  closes_a_lap(backend.exec, test::room::fisheye());
}

TYPED_TEST(OdometryLoops, AMapThatALostCameraBeginsIsJoinedWithTheFirstOne) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const rig = test::room::rig();
  ft::odometry<exec_type> odo(backend.exec, rig, params(), 1, ft::loops{});
  test::room::image const black(at(test::room::width) * at(test::room::height));
  std::vector<int> places;  // in the walk; -1 = black
  for (int i = 0; i < lap / 2 + 3; ++i) { places.push_back(i); }
  for (int i = 0; i < 3; ++i) { places.push_back(-1); }
  for (int i = 2; i < lap / 2; ++i) { places.push_back(i); }  // carried back
  std::vector<ft::tracking> told;
  for (std::size_t k = 0; k < places.size(); ++k) {
    auto const& f = walk(rig)[at(places[k] < 0 ? 0 : places[k])];
    auto const& left = places[k] < 0 ? black : f.left;
    auto const& right = places[k] < 0 ? black : f.right;
    told.push_back(odo.track({test::room::view(left), test::room::view(right)},
                             static_cast<std::int64_t>(k + 1) * period));
  }
  ASSERT_EQ(told.back().maps, 2);
  bool guessed = false;
  for (std::size_t k = at(lap / 2 + 6); k < told.size(); ++k) {
    guessed = guessed || (told[k].map_id == 2 && off(told[k].T_world_camera, places[k]) > 0.3);
  }
  EXPECT_TRUE(guessed) << "the second map is where the first one says anyway";
  EXPECT_LT(off(told.back().T_world_camera, places.back()), 0.05);
  EXPECT_EQ(told.back().map_id, 1);
  for (auto const& k : odo.placed_keyframes()) {
    EXPECT_EQ(k.map, 1);
    EXPECT_FALSE(k.loaded);
    EXPECT_LT(off(k.T_world_camera, places[at(k.time_ns / period - 1)]), 0.06);
  }
}

void expect_same(answers const& a, answers const& b) {
  ASSERT_EQ(a.told.size(), b.told.size());
  for (std::size_t i = 0; i < a.told.size(); ++i) {
    EXPECT_EQ(a.told[i].loops_closed, b.told[i].loops_closed) << i;
    EXPECT_TRUE(same(a.told[i].T_world_camera, b.told[i].T_world_camera)) << i;
    EXPECT_TRUE(same(a.told[i].T_world_odom, b.told[i].T_world_odom)) << i;
  }
  ASSERT_EQ(a.placed.size(), b.placed.size());
  for (std::size_t i = 0; i < a.placed.size(); ++i) {
    EXPECT_TRUE(same(a.placed[i].T_world_camera, b.placed[i].T_world_camera)) << i;
  }
}
TYPED_TEST(OdometryLoops, BothExecutorsHaveTheSameBitsAndSoHaveTwoRuns) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const rig = test::room::rig();
  ft::odometry<exec_type> odo(backend.exec, rig, params(), 1, ft::loops{});
  answers const first = run(odo, rig);
  ft::host_exec const host(1);
  ft::odometry<ft::host_exec> on_host(host, rig, params(), 1, ft::loops{});
  answers const other = run(on_host, rig);
  EXPECT_GT(first.closed, 0);
  expect_same(first, other);
  odo.reset();
  EXPECT_TRUE(odo.placed_keyframes().empty());
  expect_same(run(odo, rig), other);
}

TYPED_TEST(OdometryLoops, AResetOrALoadedMapForgetsThemAlsoDuringASearch) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const rig = test::room::rig();
  ft::odometry<exec_type> odo(backend.exec, rig, params(), 1, ft::loops{});
  for (int const count : {1, lap + 3, 22, 23}) {  // in the middle of a search, or not
    run(odo, rig, count);
    odo.reset();
    EXPECT_TRUE(odo.placed_keyframes().empty());
  }
  run(odo, rig, 5);
  ft::odometry<exec_type> plain(backend.exec, rig, params(false));
  run(plain, rig, 5);
  std::stringstream file;
  plain.save_map(file);
  odo.load_map(file);
  EXPECT_TRUE(odo.placed_keyframes().empty());
}

/// The map, and the loops, of the first frames of a walk.
template <typename Odometry, typename Rig>
std::string saved_after(Odometry& odo, Rig const& rig, int count) {
  run(odo, rig, count);
  return test::saved(odo);
}

// Far from the newest keyframe, where a map without loops begins anew.
TYPED_TEST(OdometryLoops, ASavedMapIsFoundFromAnywhere) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry first(backend.exec, rig, params(), 1, ft::loops{});
  std::istringstream file(saved_after(first, rig, lap / 2 + 8));
  odometry second(backend.exec, rig, params(), 1, ft::loops{});
  second.load_map(file);
  auto const before = second.placed_keyframes();
  auto const were = first.placed_keyframes();
  ASSERT_EQ(before.size(), were.size());
  EXPECT_EQ(second.closed_loops().size(), first.closed_loops().size());
  for (std::size_t k = 0; k < before.size(); ++k) {
    EXPECT_TRUE(before[k].loaded && !were[k].loaded);
    EXPECT_EQ(before[k].time_ns, were[k].time_ns);
    EXPECT_EQ(before[k].map, 1);
    EXPECT_TRUE(same(before[k].T_world_camera, were[k].T_world_camera));
    EXPECT_TRUE(same(before[k].T_odom_camera, were[k].T_odom_camera));
  }
  ft::tracking told;
  int closed = 0;
  constexpr int from = 2, to = lap / 2 - 2;
  for (int i = from; i < to; ++i) {
    auto const& f = walk(rig)[at(i)];
    told = second.track(images_of(f), (i + 1) * period);
    closed += told.loops_closed;
  }
  EXPECT_EQ(told.maps, 2) << "found near the newest keyframe: this tests nothing";
  EXPECT_GT(closed, 0);
  EXPECT_LT(off(told.T_world_camera, to - 1), 0.05);
  EXPECT_EQ(told.map_id, 1) << "joined with the loaded one";
  auto const placed = second.placed_keyframes();
  ASSERT_GT(placed.size(), before.size());
  for (std::size_t k = 0; k < placed.size(); ++k) {
    EXPECT_EQ(placed[k].map, 1) << k;
    EXPECT_EQ(placed[k].loaded, k < before.size()) << k;
  }
  for (ft::closed_loop const& l : second.closed_loops()) {
    EXPECT_TRUE(placed[at(l.from)].loaded && !placed[at(l.to)].loaded);
  }
}

TYPED_TEST(OdometryLoops, ItIsFoundInThreeFrames) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry odo(backend.exec, rig, params(), 1, ft::loops{});
  std::string const bytes = saved_after(odo, rig, lap - 2);
  for (int from = 1; from < lap - 8; from += 4) {
    std::istringstream file(bytes);
    odo.load_map(file);
    ft::tracking told;
    for (int i = from; i < from + 3; ++i) {
      auto const& f = walk(rig)[at(i)];
      told = odo.track(images_of(f), (i + 1) * period);
    }
    EXPECT_EQ(told.state, ft::tracking_state::tracking) << from;
    EXPECT_LT(off(told.T_world_camera, from + 2), 0.05) << from;
  }
}

TYPED_TEST(OdometryLoops, ACameraInAnotherRoomIsNotFound) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry odo(backend.exec, rig, params(), 1, ft::loops{});
  std::istringstream file(saved_after(odo, rig, lap / 2));
  odo.load_map(file);
  constexpr int given = 29;
  int const looked_for = given + 1 - params().rules.patience;  // each frame of the new map is
  auto const other = test::room::make_walk(rig, 1, given);
  ft::tracking told;
  for (int i = 0; i < given; ++i) {
    auto const& f = other[at(i)];
    told = odo.track(images_of(f), (i + 1) * period);
    EXPECT_EQ(told.loops_closed, 0) << i;
  }
  EXPECT_EQ(told.maps, 2);
  EXPECT_EQ(told.map_id, 2);
  auto const placed = odo.placed_keyframes();
  EXPECT_EQ(placed.front().map, 1);
  EXPECT_EQ(std::count_if(placed.begin(), placed.end(), [](auto const& k) { return k.map == 2; }),
            looked_for);
}

// A file with loops, from the middle of a search: what they correct is known before a frame.
TYPED_TEST(OdometryLoops, ASavedCorrectionIsThatOfThePrediction) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry first(backend.exec, rig, params(), 1, ft::loops{});
  std::istringstream file(saved_after(first, rig, frames - 1));
  auto const newest = first.placed_keyframes().back();
  auto const correction =
      (newest.T_world_camera * newest.T_odom_camera.inverse()).orthonormalized();
  auto const last = [](odometry& odo, ft::rigid<double> const& T_world_camera) {
    odo.predict(T_world_camera);
    auto const& f = walk(odo.rig())[at(frames - 1)];
    return odo.track(images_of(f), frames * period);
  };
  auto const T =
      pose_at(0).inverse().template cast<double>() * pose_at(frames - 1).template cast<double>();
  odometry second(backend.exec, rig, params(), 1, ft::loops{});
  second.load_map(file);
  ft::tracking const t = last(second, T);
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
  EXPECT_EQ(t.maps, 1);
  EXPECT_TRUE(same(t.T_world_odom, correction)) << "the one that was saved";
  EXPECT_FALSE(same(t.T_world_odom, ft::rigid<double>::identity()));
  EXPECT_LT(off(t.T_world_camera, frames - 1), 0.03);
}

TYPED_TEST(OdometryLoops, ADamagedFileChangesNothing) {
  TypeParam backend;
  using odometry = ft::odometry<typename TypeParam::exec_type>;
  auto const rig = test::room::rig();
  odometry odo(backend.exec, rig, params(), 1, ft::loops{});
  std::string const whole = saved_after(odo, rig, 12);
  auto const placed = odo.placed_keyframes();
  ASSERT_FALSE(placed.empty());
  auto const refused = [&](std::string const& bytes) {
    std::istringstream file(bytes);
    EXPECT_THROW(odo.load_map(file), ft::error);
    EXPECT_EQ(odo.placed_keyframes().size(), placed.size());
  };
  std::size_t const begin = whole.find("ft loop archive");
  ASSERT_NE(begin, std::string::npos);
  for (std::size_t const bytes : {begin, begin + 20, begin + 40, whole.size() - 1}) {
    refused(whole.substr(0, bytes));
  }
  for (std::size_t at = begin; at < whole.size(); at += 1 + (whole.size() - begin) / 31) {
    std::string bytes = whole;
    bytes[at] = static_cast<char>(bytes[at] ^ 0x10);
    refused(bytes);
  }
  odometry plain(backend.exec, rig, params(false));
  std::istringstream file(whole), without(saved_after(plain, rig, 5));
  EXPECT_THROW(plain.load_map(file), ft::error) << "an odometry without loops";
  odo.load_map(without);
  EXPECT_TRUE(odo.placed_keyframes().empty());
}

TYPED_TEST(OdometryLoops, APredictionIsOneInTheWorld) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const rig = test::room::rig();
  auto const after = [&](bool predict) {
    auto p = params();
    p.align_keypoints = false;  // from another start they end up to 1/64 pixel elsewhere
    ft::odometry<exec_type> odo(backend.exec, rig, p, 1, ft::loops{});
    answers const a = run(odo, rig, frames - 1);
    EXPECT_GT(a.closed, 0);
    auto const next = pose_at(frames - 2).inverse().template cast<double>() *
                      pose_at(frames - 1).template cast<double>();
    if (predict) { odo.predict(a.told.back().T_world_camera * next); }
    auto const& f = walk(rig)[at(frames - 1)];
    return odo.track(images_of(f), frames * period);
  };
  auto const d = after(true).T_world_camera.t - after(false).T_world_camera.t;
  EXPECT_LT(std::sqrt(ft::dot(d, d)), 1e-5);  // 2e-3 where it is one of the odometry
}

TYPED_TEST(OdometryLoops, RefusesWhatCannotHaveLoops) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const rig = test::room::rig();
  using odometry = ft::odometry<exec_type>;
  auto const make = [&](ft::odometry_params const& p, int batch) {
    odometry(backend.exec, rig, p, batch, ft::loops{});
  };
  EXPECT_THROW(make(params(), 2), ft::bad_argument);
  EXPECT_THROW(make(params(false), 1), ft::bad_argument);
  EXPECT_THROW(odometry(backend.exec, rig, params(), 1), ft::bad_argument);
  for (auto const& change : std::vector<void (*)(ft::loop_params&)>{
           [](ft::loop_params& p) { p.keyframes = 100; }, [](ft::loop_params& p) { p.points = 3; },
           [](ft::loop_params& p) { p.min_votes = p.votes + 1; },
           [](ft::loop_params& p) { p.min_share = std::nanf(""); },
           [](ft::loop_params& p) { p.max_drift = -1; },
           [](ft::loop_params& p) { p.max_scale_drift = std::nanf(""); },
           [](ft::loop_params& p) { p.recent = 0; },
           [](ft::loop_params& p) { p.recent = p.keyframes; },
           [](ft::loop_params& p) { p.min_inliers = p.points + 1; }}) {
    auto p = params();
    change(p.loops);
    EXPECT_THROW(make(p, 1), ft::bad_argument);
  }
}

}  // namespace odometry_loops_test
