// SPDX-License-Identifier: Apache-2.0
#include "bench/window_runner.hpp"

namespace bench {

std::unique_ptr<window_runner> make_cuda_windows(window_case const& what) {
  return std::make_unique<window_runner_of<ft::cuda_exec>>(what);
}

}  // namespace bench
