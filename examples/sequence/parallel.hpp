// SPDX-License-Identifier: Apache-2.0
/// @file Runs tasks on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace seq {

/// Calls task(i) once for every i in [0, count), in no fixed order, on `threads` threads including
/// the caller's; returns when all are done. After an exception no new task begins, and the first
/// exception is rethrown. Uses fewer threads if the system refuses more.
/// @param threads 0 = all of the machine
template <typename Task>
void parallel_for(int count, int threads, Task const& task) {
  if (threads <= 0) {
    threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  }
  std::atomic<int> next{0};
  std::mutex guard;
  std::exception_ptr failure;
  auto const work = [&] {
    for (int i = next++; i < count; i = next++) {
      try {
        task(i);
      } catch (...) {
        std::lock_guard<std::mutex> const lock(guard);
        if (!failure) { failure = std::current_exception(); }
        next = count;
      }
    }
  };
  std::vector<std::thread> pool;
  try {
    for (int i = 1; i < std::min(threads, count); ++i) { pool.emplace_back(work); }
  } catch (std::system_error const&) {}  // continue with fewer threads
  work();
  for (auto& thread : pool) { thread.join(); }
  if (failure) { std::rethrow_exception(failure); }
}

}  // namespace seq
