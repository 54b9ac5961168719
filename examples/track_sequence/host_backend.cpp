// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <stdexcept>

#include "examples/track_sequence/processor_name.hpp"
#include "examples/track_sequence/visual_odometry.hpp"

namespace app {

std::unique_ptr<odometry> make_host_odometry(odometry_options const& options) {
  if (options.monocular) { return make_host_monocular(options); }
  if (options.rgbd) { return make_host_rgbd(options); }
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
