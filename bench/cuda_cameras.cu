// SPDX-License-Identifier: Apache-2.0
#include "bench/camera_runner.hpp"

namespace bench {

std::unique_ptr<camera_runner> make_cuda_cameras(int points, int sets) {
  return std::make_unique<camera_runner_of<ft::cuda_exec>>(0, points, sets);
}

std::string cuda_description() {
  int devices = 0;
  cudaDeviceProp properties;
  int driver = 0;
  int runtime = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices < 1 ||
      cudaGetDeviceProperties(&properties, 0) != cudaSuccess ||
      cudaDriverGetVersion(&driver) != cudaSuccess ||
      cudaRuntimeGetVersion(&runtime) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return {};
  }
  auto const version = [](int v) {
    return std::to_string(v / 1000) + "." + std::to_string(v % 1000 / 10);
  };
  return std::string(properties.name) + ", driver for CUDA " + version(driver) + ", runtime " +
         version(runtime);
}

int cuda_devices() {
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return 0;
  }
  return devices;
}

void use_cuda_device(int device) { ft::throw_on_error(cudaSetDevice(device), "cudaSetDevice"); }

}  // namespace bench
