// SPDX-License-Identifier: Apache-2.0
// Frames of an odometry, judged: which keypoints are near, and what follows for keyframes.
#include "ft/kernels/odometry/judge_frame.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <string>

#include "ft/cameras/multi_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"

namespace judge_frames_test {

constexpr int keypoints = 40;

struct arrays {
  ft::keypoints_view keypoints;
  int* holder = nullptr;
  float* depth = nullptr;
  int* inliers = nullptr;
  ft::pose* T_cw = nullptr;
  unsigned char* matched = nullptr;
  int* none = nullptr;
  ft::odometry_state_view state;
};

/// A frame that is tracked and has few points, on an executor.
template <typename Exec, typename Rig>
struct room {
  static constexpr int cameras = Rig::cameras;
  Exec const& exec;
  Rig rig;
  ft::tracking_rules rules;
  test::mirrored<Exec, arrays> data;

  room(Exec const& executor, Rig const& of)
      : exec(executor), rig(of), data([](ft::carver& c, arrays& v) {
          auto const n = static_cast<std::size_t>(cameras) * keypoints;
          carve(c, v.keypoints, keypoints, Rig::images);
          v.holder = c.take<int>(n);
          v.depth = c.take<float>(n);
          v.inliers = c.take<int>(1);
          v.T_cw = c.take<ft::pose>(1);
          v.matched = c.take<unsigned char>(n);
          v.none = c.take<int>(1);
          carve(c, v.state, 1);
        }) {
    rules.wanted_near_points = 10;
    rules.new_near_points = 5;
    rules.near_depth = 10;
    arrays const& v = data.host;
    std::fill_n(v.keypoints.count, Rig::images, keypoints);
    std::fill_n(v.holder, cameras * keypoints, -1);
    std::fill_n(v.depth, cameras * keypoints, -1.0f);
    *v.inliers = rules.min_inliers;
    *v.none = 0;
    *v.T_cw = ft::pose::identity();
    v.state.tracks[0] = ft::camera_track::initial();
    v.state.tracks[0].state = ft::tracking_state::tracking;
    v.state.tracks[0].plan = ft::search_plan::follow;
    v.state.T_cw[0] = ft::rigid<double>::identity();
  }
  /// Whether the frame becomes a keyframe with so many keypoints of camera c at a depth.
  bool asks_for_keyframe(int c, int count, float depth) {
    arrays const& v = data.host;
    std::fill_n(v.depth + c * keypoints, count, depth);
    ft::keyframe_order const order = judge();
    std::fill_n(v.depth + c * keypoints, count, -1.0f);
    return order == ft::keyframe_order::add;
  }
  ft::keyframe_order judge(bool begins_maps = true) {
    data.push(exec);
    arrays const& there = data.device;
    ft::searched_frames<Rig> in{};
    in.rig = rig;
    in.frame.keypoints = there.keypoints;
    in.frame.cameras = cameras;
    in.frame.batch = 1;
    in.frame.keypoint_step = Rig::images;
    in.frame.camera_step = Rig::images / cameras;
    in.frame.holder = there.holder;
    in.depth = there.depth;
    in.inliers = there.inliers;
    in.T_cw = there.T_cw;
    in.matched = there.matched;
    in.begins_maps = begins_maps;
    in.local.slot_count = there.none;
    ft::judge_frames(exec, rules, in, there.state);
    ft::keyframe_order order{};
    ft::copy(exec, &order, static_cast<ft::keyframe_order const*>(there.state.order), 1);
    ft::copy(exec, &track, static_cast<ft::camera_track const*>(there.state.tracks), 1);
    ft::copy(exec, &T_cw, static_cast<ft::rigid<double> const*>(there.state.T_cw), 1);
    exec.wait();
    return order;
  }
  // After judge().
  ft::camera_track track{};
  ft::rigid<double> T_cw{};
};

template <typename Backend>
class JudgeFrames : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(JudgeFrames, test::backends);

TYPED_TEST(JudgeFrames, NearIsMeasuredInBaselinesOfThePair) {
  TypeParam backend;
  ft::pinhole<float> const camera{400.0f, 400.0f, 320.0f, 240.0f};
  ft::multi_rig<3> const rig{{{camera, 0.1, ft::pose::identity()},
                              {camera, 0.4, ft::pose::identity()},
                              {camera, 0.2, ft::pose::identity()}}};
  room<typename TypeParam::exec_type, ft::multi_rig<3>> r(backend.exec, rig);
  float const limit[3] = {1, 4, 2};  // metres: ten baselines
  for (int c = 0; c < 3; ++c) {
    SCOPED_TRACE("camera " + std::to_string(c));
    EXPECT_TRUE(r.asks_for_keyframe(c, 6, limit[c]));
    EXPECT_FALSE(r.asks_for_keyframe(c, 5, limit[c])) << "too few new points";
    EXPECT_FALSE(r.asks_for_keyframe(c, 6, 1.01f * limit[c])) << "none is near";
  }
}

TYPED_TEST(JudgeFrames, NearIsMeasuredInTheBaselineOfARectifiedPair) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({400.0f, 400.0f, 320.0f, 240.0f}, 0.3);
  room<typename TypeParam::exec_type, ft::rectified_rig> r(backend.exec, rig);
  EXPECT_TRUE(r.asks_for_keyframe(0, 6, 2.99f));
  EXPECT_FALSE(r.asks_for_keyframe(0, 6, 3.01f));
}

/// A camera that was lost at x = 1 m in frames with enough points, and is thought to be at 2 m.
template <typename Room>
void lose(Room& r, int frames, bool guided) {
  ft::camera_track& t = r.data.host.state.tracks[0];
  r.rules.min_stereo_points = keypoints;
  std::fill_n(r.data.host.depth, keypoints, 1.0f);
  *r.data.host.inliers = 0;
  r.data.host.state.T_cw[0].t.x = 1;
  t.predicted.t.x = 2;
  t.state = ft::tracking_state::recovering;
  t.plan = ft::search_plan::recover;
  t.lost_frames = t.lost_with_features = frames;
  t.guided = guided ? 1 : 0;
  t.maps = 1;
  t.time_ns = 7;
}

TYPED_TEST(JudgeFrames, ALostCameraBeginsAMapOrGoesOnWithItWhereAnImuTells) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({400.0f, 400.0f, 320.0f, 240.0f}, 0.3);
  using room_type = room<typename TypeParam::exec_type, ft::rectified_rig>;
  for (bool const guided : {false, true}) {
    SCOPED_TRACE(guided);
    room_type r(backend.exec, rig);
    lose(r, r.rules.patience - 2, guided);
    EXPECT_EQ(r.judge(), ft::keyframe_order::none) << "too early";
    EXPECT_EQ(r.track.state, ft::tracking_state::recovering);
    lose(r, r.rules.patience - 1, guided);
    EXPECT_EQ(r.judge(), guided ? ft::keyframe_order::add : ft::keyframe_order::begin_map);
    EXPECT_EQ(r.track.state, ft::tracking_state::tracking);
    EXPECT_EQ(r.track.maps, guided ? 1 : 2);
    EXPECT_EQ(r.track.lost_frames, 0);
    EXPECT_EQ(r.track.lost_with_features, 0);
    EXPECT_EQ(r.track.seen_ns, guided ? 0 : 7) << "the map was not seen";
    EXPECT_EQ(r.track.new_keyframe, 1);
    EXPECT_EQ(r.T_cw.t.x, 2);
  }
}

TYPED_TEST(JudgeFrames, ALostCameraNeedsMoreThanOneThatIsFollowed) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({400.0f, 400.0f, 320.0f, 240.0f}, 0.3);
  room<typename TypeParam::exec_type, ft::rectified_rig> r(backend.exec, rig);
  r.rules.min_inliers = 11;
  r.rules.min_recovered = 17;
  struct judged {
    ft::search_plan plan;
    int inliers, min_evidence;
    bool found;
  };
  using plan = ft::search_plan;
  for (judged const& of :
       {judged{plan::follow, 10, 0, false}, judged{plan::follow, 11, 0, true},
        judged{plan::follow, 11, 1000, true}, judged{plan::recover, 11, 0, false},
        judged{plan::recover, 16, 0, false}, judged{plan::recover, 17, 0, true},
        judged{plan::recover, 17, 1, false}, judged{plan::nothing, 100, 0, false}}) {
    SCOPED_TRACE(std::to_string(static_cast<int>(of.plan)) + " " + std::to_string(of.inliers) +
                 " " + std::to_string(of.min_evidence));
    lose(r, 0, false);
    r.data.host.state.tracks[0].plan = of.plan;
    *r.data.host.inliers = of.inliers;
    r.rules.min_evidence = of.min_evidence;
    r.judge();
    EXPECT_EQ(r.track.state == ft::tracking_state::tracking, of.found);
  }
}

TYPED_TEST(JudgeFrames, PlacesThatWillBeLookedUpComeBeforeANewMap) {
  TypeParam backend;
  auto const rig = ft::rectified_rig::make({400.0f, 400.0f, 320.0f, 240.0f}, 0.3);
  room<typename TypeParam::exec_type, ft::rectified_rig> r(backend.exec, rig);
  lose(r, 100, false);
  EXPECT_EQ(r.judge(false), ft::keyframe_order::none);
  EXPECT_EQ(r.track.lost_with_features, 101);
  lose(r, 100, true);
  EXPECT_EQ(r.judge(false), ft::keyframe_order::add);
  lose(r, 0, false);
  r.data.host.state.tracks[0].state = ft::tracking_state::initialising;
  EXPECT_EQ(r.judge(false), ft::keyframe_order::begin_map) << "the first map";
}

}  // namespace judge_frames_test
