// SPDX-License-Identifier: Apache-2.0
/// @file Times of the transfers and kernels of one call.
#pragma once

#include <chrono>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "integration/orbslam3/plain_types.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// Marks in the order begin, uploaded, computed, downloaded; read after the executor's wait().
/// Without measure(true) a mark only tests a flag.
template <typename Exec>
class call_clock {
public:
  void measure(bool on) { on_ = on; }
  bool measuring() const { return on_; }
  void mark(Exec const&, int i) {
    if (on_) { at_[i] = std::chrono::steady_clock::now(); }
  }
  device_times read() const {
    return on_ ? device_times{between(0, 1) + between(2, 3), between(1, 2)} : device_times{};
  }

private:
  double between(int a, int b) const {
    return std::chrono::duration<double, std::micro>(at_[b] - at_[a]).count();
  }
  bool on_ = false;
  std::chrono::steady_clock::time_point at_[4];
};

#if defined(__CUDACC__)
/// With events on the stream, which the first measure(true) creates.
template <>
class call_clock<cuda_exec> {
public:
  call_clock() = default;
  call_clock(call_clock const&) = delete;
  call_clock& operator=(call_clock const&) = delete;
  ~call_clock() {
    for (cudaEvent_t event : at_) {
      if (event != nullptr) { static_cast<void>(cudaEventDestroy(event)); }
    }
  }
  void measure(bool on) {
    for (cudaEvent_t& event : at_) {
      if (on && event == nullptr) { check(cudaEventCreate(&event)); }
    }
    on_ = on;
  }
  bool measuring() const { return on_; }
  void mark(cuda_exec const& exec, int i) {
    if (on_) { check(cudaEventRecord(at_[i], exec.stream)); }
  }
  device_times read() const {
    return on_ ? device_times{between(0, 1) + between(2, 3), between(1, 2)} : device_times{};
  }

private:
  static void check(cudaError_t status) {
    if (status != cudaSuccess) {
      throw cuda_error(std::string("ft: event: ") + cudaGetErrorString(status));
    }
  }
  double between(int a, int b) const {
    float ms = 0;
    check(cudaEventElapsedTime(&ms, at_[a], at_[b]));
    return 1e3 * static_cast<double>(ms);
  }
  bool on_ = false;
  cudaEvent_t at_[4] = {};
};
#endif

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
