// SPDX-License-Identifier: Apache-2.0
/// @file What a user says of her model, and the executors that it is tested on. Part of
/// tests/camera_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdlib>
#include <string>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"

namespace camera_contract {
inline namespace FT_ABI {

/// Base of a description; the user adds `width`, `height` (pixels) and `parameters()`, and hides
/// with her own what does not fit.
template <template <typename> class Model>
struct description {
  template <typename Scalar>
  using camera = Model<Scalar>;

  /// True where directions behind the plane z = 0 have a valid pixel; false: none has one.
  static constexpr bool sees_behind = false;
  /// An angle off the axis that a model which sees behind does see all around, degrees, 90 to 180.
  static constexpr double behind_degrees = 95;
  /// Least share of the image's pixels that have a valid ray.
  static constexpr double least_share = 0.9;
  /// How far a pixel may be off after a round trip, in double and in float, pixels. Coordinates
  /// up to 1000 have a spacing of 6e-5 in float.
  static constexpr double double_pixels = 1e-8;
  static constexpr double float_pixels = 1e-3;
};

struct host_executor {
  using exec_type = ft::host_exec;
  static constexpr char const* name = "host";
  exec_type exec{};
  static bool available() { return true; }
};

#if defined(__CUDACC__)
struct cuda_executor {
  using exec_type = ft::cuda_exec;
  static constexpr char const* name = "cuda";
  exec_type exec;

  cuda_executor() : exec(make()) {}
  cuda_executor(cuda_executor const&) = delete;
  cuda_executor& operator=(cuda_executor const&) = delete;
  ~cuda_executor() { cudaStreamDestroy(exec.stream); }

  static bool available() {
    int devices = 0;
    bool const found = cudaGetDeviceCount(&devices) == cudaSuccess && devices > 0;
    cudaGetLastError();
    char const* const require = std::getenv("FT_REQUIRE_GPU");
    if (!found && require != nullptr && std::string(require) == "1") {
      ADD_FAILURE() << "FT_REQUIRE_GPU=1 but there is no CUDA device";
    }
    return found;
  }

private:
  static ft::cuda_exec make() {
    cudaStream_t stream = nullptr;
    EXPECT_EQ(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), cudaSuccess);
    return ft::cuda_exec(stream);
  }
};
#endif

/// A copy of `values` in an executor's memory.
template <typename T, typename Exec>
ft::buffer<T, Exec::space> to_exec(Exec const& exec, std::vector<T> const& values) {
  ft::buffer<T, Exec::space> memory(values.size());
  ft::copy(exec, memory.data(), values.data(), values.size());
  exec.wait();
  return memory;
}
template <typename T, typename Exec>
std::vector<T> from_exec(Exec const& exec, T const* data, std::size_t count) {
  std::vector<T> values(count);
  ft::copy(exec, values.data(), data, count);
  exec.wait();
  return values;
}

/// Executor and description of a suite.
template <typename Executor, typename Description>
struct setting {
  using executor = Executor;
  using lens = Description;
};
struct executor_name {
  template <typename Setting>
  static std::string GetName(int) {
    return Setting::executor::name;
  }
};

#if defined(__CUDACC__)
template <typename Description>
using settings =
    ::testing::Types<setting<host_executor, Description>, setting<cuda_executor, Description>>;
template <typename Description>
using gpu_settings = ::testing::Types<setting<cuda_executor, Description>>;
#else
template <typename Description>
using settings = ::testing::Types<setting<host_executor, Description>>;
#endif

}  // namespace FT_ABI
}  // namespace camera_contract
