// SPDX-License-Identifier: Apache-2.0
// Loops with rigs that no other test of loops has: a pair and a mixed rig with an IMU, RGB-D, a
// distorted pair, a mixed rig. Each goes round a room, and is recognised where it began.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ft/cameras/any_camera.hpp"
#include "ft/cameras/distorted_pair.hpp"
#include "ft/cameras/mixed_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/mixed_rig_walk.hpp"
#include "tests/support/room.hpp"

namespace loops_of_rigs_test {

using test::at;
using test::rigs::any;
using vector = ft::vec3<double>;
using matrix = ft::mat3<double>;
constexpr std::int64_t period = 100'000'000;
constexpr double seconds = 0.1;  // of a frame
constexpr int lap = 42;
constexpr int frames = lap + 12;

/// Where the camera is at a time in frames, camera to world: on a circle of 1.2 m, looking
/// outwards, up and down.
ft::rigid<double> pose_at(double step) {
  double const yaw = 6.283185307179586 * step / lap;
  double const c = std::cos(yaw), s = std::sin(yaw);
  double const pitch = 0.1 * std::sin(2 * yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  matrix const about_y{{c, 0, s, 0, 1, 0, -s, 0, c}};
  return {about_y * matrix{{1, 0, 0, 0, cp, -sp, 0, sp, cp}},
          {0.6 * s, 0.1 * std::sin(3 * yaw), 1.2 + 0.6 * c}};
}

/// A sample of an IMU in the camera. The world's y axis points down.
ft::imu_measurement sample_at(double step) {
  double const h = 1e-3, dt = h * seconds;
  auto const before = pose_at(step - h), now = pose_at(step), after = pose_at(step + h);
  matrix const dR = before.R.transposed() * after.R;
  vector const moved = (after.t - now.t) - (now.t - before.t);
  vector const force = now.R.transposed() *
                       vector{moved.x / (dt * dt), moved.y / (dt * dt) - 9.81, moved.z / (dt * dt)};
  vector const rate =
      ft::scaled(vector{dR.m[7] - dR.m[5], dR.m[2] - dR.m[6], dR.m[3] - dR.m[1]}, 1 / (4 * dt));
  return {static_cast<std::int64_t>(std::llround((step + 1) * static_cast<double>(period))),
          force.cast<float>(), rate.cast<float>()};
}

std::vector<test::room::image> const& walls() {
  static auto const all = test::room::make_walls(0);
  return all;
}
ft::pose T_cw_at(int i) { return pose_at(i).inverse().cast<float>(); }

// ---- what each rig sees

struct pair_scene {
  ft::rectified_rig rig = test::room::rig();
  using frame = std::pair<test::room::image, test::room::image>;
  frame see(int i) const {
    ft::pose const T_cw = T_cw_at(i);
    ft::pose T_rw = T_cw;
    T_rw.t.x -= rig.baseline_length().value;
    return {test::room::render(rig.camera, walls(), T_cw),
            test::room::render(rig.camera, walls(), T_rw)};
  }
  static ft::stereo_images images(frame const& f) {
    return {test::room::view(f.first), test::room::view(f.second)};
  }
};

/// Cameras that are rectified by the odometry.
struct distorted_scene {
  using lens = ft::radtan4<float>;
  lens left{300, 301, 238, 181, {-0.21f, 0.06f, 4e-4f, -3e-4f}};
  lens right{302, 300, 242, 178, {-0.2f, 0.05f, -3e-4f, 2e-4f}};
  ft::pose T_rl = ft::pose{test::rigs::turned(0.03f, {}).R, {0.25f, -0.006f, 0.004f}}.inverse();
  ft::distorted_pair<lens> rig =
      ft::distorted_pair<lens>::make(left, right, T_rl, {290, 290, 239.5f, 179.5f});
  using frame = pair_scene::frame;
  frame see(int i) const {
    return {test::room::render(left, walls(), T_cw_at(i)),
            test::room::render(right, walls(), T_rl * T_cw_at(i))};
  }
  static ft::stereo_images images(frame const& f) { return pair_scene::images(f); }
};

struct rgbd_scene {
  ft::rgbd_rig<> rig = ft::rgbd_rig<>::make(test::room::rig().camera, 0.25f, 1.0f);
  struct frame {
    test::room::image gray;
    std::vector<float> depth;
  };
  frame see(int i) const {
    ft::pose const T_cw = T_cw_at(i);
    return {test::room::render(rig.camera, walls(), T_cw),
            test::rigs::render_depth(any::of(rig.camera), T_cw)};
  }
  static ft::rgbd_images images(frame const& f) {
    return {test::room::view(f.gray),
            ft::image_view<float const>{f.depth.data(), test::room::width, test::room::height,
                                        test::room::width}};
  }
};

/// A fisheye pair, and a camera with a depth image that looks aside.
struct mixed_scene {
  ft::mixed_rig<3> rig = make();
  static ft::mixed_rig<3> make() {
    using camera = ft::mixed_rig_camera;
    auto const pair = test::room::fisheye();
    ft::mixed_rig<3> all;
    all.of[0] = camera::single(any::of(pair.left), ft::pose::identity());
    all.of[1] = camera::single(any::of(pair.right), pair.T_rl);
    all.of[2] = camera::with_depth(
        any::of(ft::radtan5<float>{280, 281, 238, 181, {-0.1f, 0.02f, 5e-4f, -3e-4f, 0}}), 0.1, 0,
        test::rigs::turned(-1.2f, {-0.2f, 0.05f, 0}));
    ft::pair_up(all, 0, 1);
    return all;
  }
  using frame = test::rigs::mixed_frame;
  frame see(int i) const { return test::rigs::see_mixed(rig, walls(), T_cw_at(i)); }
  static ft::mixed_images<3> images(frame const& f) { return test::rigs::views_of<3>(f); }
};

/// What a rig sees on its way. Rendered once.
template <typename Scene>
std::vector<typename Scene::frame> const& walk(Scene const& scene) {
  static std::vector<typename Scene::frame> const all = [&] {
    std::vector<typename Scene::frame> made;
    for (int i = 0; i < frames; ++i) { made.push_back(scene.see(i)); }
    return made;
  }();
  return all;
}

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.window = {4, 2};
  p.keyframes = 12;  // the odometry itself has forgotten where it began
  p.local_map.keyframes = 8;
  p.loops.present = true;
  p.loops.recent = 20;
  p.align_keypoints = false;  // else the odometry drifts by no more than a loop is off
  return p;
}
ft::odometry_params inertial_params() {
  auto p = params();
  p.window = {10, 4};  // the IMU is found out about in a window
  p.keyframes = 16;
  p.imu.present = true;
  p.imu.keyframe_period_s = 0.2;
  p.imu.initialization.least_keyframes = 8;
  return p;
}

/// How far the camera is from its place, metres. The world is the first frame's camera.
double off(ft::rigid<double> const& T_world_camera, int i) {
  auto const d = T_world_camera.t - (pose_at(0).inverse() * pose_at(i)).t;
  return std::sqrt(ft::dot(d, d));
}

template <typename Exec, typename Scene, typename... Parts>
void closes_a_lap(Exec const& exec, Scene const& scene, ft::odometry_params const& p,
                  Parts const&... parts) {
  ft::odometry<Exec, decltype(scene.rig)> odo(exec, scene.rig, p, 1, parts...);
  int closed = 0, first = 0, samples = 0;
  bool knew_gravity = false;  // before the first loop
  ft::tracking t;
  for (int i = 0; i < frames; ++i) {
    while (p.imu.present && samples <= 20 * i) { odo.add_imu(sample_at(0.05 * samples++)); }
    t = odo.track(scene.images(walk(scene)[at(i)]), (i + 1) * period);
    ASSERT_EQ(t.state, ft::tracking_state::tracking) << i;
    ASSERT_LT(off(t.T_world_camera, i), 0.1) << i;
    closed += t.loops_closed;
    if (closed > 0 && first == 0) { first = i; }
    knew_gravity = knew_gravity || (first == 0 && t.imu.known);
  }
  EXPECT_GT(closed, 0);
  EXPECT_GT(first, lap - 8) << "nothing is recognised before the camera is back";
  EXPECT_EQ(knew_gravity, p.imu.present);
  EXPECT_LT(off(t.T_world_camera, frames - 1), 0.04);
  EXPECT_LT(off(t.T_world_camera, frames - 1), std::max(0.01, off(t.T_odom_camera, frames - 1)));
  for (auto const& k : odo.placed_keyframes()) {
    EXPECT_LT(off(k.T_world_camera, static_cast<int>(k.time_ns / period) - 1), 0.05) << k.time_ns;
  }
  EXPECT_EQ(static_cast<int>(odo.closed_loops().size()), closed);
}

template <typename Backend>
class LoopsOfRigs : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(LoopsOfRigs, test::backends);

TYPED_TEST(LoopsOfRigs, APairWithAnImu) {
  TypeParam backend;
  closes_a_lap(backend.exec, pair_scene{}, inertial_params(), ft::inertial{}, ft::loops{});
}
TYPED_TEST(LoopsOfRigs, ACameraWithDepthImages) {
  TypeParam backend;
  closes_a_lap(backend.exec, rgbd_scene{}, params(), ft::loops{});
}
TYPED_TEST(LoopsOfRigs, ADistortedPair) {
  TypeParam backend;
  closes_a_lap(backend.exec, distorted_scene{}, params(), ft::loops{});
}
TYPED_TEST(LoopsOfRigs, AMixedRig) {
  TypeParam backend;
  closes_a_lap(backend.exec, mixed_scene{}, params(), ft::loops{});
}
TYPED_TEST(LoopsOfRigs, AMixedRigWithAnImu) {
  TypeParam backend;
  closes_a_lap(backend.exec, mixed_scene{}, inertial_params(), ft::inertial{}, ft::loops{});
}

}  // namespace loops_of_rigs_test
