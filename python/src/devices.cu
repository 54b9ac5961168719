// SPDX-License-Identifier: Apache-2.0
#include <cuda_runtime.h>

#include "python/src/api.hpp"

namespace ftpy {

std::vector<std::string> cuda_devices() {
  std::vector<std::string> names;
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return names;
  }
  for (int i = 0; i < devices; ++i) {
    cudaDeviceProp properties;
    if (cudaGetDeviceProperties(&properties, i) == cudaSuccess) {
      names.emplace_back(properties.name);
    }
  }
  return names;
}

}  // namespace ftpy
