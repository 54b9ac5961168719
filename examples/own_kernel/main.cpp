// SPDX-License-Identifier: Apache-2.0
// ft's device functions in a user-defined kernel: views are passed to it by value, cameras and
// descriptors are used inside. The kernel matches every left keypoint with the right one whose
// descriptor is nearest, and computes the angle between their rays. The same function runs on the
// host to compare.
#include <cmath>
#include <cstdio>
#include <vector>

#include "examples/common/run.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/orb_extractor.hpp"

struct match {
  int right;     ///< index of the keypoint, -1 = none
  int distance;  ///< differing bits
  float cosine;  ///< of the angle between the two rays
};

using strict = ft::strict_float;  // products are never fused with sums: equal bits everywhere

/// All functions called here are ft's and marked FT_HOST_DEVICE.
FT_HOST_DEVICE match nearest(ft::pinhole<float> const& camera, ft::keypoints_view const& left,
                             ft::keypoints_view const& right, int i) {
  match best{-1, 257, 0};
  for (int j = 0; j < *right.count; ++j) {
    int const distance = ft::hamming(left.orb(i), right.orb(j));
    if (distance < best.distance) { best = {j, distance, 0}; }
  }
  if (best.right < 0) { return best; }
  auto const ray = [&](ft::keypoints_view const& keypoints, int k) {
    return camera.cast<strict>().unproject({keypoints.x(k), keypoints.y(k)}).direction;
  };
  auto const a = ray(left, i);
  auto const b = ray(right, best.right);
  best.cosine = (ft::dot(a, b) / ft::scalar::sqrt(ft::dot(a, a) * ft::dot(b, b))).value;
  return best;
}

__global__ void match_kernel(ft::pinhole<float> camera, ft::keypoints_view left,
                             ft::keypoints_view right, match* out) {
  int const i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i < *left.count) { out[i] = nearest(camera, left, right, i); }
}

int main() {
  return demo::run([](ft::cuda_exec const& exec) {
    demo::scene const scene(100);
    auto const images = scene.render(60);
    auto const [fx, fy, cx, cy] = scene.intrinsics();
    ft::pinhole<float> const camera{fx, fy, cx, cy};
    ft::orb_extractor<ft::cuda_exec> orb(exec, demo::params_for(images.left), 2);
    orb.upload(exec, 0, demo::view(images.left));
    orb.upload(exec, 1, demo::view(images.right));
    orb.extract(exec);

    // The kernel follows on the same stream. It is launched for the capacity, so that the host need
    // not wait for the number of keypoints.
    auto const n = static_cast<std::size_t>(orb.capacity());
    ft::buffer<match, ft::memory_space::device> const matches(n);
    auto const left = orb.keypoints().slice(0);
    auto const right = orb.keypoints().slice(1);
    int const blocks = (orb.capacity() + 127) / 128;
    match_kernel<<<blocks, 128, 0, exec.stream>>>(camera, left, right, matches.data());
    ft::throw_on_error(cudaGetLastError(), "match_kernel");

    std::vector<match> found(n);
    ft::copy(exec, found.data(), static_cast<match const*>(matches.data()), n);
    auto const keypoints = ft::download(exec, orb.keypoints());  // waits

    auto const host_left = keypoints.view().slice(0);
    auto const host_right = keypoints.view().slice(1);
    int different = 0;
    int close = 0;
    for (int i = 0; i < *host_left.count; ++i) {
      match const want = nearest(camera, host_left, host_right, i);
      match const got = found[static_cast<std::size_t>(i)];
      different += static_cast<int>(want.right != got.right || want.distance != got.distance ||
                                    want.cosine != got.cosine);
      close += static_cast<int>(got.distance < 50);
    }
    std::printf(
        "%d keypoints matched by a kernel, %d of them closely; %d answers differ from the "
        "host's\n",
        *host_left.count, close, different);
    return demo::verdict(different == 0 && close > 300);
  });
}
