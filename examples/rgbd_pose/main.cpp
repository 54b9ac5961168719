// SPDX-License-Identifier: Apache-2.0
// The pose of a camera with a depth sensor, frame by frame.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <vector>

#include "examples/common/run.hpp"
#include "examples/common/scene.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/odometry.hpp"

/// What a sensor would see: millimetres, 0 beyond 6 m.
std::vector<std::uint16_t> depth_image(demo::scene const& scene, int frame) {
  std::vector<std::uint16_t> depth;
  for (int v = 0; v < scene.height(); ++v) {
    for (int u = 0; u < scene.width(); ++u) {
      double const metres = scene.depth(frame, u, v);
      depth.push_back(metres < 6 ? static_cast<std::uint16_t>(std::lround(1000 * metres)) : 0);
    }
  }
  return depth;
}

int main() {
  return demo::run([](auto const& exec) {
    demo::scene const scene(30, 640);
    auto const [fx, fy, cx, cy] = scene.intrinsics();
    // A virtual pair 0.08 m apart; depth in millimetres. A lens with distortion is given as another
    // camera model: ft::rgbd_rig<ft::radtan5<float>>.
    auto const rig = ft::rgbd_rig<>::make({fx, fy, cx, cy}, 0.08, 0.001f);
    ft::odometry_params params;
    params.orb.width = scene.width();
    params.orb.height = scene.height();
    ft::odometry odometry(exec, rig, params);

    double worst = 0;
    bool tracked = true;
    for (int i = 0; i < scene.frames(); ++i) {
      auto const gray = scene.render(i).left;
      auto const pixels = depth_image(scene, i);
      ft::image_view<std::uint16_t const> const depth{pixels.data(), gray.width, gray.height,
                                                      gray.width};
      auto const t = odometry.track({demo::view(gray), depth}, std::int64_t{50'000'000} * (i + 1));
      auto const truth = scene.centre(i);
      auto const& at = t.T_world_camera.t;
      double const error = std::hypot(truth[0] - at.x, truth[1] - at.y, truth[2] - at.z);
      worst = std::max(worst, error);
      tracked = tracked && t.state == ft::tracking_state::tracking;
      if (i % 5 == 0) {
        std::printf("frame %2d: %4d inliers, %4d of %4d keypoints with depth, %.1f mm off\n", i,
                    t.inliers, t.stereo_points, t.keypoints, 1000 * error);
      }
    }
    std::printf("at most %.1f mm off\n", 1000 * worst);
    return demo::verdict(tracked && worst < 0.02);
  });
}
