// SPDX-License-Identifier: Apache-2.0
#include "integration/orbslam3/executor_tracker.hpp"

std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s) {
  return ft::orbslam3::make_cuda_tracker(s);
}
