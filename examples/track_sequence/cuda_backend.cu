// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/cuda_odometry.hpp"

namespace app {

std::string cuda_device_name() {
  int devices = 0;
  cudaDeviceProp properties;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices < 1 ||
      cudaGetDeviceProperties(&properties, 0) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());
    return {};
  }
  return properties.name;
}

std::unique_ptr<odometry> make_cuda_odometry(odometry_options const& options) {
  if (options.monocular) { return make_cuda_monocular(options); }
  if (options.rgbd) { return make_cuda_rgbd(options); }
  if (options.fisheye) { return std::make_unique<cuda_odometry<fisheye_rig>>(options); }
  return std::make_unique<cuda_odometry<ft::rectified_rig>>(options);
}

}  // namespace app
