// SPDX-License-Identifier: Apache-2.0
#include "bench/inertial_runner.hpp"

namespace bench {

std::unique_ptr<inertial_runner> make_cuda_inertial(inertial_case const& what) {
  return std::make_unique<inertial_runner_of<ft::cuda_exec>>(what);
}

}  // namespace bench
