// SPDX-License-Identifier: Apache-2.0
#include "bench/frame_runner.hpp"

namespace bench {

std::unique_ptr<frame_runner> make_cuda_fisheye(scene const& s, frame_options const& how) {
  return make_runner_of<ft::cuda_exec, fisheye_rig>(s, how);
}

}  // namespace bench
