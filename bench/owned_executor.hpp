// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "ft/core/execution.hpp"

namespace bench {
inline namespace FT_ABI {

/// The executor of a runner, with its stream on a device.
template <typename Exec>
struct owned_executor;

template <>
struct owned_executor<ft::host_exec> {
  ft::host_exec exec;
  explicit owned_executor(int threads) : exec(threads) {}
  bool done() const { return true; }
};

#if defined(__CUDACC__)
template <>
struct owned_executor<ft::cuda_exec> {
  ft::stream owned;
  ft::cuda_exec exec{owned.get()};
  explicit owned_executor(int) {}
  bool done() const {
    cudaError_t const status = cudaStreamQuery(exec.stream);
    if (status == cudaErrorNotReady) { return false; }
    ft::throw_on_error(status, "cudaStreamQuery");
    return true;
  }
};
#endif

}  // namespace FT_ABI
}  // namespace bench
