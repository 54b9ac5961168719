// SPDX-License-Identifier: Apache-2.0
/// @file The executors that the shim's tests run on. The tests are units of the host compiler; the
/// device's side comes from cuda_backend.cu, where the program is built with it.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "integration/orbslam3/host_tracker.hpp"

namespace orbslam3_test {

#if FT_TEST_CUDA
bool cuda_found();
std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s);
#endif

/// ThreadSanitizer does not see how the oneTBB library, which is not built with it, orders its
/// workers: every access in a parallel loop would be reported. One thread uses no pool, and leaves
/// what the shim itself shares between threads.
#if defined(__SANITIZE_THREAD__)
inline constexpr int host_threads = 1;
#else
inline constexpr int host_threads = 0;
#endif

/// Base of tests over executors, by name: "host" or "cuda".
class on_executor : public ::testing::TestWithParam<std::string> {
protected:
  void SetUp() override {
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
  static std::unique_ptr<ft::orbslam3::device_tracker> make(ft::orbslam3::settings const& s) {
#if FT_TEST_CUDA
    if (GetParam() == "cuda") { return make_cuda(s); }
#endif
    return ft::orbslam3::make_host_tracker(s, host_threads);
  }
};

inline std::vector<std::string> executors() {
#if FT_TEST_CUDA
  return {"host", "cuda"};
#else
  return {"host"};
#endif
}

inline std::string executor_name(::testing::TestParamInfo<std::string> const& info) {
  return info.param;
}

}  // namespace orbslam3_test
