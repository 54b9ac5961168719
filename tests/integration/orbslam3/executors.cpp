// SPDX-License-Identifier: Apache-2.0
// With FT_TEST_CUDA the program has cuda_backend.cu as well, and the tests of that executor alone.
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "tests/integration/orbslam3/backends.hpp"

namespace orbslam3_test {

void on_executor::SetUp() {
#if FT_TEST_CUDA
  if (GetParam() == "cuda" && !cuda_found()) {
    char const* const require = std::getenv("FT_REQUIRE_GPU");
    if (require != nullptr && std::string(require) == "1") {
      FAIL() << "FT_REQUIRE_GPU=1 but there is no CUDA device";
    }
    GTEST_SKIP() << "no CUDA device";
  }
#endif
}

std::unique_ptr<ft::orbslam3::device_tracker> on_executor::make(ft::orbslam3::settings const& s) {
#if FT_TEST_CUDA
  return make_cuda(s);
#else
  return make_host(s);
#endif
}

std::vector<std::string> executors() {
#if FT_TEST_CUDA
  return {"cuda"};  // the other program has the host
#else
  return {"host"};
#endif
}

}  // namespace orbslam3_test
