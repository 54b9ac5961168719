// SPDX-License-Identifier: Apache-2.0
/// @file The executor of a GPU: a CUDA stream. Empty where the compiler is not a CUDA compiler.
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <cstddef>
#include <string>
#include <thread>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/detail/cuda_launch.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/stage.hpp"
#include "ft/core/views.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {
struct launch_access;

/// @throws bad_argument if memory is that of another GPU
inline void require_memory_of(int gpu, cudaPointerAttributes const& facts) {
  if (facts.type != cudaMemoryTypeDevice || facts.device == gpu) { return; }
  throw bad_argument("an array is in the memory of GPU " + std::to_string(facts.device) +
                     ", and GPU " + std::to_string(gpu) + " is to read it: copy it there first");
}
}  // namespace detail

/// Runs stages on a CUDA stream, asynchronously and in stream order. Does not own the stream. Only
/// wait() and wait_until() synchronise.
class cuda_exec {
public:
  static constexpr memory_space space = memory_space::device;
  static constexpr bool asynchronous = true;

  cudaStream_t stream;

  explicit cuda_exec(cudaStream_t s) : stream(s) {}
  /// Blocks until all work enqueued on the stream is done. @throws cuda_error
  void wait() const { throw_on_error(cudaStreamSynchronize(stream), "cudaStreamSynchronize"); }
  /// Blocks until done(), which reads what the work writes to memory of the host, or until all work
  /// is complete. The thread looks again and again, which sees an end some two microseconds before
  /// wait() does; it sleeps where the device's flags say cudaDeviceScheduleBlockingSync.
  /// @throws cuda_error
  template <typename Done>
  void wait_until(Done const& done) const {
    unsigned flags = 0;
    throw_on_error(cudaGetDeviceFlags(&flags), "cudaGetDeviceFlags");
    if ((flags & cudaDeviceScheduleMask) == cudaDeviceScheduleBlockingSync) { return wait(); }
    constexpr unsigned looks = 1 << 14;  // some 20 microseconds
    for (unsigned i = 1; !done(); ++i) {
      if (i % looks != 0) { continue; }
      cudaError_t const status = cudaStreamQuery(stream);
      if (status == cudaSuccess) { return; }
      if (status != cudaErrorNotReady) { throw_on_error(status, "cudaStreamQuery"); }
      std::this_thread::yield();
    }
  }
  /// The address through which stages can read host pointer `p`, in pinned, registered, managed or
  /// device memory; null if they cannot. Does not change the calling thread's current context.
  /// @throws bad_argument if it is in the memory of another GPU than the current one
  static void const* host_address(void const* p) {
    // The query needs a current context. This call makes that of the current device current, but
    // unlike cudaSetDevice keeps a context that the caller has made current.
    int least = 0;
    int greatest = 0;
    throw_on_error(cudaDeviceGetStreamPriorityRange(&least, &greatest),
                   "cudaDeviceGetStreamPriorityRange");
    cudaPointerAttributes facts{};
    throw_on_error(cudaPointerGetAttributes(&facts, p), "cudaPointerGetAttributes");
    int gpu = 0;
    throw_on_error(cudaGetDevice(&gpu), "cudaGetDevice");
    detail::require_memory_of(gpu, facts);
    return facts.type == cudaMemoryTypeUnregistered ? nullptr : facts.devicePointer;
  }

private:
  friend struct detail::launch_access;
  bool programmatic_ = false;
  detail::launch_order order_ = detail::launch_order::serial;
};

namespace detail {

/// How an executor launches; for recordings, branches and tests.
struct launch_access {
  /// Whether launches may be programmatic dependent launches: in recordings. Has no effect below
  /// compute capability 9.0 or CUDA 12.3.
  static bool programmatic(cuda_exec const& exec) { return exec.programmatic_; }
  static launch_order order(cuda_exec const& exec) { return exec.order_; }

  static cuda_exec make(cudaStream_t stream, bool programmatic,
                        launch_order order = launch_order::serial) {
    cuda_exec exec(stream);
    exec.programmatic_ = programmatic;
    exec.order_ = order;
    return exec;
  }
};

/// The same executor for launches in another order.
inline cuda_exec with_order(cuda_exec const& exec, launch_order order) {
  return launch_access::make(exec.stream, launch_access::programmatic(exec), order);
}

}  // namespace detail

/// Enqueues op(group, scratch, item, args...) for every item in [0, items). Items are independent.
template <typename Shape, typename Op, typename... Args>
FT_HIDDEN FT_OUT_OF_LINE void for_each_item(cuda_exec const& exec, int items, Op const& op,
                                            Args const&... args)
#if defined(FT_STAGES_ELSEWHERE)
    ;
#else
{
  if constexpr (detail::is_stage<Op, typename detail::launch<Shape>::group, Args...>()) {
    if (items > 0) {
      detail::launch<Shape>::run({exec.stream, detail::launch_access::programmatic(exec),
                                  detail::launch_access::order(exec)},
                                 items, op, args...);
    }
  }
}
#endif

/// All shared memory of a multiprocessor if each block has one to itself, else a share that leaves
/// room for several blocks.
/// @throws cuda_error
template <int Threads, typename Op>
FT_HIDDEN std::size_t extra_scratch(cuda_exec const&, int items) {
  // A kernel that nvcc had not optimised was refused with 321 bytes less than the limit.
  constexpr std::size_t reserve = 1024;
  constexpr std::size_t declared =
      sizeof(typename Op::scratch) + sizeof(typename block_group<Threads>::scratch) + reserve;
  constexpr std::size_t usual = 48 * 1024;
  detail::shared_memory_limits const limits;
  std::size_t const limit = items <= limits.multiprocessors
                                ? max_of(static_cast<std::size_t>(limits.bytes_per_block), usual)
                                : usual;
  return limit > declared ? limit - declared : 0;
}

inline void copy_bytes(cuda_exec const& exec, void* to, void const* from, std::size_t bytes) {
  if (bytes != 0) {
    throw_on_error(cudaMemcpyAsync(to, from, bytes, cudaMemcpyDefault, exec.stream),
                   "cudaMemcpyAsync");
  }
}
inline void copy_rows(cuda_exec const& exec, pitched_rows<void> to, pitched_rows<void const> from,
                      std::size_t row_bytes, int rows) {
  throw_on_error(cudaMemcpy2DAsync(to.data, to.pitch, from.data, from.pitch, row_bytes,
                                   static_cast<std::size_t>(rows), cudaMemcpyDefault, exec.stream),
                 "cudaMemcpy2DAsync");
}
inline void fill_bytes(cuda_exec const& exec, void* to, int value, std::size_t bytes) {
  if (bytes != 0) {
    throw_on_error(cudaMemsetAsync(to, value, bytes, exec.stream), "cudaMemsetAsync");
  }
}

}  // namespace FT_ABI
}  // namespace ft

#endif  // __CUDACC__
