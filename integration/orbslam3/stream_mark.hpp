// SPDX-License-Identifier: Apache-2.0
/// @file A place in an executor's queue that the host can wait for while what follows goes on; and
/// the device that a thread works with.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// On the host everything is done when a call returns.
template <typename Exec>
class stream_mark {
public:
  void make() {}
  void set(Exec const&) {}
  void wait() const {}
};

/// The device of the thread that made the object, for other threads.
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
  /// Until what was queued before set() is done. @throws cuda_error
  void wait() const { ft::throw_on_error(cudaEventSynchronize(event_), "cudaEventSynchronize"); }

private:
  cudaEvent_t event_ = nullptr;
};

template <>
class thread_device<cuda_exec> {
public:
  thread_device() { ft::throw_on_error(cudaGetDevice(&device_), "cudaGetDevice"); }
  /// The calling thread works with that device from now on.
  void enter() const { ft::throw_on_error(cudaSetDevice(device_), "cudaSetDevice"); }

private:
  int device_ = 0;
};
#endif

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
