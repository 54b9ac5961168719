// SPDX-License-Identifier: Apache-2.0
/// @file Executors whose work does not queue behind that of another one.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// An executor for another thread than that of `beside`. On the host both share the thread pool.
/// The destructor waits.
template <typename Exec>
class own_stream {
public:
  explicit own_stream(Exec const& beside) : exec_(beside) {}
  Exec const& exec() const { return exec_; }

private:
  Exec exec_;
};

#if defined(__CUDACC__)
/// On a stream of its own, of the device that is current at construction.
template <>
class own_stream<cuda_exec> {
public:
  explicit own_stream(cuda_exec const& /*beside*/) : exec_(stream_.get()) {}
  own_stream(own_stream const&) = delete;
  own_stream& operator=(own_stream const&) = delete;
  ~own_stream() {
    try {
      exec_.wait();
    } catch (error const&) {  // the device is lost, and so is the work on it
    }
  }
  cuda_exec const& exec() const { return exec_; }

private:
  stream stream_;
  cuda_exec exec_;
};
#endif

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft
