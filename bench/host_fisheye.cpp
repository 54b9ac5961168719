// SPDX-License-Identifier: Apache-2.0
#include "bench/frame_runner.hpp"

namespace bench {

std::unique_ptr<frame_runner> make_host_fisheye(scene const& s, frame_options const& how) {
  return make_runner_of<ft::host_exec, fisheye_rig>(s, how);
}

}  // namespace bench
