// SPDX-License-Identifier: Apache-2.0
/// @file What the units do. Their interface is plain: executors and pipelines differ between
/// compilers.
#pragma once

#include <ft/pipelines/orb_extractor.hpp>

#include <cstddef>

template <typename Exec>
int count_keypoints(Exec const& exec, unsigned char const* pixels, int width, int height) {
  ft::orb_params params;
  params.width = width;
  params.height = height;
  ft::orb_extractor<Exec> orb(exec, params, 1);
  orb.upload(exec, 0, {pixels, width, height, width});
  orb.extract(exec);
  int count = 0;
  ft::copy(exec, &count, static_cast<int const*>(orb.keypoints().count), std::size_t{1});
  exec.wait();
  return count;
}

/// On the host, and in a CUDA unit on a GPU as well where there is one. -1 where the two differ.
inline int count_on_all(unsigned char const* pixels, int width, int height) {
  int const host = count_keypoints(ft::host_exec(1), pixels, width, height);
#if defined(__CUDACC__)
  int devices = 0;
  if (cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0) {
    cudaStream_t stream = nullptr;
    ft::throw_on_error(cudaStreamCreate(&stream), "cudaStreamCreate");
    int const device = count_keypoints(ft::cuda_exec(stream), pixels, width, height);
    cudaStreamDestroy(stream);
    return device == host ? host : -1;
  }
#endif
  return host;
}
