// SPDX-License-Identifier: Apache-2.0
/// @file Executors: where a stage runs.
///
/// A stage's body is a functor `op(group, scratch, item, args...)` with a nested type `scratch`.
/// The executor runs it once per item, with the threads that the shape asks for: `per_thread`,
/// `per_warp` or `per_block<N>` on the device; on the host always one thread per item, items spread
/// over a pool.
#pragma once

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <cstring>
#include <memory>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#if defined(__CUDACC__)
#include "ft/core/detail/cuda_launch.hpp"
#endif

namespace ft {
inline namespace FT_ABI {

/// Device: one thread per item.
struct per_thread {};
/// Device: one warp per item.
struct per_warp {};
/// Device: one block of N threads per item.
template <int N>
struct per_block {};

/// For functors without scratch memory.
struct no_scratch {};

// Scratch whose size is known at launch only: a functor for blocks may have a member
// `std::size_t extra_bytes() const`, at most what extra_scratch() says; then `group.extra()` is so
// much memory on the multiprocessor. The host has none to give.

// Before it is run, a functor for blocks may prepare(), one for warps begin(); see group.hpp.

/// Runs stages on host threads, synchronously. Copies share the thread pool; safe to use from
/// several threads at a time.
class host_exec {
public:
  static constexpr memory_space space = memory_space::host;
  static constexpr bool asynchronous = false;

  /// @param threads how many to use, the caller's included; 0 = all that the machine has
  /// @throws bad_argument outside [0, 4096]
  explicit host_exec(int threads = 0) {
    detail::require_range("host threads", threads, 0, 4096);
    if (threads > 1) { arena_ = std::make_shared<tbb::task_arena>(threads); }
    sequential_ = threads == 1;
  }

  template <typename Body>
  void parallel_for(int items, Body const& body) const {
    if (sequential_ || items <= 1) {
      for (int i = 0; i < items; ++i) { body(i); }
      return;
    }
    auto const run = [&] {
      tbb::parallel_for(tbb::blocked_range<int>(0, items),
                        [&](tbb::blocked_range<int> const& range) {
                          for (int i = range.begin(); i != range.end(); ++i) { body(i); }
                        });
    };
    if (arena_) {
      arena_->execute(run);
    } else {
      run();
    }
  }

  /// Everything is done already when a call returns.
  void wait() const {}
  /// Where threads read what the caller has at `p`; null where they cannot.
  static void const* host_address(void const* p) { return p; }

private:
  std::shared_ptr<tbb::task_arena> arena_;
  bool sequential_ = false;
};

namespace detail {

/// Stages that say `static constexpr bool wide_on_host = true` run, on the host, in a version for
/// wide vectors where the processor has them.
template <typename Op, typename = void>
inline constexpr bool is_wide_on_host = false;
template <typename Op>
inline constexpr bool is_wide_on_host<Op, std::enable_if_t<Op::wide_on_host>> = true;

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
FT_WIDE void run_wide(Op const& op, int item, Args const&... args) {
  typename Op::scratch scratch;
  if constexpr (prepares<Op>) { op.prepare(single_group{}, scratch, item, args...); }
  if constexpr (begins_beside<Op>) {
    if (!op.begin(single_group{}, scratch, item, args...)) { return; }
  }
  op(single_group{}, scratch, item, args...);
}
template <typename Op, typename... Args>
void run_plain(Op const& op, int item, Args const&... args) {
  typename Op::scratch scratch;
  if constexpr (prepares<Op>) { op.prepare(single_group{}, scratch, item, args...); }
  if constexpr (begins_beside<Op>) {
    if (!op.begin(single_group{}, scratch, item, args...)) { return; }
  }
  op(single_group{}, scratch, item, args...);
}

}  // namespace detail

/// Runs op(group, scratch, item, args...) for every item in [0, items). Items are independent.
template <typename Shape, typename Op, typename... Args>
void for_each_item(host_exec const& exec, int items, Op const& op, Args const&... args) {
  if constexpr (detail::is_wide_on_host<Op> && FT_HAS_WIDE) {
    if (detail::has_wide_vectors()) {
      exec.parallel_for(items, [&](int item) { detail::run_wide(op, item, args...); });
      return;
    }
  }
  exec.parallel_for(items, [&](int item) { detail::run_plain(op, item, args...); });
}

/// No items of another stage.
struct no_items {
  FT_HOST_DEVICE static int count() { return 0; }
  FT_HOST_DEVICE void operator()(int /*item*/) const {}
};

/// A functor whose threads first do small items of another stage among them, `also(i)` for all i <
/// also.count(): a launch less, and what waits for launches that were beside each other waits for
/// one less.
template <typename Op, typename Also>
struct with_small_items {
  static constexpr bool wide_on_host = detail::is_wide_on_host<Op>;
  using scratch = typename Op::scratch;
  Op op;
  Also also;
  int items;  ///< of the launch

  template <typename Group, typename... Args>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, Args const&... args) const {
    for (int i = item * g.size() + g.rank(); i < also.count(); i += items * g.size()) { also(i); }
    op(g, s, item, args...);
  }
};

/// For launches that fill the device.
inline host_exec const& evenly(host_exec const& exec) { return exec; }
/// For launches that need nothing of the one ahead.
inline host_exec const& beside(host_exec const& exec) { return exec; }
inline host_exec const& in_turn(host_exec const& exec) { return exec; }

/// How much extra scratch each of `items` blocks of `Threads` threads may have, bytes.
template <int Threads, typename Op>
std::size_t extra_scratch(host_exec const&, int /*items*/) {
  return 0;
}

inline void copy_bytes(host_exec const&, void* to, void const* from, std::size_t bytes) {
  if (bytes != 0) { std::memcpy(to, from, bytes); }
}
inline void copy_rows(host_exec const&, void* to, std::size_t to_pitch, void const* from,
                      std::size_t from_pitch, std::size_t row_bytes, int rows) {
  for (int y = 0; y < rows; ++y) {
    auto const row = static_cast<std::size_t>(y);
    std::memcpy(static_cast<unsigned char*>(to) + row * to_pitch,
                static_cast<unsigned char const*>(from) + row * from_pitch, row_bytes);
  }
}
inline void fill_bytes(host_exec const&, void* to, int value, std::size_t bytes) {
  if (bytes != 0) { std::memset(to, value, bytes); }
}

#if defined(__CUDACC__)

/// Runs stages on a CUDA stream, asynchronously and in stream order. Does not own the stream.
/// Nothing here synchronises but wait().
struct cuda_exec {
  static constexpr memory_space space = memory_space::device;
  static constexpr bool asynchronous = true;

  cudaStream_t stream;
  /// Kernels may be set up while the one ahead is still running (programmatic dependent launch);
  /// they wait for it before they touch memory. For recordings: there it saves about a microsecond
  /// a launch. Needs compute capability 9.0 and CUDA 12.3; without effect elsewhere.
  bool early_launches = false;

  /// See beside().
  bool launches_beside = false;

  explicit cuda_exec(cudaStream_t s, bool early = false) : stream(s), early_launches(early) {}
  /// Blocks until everything queued on the stream is done. @throws cuda_error
  void wait() const { throw_on_error(cudaStreamSynchronize(stream), "cudaStreamSynchronize"); }
  /// Where threads read what the caller has at `p`, in pinned, registered, managed or device
  /// memory; null where they cannot. Leaves the calling thread's current context as it is.
  static void const* host_address(void const* p) {
    // A thread without a context gets no answer about memory. This call gives it the current
    // device's; a context that the caller has made current stays, which cudaSetDevice would
    // replace.
    int least = 0;
    int greatest = 0;
    throw_on_error(cudaDeviceGetStreamPriorityRange(&least, &greatest),
                   "cudaDeviceGetStreamPriorityRange");
    cudaPointerAttributes facts{};
    throw_on_error(cudaPointerGetAttributes(&facts, p), "cudaPointerGetAttributes");
    return facts.type == cudaMemoryTypeUnregistered ? nullptr : facts.devicePointer;
  }
};

/// For launches that fill the device. One that begins early takes its places while the one ahead
/// still has some: then multiprocessors get different shares of it.
inline cuda_exec evenly(cuda_exec const& exec) { return cuda_exec(exec.stream); }

/// For launches that need nothing of the one ahead, and all of what that waits for: early ones
/// begin when it has begun, and run beside it. They may also wait for parts of it
/// (containers/frame_arrivals.hpp): all of its blocks have begun, and do not depend on who waits.
/// None ends before the one ahead has. Side branches do the same for more than one launch, but what
/// joins one was seen to begin two microseconds late.
inline cuda_exec beside(cuda_exec const& exec) {
  cuda_exec result = exec;
  result.launches_beside = exec.early_launches;
  return result;
}
/// The same executor for launches that need the one ahead again.
inline cuda_exec in_turn(cuda_exec const& exec) {
  return cuda_exec(exec.stream, exec.early_launches);
}

template <typename Shape, typename Op, typename... Args>
FT_HIDDEN void for_each_item(cuda_exec const& exec, int items, Op const& op, Args const&... args) {
  if (items > 0) {
    detail::launch<Shape>::run({exec.stream, exec.early_launches, exec.launches_beside}, items, op,
                               args...);
  }
}

/// As much as a multiprocessor has where no two blocks share one, else what lets several do.
/// @throws cuda_error
template <int Threads, typename Op>
FT_HIDDEN std::size_t extra_scratch(cuda_exec const&, int items) {
  constexpr std::size_t declared =
      sizeof(typename Op::scratch) + sizeof(typename block_group<Threads>::scratch) + 64;
  constexpr std::size_t usual = 48 * 1024;
  detail::block_scratch_facts const facts;
  std::size_t const limit =
      items <= facts.processors ? max_of(static_cast<std::size_t>(facts.most), usual) : usual;
  return limit > declared ? limit - declared : 0;
}

inline void copy_bytes(cuda_exec const& exec, void* to, void const* from, std::size_t bytes) {
  if (bytes != 0) {
    throw_on_error(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDefault, exec.stream),
                   "cudaMemcpyAsync");
  }
}
inline void copy_rows(cuda_exec const& exec, void* to, std::size_t to_pitch, void const* from,
                      std::size_t from_pitch, std::size_t row_bytes, int rows) {
  throw_on_error(cudaMemcpy2DAsync(to, to_pitch, from, from_pitch, row_bytes,
                                   static_cast<std::size_t>(rows), cudaMemcpyDefault, exec.stream),
                 "cudaMemcpy2DAsync");
}
inline void fill_bytes(cuda_exec const& exec, void* to, int value, std::size_t bytes) {
  if (bytes != 0) {
    throw_on_error(cudaMemsetAsync(to, value, bytes, exec.stream), "cudaMemsetAsync");
  }
}

#endif  // __CUDACC__

/// Elements rather than bytes. Asynchronous where the executor is; allocates nothing.
template <typename Exec, typename T>
void copy(Exec const& exec, T* to, T const* from, std::size_t count) {
  copy_bytes(exec, to, from, count * sizeof(T));
}

/// The memory in which an executor's host side prepares copies: pinned beside a device, plain
/// otherwise.
template <typename Exec>
inline constexpr memory_space staging_space =
    Exec::space == memory_space::device ? memory_space::pinned : memory_space::host;

}  // namespace FT_ABI
}  // namespace ft
