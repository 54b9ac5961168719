// SPDX-License-Identifier: Apache-2.0
// The pose of a stereo camera with the compiled library ft::odometry: any C++ compiler takes a
// second or two, and the program runs on a GPU where the library finds one. A wall that is 4 m away
// moves by 0.1 m to the left.
#include <ft/any_odometry.hpp>

#include <cmath>
#include <cstdio>
#include <vector>

int main() {
  constexpr int width = 752, height = 480;
  ft::device where;
  where.gpu = ft::gpu_names().empty() ? ft::device::host : 0;
  ft::odometry_params params;
  params.orb.width = width;
  params.orb.height = height;
  auto const rig = ft::rig_description::rectified_pair(435, 435, 367, 252, 0.11);  // pixels, m
  ft::any_odometry odometry = ft::make_odometry(where, rig, params);
  std::vector<unsigned char> image[2];
  ft::tracking pose;
  for (int frame = 0; frame < 2; ++frame) {
    for (int side = 0; side < 2; ++side) {
      image[side].clear();
      for (int i = 0; i < width * height; ++i) {
        int const x = (i % width + 11 * frame + 12 * side) / 9, y = i / width / 9;
        image[side].push_back(static_cast<unsigned char>(((x * 7919) ^ (y * 104729)) % 251));
      }
    }
    ft::gray_view const left{image[0].data(), width, height, width};
    ft::gray_view const right{image[1].data(), width, height, width};
    pose = odometry.track({{left, right}}, 50'000'000 * (frame + 1));
    auto const& t = pose.T_world_camera.t;
    std::printf("%.3f %.3f %.3f m, %d inliers\n", t.x, t.y, t.z, pose.inliers);
  }
  return pose.inliers > 100 && std::abs(pose.T_world_camera.t.x - 0.1) < 0.01 ? 0 : 1;
}
