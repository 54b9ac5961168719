// SPDX-License-Identifier: Apache-2.0
/// @file Work that runs beside an executor's main line: on a stream of its own, or on a thread.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Runs the same work again and again, one run after the other, on a thread of its own, in the
/// background of the executor's other work. The thread sleeps in between. Not movable.
/// @tparam Work `void enqueue(Exec const&, int run)`, called on that thread; run counts from 0
template <typename Exec, typename Work>
class work_beside {
public:
  /// @param runs in flight at a time, at most
  /// @param parts the work has one of so many parts of the executor's threads
  work_beside(Exec const& exec, Work work, int /*runs*/, int parts = 1)
      : exec_(exec.in_background(parts)), work_(std::move(work)), thread_([this] { serve(); }) {}
  work_beside(work_beside const&) = delete;
  work_beside& operator=(work_beside const&) = delete;
  /// Ends the thread after the run in progress.
  ~work_beside() {
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      ends_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  Work& work() { return work_; }
  /// The next run begins after the work before a mark of the main line. Asynchronous.
  void begin_after(work_mark<Exec> const&) {}
  /// Starts the next run, whose number is returned. Asynchronous.
  int begin() {
    int run = 0;
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      run = begun_++;
    }
    changed_.notify_all();
    return run;
  }
  /// Later work of the main line sees what run number `run` has written. Blocks here.
  /// @throws what the work threw
  void finish(Exec const&, int run) {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [&] { return done_ > run; });
    if (failure_) { std::rethrow_exception(std::exchange(failure_, nullptr)); }
  }
  /// Waits for all runs.
  void drain() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [&] { return done_ == begun_; });
  }

private:
  void serve() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      changed_.wait(lock, [&] { return ends_ || done_ < begun_; });
      if (ends_) { return; }
      int const run = done_;
      lock.unlock();
      std::exception_ptr failure;
      try {
        work_.enqueue(exec_, run);
      } catch (...) { failure = std::current_exception(); }
      lock.lock();
      if (failure) { failure_ = failure; }
      ++done_;
      changed_.notify_all();
    }
  }

  Exec exec_;
  Work work_;
  std::mutex mutex_;
  std::condition_variable changed_;
  int begun_ = 0;
  int done_ = 0;
  bool ends_ = false;
  std::exception_ptr failure_;
  std::thread thread_;  ///< last: it uses the others
};

#if defined(__CUDACC__)
/// On a device: a stream, and an event for each run in flight.
template <typename Work>
class work_beside<cuda_exec, Work> {
public:
  work_beside(cuda_exec const&, Work work, int runs, int /*parts*/ = 1)
      : exec_(stream_.get()), work_(std::move(work)) {
    for (int i = 0; i < runs; ++i) { ends_.emplace_back(); }
  }
  work_beside(work_beside const&) = delete;
  work_beside& operator=(work_beside const&) = delete;
  /// Waits for all runs, which use the caller's memory.
  ~work_beside() { static_cast<void>(cudaStreamSynchronize(stream_.get())); }

  Work& work() { return work_; }
  void begin_after(work_mark<cuda_exec> const& mark) { mark.make_wait(exec_); }
  int begin() {
    int const run = begun_++;
    work_.enqueue(exec_, run);
    ends_[static_cast<std::size_t>(run) % ends_.size()].record(stream_.get());
    return run;
  }
  /// Makes later work of `exec` wait for run number `run`. Asynchronous.
  void finish(cuda_exec const& exec, int run) {
    ends_[static_cast<std::size_t>(run) % ends_.size()].make_wait(exec.stream);
  }
  void drain() { exec_.wait(); }

private:
  stream stream_;
  cuda_exec exec_;
  Work work_;
  std::vector<event> ends_;
  int begun_ = 0;
};
#endif

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
