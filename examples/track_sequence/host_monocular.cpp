// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "examples/track_sequence/processor_name.hpp"
#include "examples/track_sequence/visual_odometry.hpp"

namespace app {

std::unique_ptr<odometry> make_host_monocular(odometry_options const& options) {
  ft::host_exec const exec(options.threads);
  if (options.fisheye) {
    using rig_type = ft::monocular_rig<ft::kannala_brandt<float>>;
    return std::make_unique<visual_odometry<ft::host_exec, rig_type>>(exec, options,
                                                                      processor_name());
  }
  using rig_type = ft::monocular_rig<ft::pinhole<float>>;
  return std::make_unique<visual_odometry<ft::host_exec, rig_type>>(exec, options,
                                                                    processor_name());
}

}  // namespace app
