// SPDX-License-Identifier: Apache-2.0
/// @file Work beside the main line of an executor: a second stream on a device, nothing special on
/// the host.
#pragma once

#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// fork() gives an executor for work that may run beside what is queued next; join() makes what is
/// queued after it wait for that work. Both may be recorded in a graph. A single launch needs no
/// branch, see beside() in execution.hpp.
template <typename Exec>
class side_branch {
public:
  void make() {}
  Exec const& fork(Exec const& exec) { return exec; }
  void join(Exec const&) {}
};

#if defined(__CUDACC__)
/// Owns a stream and two events; move-only. One fork at a time.
template <>
class side_branch<cuda_exec> {
public:
  side_branch() = default;
  side_branch(side_branch&& other) noexcept
      : stream_(std::exchange(other.stream_, nullptr)),
        begin_(std::exchange(other.begin_, nullptr)),
        end_(std::exchange(other.end_, nullptr)) {}
  side_branch& operator=(side_branch&& other) noexcept {
    std::swap(stream_, other.stream_);
    std::swap(begin_, other.begin_);
    std::swap(end_, other.end_);
    return *this;
  }
  side_branch(side_branch const&) = delete;
  side_branch& operator=(side_branch const&) = delete;
  ~side_branch() {
    if (begin_ != nullptr) { static_cast<void>(cudaEventDestroy(begin_)); }
    if (end_ != nullptr) { static_cast<void>(cudaEventDestroy(end_)); }
    if (stream_ != nullptr) { static_cast<void>(cudaStreamDestroy(stream_)); }
  }

  /// Creates the stream and the events; once, before the first fork(). @throws cuda_error
  void make() {
    detail::check(cudaStreamCreateWithFlags(&stream_, cudaStreamNonBlocking),
                  "cudaStreamCreateWithFlags");
    detail::check(cudaEventCreateWithFlags(&begin_, cudaEventDisableTiming),
                  "cudaEventCreateWithFlags");
    detail::check(cudaEventCreateWithFlags(&end_, cudaEventDisableTiming),
                  "cudaEventCreateWithFlags");
  }
  cuda_exec fork(cuda_exec const& exec) {
    detail::check(cudaEventRecord(begin_, exec.stream), "cudaEventRecord");
    detail::check(cudaStreamWaitEvent(stream_, begin_, 0), "cudaStreamWaitEvent");
    return cuda_exec(stream_, exec.early_launches);
  }
  void join(cuda_exec const& exec) {
    detail::check(cudaEventRecord(end_, stream_), "cudaEventRecord");
    detail::check(cudaStreamWaitEvent(exec.stream, end_, 0), "cudaStreamWaitEvent");
  }

private:
  cudaStream_t stream_ = nullptr;
  cudaEvent_t begin_ = nullptr;
  cudaEvent_t end_ = nullptr;
};
#endif

}  // namespace FT_ABI
}  // namespace ft
