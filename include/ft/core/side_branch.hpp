// SPDX-License-Identifier: Apache-2.0
/// @file Work concurrent with an executor's main line: a second stream on a device. On the host it
/// runs in order.
#pragma once

#include <optional>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"

namespace ft {
inline namespace FT_ABI {

/// fork() returns an executor for work that may run concurrently with later work of the main line.
/// A second fork() makes later work of the branch wait for the main line again. join() makes later
/// work of the main line wait for the branch. All can be recorded in a graph. For a single launch
/// use launch_order::concurrent instead.
template <typename Exec>
class side_branch {
public:
  void make() {}
  Exec const& fork(Exec const& exec) { return exec; }
  void join(Exec const&) {}
};

#if defined(__CUDACC__)
/// Owns a stream and two events; move-only.
template <>
class side_branch<cuda_exec> {
public:
  /// Creates the stream and the events; once, before the first fork(). @throws cuda_error
  void make() { handles_.emplace(); }
  cuda_exec fork(cuda_exec const& exec) {
    handles_->begin.record(exec.stream);
    handles_->begin.make_wait(handles_->branch.get());
    return detail::launch_access::make(handles_->branch.get(),
                                       detail::launch_access::programmatic(exec));
  }
  void join(cuda_exec const& exec) {
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

}  // namespace FT_ABI
}  // namespace ft
