// SPDX-License-Identifier: Apache-2.0
// Poses with the IMU, taken over or not: where map points and IMU agree, where they contradict each
// other once and again, and which frames tell little.
#include "ft/kernels/odometry/take_inertial.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"

namespace take_inertial_test {

constexpr int keypoints = 300;
constexpr int images = 6;  ///< of a rig, of which one or two cameras are looked at
constexpr int seen = 60;   ///< keypoints with a map point, all of them visual inliers

struct arrays {
  ft::keypoints_view keypoints;
  int* holder = nullptr;
  ft::pose* T_cw = nullptr;
  ft::observations_view observations;
  float* information = nullptr;
  ft::image_changes* changes = nullptr;
  unsigned* missing = nullptr;
  ft::odometry_state_view state;
  ft::inertial_view imu;
};

/// What became of a frame.
struct outcome {
  int inliers;
  int held;
  float x;  ///< of the pose: 1 by the map points, 2 with the IMU
  ft::inertial_track track;
};

template <typename Exec>
struct room {
  Exec const& exec;
  test::mirrored<Exec, arrays> data;
  bool tells_errors = false;  ///< of the images' poses
  int cameras = 1, camera_step = 1;

  explicit room(Exec const& on)
      : exec(on), data([](ft::carver& c, arrays& v) {
          carve(c, v.keypoints, keypoints, images);
          v.holder = c.take<int>(2 * keypoints);
          v.T_cw = c.take<ft::pose>(1);
          carve(c, v.observations, keypoints, 1);
          v.information = c.take<float>(ft::information_terms);
          v.changes = c.take<ft::image_changes>(images);
          v.missing = c.take<unsigned>(1);
          carve(c, v.state, 1);
          carve(c, v.imu, {4, 1, keypoints}, 1);
        }) {
    arrays const& v = data.host;
    std::fill_n(v.keypoints.count, images, keypoints);
    std::fill_n(v.changes, images, ft::image_changes{});
    *v.missing = 0;
    v.state.tracks[0] = ft::camera_track::initial();
    v.state.tracks[0].plan = ft::search_plan::follow;
    v.imu.tracks[0] = ft::inertial_track::initial();
    v.imu.tracks[0].keyframe_moves = 1;
    data.host.imu.mount =
        data.device.imu.mount = {ft::rigid<float>::identity(), ft::rigid<float>::identity()};
    v.imu.from_last(0) = {};
    v.imu.from_last(0).status = ft::integration_status::no_samples;
    v.imu.from_last(0).dR = ft::mat3<float>::identity();
    v.imu.poses.result[0] = {};
    v.imu.poses.result[0].status = ft::inertial_pose_status::optimised;
    v.imu.poses.result[0].stored.q_cw = {0, 0, 0, 1};
    v.imu.poses.result[0].stored.t_cw = {2, 0, 0};
  }
  /// The next frame. @param agree observations that are no outliers with the IMU
  outcome frame(int agree, int visual = seen, int all = seen,
                ft::inertial_source source = ft::inertial_source::last_keyframe) {
    arrays const& v = data.host;
    std::fill_n(v.holder, keypoints, -1);
    for (int i = 0; i < all; ++i) {
      v.observations.number[i] = 2 * i;
      v.observations.outlier[i] = i < agree ? 0 : 1;
      if (i < visual) { v.holder[2 * i] = 1000 + i; }
    }
    *v.observations.count = all;
    *v.observations.inliers = visual;
    *v.T_cw = ft::pose::identity();
    v.T_cw->t.x = 1;
    v.imu.tracks[0].source = source;
    v.imu.from_keyframe(0).status = ft::integration_status::integrated;
    data.push(exec);
    arrays const& there = data.device;
    ft::frame_view f;
    f.keypoints = there.keypoints;
    f.keypoint_step = images;
    f.cameras = cameras;
    f.camera_step = camera_step;
    f.holder = there.holder;
    ft::image_changes_view changes;
    changes.of = there.changes;
    changes.missing = there.missing;
    changes.images_of_rig = images;
    float const* const information = tells_errors ? there.information : nullptr;
    ft::take_inertial_poses(
        exec, {there.observations, there.state, f, information, there.T_cw, changes}, there.imu);
    data.pull(exec);
    auto const held = std::count_if(v.holder, v.holder + keypoints, [](int h) { return h >= 0; });
    return {*v.observations.inliers, static_cast<int>(held), v.T_cw->t.x, v.imu.tracks[0]};
  }
};

template <typename Backend>
class TakeInertialPoses : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(TakeInertialPoses, test::backends);

TYPED_TEST(TakeInertialPoses, TakesWhatHalfOfTheInliersAgreeWith) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  auto const o = r.frame(seen / 2);
  EXPECT_EQ(o.inliers, seen / 2);
  EXPECT_EQ(o.held, seen / 2) << "outliers release their points";
  EXPECT_EQ(o.x, 2);
  EXPECT_EQ(o.track.optimized, 1);
  auto const released = r.frame(seen, seen / 2);
  EXPECT_EQ(released.inliers, seen / 2) << "what the visual pose released stays so";
}

TYPED_TEST(TakeInertialPoses, FewMatchesThatContradictTheImuAreWrongTwice) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  for (int i = 1; i < ft::detail::most_contradictions; ++i) {
    auto const o = r.frame(seen / 2 - 1);
    EXPECT_EQ(o.inliers, 0) << i << ": the frame is not tracked";
    EXPECT_EQ(o.track.optimized, 0);
    EXPECT_EQ(o.track.contradicted, i);
    EXPECT_EQ(o.track.source, ft::inertial_source::last_keyframe);
    EXPECT_EQ(o.track.keyframe_moves, 1);
    EXPECT_EQ(o.track.weak, 1);
  }
  auto const o = r.frame(seen / 2 - 1);
  EXPECT_EQ(o.inliers, seen) << "the visual pose stands";
  EXPECT_EQ(o.held, seen);
  EXPECT_EQ(o.x, 1);
  EXPECT_EQ(o.track.optimized, 0);
  EXPECT_EQ(o.track.source, ft::inertial_source::none);
  EXPECT_EQ(o.track.keyframe_moves, 0);
  EXPECT_EQ(o.track.contradicted, 0);
}

TYPED_TEST(TakeInertialPoses, ManyMatchesOutvoteTheImuAtOnce) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  int const many = ft::detail::outvoting_matches;
  auto const link = [&] { return r.data.host.imu.from_keyframe(0).status; };
  auto const agreed = r.frame(7 * many / 8, many, many);
  EXPECT_EQ(agreed.inliers, 7 * many / 8);
  EXPECT_EQ(agreed.x, 2);
  EXPECT_EQ(link(), ft::integration_status::integrated);
  auto const o = r.frame(7 * many / 8 - 1, many, many);
  EXPECT_EQ(o.inliers, many) << "the visual pose stands";
  EXPECT_EQ(o.held, many);
  EXPECT_EQ(o.x, 1);
  EXPECT_EQ(o.track.optimized, 0);
  EXPECT_EQ(o.track.source, ft::inertial_source::none);
  EXPECT_EQ(o.track.keyframe_moves, 0);
  EXPECT_EQ(o.track.status, ft::integration_status::contradicted);
  EXPECT_EQ(link(), ft::integration_status::contradicted);
  EXPECT_FALSE(ft::usable(link()));
  EXPECT_EQ(r.frame(0, many - 1, many - 1).inliers, 0) << "fewer may be wrong ones that agree";
  EXPECT_EQ(link(), ft::integration_status::integrated);
}

// A sensor may be shaken once. If what was estimated after that is outvoted before it has agreed
// with a frame, its biases are others than before.
TYPED_TEST(TakeInertialPoses, WhatIsOutvotedAgainIsForgotten) {
  TypeParam backend;
  int const many = ft::detail::outvoting_matches;
  struct row {
    int between;  ///< agreeing observations of a frame between two that are outvoted; 0 = no frame
    int matches;  ///< of the second of these
    bool forgotten;
  };
  for (row const& c : {row{0, many, true}, row{many, many, false}, row{0, many - 1, false}}) {
    room<typename TypeParam::exec_type> r(backend.exec);
    ft::inertial_track& t = r.data.host.imu.tracks[0];
    t.estimates = 3;
    t.gyro_weight = 7;
    t.metric = 1;
    t.bias.gyro.x = t.last.bias.gyro.x = 0.05f;
    t.restarts = 0;
    ft::inertial_track const once = r.frame(0, many, many).track;
    EXPECT_EQ(once.estimates, 3);
    EXPECT_EQ(once.doubted, 1);
    EXPECT_EQ(once.bias.gyro.x, 0.05f);
    if (c.between > 0) { EXPECT_EQ(r.frame(c.between, many, many).track.doubted, 0); }
    ft::inertial_track const again = r.frame(0, c.matches, c.matches).track;
    EXPECT_EQ(again.known(), !c.forgotten);
    EXPECT_EQ(again.gyro_weight, c.forgotten ? 0 : 7);
    EXPECT_EQ(again.last.bias.gyro.x, c.forgotten ? 0 : 0.05f);
    EXPECT_EQ(again.stale, c.forgotten ? 1 : 0);
    EXPECT_EQ(again.metric, 1);
    EXPECT_EQ(again.restarts, 0) << "the integral from the keyframe is as it was";
    EXPECT_EQ(again.optimized, 0);
  }
}

// Nothing was estimated in between: there is nothing new that could be wrong.
TYPED_TEST(TakeInertialPoses, TurnsThatDifferAgainForgetNothing) {
  TypeParam backend;
  int const many = ft::detail::outvoting_matches;
  room<typename TypeParam::exec_type> r(backend.exec);
  ft::inertial_track& t = r.data.host.imu.tracks[0];
  t.estimates = 3;
  r.data.host.imu.from_last(0).status = ft::integration_status::integrated;
  r.data.host.imu.from_last(0).dR = {{0, -1, 0, 1, 0, 0, 0, 0, 1}};  // images: none
  r.frame(many, many, many);  // the turn since the frame before is not known yet
  for (int i = 0; i < 3; ++i) {
    ft::inertial_track const o = r.frame(many, many, many, ft::inertial_source::none).track;
    EXPECT_EQ(o.doubted, 1);
    EXPECT_EQ(o.estimates, 3);
    EXPECT_EQ(o.status, ft::integration_status::contradicted);
  }
}

TYPED_TEST(TakeInertialPoses, APoseFartherThanTheErrorsOfManyMatchesExplainIsNotTaken) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  r.tells_errors = true;
  int const many = ft::detail::outvoting_matches;
  // Both poses are a metre apart along x: so many standard deviations.
  auto const at = [&](float deviations) {
    std::fill_n(r.data.host.information, ft::information_terms, 0.0f);
    r.data.host.information[15] = deviations * deviations;  // of x
    return r.frame(many, many, many);
  };
  EXPECT_EQ(at(5).x, 2);
  auto const far = at(6);
  EXPECT_EQ(far.x, 1);
  EXPECT_EQ(far.inliers, many) << "the frame is tracked";
  EXPECT_EQ(far.track.status, ft::integration_status::contradicted);
  EXPECT_EQ(at(std::numeric_limits<float>::quiet_NaN()).x, 1);
  std::fill_n(r.data.host.information, ft::information_terms, 1e6f);
  EXPECT_EQ(r.frame(many - 1, many - 1, many - 1).x, 2) << "few matches may be wrong ones";
}

TYPED_TEST(TakeInertialPoses, WhereImagesAreBlurredThePosesMayBeFarApart) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  r.tells_errors = true;
  int const many = ft::detail::outvoting_matches;
  std::fill_n(r.data.host.information, ft::information_terms, 0.0f);
  r.data.host.information[15] = 36;  // a metre is six standard deviations
  auto* const of = r.data.host.changes;
  of[1].streaked = of[4].streaked = 1;
  EXPECT_EQ(r.frame(many, many, many).x, 1) << "another image is";
  of[0].streaked = 1;
  auto const blurred = r.frame(many, many, many);
  EXPECT_EQ(blurred.x, 2) << "all keypoints are displaced alike, which their errors do not say";
  EXPECT_EQ(blurred.track.optimized, 1);
  EXPECT_EQ(r.frame(7 * many / 8 - 1, many, many).x, 1) << "many that disagree still outvote it";
  r.cameras = 2;
  r.camera_step = 3;
  EXPECT_EQ(r.frame(many, many, many).x, 1) << "one image of two";
  of[3].streaked = 1;
  EXPECT_EQ(r.frame(many, many, many).x, 2);
  of[3].streaked = 0;
  *r.data.host.missing = 1u << 3;
  EXPECT_EQ(r.frame(many, many, many).x, 2) << "the other image is not there";
}

TYPED_TEST(TakeInertialPoses, AGyroscopeThatTurnsOtherwiseThanTheImagesIsNotUsed) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  int const many = ft::detail::outvoting_matches;
  EXPECT_EQ(r.frame(many, many, many).track.gyro_agrees, 0) << "of one frame nothing is known";
  auto const turned = [&](float angle) {  // the images say: not at all
    auto& turn = r.data.host.imu.from_last(0);
    turn.status = ft::integration_status::integrated;
    float const c = std::cos(angle), s = std::sin(angle);
    turn.dR = {{c, -s, 0, s, c, 0, 0, 0, 1}};
    return r.frame(many, many, many);
  };
  EXPECT_EQ(turned(0.019f).x, 2);
  EXPECT_EQ(r.data.host.imu.tracks[0].gyro_agrees, 1);
  auto const off = turned(0.021f);
  EXPECT_EQ(off.x, 1);
  EXPECT_EQ(off.inliers, many) << "the frame is tracked";
  EXPECT_EQ(off.track.gyro_agrees, 0);
  EXPECT_EQ(r.data.host.imu.from_keyframe(0).status, ft::integration_status::contradicted);
  EXPECT_EQ(turned(0).track.gyro_agrees, 1);
  r.data.host.changes->streaked = 1;
  EXPECT_EQ(turned(0.021f).x, 1) << "nor where images are blurred";
}

TYPED_TEST(TakeInertialPoses, AgreementForgetsContradictions) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  for (int i = 0; i < 2 * ft::detail::most_contradictions; ++i) {
    EXPECT_EQ(r.frame(0).inliers, 0) << i;
    EXPECT_EQ(r.frame(seen).inliers, seen) << i;
  }
}

TYPED_TEST(TakeInertialPoses, LeaveAloneWhatIsSearchedForOrWithoutAnImu) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  auto& plan = r.data.host.state.tracks[0].plan;
  plan = ft::search_plan::recover;
  auto const searched = r.frame(0);
  EXPECT_EQ(searched.inliers, seen);
  EXPECT_EQ(searched.x, 1);
  EXPECT_EQ(searched.track.contradicted, 0);
  plan = ft::search_plan::follow;
  auto& status = r.data.host.imu.poses.result[0].status;
  status = ft::inertial_pose_status::no_integral;
  auto const refused = r.frame(seen);
  EXPECT_EQ(refused.inliers, seen);
  EXPECT_EQ(refused.x, 1);
  EXPECT_EQ(refused.track.source, ft::inertial_source::none);
}

TYPED_TEST(TakeInertialPoses, FewInliersAmongTheKeypointsTellLittle) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  int const least = keypoints / ft::detail::weak_share;
  EXPECT_EQ(r.frame(least).track.weak, 0);
  EXPECT_EQ(r.frame(least - 1, least).track.weak, 1);
}

}  // namespace take_inertial_test
