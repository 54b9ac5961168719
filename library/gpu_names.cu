// SPDX-License-Identifier: Apache-2.0
#include <cuda_runtime.h>

#include "ft/any_odometry.hpp"

namespace ft {
inline namespace v0 {

std::vector<std::string> gpu_names() {
  std::vector<std::string> names;
  int gpus = 0;
  if (cudaGetDeviceCount(&gpus) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return names;
  }
  for (int i = 0; i < gpus; ++i) {
    cudaDeviceProp properties;
    if (cudaGetDeviceProperties(&properties, i) == cudaSuccess) {
      names.emplace_back(properties.name);
    }
  }
  return names;
}

}  // namespace v0
}  // namespace ft
