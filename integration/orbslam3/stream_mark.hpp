// SPDX-License-Identifier: Apache-2.0
/// @file A mark in a stream that the host can wait for while later work goes on, and the device of
/// a thread.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// On the host all work is done when a call returns.
template <typename Exec>
class stream_mark {
public:
  void make() {}
  void set(Exec const&) {}
  void wait() const {}
};

/// The device of the thread that constructed the object, for other threads.
template <typename Exec>
class thread_device {
public:
  void enter() const {}
};

#if defined(__CUDACC__)
/// Owns an event.
template <>
class stream_mark<cuda_exec> {
public:
  stream_mark() = default;
  stream_mark(stream_mark const&) = delete;
  stream_mark& operator=(stream_mark const&) = delete;
  ~stream_mark() {
    if (event_ != nullptr) { static_cast<void>(cudaEventDestroy(event_)); }
  }
  /// Creates the event; once. @throws cuda_error
  void make() {
    ft::throw_on_error(cudaEventCreateWithFlags(&event_, cudaEventDisableTiming),
                       "cudaEventCreateWithFlags");
  }
  void set(cuda_exec const& exec) {
    ft::throw_on_error(cudaEventRecord(event_, exec.stream), "cudaEventRecord");
  }
  /// Waits for the work that was enqueued before set(). @throws cuda_error
  void wait() const { ft::throw_on_error(cudaEventSynchronize(event_), "cudaEventSynchronize"); }

private:
  cudaEvent_t event_ = nullptr;
};

template <>
class thread_device<cuda_exec> {
public:
  thread_device() { ft::throw_on_error(cudaGetDevice(&device_), "cudaGetDevice"); }
  /// Makes this the current device of the calling thread.
  void enter() const { ft::throw_on_error(cudaSetDevice(device_), "cudaSetDevice"); }

private:
  int device_ = 0;
};
#endif

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
