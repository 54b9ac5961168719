// SPDX-License-Identifier: Apache-2.0
/// @file Owners of CUDA streams and events, and the check of CUDA's status codes. Empty where the
/// compiler is not a CUDA compiler.
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <string>
#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"

namespace ft {
inline namespace FT_ABI {

/// Turns a status of the CUDA runtime into an exception, and clears the runtime's last error.
/// @param call named in the message
/// @throws cuda_error with CUDA's description
inline void throw_on_error(cudaError_t status, char const* call) {
  if (status != cudaSuccess) {
    cudaGetLastError();
    throw cuda_error(std::string("ft: ") + call + ": " + cudaGetErrorName(status) + ", " +
                     cudaGetErrorString(status));
  }
}

/// Owns a stream of the current device that does not synchronise with the default stream.
/// Move-only; a moved-from stream holds null. The destructor does not wait for the stream.
class stream {
public:
  /// @throws cuda_error
  stream() {
    throw_on_error(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking),
                   "cudaStreamCreateWithFlags");
  }
  stream(stream&& other) noexcept : stream_(std::exchange(other.stream_, nullptr)) {}
  stream& operator=(stream&& other) noexcept {
    std::swap(stream_, other.stream_);
    return *this;
  }
  stream(stream const&) = delete;
  stream& operator=(stream const&) = delete;
  ~stream() {
    if (stream_ != nullptr) { static_cast<void>(cudaStreamDestroy(stream_)); }
  }
  cudaStream_t get() const { return stream_; }

private:
  cudaStream_t stream_ = nullptr;
};

/// Owns an event of the current device. Move-only; a moved-from event holds null.
class event {
public:
  /// @param flags as cudaEventCreateWithFlags takes them: cudaEventDefault for one that is timed
  /// @throws cuda_error
  explicit event(unsigned flags = cudaEventDisableTiming) {
    throw_on_error(cudaEventCreateWithFlags(&event_, flags), "cudaEventCreateWithFlags");
  }
  event(event&& other) noexcept : event_(std::exchange(other.event_, nullptr)) {}
  event& operator=(event&& other) noexcept {
    std::swap(event_, other.event_);
    return *this;
  }
  event(event const&) = delete;
  event& operator=(event const&) = delete;
  ~event() {
    if (event_ != nullptr) { static_cast<void>(cudaEventDestroy(event_)); }
  }
  cudaEvent_t get() const { return event_; }

  /// Marks the work enqueued on `stream` so far. Asynchronous. @throws cuda_error
  void record(cudaStream_t stream) const {
    throw_on_error(cudaEventRecord(event_, stream), "cudaEventRecord");
  }
  /// Makes later work on `stream` wait for the last record(). Asynchronous.
  /// @throws cuda_error
  void make_wait(cudaStream_t stream) const {
    throw_on_error(cudaStreamWaitEvent(stream, event_, 0), "cudaStreamWaitEvent");
  }

private:
  cudaEvent_t event_ = nullptr;
};

}  // namespace FT_ABI
}  // namespace ft

#endif  // __CUDACC__
