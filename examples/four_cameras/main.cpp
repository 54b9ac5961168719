// SPDX-License-Identifier: Apache-2.0
// One pose from four cameras: a stereo pair that looks ahead and one that looks to the right. From
// frame 20 to 29 the first pair is black, and the second one carries on alone.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>

#include "examples/common/run.hpp"
#include "examples/common/scene.hpp"
#include "ft/cameras/multi_rig.hpp"
#include "ft/pipelines/odometry.hpp"

constexpr demo::mounting aside{1.2, {0.2, 0, -0.1}};  // of the second pair

ft::multi_rig<2> rig_of(demo::scene const& scene) {
  auto const k = scene.intrinsics();
  ft::pinhole<float> const camera{k[0], k[1], k[2], k[3]};
  auto const c = static_cast<float>(std::cos(aside.turn));
  auto const s = static_cast<float>(std::sin(aside.turn));
  ft::pose const T_body_aside{
      {{c, 0, s, 0, 1, 0, -s, 0, c}},
      {static_cast<float>(aside.centre[0]), 0, static_cast<float>(aside.centre[2])}};
  double const baseline = static_cast<double>(scene.baseline());
  // The body's frame is that of the first camera.
  return {{{camera, baseline, ft::pose::identity()}, {camera, baseline, T_body_aside.inverse()}}};
}

int main() {
  return demo::run([](auto const& exec) {
    using exec_type = std::decay_t<decltype(exec)>;
    demo::scene const scene(40);
    ft::odometry_params params;
    params.orb.width = scene.width();
    params.orb.height = scene.height();
    ft::odometry<exec_type, ft::multi_rig<2>> odometry(exec, rig_of(scene), params);

    double worst = 0;
    int fewest = 1 << 30;
    bool tracked = true;
    for (int i = 0; i < scene.frames(); ++i) {
      auto ahead = scene.render(i);
      auto const right = scene.render(i, aside);
      if (i / 10 == 2) {
        std::fill(ahead.left.pixels.begin(), ahead.left.pixels.end(), std::uint8_t{0});
        std::fill(ahead.right.pixels.begin(), ahead.right.pixels.end(), std::uint8_t{0});
      }
      auto const t = odometry.track({demo::view(ahead.left), demo::view(ahead.right),
                                     demo::view(right.left), demo::view(right.right)},
                                    std::int64_t{50'000'000} * (i + 1));
      auto const truth = scene.centre(i);
      auto const& at = t.T_world_camera.t;
      double const error = std::hypot(truth[0] - at.x, truth[1] - at.y, truth[2] - at.z);
      worst = std::max(worst, error);
      tracked = tracked && t.state == ft::tracking_state::tracking;
      if (i > 0) { fewest = std::min(fewest, t.inliers); }
      if (i % 5 == 0) {
        std::printf("frame %2d: %4d inliers, %4d map points, %.1f mm off\n", i, t.inliers,
                    t.map_points, 1000 * error);
      }
    }
    std::printf("at least %d inliers, at most %.1f mm off\n", fewest, 1000 * worst);
    return demo::verdict(tracked && fewest > 50 && worst < 0.02);
  });
}
