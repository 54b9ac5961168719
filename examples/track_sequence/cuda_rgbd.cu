// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/cuda_odometry.hpp"

namespace app {

std::unique_ptr<odometry> make_cuda_rgbd(odometry_options const& options) {
  return std::make_unique<cuda_odometry<ft::rgbd_rig<>>>(options);
}

}  // namespace app
