// SPDX-License-Identifier: Apache-2.0
/// @file Threads that share short pieces of work.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace ft::orbslam3 {

/// share() and wake() may be called by one thread at a time. The caller takes parts from the
/// beginning, so a helper that wakes up late finds less work, or none. A sleeping thread takes tens
/// of microseconds to begin; helpers therefore stay awake for a while after each piece of work.
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
    ended_ = true;
    wake();
    for (std::thread& t : threads_) { t.join(); }
  }

  /// Calls part(i) once for every i in [0, parts), on any of the threads; returns when all are
  /// done. @param parts less than 2^16
  /// @throws the last exception thrown by a part
  template <typename Part>
  void share(int parts, Part const& part) {
    if (threads_.empty() || parts < 2) {
      for (int i = 0; i < parts; ++i) { part(i); }
      return;
    }
    part_ = &part;
    call_ = [](void const* p, int i) { (*static_cast<Part const*>(p))(i); };
    done_ = 0;
    ++jobs_;
    ticket_ = ticket{jobs_, static_cast<std::uint16_t>(parts), 0}.packed();
    if (sleeping_ > 0) { wake_all(); }
    while (take_part()) {}
    // The rest takes microseconds: too short for a sleep.
    for (int turn = 1; done_ < parts; ++turn) { pause(turn); }
    if (failure_) { std::rethrow_exception(std::exchange(failure_, nullptr)); }
  }
  /// Wakes the threads for a share() that will follow soon. Does not wait for them.
  /// @param stay how long they stay awake without work
  void wake(std::chrono::microseconds stay = awake) {
    stay_ = stay.count();
    ++calls_;
    if (sleeping_ > 0) { wake_all(); }
  }

private:
  static constexpr std::chrono::microseconds awake{200};  ///< after the last work

  /// A job and its next part, in one word: who takes a part knows that its job is not over.
  struct ticket {
    std::uint32_t job;
    std::uint16_t parts;
    std::uint16_t next;

    std::uint64_t packed() const {
      return (std::uint64_t{job} << 32) | (std::uint64_t{parts} << 16) | next;
    }
    static ticket of(std::uint64_t word) {
      return {static_cast<std::uint32_t>(word >> 32), static_cast<std::uint16_t>(word >> 16),
              static_cast<std::uint16_t>(word)};
    }
    bool open() const { return next < parts; }
  };

  static void pause(int turn) {
    if (turn % 1024 == 0) { std::this_thread::yield(); }
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_ia32_pause();
#endif
  }
  /// All at once: if they woke each other, the last would begin when the work is done.
  void wake_all() {
    { std::lock_guard<std::mutex> const lock(mutex_); }
    woken_.notify_all();
  }
  /// Runs a part. @return false if there is none
  bool take_part() {
    std::uint64_t word = ticket_;
    for (;;) {
      if (!ticket::of(word).open()) { return false; }
      if (ticket_.compare_exchange_weak(word, word + 1)) { break; }
    }
    try {
      call_(part_, ticket::of(word).next);
    } catch (...) {
      std::lock_guard<std::mutex> const lock(mutex_);
      failure_ = std::current_exception();
    }
    ++done_;
    return true;
  }
  void help() {
    std::uint32_t calls = 0;
    while (!ended_) {
      using clock = std::chrono::steady_clock;
      auto end = clock::now() + std::chrono::microseconds(stay_);
      for (int turn = 1; turn % 64 != 0 || clock::now() < end; ++turn) {
        if (take_part()) {
          while (take_part()) {}
          end = clock::now() + awake;
        }
        pause(turn);
      }
      std::unique_lock<std::mutex> lock(mutex_);
      ++sleeping_;
      woken_.wait(lock, [&] { return ended_ || calls != calls_ || ticket::of(ticket_).open(); });
      --sleeping_;
      calls = calls_;
    }
  }

  std::mutex mutex_;  ///< of the sleep and of failure_
  std::condition_variable woken_;
  std::vector<std::thread> threads_;
  void const* part_ = nullptr;
  void (*call_)(void const*, int) = nullptr;
  std::exception_ptr failure_;
  std::uint32_t jobs_ = 0;
  std::atomic<std::uint64_t> ticket_{0};
  std::atomic<int> done_{0};  ///< parts of the job
  std::atomic<int> sleeping_{0};
  std::atomic<std::uint32_t> calls_{0};            ///< of wake()
  std::atomic<std::int64_t> stay_{awake.count()};  ///< microseconds, of the last wake()
  std::atomic<bool> ended_{false};
};

}  // namespace ft::orbslam3
