// SPDX-License-Identifier: Apache-2.0
#include <memory>

#include "integration/orbslam3/make_tracker.hpp"
#include "tests/integration/orbslam3/backends.hpp"

namespace orbslam3_test {

bool cuda_found() {
  int devices = 0;
  bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
  static_cast<void>(cudaGetLastError());
  return found;
}

std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s) {
  return ft::orbslam3::make_cuda_tracker(s);
}

}  // namespace orbslam3_test
