// SPDX-License-Identifier: Apache-2.0
// One camera with an IMU: when its map gets its scale, what is scaled, and what gives no scale.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <sstream>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/room.hpp"

namespace inertial_monocular_test {

using vector = ft::vec3<double>;
using matrix = ft::mat3<double>;
using motion = ft::rigid<double>;
using path = std::function<motion(double)>;  ///< T_wc at a time in seconds
using rig_type = ft::monocular_rig<ft::pinhole<float>>;
constexpr std::int64_t period = 50'000'000;
constexpr double seconds = 0.05;  // of a frame
constexpr double gravity = 9.81;  // along y: the walk's world has y down
constexpr int frame_count = 75;

rig_type rig() { return rig_type::make(test::room::rig().camera); }

motion pose_at(double yaw, double pitch, vector const& at) {
  double const c = std::cos(yaw), s = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  return {matrix{{c, 0, s, 0, 1, 0, -s, 0, c}} * matrix{{1, 0, 0, 0, cp, -sp, 0, sp, cp}}, at};
}
motion swaying(double t) {
  return pose_at(0.15 * std::sin(1.7 * t), 0.1 * std::sin(2.3 * t),
                 {0.5 * std::sin(2.5 * t), 0.25 * std::sin(3.3 * t), 0.4 - 0.4 * std::cos(2 * t)});
}
motion gliding(double t) { return pose_at(0, 0, {0.4 * t, 0, 0.3 * t}); }
motion turning(double t) { return pose_at(0.3 * t, 0, {0, 0, 0}); }
motion resting(double) { return motion::identity(); }

// A mount, and biases, that nothing can be right without.
motion mount() {
  double const c = std::cos(0.4), s = std::sin(0.4);
  return {{{c, -s, 0, s, c, 0, 0, 0, 1}}, {0.05, -0.02, 0.03}};
}
vector const gyro_bias{0.004, -0.006, 0.003};
vector const accel_bias{0.02, -0.03, 0.01};

/// The sample of a path at a time in seconds. A frame i is at i * seconds, stamped (i + 1) periods.
ft::imu_measurement sample_of(path const& of, double t) {
  auto const body = [&](double at) { return of(at) * mount().inverse(); };
  double const h = 1e-4;
  motion const before = body(t - h), now = body(t), after = body(t + h);
  matrix const dR = before.R.transposed() * after.R;
  vector const turn{dR.m[7] - dR.m[5], dR.m[2] - dR.m[6], dR.m[3] - dR.m[1]};
  vector const rise = (after.t - now.t) - (now.t - before.t);
  vector const force = ft::scaled(rise, 1 / (h * h)) - vector{0, gravity, 0};
  auto const narrow = [](vector const& v) { return v.cast<float>(); };
  return {static_cast<std::int64_t>(std::llround((t / seconds + 1) * static_cast<double>(period))),
          narrow(now.R.transposed() * force + accel_bias),
          narrow(ft::scaled(turn, 0.25 / h) + gyro_bias)};
}

using image = test::room::image;
std::vector<image> render(path const& of, int frames) {
  auto const walls = test::room::make_walls(0);
  std::vector<image> all;
  for (int i = 0; i < frames; ++i) {
    auto const T_cw = of(i * seconds).inverse().cast<float>();
    all.push_back(test::room::render(rig().camera, walls, T_cw));
  }
  return all;
}
std::vector<image> const& sway() {
  static auto const images = render(swaying, frame_count);
  return images;
}

ft::odometry_params params() {
  auto p = test::room::odometry_params(8192);
  p.imu.present = true;
  p.imu.T_bc = mount();
  return p;
}

using change = std::function<void(ft::imu_measurement&)>;

/// Tracks images of a path, with 200 samples a second.
template <typename Exec>
std::vector<ft::tracking> run(ft::odometry<Exec, rig_type>& odo, std::vector<image> const& images,
                              path const& of, change const& changed = {}) {
  std::vector<ft::tracking> all;
  int samples = 0;
  for (std::size_t i = 0; i < images.size(); ++i) {
    for (; samples <= 10 * static_cast<int>(i); ++samples) {
      auto m = sample_of(of, 0.005 * samples);
      if (changed) { changed(m); }
      odo.add_imu(m);
    }
    all.push_back(
        odo.track(test::room::view(images[i]), static_cast<std::int64_t>(i + 1) * period));
  }
  return all;
}

/// The first frame with a metric map, or all.size().
std::size_t metric_from(std::vector<ft::tracking> const& all) {
  std::size_t i = 0;
  while (i < all.size() && !all[i].metric) { ++i; }
  return i;
}
bool ever_metric(std::vector<ft::tracking> const& all) { return metric_from(all) != all.size(); }
int frames_with_map(std::vector<ft::tracking> const& all) {
  return static_cast<int>(std::count_if(all.begin(), all.end(), [](ft::tracking const& t) {
    return t.state == ft::tracking_state::tracking;
  }));
}

double length(vector const& v) { return std::sqrt(ft::dot(v, v)); }

/// Times and poses of a camera.
struct timed {
  double t;
  motion T_wc;
};

/// The factor from the spread of the positions to that of the path. Source: Horn, "Closed-form
/// solution of absolute orientation using unit quaternions", JOSA A 1987 (symmetric scale).
double scale_of(std::vector<timed> const& seen, path const& of) {
  auto const spread = [&](auto const& place) {
    vector mean{0, 0, 0};
    for (timed const& s : seen) { mean = mean + place(s); }
    mean = ft::scaled(mean, 1 / static_cast<double>(seen.size()));
    double sum = 0;
    for (timed const& s : seen) {
      vector const d = place(s) - mean;
      sum += ft::dot(d, d);
    }
    return std::sqrt(sum);
  };
  return spread([&](timed const& s) { return of(s.t).t; }) /
         spread([](timed const& s) { return s.T_wc.t; });
}

/// What the host says of the swaying walk.
std::vector<ft::tracking> const& host_answers() {
  static auto const answers = [] {
    ft::odometry<ft::host_exec, rig_type> odo(ft::host_exec(1), rig(), params(), 1, ft::inertial{});
    return run(odo, sway(), swaying);
  }();
  return answers;
}
void expect_same(ft::tracking const& a, ft::tracking const& e, std::size_t i) {
  EXPECT_EQ(a.metric, e.metric) << i;
  EXPECT_EQ(a.inliers, e.inliers) << i;
  EXPECT_EQ(std::memcmp(&a.T_world_camera, &e.T_world_camera, sizeof(motion)), 0) << i;
  EXPECT_EQ(std::memcmp(&a.imu.bias, &e.imu.bias, sizeof(ft::imu_bias)), 0) << i;
  EXPECT_EQ(std::memcmp(&a.imu.velocity, &e.imu.velocity, sizeof(vector)), 0) << i;
}

template <typename Backend>
class inertial_monocular : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(inertial_monocular, test::backends);

TYPED_TEST(inertial_monocular, gets_its_scale_from_the_imu) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params(), 1,
                                                     ft::inertial{});
  auto const all = run(odo, sway(), swaying);
  std::size_t const from = metric_from(all);
  ASSERT_LT(from, all.size() - 15);
  motion const to_room = swaying((frame_count - 1) * seconds) * all.back().T_world_camera.inverse();
  for (std::size_t i = 0; i < all.size(); ++i) {
    ft::tracking const& t = all[i];
    EXPECT_EQ(t.metric, i >= from) << i;
    EXPECT_EQ(t.imu.known, i >= from) << i;
    EXPECT_LE(t.maps, 1) << i;
    if (i < from) { continue; }
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << i;
    EXPECT_TRUE(t.imu.predicted) << i;
    vector const at = (to_room * t.T_world_camera).t;
    EXPECT_LT(length(at - swaying(static_cast<double>(i) * seconds).t), 0.06) << i;
  }
  EXPECT_TRUE(all.back().imu.optimized);
  EXPECT_NEAR(length(all.back().imu.gravity), gravity, 1e-3);

  // The map, with what it had before: keyframes, and points, which are on the walls of the room.
  auto const map = odo.download_map();
  std::vector<timed> keyframes;
  for (auto const& k : map.keyframes) {
    keyframes.push_back(
        {(static_cast<double>(k.time_ns) / static_cast<double>(period) - 1) * seconds,
         k.T_world_camera});
  }
  ASSERT_LT(keyframes.front().t, static_cast<double>(from) * seconds);
  EXPECT_NEAR(scale_of(keyframes, swaying), 1, 0.01);
  std::vector<double> off;
  for (auto const& p : map.points) {
    vector const at = to_room * p.position.template cast<double>();
    double const walls[] = {3 - at.x, at.x + 3, 1.5 - at.y, at.y + 1.5, 6 - at.z, at.z + 2};
    double nearest = 1e9;
    for (double const w : walls) { nearest = std::min(nearest, std::abs(w)); }
    off.push_back(nearest);
  }
  ASSERT_GT(off.size(), 200u);
  std::nth_element(off.begin(), off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2),
                   off.end());
  EXPECT_LT(off[off.size() / 2], 0.05);
}

TYPED_TEST(inertial_monocular, begins_anew_after_a_reset_with_the_answers_of_the_host) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params(), 1,
                                                     ft::inertial{});
  for (int round = 0; round < 2; ++round) {
    auto const all = run(odo, sway(), swaying);
    for (std::size_t i = 0; i < all.size(); ++i) { expect_same(all[i], host_answers()[i], i); }
    odo.reset();
  }
  EXPECT_TRUE(ever_metric(host_answers()));
}

TYPED_TEST(inertial_monocular, cameras_of_a_batch_have_scales_of_their_own) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params(), 2,
                                                     ft::inertial{});
  int samples = 0;
  for (std::size_t i = 0; i < sway().size(); ++i) {
    for (; samples <= 10 * static_cast<int>(i); ++samples) {
      odo.add_imu(sample_of(swaying, 0.005 * samples), 1);
    }
    auto const now = static_cast<std::int64_t>(i + 1) * period;
    ft::gray_view const images[] = {test::room::view(sway()[i]), test::room::view(sway()[i])};
    std::int64_t const times[] = {now, now};
    ft::tracking const* const t = odo.track(images, times);
    EXPECT_FALSE(t[0].metric) << i;
    expect_same(t[1], host_answers()[i], i);
  }
}

// Without a motion that the IMU feels there is no scale, with or without a map.
TYPED_TEST(inertial_monocular, other_motions_give_no_scale) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  for (path const& of : {path(resting), path(turning)}) {
    odometry_type odo(backend.exec, rig(), params(), 1, ft::inertial{});
    auto const all = run(odo, render(of, 40), of);
    EXPECT_FALSE(ever_metric(all));
  }
  odometry_type odo(backend.exec, rig(), params(), 1, ft::inertial{});
  auto const all = run(odo, render(gliding, 60), gliding);
  EXPECT_FALSE(ever_metric(all));
  EXPECT_GT(frames_with_map(all), 35);
}

TYPED_TEST(inertial_monocular, bad_samples_give_no_scale) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  auto const nothing = [](ft::imu_measurement& m) { m.accel = m.gyro = {0, 0, 0}; };
  // Another body's motion.
  auto const other = [](ft::imu_measurement& m) {
    auto const t = static_cast<float>(m.time_ns) * 1e-9f;
    m.accel = {2 * std::sin(9 * t), -9.81f, 3 * std::cos(7 * t)};
  };
  for (change const& changed : {change(nothing), change(other)}) {
    odometry_type odo(backend.exec, rig(), params(), 1, ft::inertial{});
    auto const all = run(odo, sway(), swaying, changed);
    EXPECT_FALSE(ever_metric(all));
    EXPECT_GT(frames_with_map(all), 40);
  }
  // None, and one in a while: gaps.
  for (int const every : {1000, 40}) {
    odometry_type odo(backend.exec, rig(), params(), 1, ft::inertial{});
    int samples = 0;
    for (std::size_t i = 0; i < sway().size(); ++i) {
      for (; samples <= 10 * static_cast<int>(i); ++samples) {
        if (samples % every == every - 1) { odo.add_imu(sample_of(swaying, 0.005 * samples)); }
      }
      auto const t =
          odo.track(test::room::view(sway()[i]), static_cast<std::int64_t>(i + 1) * period);
      EXPECT_FALSE(t.metric) << i;
    }
  }
}

TYPED_TEST(inertial_monocular, a_loaded_map_has_no_scale_yet) {
  TypeParam backend;
  ft::odometry<decltype(backend.exec), rig_type> odo(backend.exec, rig(), params(), 1,
                                                     ft::inertial{});
  auto const all = run(odo, sway(), swaying);
  ASSERT_TRUE(all.back().metric);
  std::stringstream file;
  odo.save_map(file);
  odo.load_map(file);
  auto const t = odo.track(test::room::view(sway().back()), (frame_count + 1) * period);
  EXPECT_FALSE(t.metric);
  EXPECT_EQ(t.state, ft::tracking_state::tracking);
}

TYPED_TEST(inertial_monocular, a_map_loaded_with_loops_keeps_its_scale) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  auto p = params();
  p.loops.present = true;
  odometry_type odo(backend.exec, rig(), p, 1, ft::inertial{}, ft::loops{});
  ASSERT_TRUE(run(odo, sway(), swaying).back().metric);
  auto const known = odo.placed_keyframes();
  ASSERT_FALSE(known.empty());
  std::stringstream file;
  odo.save_map(file);
  odo.load_map(file);
  EXPECT_TRUE(odo.last().metric);
  auto const all = run(odo, sway(), swaying);
  EXPECT_TRUE(all.back().imu.known);
  EXPECT_GT(odo.placed_keyframes().size(), known.size());
  std::vector<timed> seen;
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_EQ(all[i].maps, 1) << i;
    EXPECT_TRUE(all[i].metric) << i;
    seen.push_back({static_cast<double>(i) * seconds, all[i].T_world_camera});
  }
  EXPECT_NEAR(scale_of(seen, swaying), 1, 0.01);

  p.imu.present = false;
  odometry_type without(backend.exec, rig(), p, 1, ft::loops{});
  std::int64_t time = 0;
  for (std::size_t i = 0; i < 20; ++i) {
    without.track(test::room::view(sway()[i]), time += period);
  }
  ASSERT_FALSE(without.placed_keyframes().empty());
  std::stringstream unknown;
  without.save_map(unknown);
  EXPECT_THROW(odo.load_map(unknown), ft::error);
  EXPECT_EQ(odo.last().maps, 1);
}

TYPED_TEST(inertial_monocular, refuses_limits_out_of_range) {
  TypeParam backend;
  using odometry_type = ft::odometry<decltype(backend.exec), rig_type>;
  auto p = params();
  p.imu.scale_sigma = -1;
  EXPECT_THROW(odometry_type(backend.exec, rig(), p, 1, ft::inertial{}), ft::bad_argument);
  p = params();
  p.imu.scale_position_sigma = 0;
  EXPECT_THROW(odometry_type(backend.exec, rig(), p, 1, ft::inertial{}), ft::bad_argument);
}

}  // namespace inertial_monocular_test
