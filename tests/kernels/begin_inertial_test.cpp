// SPDX-License-Identifier: Apache-2.0
// From what the state of a frame is predicted with an IMU, and when it is not.
#include "ft/kernels/odometry/begin_inertial.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/pipelines/detail/odometry_inertial.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/plain_map.hpp"

namespace begin_inertial_test {

constexpr std::int64_t second = 1'000'000'000;
constexpr float dT = 0.5f;

struct arrays {
  ft::keyframes_view keyframes;
  ft::inertial_view imu;
  ft::odometry_state_view state;
  ft::odometry_input* input = nullptr;
  ft::pose* T_cw = nullptr;
};

/// A camera at the origin that moves along x by 2 m/s, without gravity, and its next frame.
template <typename Exec>
struct room {
  Exec const& exec;
  test::mirrored<Exec, arrays> data;

  explicit room(Exec const& on)
      : exec(on), data([](ft::carver& c, arrays& v) {
          carve(c, v.keyframes, {4, 1, 1}, 1);
          carve(c, v.imu, {4, 1, 1}, 1);
          carve(c, v.state, 1);
          v.input = c.take<ft::odometry_input>(1);
          v.T_cw = c.take<ft::pose>(1);
        }) {
    arrays const& v = data.host;
    *v.input = {};
    *v.T_cw = ft::pose::identity();
    v.keyframes.made[0] = v.keyframes.count[0] = 1;
    v.state.apply[0] = 0;
    ft::camera_track& track = v.state.tracks[0];
    track = ft::camera_track::initial();
    track.state = ft::tracking_state::tracking;
    track.time_ns = 100 * second;
    track.keyframe_ns = track.seen_ns = 100 * second - second / 2;
    ft::inertial_track& t = v.imu.tracks[0];
    t = ft::inertial_track::initial();
    t.estimates = 1;
    t.last.v = t.keyframe.v = {2, 0, 0};
    t.follows = t.moves = t.keyframe_moves = 1;
    for (int i = 0; i < 2; ++i) {
      ft::preintegrated& p = v.imu.integrals[i];
      p = {};
      p.dT = dT;
      p.dR = ft::mat3<float>::identity();
      p.status = ft::integration_status::integrated;
    }
  }
  ft::camera_track& track() { return data.host.state.tracks[0]; }
  ft::inertial_track& imu() { return data.host.imu.tracks[0]; }
  ft::inertial_source predict() {
    data.push(exec);
    arrays const& there = data.device;
    ft::inertial_prediction const in{
        there.input, {ft::pose::identity(), ft::pose::identity()}, there.keyframes};
    ft::predict_inertial_frames(exec, in, there.state, {there.T_cw, nullptr, nullptr}, there.imu);
    data.pull(exec);
    return imu().source;
  }
};

template <typename Backend>
class PredictInertialFrames : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(PredictInertialFrames, test::backends);

TYPED_TEST(PredictInertialFrames, GoOnFromTheLastFrameOrTheNewestKeyframe) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  EXPECT_EQ(r.predict(), ft::inertial_source::last_frame);
  EXPECT_EQ(r.track().guided, 1);
  EXPECT_EQ(r.data.host.T_cw->t.x, -2 * dT);
  EXPECT_EQ(r.data.host.imu.inputs.from_last_frame[0], 1);
  r.imu().follows = 0;
  EXPECT_EQ(r.predict(), ft::inertial_source::last_keyframe);
  EXPECT_EQ(r.data.host.imu.inputs.from_last_frame[0], 0);
  r.imu().keyframe_moves = 0;
  EXPECT_EQ(r.predict(), ft::inertial_source::none);
  EXPECT_EQ(r.track().guided, 0);
}

TYPED_TEST(PredictInertialFrames, EndAfterFiveSecondsWithoutTheMap) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  r.track().seen_ns = 95 * second + 1;
  EXPECT_EQ(r.predict(), ft::inertial_source::last_frame);
  r.track().seen_ns = 95 * second;
  EXPECT_EQ(r.predict(), ft::inertial_source::none);
  EXPECT_EQ(r.track().guided, 0);
  r.track().seen_ns = 99 * second;
  r.track().keyframe_ns = 95 * second;
  r.imu().follows = 0;
  EXPECT_EQ(r.predict(), ft::inertial_source::none) << "the keyframe is too old";
}

TYPED_TEST(PredictInertialFrames, AreLessCertainOfTurnsWhileTheOffsetOfTheClocksIsNotKnown) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  auto const covariance = [&] {
    r.predict();
    ft::preintegrated const& p = r.data.host.imu.inputs.integral[0];
    return std::vector<float>(p.C, p.C + 81);
  };
  auto const known = covariance();
  r.imu().rate = {0, 0, 2};  // at the last frame; it has ended since
  auto const exact = covariance();
  EXPECT_EQ(exact, known);
  r.imu().rate = {0, 0, 2};
  r.imu().clock_sigma = 0.01f;
  auto const changed = covariance();
  for (std::size_t k = 0; k < 81; ++k) {
    EXPECT_NEAR(changed[k] - known[k], k == 20 ? 4e-4f : 0, 1e-9f) << k;
  }
}

TYPED_TEST(PredictInertialFrames, TakeTheMeanRateForOneThatIsUnknown) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  float const none = ft::detail::unknown_rate;
  r.data.host.imu.integrals[0].mean_gyro = {0, 0, 1.5f};
  r.data.host.imu.integrals[0].bias.gyro = {0, 0, 0.5f};
  auto const more = [&](float from, float to) {
    r.imu().rate = {from, from, from};
    if (!std::isnan(from)) { r.imu().rate = {0, 0, from}; }
    r.data.host.imu.integrals[0].steps = std::isnan(to) ? 0 : 1;
    r.data.host.imu.steps.of(0)[0].gyro = {0, 0, to};
    r.imu().clock_sigma = 0;
    auto const before = r.imu();
    r.predict();
    float const exact = r.data.host.imu.inputs.integral[0].C[20];
    r.imu() = before;
    r.imu().clock_sigma = 0.01f;
    r.predict();
    return r.data.host.imu.inputs.integral[0].C[20] - exact;
  };
  EXPECT_NEAR(more(2, 2), 0, 1e-9f);
  EXPECT_NEAR(more(0, 2), 4e-4f, 1e-9f);
  EXPECT_NEAR(more(none, 2), 0, 1e-9f);
  EXPECT_NEAR(more(none, 3), 1e-4f, 1e-9f);
  EXPECT_NEAR(more(1, none), 1e-4f, 1e-9f);
  EXPECT_NEAR(more(none, none), 4e-4f, 1e-9f) << "nothing tells that it did not change";
}

TYPED_TEST(PredictInertialFrames, LeaveThePoseToACallerWhoPredictsIt) {
  TypeParam backend;
  room<typename TypeParam::exec_type> r(backend.exec);
  EXPECT_EQ(r.predict(), ft::inertial_source::last_frame);
  EXPECT_TRUE(ft::detail::imu_tracking_of(r.imu()).predicted);
  r.data.host.T_cw->t.x = 0;
  r.data.host.input->predicted = 1;
  EXPECT_EQ(r.predict(), ft::inertial_source::last_frame);
  EXPECT_EQ(r.track().guided, 0);
  EXPECT_EQ(r.data.host.T_cw->t.x, 0);
  EXPECT_TRUE(ft::detail::imu_tracking_of(r.imu()).known);
  EXPECT_FALSE(ft::detail::imu_tracking_of(r.imu()).predicted);
}

}  // namespace begin_inertial_test
