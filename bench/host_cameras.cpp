// SPDX-License-Identifier: Apache-2.0
#include "bench/camera_runner.hpp"

namespace bench {

std::unique_ptr<camera_runner> make_host_cameras(int threads, int points, int sets) {
  return std::make_unique<camera_runner_of<ft::host_exec>>(threads, points, sets);
}

}  // namespace bench
