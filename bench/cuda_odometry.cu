// SPDX-License-Identifier: Apache-2.0
#include <stdexcept>

#include "bench/odometry_runner.hpp"

namespace bench {

std::unique_ptr<odometry_runner> make_cuda_odometry(scene const& s, frame_options const& how) {
  return make_odometry_runner_of<ft::cuda_exec>(s, how);
}

double device_bytes_in_use() {
  std::size_t available = 0, all = 0;
  if (cudaMemGetInfo(&available, &all) != cudaSuccess) {
    throw std::runtime_error("cudaMemGetInfo");
  }
  return static_cast<double>(all - available);
}

}  // namespace bench
