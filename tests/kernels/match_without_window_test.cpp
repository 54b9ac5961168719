// SPDX-License-Identifier: Apache-2.0
// Poses from matches anywhere in the image: three points, wrong matches, rigs, cameras that are
// lost, and the same bits on both executors.
#include "ft/kernels/odometry/match_without_window.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/kernels/motion/constant_velocity.hpp"
#include "ft/kernels/odometry/propose_pose.hpp"
#include "ft/kernels/odometry/refine_proposal.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace match_without_window_test {

using test::at;
constexpr int capacity = 400;
constexpr int slots = 2000;

struct arrays {
  ft::keypoints_view keypoints;
  ft::odometry_map_view map;
  ft::odometry_state_view state;
  ft::windowless_workspace work;
  int* last_holder = nullptr;
  int* inliers = nullptr;
  ft::pose* T_cw = nullptr;
};

/// A frame that sees the points that the last one held, from another pose.
struct scene {
  int right = 200;      ///< keypoints that see their point
  int wrong = 100;      ///< that have its descriptor elsewhere
  double turn = 0.3;    ///< rad, from the pose of the last frame
  float noise = 0.5f;   ///< pixels
  int lost_frames = 0;  ///< above 0: the points are those of the newest keyframe
  bool known_motion = false;
  int held = 0, inliers = 0;
  bool first_is_right = false;  ///< the pose of the search from the last frame
  float first_off = 0;          ///< metres, what it is off by
  bool refined = false;
  float width = 350;  ///< of the square of the image that has the right keypoints, pixels
  unsigned seed = 1;
};

template <typename Exec, typename Rig>
struct room {
  Exec const& exec;
  Rig rig = test::example_rig<Rig>();
  test::motion T_cw;  ///< the true pose
  test::mirrored<Exec, arrays> data;

  room(Exec const& on, scene const& s, int camera = 0)
      : exec(on),
        T_cw(test::turn({0.2, 1, 0.1}, s.turn, {0.4, -0.1, 0.3})),
        data([](ft::carver& c, arrays& v) {
          constexpr int numbers = Rig::cameras * capacity;
          carve(c, v.keypoints, capacity, Rig::images);
          carve(c, v.map, {slots, {4, Rig::cameras, capacity}}, 1);
          carve(c, v.state, 1);
          carve(c, v.work, numbers, 1);
          v.last_holder = c.take<int>(numbers);
          v.inliers = c.take<int>(1);
          v.T_cw = c.take<ft::pose>(1);
        }) {
    put(s, camera);
    data.push(exec);
    ft::windowless_search<Rig> in{};
    arrays const& there = data.device;
    in.rig = rig;
    in.frame.keypoints = there.keypoints;
    in.frame.cameras = Rig::cameras;
    in.frame.keypoint_step = Rig::images;
    in.frame.camera_step = Rig::images / Rig::cameras;
    in.map = there.map;
    in.last_holder = there.last_holder;
    in.geometry = ft::pyramid_geometry::make(640, 480, 1, 1.2f);
    in.inliers = there.inliers;
    in.T_cw = there.T_cw;
    ft::match_without_window(exec, in, rules, there.state, there.work);
    ft::propose_poses(exec, in, rules, there.state, there.work);
    if (s.refined) { ft::refine_proposals(exec, in, rules, there.state, there.work); }
    data.pull(exec);
  }
  ft::tracking_rules rules;
  ft::pose_proposal const& proposal() const { return data.host.work.proposals[0]; }
  /// Distance of the proposed centre from the true one, metres.
  double off() const {
    auto const d = proposal().T_cw.centre() - T_cw.centre();
    return std::sqrt(ft::dot(d, d));
  }

private:
  void put(scene const& s, int camera) {
    arrays const& v = data.host;
    test::generator random(s.seed);
    std::fill_n(v.last_holder, Rig::cameras * capacity, -1);
    std::fill_n(v.map.records.number, slots, 0);
    std::fill_n(v.map.keyframes.holder, 4 * Rig::cameras * capacity, -1);
    std::fill_n(v.keypoints.count, Rig::images, 0);
    int const image = camera * (Rig::images / Rig::cameras);
    auto const keypoints = v.keypoints.slice(image);
    ft::keyframes_view const& ring = v.map.keyframes;
    ring.made[0] = 3;
    ring.count[0] = 3;
    int n = 0;
    while (n < s.right + s.wrong) {
      // Within 90 degrees of the axis of each camera.
      float const last = 80 + (n < s.right ? s.width : 350);
      ft::vec2<float> const pixel{random.real(80, last), random.real(80, last)};
      auto const ray = test::model_of(rig, camera).unproject(pixel).direction;
      float const depth = random.real(1, 8) / ray.z;
      ft::vec3<float> in_camera{ray.x * depth, ray.y * depth, ray.z * depth};
      if (!(ray.z > 0.2f)) { continue; }
      ft::vec3<float> in_body = in_camera;
      if constexpr (Rig::rectified) { in_body = rig.to_body(camera, in_camera); }
      auto const world = T_cw.inverse() * in_body.template cast<double>();
      bool const is_right = n < s.right;
      int const slot = 3 * n + 1, k = n;
      v.map.points.slice(0).position(slot) = world.template cast<float>();
      ft::descriptor const d = random.descriptor();
      v.map.points.slice(0).orb(slot) = d;
      v.map.records.number[slot] = 100 + n;
      keypoints.orb(k) = random.flipped(d, 20);
      keypoints.x(k) = is_right ? pixel.x + random.real(-s.noise, s.noise) : random.real(0, 640);
      keypoints.y(k) = is_right ? pixel.y + random.real(-s.noise, s.noise) : random.real(0, 480);
      keypoints.octave(k) = 0;
      int const anchor = camera * capacity + (n * 7) % capacity;
      if (s.lost_frames > 0) {
        ring.holder[ring.at(0, ring.position(3), anchor)] = slot;
        // The slot of every tenth point belongs to another point now.
        ring.holder_number[ring.at(0, ring.position(3), anchor)] = n % 10 == 9 ? 1 : 100 + n;
      } else {
        v.last_holder[anchor] = slot;
      }
      ++n;
    }
    *keypoints.count = n;
    ft::camera_track t = ft::camera_track::initial();
    t.state = ft::tracking_state::tracking;
    t.time_ns = 77;
    t.lost_frames = s.lost_frames;
    t.held = s.held;
    if (s.known_motion) {
      t.velocity.observe(ft::rigid<double>::identity(), ft::rigid<double>::identity(), 100);
    }
    v.state.tracks[0] = t;
    v.inliers[0] = s.inliers;
    v.T_cw[0] = s.first_is_right ? T_cw.template cast<float>() : ft::pose::identity();
    v.T_cw[0].t.x += s.first_off;
  }
};

template <typename Backend>
class MatchWithoutWindow : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MatchWithoutWindow, test::backends);

template <typename Rig, typename Exec>
void finds_the_pose(Exec const& exec, int camera) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    scene s;
    s.seed = seed;
    room<Exec, Rig> const r(exec, s, camera);
    EXPECT_GE(r.proposal().matches, 280);
    EXPECT_GE(r.proposal().support, 190);
    EXPECT_LE(r.proposal().first_support, 20);
    EXPECT_EQ(r.proposal().adopted, 1);
    EXPECT_LT(r.off(), 0.05);
  }
}
TYPED_TEST(MatchWithoutWindow, FindsThePoseOfEachKindOfRig) {
  TypeParam backend;
  finds_the_pose<ft::rectified_rig>(backend.exec, 0);
  finds_the_pose<test::fisheye_rig>(backend.exec, 0);
  for (int c = 0; c < 3; ++c) { finds_the_pose<test::three_camera_rig>(backend.exec, c); }
}

TYPED_TEST(MatchWithoutWindow, FindsItAmongThreeWrongMatchesToOne) {
  TypeParam backend;
  scene s;
  s.right = 100;
  s.wrong = 300;
  room<typename TypeParam::exec_type, ft::rectified_rig> const r(backend.exec, s);
  EXPECT_GE(r.proposal().support, 90);
  EXPECT_EQ(r.proposal().adopted, 1);
  EXPECT_LT(r.off(), 0.05);
}

TYPED_TEST(MatchWithoutWindow, KeepsAFirstPoseThatIsRight) {
  TypeParam backend;
  scene s;
  s.first_is_right = true;
  for (bool refined : {false, true}) {
    s.refined = refined;
    room<typename TypeParam::exec_type, ft::rectified_rig> const r(backend.exec, s);
    EXPECT_GE(r.proposal().first_support, 195);
    EXPECT_EQ(r.proposal().adopted, 0);
  }
}

TYPED_TEST(MatchWithoutWindow, AFirstPoseThatIsAPixelOffIsLeft) {
  TypeParam backend;
  scene s;
  s.first_is_right = true;
  s.first_off = 0.01f;  // metres, at depths of 1 to 8
  s.wrong = 200;
  s.noise = 1;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  EXPECT_EQ(room_type(backend.exec, s).proposal().adopted, 0) << "less than a tenth better";
  s.refined = true;
  EXPECT_EQ(room_type(backend.exec, s).proposal().adopted, 1);
}

TYPED_TEST(MatchWithoutWindow, AdoptsNothingWhereNothingAgrees) {
  TypeParam backend;
  for (int wrong : {0, 3, 14, 400}) {
    SCOPED_TRACE(wrong);
    scene s;
    s.right = 0;
    s.wrong = wrong;
    room<typename TypeParam::exec_type, ft::rectified_rig> const r(backend.exec, s);
    EXPECT_EQ(r.proposal().adopted, 0);
    EXPECT_LT(r.proposal().support, r.rules.min_support);
  }
}

TYPED_TEST(MatchWithoutWindow, RunsForFramesInDoubtOnly) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  scene s;
  s.known_motion = true;
  s.held = 100;
  s.inliers = 50;
  EXPECT_EQ(room_type(backend.exec, s).proposal().matches, 0);
  s.inliers = 49;
  EXPECT_GT(room_type(backend.exec, s).proposal().matches, 0);
  s.inliers = 50;
  s.known_motion = false;
  EXPECT_GT(room_type(backend.exec, s).proposal().matches, 0);
}

TYPED_TEST(MatchWithoutWindow, ALostCameraIsFoundByAKeyframesPoints) {
  TypeParam backend;
  scene s;
  s.lost_frames = 2;
  s.known_motion = true;
  room<typename TypeParam::exec_type, ft::rectified_rig> const r(backend.exec, s);
  EXPECT_EQ(r.proposal().adopted, 1);
  EXPECT_LT(r.off(), 0.05);
  // Every tenth of its slots belongs to another point.
  EXPECT_LE(r.proposal().matches, 270);
  EXPECT_GE(r.proposal().matches, 250);
}

TYPED_TEST(MatchWithoutWindow, BothExecutorsHaveTheSameBits) {
  TypeParam backend;
  ft::host_exec const host;
  for (unsigned seed = 11; seed < 16; ++seed) {
    scene s;
    s.seed = seed;
    s.noise = 1;
    room<typename TypeParam::exec_type, test::fisheye_rig> const a(backend.exec, s);
    room<ft::host_exec, test::fisheye_rig> const b(host, s);
    EXPECT_EQ(a.proposal().support, b.proposal().support);
    EXPECT_EQ(std::memcmp(&a.proposal().T_cw, &b.proposal().T_cw, sizeof(ft::rigid<double>)), 0);
  }
}

template <typename Rig, typename Exec>
void refines_the_pose(Exec const& exec, int camera) {
  double drawn = 0, refined = 0;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    scene s;
    s.seed = seed;
    s.noise = 1;
    drawn += room<Exec, Rig>(exec, s, camera).off();
    s.refined = true;
    room<Exec, Rig> const r(exec, s, camera);
    refined += r.off();
    EXPECT_GE(r.proposal().support, 190);
    // 200 matches tell where points are within a fifth of a pixel.
    EXPECT_GE(r.proposal().search_factor, 1.0f);
    EXPECT_LT(r.proposal().search_factor, 1.1f);
  }
  EXPECT_LT(refined, 0.5 * drawn);
}
TYPED_TEST(MatchWithoutWindow, AllMatchesThatAgreeMakeThePoseBetter) {
  TypeParam backend;
  refines_the_pose<ft::rectified_rig>(backend.exec, 0);
  refines_the_pose<test::fisheye_rig>(backend.exec, 0);
  for (int c = 0; c < 3; ++c) { refines_the_pose<test::three_camera_rig>(backend.exec, c); }
}

TYPED_TEST(MatchWithoutWindow, FewMatchesInACornerAskForAWideSearch) {
  TypeParam backend;
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  auto const factor = [&](int right, float width) {
    scene s;
    s.right = right;
    s.wrong = 100;
    s.width = width;
    s.refined = true;
    room_type const r(backend.exec, s);
    EXPECT_EQ(r.proposal().adopted, 1);
    return r.proposal().search_factor;
  };
  EXPECT_GT(factor(25, 350), factor(200, 350));
  EXPECT_GT(factor(200, 30), factor(200, 350));
  EXPECT_EQ(factor(25, 30), ft::tracking_rules{}.matched_search);
}

TYPED_TEST(MatchWithoutWindow, RefinedPosesHaveTheSameBits) {
  TypeParam backend;
  ft::host_exec const host;
  auto const compare = [&](auto rig, scene const& s) {
    using rig_type = decltype(rig);
    room<typename TypeParam::exec_type, rig_type> const a(backend.exec, s);
    room<ft::host_exec, rig_type> const b(host, s);
    EXPECT_EQ(a.proposal().support, b.proposal().support);
    EXPECT_EQ(a.proposal().search_factor, b.proposal().search_factor);
    EXPECT_EQ(std::memcmp(&a.proposal().T_cw, &b.proposal().T_cw, sizeof(ft::rigid<double>)), 0);
  };
  for (unsigned seed = 21; seed < 26; ++seed) {
    scene s;
    s.seed = seed;
    s.noise = 2;
    s.right = 20 * static_cast<int>(seed - 20);
    s.refined = true;
    compare(test::example_rig<ft::rectified_rig>(), s);
    compare(test::example_rig<test::fisheye_rig>(), s);
    compare(test::example_rig<test::three_camera_rig>(), s);
  }
}

/// One pose for each solution; none for degenerate points.
TEST(ThreePoints, OneOfThePosesIsTheTrueOne) {
  using real = ft::strict_double;
  test::generator random(3);
  constexpr int problems = 2000;
  int found = 0;
  for (int p = 0; p < problems; ++p) {
    auto const value = [&] { return static_cast<double>(random.real(-1, 1)); };
    auto const T = test::turn({value(), value(), value()}, 3 * value(),
                              {3 * value(), 3 * value(), 3 * value()});
    ft::vec3<real> ray[3], point[3];
    for (int i = 0; i < 3; ++i) {
      double const z = 1 + 5 * std::abs(value());
      ft::vec3<double> const c{z * value(), z * value(), z};
      double const length = std::sqrt(ft::dot(c, c));
      ray[i] = ft::vec3<double>{c.x / length, c.y / length, c.z / length}.cast<real>();
      point[i] = (T.inverse() * c).cast<real>();
    }
    auto const all = ft::detail::three_point_solver(ray, point).solve();
    bool any = false;
    for (int i = 0; i < all.count; ++i) {
      auto const d = all.T_cw[i].template cast<double>().centre() - T.centre();
      any = any || std::sqrt(ft::dot(d, d)) < 1e-5;
    }
    found += static_cast<int>(any);
  }
  EXPECT_GE(found, problems * 995 / 1000);
}
TEST(ThreePoints, DegenerateOnesHaveNoPose) {
  using real = ft::strict_double;
  ft::vec3<real> const z{0.0, 0.0, 1.0};
  ft::vec3<real> const same[3] = {z, z, z};
  EXPECT_EQ(ft::detail::three_point_solver(same, same).solve().count, 0);
  double const nan = std::nan("");
  ft::vec3<real> const none[3] = {z, {nan, nan, nan}, z};
  EXPECT_EQ(ft::detail::three_point_solver(none, same).solve().count, 0);
  EXPECT_EQ(ft::detail::three_point_solver(same, none).solve().count, 0);
}

}  // namespace match_without_window_test
