// SPDX-License-Identifier: Apache-2.0
// Follows a stereo camera through a generated room, frame by frame, and compares its positions with
// the truth. The tracking is in examples/common/simple_odometry.hpp.
#include <array>
#include <cmath>
#include <cstdio>

#include "examples/common/run.hpp"
#include "examples/common/scene.hpp"
#include "examples/common/simple_odometry.hpp"

double distance(std::array<double, 3> const& a, std::array<double, 3> const& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

int main() {
  return demo::run([](auto const& exec) {
    demo::scene const scene(60);
    demo::simple_odometry odometry(exec, scene);
    double travelled = 0;
    double error = 0;
    int fewest = 1 << 30;
    for (int i = 0; i < scene.frames(); ++i) {
      int const inliers = odometry.track(scene.render(i));
      auto const centre = odometry.T_cw().centre();
      auto const truth = scene.centre(i);
      error = distance(truth, {static_cast<double>(centre.x), static_cast<double>(centre.y),
                               static_cast<double>(centre.z)});
      fewest = inliers < fewest ? inliers : fewest;
      if (i > 0) { travelled += distance(truth, scene.centre(i - 1)); }
      if (i % 10 == 0) {
        std::printf("frame %2d: %4d inliers, %5.2f m travelled, %.1f cm off\n", i, inliers,
                    travelled, 100 * error);
      }
    }
    std::printf("%d frames, %.2f m, %d map points, at least %d inliers, %.1f cm off at the end\n",
                scene.frames(), travelled, odometry.points(), fewest, 100 * error);
    return demo::verdict(travelled > 1 && fewest > 100 && error < 0.02 * travelled);
  });
}
