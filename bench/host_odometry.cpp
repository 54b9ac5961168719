// SPDX-License-Identifier: Apache-2.0
#include "bench/odometry_runner.hpp"

namespace bench {

std::unique_ptr<odometry_runner> make_host_odometry(scene const& s, frame_options const& how) {
  return make_odometry_runner_of<ft::host_exec>(s, how);
}

}  // namespace bench
