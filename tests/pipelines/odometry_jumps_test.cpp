// SPDX-License-Identifier: Apache-2.0
// A camera that jumps between two frames: the pose is right, or it is not called tracked.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/example_rigs.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/room.hpp"

namespace odometry_jumps_test {

using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;

double distance(ft::vec3<double> a, ft::vec3<double> b) { return std::sqrt(ft::dot(a - b, a - b)); }

template <typename Backend>
class OdometryJumps : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(OdometryJumps, test::backends);

struct outcomes {
  int right = 0, silent = 0, all = 0;
};

/// Two frames, up to `most_m` and `most_rad` apart, of rooms with other walls each.
template <typename Exec>
outcomes jump(Exec const& exec, int jumps, float most_m, float most_rad, bool without_window) {
  auto const rig = test::room::rig();
  auto params = test::room::odometry_params(4096);
  params.rules.matches_without_window = without_window;
  ft::odometry<Exec> odometry(exec, rig, params);
  test::generator random(9);
  outcomes found;
  for (int i = 0; i < jumps; ++i) {
    auto const walls = test::room::make_walls(static_cast<unsigned>(i % 3));
    auto const vector = [&](float most) {
      return ft::vec3<double>{random.real(-most, most), random.real(-most, most),
                              random.real(-most, most)};
    };
    test::motion const from = test::turn({0, random.real(-1, 1), 0}, {0, 0, 1});
    float const share = 0.577f;  // of each axis
    test::motion const to = from * test::turn(vector(share * most_rad), vector(share * most_m));
    odometry.reset();
    odometry.track(images_of(test::room::see(rig, walls, from.inverse().cast<float>())), period);
    auto const t = odometry.track(
        images_of(test::room::see(rig, walls, to.inverse().cast<float>())), 2 * period);
    double const off = distance(t.T_world_camera.t, (from.inverse() * to).t);
    bool const tracked = t.state == ft::tracking_state::tracking;
    ++found.all;
    found.right += static_cast<int>(tracked && off < 0.03);
    found.silent += static_cast<int>(tracked && off >= 0.03);
  }
  return found;
}

TYPED_TEST(OdometryJumps, AreFollowedOrNotTracked) {
  TypeParam backend;
  int const jumps = test::effort(20);
  auto const found = jump(backend.exec, jumps, 0.5f, 0.45f, true);
  EXPECT_EQ(found.silent, 0);
  EXPECT_GE(found.right, found.all * 9 / 10);
  // Windows around the last pose alone find fewer.
  auto const before = jump(backend.exec, jumps, 0.5f, 0.45f, false);
  EXPECT_LT(before.right, found.right);
}

/// As in docs/extending.md. @param last of the frame before @param T_last_now how the vehicle has
/// moved since the last frame
/// @param T_base_camera where the camera is on the vehicle
template <typename Odometry, typename Images>
ft::tracking track_with_wheels(Odometry& odo, ft::tracking const& last, Images const& images,
                               std::int64_t time_ns, ft::rigid<double> const& T_last_now,
                               ft::rigid<double> const& T_base_camera) {
  odo.predict(last.T_world_camera * T_base_camera.inverse() * T_last_now * T_base_camera);
  return odo.track(images, time_ns);
}

TYPED_TEST(OdometryJumps, AreFollowedByWheels) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const walls = test::room::make_walls(1);
  auto params = test::room::odometry_params(4096);
  params.rules.matches_without_window = false;  // so that nothing else finds the camera
  ft::odometry driven(backend.exec, rig, params);
  ft::odometry blind(backend.exec, rig, params);
  test::motion const T_base_camera = test::turn({0.3, -0.2, 0.1}, {0.4, 0.1, -0.3});
  test::motion const base = test::turn({0, 0.2, 0}, {0, 0, 1}) * T_base_camera.inverse();
  test::motion const moves[] = {test::motion::identity(), test::turn({0, 0.3, 0}, {0.3, 0, 0.1}),
                                test::turn({0.1, -0.3, 0}, {-0.2, 0.1, 0.2})};
  test::motion now = base;
  int blind_inliers = 0, inliers = 0;
  std::int64_t time = 0;
  ft::tracking last;
  for (test::motion const& move : moves) {
    now = now * move;
    auto const frame = test::room::see(rig, walls, (now * T_base_camera).inverse().cast<float>());
    auto const t =
        track_with_wheels(driven, last, images_of(frame), time += period, move, T_base_camera);
    last = t;
    auto const truth = (base * T_base_camera).inverse() * now * T_base_camera;
    EXPECT_EQ(t.state, ft::tracking_state::tracking) << time;
    EXPECT_LT(distance(t.T_world_camera.t, truth.t), 0.03) << time;
    inliers += t.inliers;
    blind_inliers += blind.track(images_of(frame), time).inliers;
  }
  EXPECT_LT(blind_inliers, inliers / 2);
}

/// The first frame of a map is its origin, whatever was predicted.
TYPED_TEST(OdometryJumps, AreNotPredictedWhereThereIsNoMap) {
  TypeParam backend;
  auto const rig = test::room::rig();
  auto const frames = test::room::make_walk(rig, 0, 3);
  ft::odometry plain(backend.exec, rig, test::room::odometry_params(4096));
  ft::odometry odo(backend.exec, rig, test::room::odometry_params(4096));
  auto const run = [&] {
    odo.predict(test::turn({0, 0, 0}, {5, 0, 0}));
    std::int64_t time = 0;
    for (auto const& f : frames) {
      auto const t = odo.track(images_of(f), time += period);
      EXPECT_TRUE(test::same(t, plain.track(images_of(f), time))) << time;
    }
  };
  run();
  odo.reset();
  plain.reset();
  run();
}

}  // namespace odometry_jumps_test
