// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "examples/track_sequence/processor_name.hpp"
#include "examples/track_sequence/visual_odometry.hpp"

namespace app {

std::unique_ptr<odometry> make_host_rgbd(odometry_options const& options) {
  return std::make_unique<visual_odometry<ft::host_exec, ft::rgbd_rig<>>>(
      ft::host_exec(options.threads), options, processor_name());
}

}  // namespace app
