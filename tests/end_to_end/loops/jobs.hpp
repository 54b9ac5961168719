// SPDX-License-Identifier: Apache-2.0
/// @file Runs that do not depend on each other, several at a time.
#pragma once

#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace loop_cases {

/// Calls run(exec, i) for i in [0, count) on `jobs` threads, each with an executor of its own.
/// @param make_exec calls what it is given with one @throws what a run threw
template <typename MakeExec, typename Run>
void in_parallel(int count, int jobs, MakeExec const& make_exec, Run const& run) {
  std::atomic<int> next{0};
  std::exception_ptr failure;
  std::mutex mutex;
  std::vector<std::thread> threads;
  for (int j = 0; j < jobs; ++j) {
    threads.emplace_back([&] {
      try {
        make_exec([&](auto const& exec) {
          for (int i = next++; i < count; i = next++) { run(exec, i); }
        });
      } catch (...) {
        std::lock_guard<std::mutex> const lock(mutex);
        failure = std::current_exception();
        next = count;
      }
    });
  }
  for (auto& t : threads) { t.join(); }
  if (failure) { std::rethrow_exception(failure); }
}

}  // namespace loop_cases
