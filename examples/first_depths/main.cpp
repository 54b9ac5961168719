// SPDX-License-Identifier: Apache-2.0
// The program of the README: depths of the keypoints of a rectified stereo pair. It needs only ft's
// headers. g++ compiles this file for the host, nvcc for the GPU.
#include <ft/stages.hpp>

#include <cstdio>
#include <vector>

template <typename Exec>  // ft::host_exec or ft::cuda_exec
int print_depths(Exec const& exec, ft::gray_view left, ft::gray_view right) {
  auto const rig = ft::rectified_rig::make({435.0f, 435.0f, 367.0f, 252.0f}, 0.11f);  // pixels, m
  ft::orb_params params;
  params.width = left.width;
  params.height = left.height;
  ft::orb_extractor<Exec> orb(exec, params, 2);  // allocates for a batch of two images
  ft::stereo_matcher<Exec> stereo(rig, orb);
  orb.upload(exec, 0, left);
  orb.upload(exec, 1, right);
  orb.extract(exec);  // enqueued on a GPU; done on return on the host
  stereo.match(exec, orb);
  auto const matches = ft::download(exec, stereo.matches());  // waits
  int matched = 0;
  for (int i = 0; i < *matches.view().count; ++i) {
    float const depth = matches.view().depth(i);
    if (depth > 0) { std::printf("keypoint %d is %.2f m away\n", i, static_cast<double>(depth)); }
    matched += depth > 0;
  }
  return matched;
}

int main() {
  constexpr int width = 752, height = 480, disparity = 12;
  std::vector<unsigned char> left(width * height), right(width * height);
  for (int i = 0; i < width * height; ++i) {
    auto const grey = [&](int x) { return ((x / 9 * 7919) ^ (i / width / 9 * 104729)) % 251; };
    left[static_cast<std::size_t>(i)] = static_cast<unsigned char>(grey(i % width));
    right[static_cast<std::size_t>(i)] = static_cast<unsigned char>(grey(i % width + disparity));
  }
  ft::gray_view const l{left.data(), width, height, width}, r{right.data(), width, height, width};
#if defined(__CUDACC__)
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no CUDA device was found: nothing was run");
    return 77;
  }
  return print_depths(ft::cuda_exec(cudaStreamPerThread), l, r) > 100 ? 0 : 1;
#else
  return print_depths(ft::host_exec(), l, r) > 100 ? 0 : 1;
#endif
}
