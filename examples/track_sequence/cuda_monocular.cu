// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/cuda_odometry.hpp"

namespace app {

std::unique_ptr<odometry> make_cuda_monocular(odometry_options const& options) {
  if (options.fisheye) {
    return std::make_unique<cuda_odometry<ft::monocular_rig<ft::kannala_brandt<float>>>>(options);
  }
  return std::make_unique<cuda_odometry<ft::monocular_rig<ft::pinhole<float>>>>(options);
}

}  // namespace app
