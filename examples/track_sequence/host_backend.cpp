// SPDX-License-Identifier: Apache-2.0
#include <fstream>
#include <string>

#include "examples/track_sequence/visual_odometry.hpp"

namespace app {

namespace {

std::string processor_name() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("model name", 0) == 0) { return line.substr(line.find(':') + 2); }
  }
  return "unknown processor";
}

}  // namespace

std::unique_ptr<odometry> make_host_odometry(odometry_options const& options) {
  ft::host_exec const exec(options.threads);
  if (options.fisheye) {
    return std::make_unique<visual_odometry<ft::host_exec, fisheye_rig>>(exec, options,
                                                                         processor_name());
  }
  return std::make_unique<visual_odometry<ft::host_exec, ft::rectified_rig>>(exec, options,
                                                                             processor_name());
}

#if !FT_APP_HAS_CUDA
std::string cuda_device_name() { return {}; }
std::unique_ptr<odometry> make_cuda_odometry(odometry_options const&) {
  throw std::runtime_error("this program was built without CUDA");
}
#endif

}  // namespace app
