// SPDX-License-Identifier: Apache-2.0
/// @file A sequence of launches and copies, recorded once and replayed: a CUDA graph on a device,
/// the calls themselves on the host.
#pragma once

#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// The host has no graphs: replay() makes the calls.
template <typename Exec>
class recording {
public:
  /// Calls the second argument with an executor. The memory that its launches use must not move.
  template <typename Queue>
  void record(Exec const&, Queue const&) {}
  template <typename Queue>
  void replay(Exec const& exec, Queue const& queue) const {
    queue(exec);
  }
};

#if defined(__CUDACC__)
/// Owns an executable CUDA graph; move-only. record() neither waits nor runs anything. replay() is
/// asynchronous, a single launch, and allocates nothing.
template <>
class recording<cuda_exec> {
public:
  recording() = default;
  recording(recording&& other) noexcept : graph_(std::exchange(other.graph_, nullptr)) {}
  recording& operator=(recording&& other) noexcept {
    std::swap(graph_, other.graph_);
    return *this;
  }
  recording(recording const&) = delete;
  recording& operator=(recording const&) = delete;
  ~recording() {
    if (graph_ != nullptr) { static_cast<void>(cudaGraphExecDestroy(graph_)); }
  }

  /// Captures on its own stream, so the caller's may be any stream, including the default one.
  /// @throws cuda_error
  template <typename Queue>
  void record(cuda_exec const&, Queue const& queue) {
    stream const capturing;
    cudaGraph_t graph = nullptr;
    throw_on_error(cudaStreamBeginCapture(capturing.get(), cudaStreamCaptureModeThreadLocal),
                   "cudaStreamBeginCapture");
    try {
      queue(detail::launch_access::make(capturing.get(), true));
    } catch (...) {
      static_cast<void>(cudaStreamEndCapture(capturing.get(), &graph));
      if (graph != nullptr) { static_cast<void>(cudaGraphDestroy(graph)); }
      throw;
    }
    throw_on_error(cudaStreamEndCapture(capturing.get(), &graph), "cudaStreamEndCapture");
    cudaGraphExec_t made = nullptr;
    cudaError_t const status = cudaGraphInstantiateWithFlags(&made, graph, 0);
    static_cast<void>(cudaGraphDestroy(graph));
    throw_on_error(status, "cudaGraphInstantiate");
    if (graph_ != nullptr) { static_cast<void>(cudaGraphExecDestroy(graph_)); }
    graph_ = made;
  }
  template <typename Queue>
  void replay(cuda_exec const& exec, Queue const& queue) const {
    if (graph_ == nullptr) {
      queue(exec);
      return;
    }
    throw_on_error(cudaGraphLaunch(graph_, exec.stream), "cudaGraphLaunch");
  }

private:
  cudaGraphExec_t graph_ = nullptr;
};
#endif

}  // namespace FT_ABI
}  // namespace ft
