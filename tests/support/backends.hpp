// SPDX-License-Identifier: Apache-2.0
/// @file The executors that a test body runs on, and copies to and from their memory.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

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

/// A grey image with structure at all scales: flat areas, edges and noise; the same for the same
/// seed.
inline std::vector<std::uint8_t> random_image(int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::uint8_t> image(
      static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 90);
  int const boxes = 40 + width * height / 1500;
  for (int i = 0; i < boxes; ++i) {
    int const w = 1 + static_cast<int>(random() % static_cast<unsigned>(2 + width / (2 + i % 40)));
    int const h = 1 + static_cast<int>(random() % static_cast<unsigned>(2 + height / (2 + i % 40)));
    int const x0 = static_cast<int>(random() % static_cast<unsigned>(width));
    int const y0 = static_cast<int>(random() % static_cast<unsigned>(height));
    auto const grey = static_cast<std::uint8_t>(random());
    for (int y = y0; y < y0 + h && y < height; ++y) {
      for (int x = x0; x < x0 + w && x < width; ++x) {
        image[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
              static_cast<std::size_t>(x)] = grey;
      }
    }
  }
  for (auto& p : image) {
    p = static_cast<std::uint8_t>(
        std::min(255, std::max(0, static_cast<int>(p) + static_cast<int>(random() % 9) - 4)));
  }
  return image;
}

}  // namespace test
