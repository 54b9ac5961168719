// SPDX-License-Identifier: Apache-2.0
/// @file A sequence of launches and copies, recorded once and replayed: a CUDA graph on a device,
/// the calls themselves on the host.
#pragma once

#include <optional>
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

// Work concurrent with an executor's main line: a second stream on a device. On the host it
// runs in order.

/// fork() returns an executor for work that may run concurrently with later work of the main line.
/// A second fork() makes later work of the branch wait for the main line again. join() makes later
/// work of the main line wait for the branch. All can be recorded in a graph. For a single launch
/// use launch_order::concurrent instead.
template <typename Exec>
class side_branch {
public:
  void make() {}
  Exec const& fork(Exec const& exec) const { return exec; }
  void join(Exec const&) const {}
};

#if defined(__CUDACC__)
/// Owns a stream and two events; move-only.
template <>
class side_branch<cuda_exec> {
public:
  /// Creates the stream and the events; once, before the first fork(). @throws cuda_error
  void make() { handles_.emplace(); }
  cuda_exec fork(cuda_exec const& exec) const {
    handles_->begin.record(exec.stream);
    handles_->begin.make_wait(handles_->branch.get());
    return detail::launch_access::make(handles_->branch.get(),
                                       detail::launch_access::programmatic(exec));
  }
  void join(cuda_exec const& exec) const {
    handles_->end.record(handles_->branch.get());
    handles_->end.make_wait(exec.stream);
  }

private:
  struct handles {
    stream branch;
    event begin, end;
  };
  std::optional<handles> handles_;
};
#endif

/// A place in an executor's work, which other work, or the host, can wait for. On the host all work
/// is complete.
template <typename Exec>
class work_mark {
public:
  void make() {}
  void set(Exec const&) const {}
  void wait() const {}
  void make_wait(Exec const&) const {}
};

#if defined(__CUDACC__)
/// Owns an event; move-only.
template <>
class work_mark<cuda_exec> {
public:
  /// Creates the event; once, before the first set(). @throws cuda_error
  void make() { event_.emplace(); }
  /// After all that is enqueued so far. @throws cuda_error
  void set(cuda_exec const& exec) const { event_->record(exec.stream); }
  /// Blocks until the work before the last set() is done; not at all without one.
  /// @throws cuda_error
  void wait() const {
    if (event_) { throw_on_error(cudaEventSynchronize(event_->get()), "cudaEventSynchronize"); }
  }
  /// Makes later work of `exec` wait for it. Asynchronous. @throws cuda_error
  void make_wait(cuda_exec const& exec) const { event_->make_wait(exec.stream); }

private:
  std::optional<event> event_;
};
#endif

}  // namespace FT_ABI
}  // namespace ft
