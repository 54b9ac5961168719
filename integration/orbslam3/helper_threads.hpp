// SPDX-License-Identifier: Apache-2.0
/// @file Threads that share short pieces of work.
#pragma once

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace ft {
namespace orbslam3 {

/// share() may be called by one thread at a time. The caller takes parts from the beginning, so a
/// helper that wakes up late finds less work, or none.
class helper_threads {
public:
  /// @param wanted threads; -1: a quarter of the machine's, 3 at most
  static int chosen(int wanted) {
    int const machine = static_cast<int>(std::thread::hardware_concurrency());
    return wanted < 0 ? std::min(machine / 4, 3) : wanted;
  }

  explicit helper_threads(int count) {
    for (int i = 0; i < count; ++i) {
      threads_.emplace_back([this] { help(); });
    }
  }
  helper_threads(helper_threads const&) = delete;
  helper_threads& operator=(helper_threads const&) = delete;
  ~helper_threads() {
    {
      std::lock_guard<std::mutex> const lock(mutex_);
      ended_ = true;
    }
    begun_.notify_all();
    for (std::thread& t : threads_) { t.join(); }
  }

  /// Calls part(i) once for every i in [0, parts), on any of the threads; returns when all are
  /// done.
  /// @throws the last exception thrown by a part
  template <typename Part>
  void share(int parts, Part const& part) {
    if (threads_.empty() || parts < 2) {
      for (int i = 0; i < parts; ++i) { part(i); }
      return;
    }
    std::unique_lock<std::mutex> lock(mutex_);
    next_ = 0;
    parts_ = parts;
    part_ = &part;
    call_ = [](void const* p, int i) { (*static_cast<Part const*>(p))(i); };
    begun_.notify_all();
    work(lock);
    while (working_ > 0) {
      // The rest takes microseconds: too short for a sleep.
      lock.unlock();
      std::this_thread::yield();
      lock.lock();
    }
    parts_ = 0;
    if (failure_) { std::rethrow_exception(std::exchange(failure_, nullptr)); }
  }

private:
  /// Runs parts until none is left. @param lock held on entry; released while a part runs
  void work(std::unique_lock<std::mutex>& lock) {
    while (next_ < parts_) {
      int const i = next_++;
      lock.unlock();
      std::exception_ptr failure;
      try {
        call_(part_, i);
      } catch (...) { failure = std::current_exception(); }
      lock.lock();
      if (failure) { failure_ = failure; }
    }
  }
  void help() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (!ended_) {
      if (next_ < parts_) {
        ++working_;
        work(lock);
        --working_;
      } else {
        begun_.wait(lock);
      }
    }
  }

  std::mutex mutex_;
  std::condition_variable begun_;
  std::vector<std::thread> threads_;
  void const* part_ = nullptr;
  void (*call_)(void const*, int) = nullptr;
  std::exception_ptr failure_;
  int next_ = 0;
  int parts_ = 0;
  int working_ = 0;  ///< busy helpers
  bool ended_ = false;
};

}  // namespace orbslam3
}  // namespace ft
