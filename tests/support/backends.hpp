// SPDX-License-Identifier: Apache-2.0
/// @file The executors that a test body runs on, and copies to and from their memory.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <string>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/memory.hpp"

namespace test {

struct host_backend {
  using exec_type = ft::host_exec;
  static constexpr char const* name = "host";
  exec_type exec{};
  static bool available() { return true; }
};

#if defined(__CUDACC__)
struct cuda_backend {
  using exec_type = ft::cuda_exec;
  static constexpr char const* name = "cuda";
  exec_type exec;

  /// Without a device there is no stream: such a backend exists only for tests that skip.
  cuda_backend() : exec(make()) {}
  cuda_backend(cuda_backend const&) = delete;
  cuda_backend& operator=(cuda_backend const&) = delete;
  ~cuda_backend() {
    if (exec.stream != nullptr) { cudaStreamDestroy(exec.stream); }
  }
  /// False without a device, so that the test skips; with FT_REQUIRE_GPU=1 that is a failure.
  static bool available() {
    char const* const require = std::getenv("FT_REQUIRE_GPU");
    if (!device_found() && require != nullptr && std::string(require) == "1") {
      ADD_FAILURE() << "FT_REQUIRE_GPU=1 but there is no CUDA device";
    }
    return device_found();
  }

private:
  static bool device_found() {
    int devices = 0;
    bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
    cudaGetLastError();
    return found;
  }
  static ft::cuda_exec make() {
    cudaStream_t stream = nullptr;
    if (device_found()) {
      ft::throw_on_error(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking),
                         "cudaStreamCreate");
    }
    return ft::cuda_exec(stream);
  }
};
/// The program of the C++ compiler runs the same tests on the host.
using backends = ::testing::Types<cuda_backend>;
#else
using backends = ::testing::Types<host_backend>;
#endif

/// Base of typed test suites over executors.
template <typename Backend>
class on_backend : public ::testing::Test {
protected:
  void SetUp() override {
    if (!Backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  }
};

}  // namespace test
