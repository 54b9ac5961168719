// SPDX-License-Identifier: Apache-2.0
/// @file The executor of the host: a pool of threads, one thread per item.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_invoke.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <cstring>
#include <memory>

#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/stage.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Whether this processor has AVX2 and POPCNT.
inline bool has_wide_vectors() {
#if FT_HAS_WIDE
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("popcnt");
#elif defined(__AVX2__)
  return true;
#else
  return false;
#endif
}

template <typename Op, typename... Args>
void run_plain(Op const& op, int item, Args const&... args) {
  typename Op::scratch scratch;
  if (run_prologue(op, single_group{}, scratch, item, args...)) {
    op(single_group{}, scratch, item, args...);
  }
}
/// The same, compiled for wide vectors.
template <typename Op, typename... Args>
FT_WIDE void run_wide(Op const& op, int item, Args const&... args) {
  typename Op::scratch scratch;
  if (run_prologue(op, single_group{}, scratch, item, args...)) {
    op(single_group{}, scratch, item, args...);
  }
}

}  // namespace detail

/// Runs stages on host threads, synchronously. Copies share the thread pool; safe to use from
/// several threads at a time.
class host_exec {
public:
  static constexpr memory_space space = memory_space::host;
  static constexpr bool asynchronous = false;

  /// @param threads to use, including the caller's; 0 = as many as the machine has
  /// @throws bad_argument outside [0, 4096]
  explicit host_exec(int threads = 0) : threads_(threads) {
    detail::require_range("host threads", threads, 0, 4096);
    if (threads > 1) { arena_ = std::make_shared<tbb::task_arena>(threads); }
  }
  /// For work that gives way to that of other executors: as many threads as this one has, divided
  /// by `parts`, but at least one.
  host_exec in_background(int parts = 1) const {
    int const all = threads_ == 0 ? tbb::this_task_arena::max_concurrency() : threads_;
    host_exec other(all / parts > 1 ? all / parts : 1);
    if (other.threads_ > 1) {
      other.arena_ =
          std::make_shared<tbb::task_arena>(other.threads_, 1, tbb::task_arena::priority::low);
    }
    return other;
  }

  template <typename Body>
  void parallel_for(int items, Body const& body) const {
    run_ranges(
        items,
        [](void const* context, int begin, int end) {
          Body const& run = *static_cast<Body const*>(context);
          for (int i = begin; i != end; ++i) { run(i); }
        },
        &body);
  }

  /// Calls a() and b(), at the same time where there are threads for it.
  template <typename A, typename B>
  void both(A const& a, B const& b) const {
    call_both({[](void const* f) { (*static_cast<A const*>(f))(); }, &a},
              {[](void const* f) { (*static_cast<B const*>(f))(); }, &b});
  }

  /// Returns at once: all calls are synchronous.
  void wait() const {}
  template <typename Done>
  void wait_until(Done const&) const {}
  /// The address through which stages can read host pointer `p`; null if they cannot.
  static void const* host_address(void const* p) { return p; }

private:
  // Pointers to functions, so that the thread pool's templates are compiled once and not for each
  // stage.
  using range_function = void (*)(void const* context, int begin, int end);
  struct call {
    void (*run)(void const* context);
    void const* context;

    void operator()() const { run(context); }
  };

  /// Calls `run` for disjoint ranges that cover [0, items).
  FT_OUT_OF_LINE void run_ranges(int items, range_function run, void const* context) const {
    if (threads_ == 1 || items <= 1) {
      run(context, 0, items > 0 ? items : 0);
      return;
    }
    auto const start = [=] {
      tbb::parallel_for(
          tbb::blocked_range<int>(0, items),
          [=](tbb::blocked_range<int> const& range) { run(context, range.begin(), range.end()); });
    };
    in_arena(start);
  }
  void call_both(call const& a, call const& b) const {
    if (threads_ == 1) {
      a();
      b();
    } else {
      in_arena([&] { tbb::parallel_invoke(a, b); });
    }
  }
  template <typename Start>
  void in_arena(Start const& start) const {
    if (arena_) {
      arena_->execute(start);
    } else {
      start();
    }
  }

  std::shared_ptr<tbb::task_arena> arena_;
  int threads_;  ///< 0 = as many as the machine has
};

/// Runs op(group, scratch, item, args...) for every item in [0, items). Items are independent.
template <typename Shape, typename Op, typename... Args>
FT_OUT_OF_LINE FT_EMITTED void for_each_item(host_exec const& exec, int items, Op const& op,
                                             Args const&... args)
#if defined(FT_STAGES_ELSEWHERE)
    ;
#else
{
  if constexpr (detail::is_stage<Op, single_group, Args...>()) {
    if constexpr (detail::stage_traits<Op>::wide_on_host && FT_HAS_WIDE) {
      if (detail::has_wide_vectors()) {
        exec.parallel_for(items, [&](int item) { detail::run_wide(op, item, args...); });
        return;
      }
    }
    exec.parallel_for(items, [&](int item) { detail::run_plain(op, item, args...); });
  }
}
#endif

namespace detail {

inline host_exec const& with_order(host_exec const& exec, launch_order) { return exec; }

}  // namespace detail

/// Extra scratch that each of `items` blocks of `Threads` threads may have, bytes.
template <int Threads, typename Op>
std::size_t extra_scratch(host_exec const&, int /*items*/) {
  return 0;
}

inline void copy_bytes(host_exec const&, void* to, void const* from, std::size_t bytes) {
  if (bytes != 0) { std::memcpy(to, from, bytes); }
}
inline void copy_rows(host_exec const&, pitched_rows<void> to, pitched_rows<void const> from,
                      std::size_t row_bytes, int rows) {
  for (int y = 0; y < rows; ++y) {
    auto const row = static_cast<std::size_t>(y);
    std::memcpy(static_cast<unsigned char*>(to.data) + row * to.pitch,
                static_cast<unsigned char const*>(from.data) + row * from.pitch, row_bytes);
  }
}
inline void fill_bytes(host_exec const&, void* to, int value, std::size_t bytes) {
  if (bytes != 0) { std::memset(to, value, bytes); }
}

}  // namespace FT_ABI
}  // namespace ft
