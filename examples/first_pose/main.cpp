// SPDX-License-Identifier: Apache-2.0
// The program of the README: the pose of a stereo camera, frame by frame. It needs only ft's
// headers. g++ compiles this file for the host, nvcc for the GPU.
#include <ft/ft.hpp>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>

template <typename Exec, typename Camera>  // ft::host_exec or ft::cuda_exec
ft::tracking follow(Exec const& exec, Camera camera) {
  ft::odometry_params params;
  params.orb.width = 752;  // pixels
  params.orb.height = 480;
  auto const rig = ft::rectified_rig::make({435.0f, 435.0f, 367.0f, 252.0f}, 0.11f);  // pixels, m
  ft::odometry<Exec> odometry(exec, rig, params);
  ft::tracking pose;
  while (camera.next()) {
    pose = odometry.track({camera.left(), camera.right()}, camera.time_ns());
    auto const& t = pose.T_world_camera.t;
    std::printf("%.3f %.3f %.3f m, %d inliers\n", t.x, t.y, t.z, pose.inliers);
  }
  return pose;
}

/// Two frames of a wall that is 4 m away, and moves by 0.1 m to the left.
struct wall_camera {
  static constexpr int width = 752, height = 480, disparity = 12;
  std::vector<unsigned char> pixels[2];
  int frame = 0;

  bool next() {
    for (int side = 0; side < 2; ++side) {
      pixels[side].resize(std::size_t{width} * height);
      int const shift = 11 * frame + disparity * side;
      for (int i = 0; i < width * height; ++i) {
        int const x = (i % width + shift) / 9, y = i / width / 9;
        pixels[side][static_cast<std::size_t>(i)] =
            static_cast<unsigned char>(((x * 7919) ^ (y * 104729)) % 251);
      }
    }
    return frame++ < 2;
  }
  ft::gray_view left() const { return {pixels[0].data(), width, height, width}; }
  ft::gray_view right() const { return {pixels[1].data(), width, height, width}; }
  std::int64_t time_ns() const { return 50'000'000 * std::int64_t{frame}; }
};

int check(ft::tracking const& pose) {  // 11 pixels at 435 pixels' focal length and 4 m
  return pose.inliers > 100 && std::abs(pose.T_world_camera.t.x - 0.1) < 0.01 ? 0 : 1;
}

int main() {
#if defined(__CUDACC__)
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no CUDA device was found: nothing was run");
    return 77;
  }
  return check(follow(ft::cuda_exec(cudaStreamPerThread), wall_camera{}));
#else
  return check(follow(ft::host_exec(), wall_camera{}));
#endif
}
