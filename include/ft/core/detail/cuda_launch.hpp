// SPDX-License-Identifier: Apache-2.0
/// @file The one place where kernels are launched. Included by execution.hpp under a CUDA compiler.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <type_traits>
#include <utility>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/cuda_groups.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

struct per_thread;
struct per_warp;
template <int N>
struct per_block;

namespace detail {

/// First in every kernel. Waits for the launch ahead where this one began early, and lets the next
/// one begin. @param beside the launch ahead, which has waited for the one before it: what that
/// wrote is there, in the caches as well
__device__ inline void begin_launch(bool beside) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  if (beside) {
    __threadfence();
  } else {
    cudaGridDependencySynchronize();
  }
  cudaTriggerProgrammaticLaunchCompletion();
#else
  static_cast<void>(beside);
#endif
}
/// Waits for the launch ahead of one that is beside it.
__device__ inline void wait_for_launch_ahead(bool beside) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  if (beside) { cudaGridDependencySynchronize(); }
#else
  static_cast<void>(beside);
#endif
}
/// Last in every kernel: who waits for a launch waits for the one ahead of it, too.
__device__ inline void end_launch(bool beside) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  if (beside && blockIdx.x == 0) { cudaGridDependencySynchronize(); }
#else
  static_cast<void>(beside);
#endif
}

/// Bytes of block scratch that one block may have, and how many multiprocessors there are.
struct block_scratch_facts {
  int most = 0;
  int processors = 0;

  block_scratch_facts() {
    int device = 0;
    throw_on_error(cudaGetDevice(&device), "cudaGetDevice");
    throw_on_error(cudaDeviceGetAttribute(&most, cudaDevAttrMaxSharedMemoryPerBlockOptin, device),
                   "cudaDeviceGetAttribute");
    throw_on_error(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device),
                   "cudaDeviceGetAttribute");
  }
};

/// Lets launches of a kernel have what the device has: always the same, so that nobody takes back
/// what another, or a recording, relies on.
template <typename... Params>
FT_HIDDEN void allow_all_block_scratch(void (*kernel)(Params...)) {
  cudaFuncAttributes facts{};
  throw_on_error(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes");
  throw_on_error(
      cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                           block_scratch_facts{}.most - static_cast<int>(facts.sharedSizeBytes)),
      "cudaFuncSetAttribute");
}

/// Functors whose launches overlap say `static constexpr bool shares_multiprocessors = true`: a
/// kernel that wants another share of a multiprocessor's memory for block scratch than the one that
/// is there would wait until it is idle.
template <typename Op, typename = void>
inline constexpr bool shares_multiprocessors = false;
template <typename Op>
inline constexpr bool shares_multiprocessors<Op, std::enable_if_t<Op::shares_multiprocessors>> =
    true;
/// Has a multiprocessor give all that it can to block scratch.
template <typename... Params>
FT_HIDDEN void most_block_scratch(void (*kernel)(Params...)) {
  throw_on_error(cudaFuncSetAttribute(kernel, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      cudaSharedmemCarveoutMaxShared),
                 "cudaFuncSetAttribute");
}

/// Where a launch goes, and when it begins; as cuda_exec has it.
struct launch_order {
  cudaStream_t stream;
  bool early;
  bool beside;
};

/// Launches a kernel, early only where it is compiled for an architecture that knows
/// begin_launch(). @param extra_bytes of block scratch besides what the kernel declares
template <typename... Params, typename... Args>
FT_HIDDEN void launch_kernel(void (*kernel)(Params...), unsigned blocks, unsigned threads,
                             std::size_t extra_bytes, launch_order how, Args const&... args) {
  if (extra_bytes > 0) { allow_all_block_scratch(kernel); }
#if CUDART_VERSION >= 12030
  cudaFuncAttributes facts{};
  if (how.early) { throw_on_error(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes"); }
  cudaLaunchAttribute attribute{};
  attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  attribute.val.programmaticStreamSerializationAllowed = 1;
  cudaLaunchConfig_t config{};
  config.gridDim = dim3(blocks);
  config.blockDim = dim3(threads);
  config.dynamicSmemBytes = extra_bytes;
  config.stream = how.stream;
  config.attrs = &attribute;
  config.numAttrs = how.early && facts.ptxVersion >= 90 && facts.binaryVersion >= 90 ? 1 : 0;
  throw_on_error(cudaLaunchKernelEx(&config, kernel, how.beside, args...), "kernel launch");
#else
  kernel<<<blocks, threads, extra_bytes, how.stream>>>(how.beside, args...);
  throw_on_error(cudaGetLastError(), "kernel launch");
#endif
}

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads)
    per_thread_kernel(bool beside, int items, Op op, Args... args) {
  begin_launch(beside);
  int const item = static_cast<int>(blockIdx.x) * Threads + static_cast<int>(threadIdx.x);
  if (item < items) {
    typename Op::scratch scratch;
    op(single_group{}, scratch, item, args...);
  }
  end_launch(beside);
}

template <int Warps, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Warps * 32)
    per_warp_kernel(bool beside, int items, Op op, Args... args) {
  begin_launch(beside);
  __shared__ typename Op::scratch scratch[Warps];
  int const warp = static_cast<int>(threadIdx.x) / 32;
  int const item = static_cast<int>(blockIdx.x) * Warps + warp;
  bool more = item < items;
  if constexpr (begins_beside<Op>) {
    more = more && op.begin(warp_group{}, scratch[warp], item, args...);
    if (more) { wait_for_launch_ahead(beside); }
  }
  if (more) { op(warp_group{}, scratch[warp], item, args...); }
  end_launch(beside);
}

/// Threads that a multiprocessor of this architecture has at a time, at least.
#if defined(__CUDA_ARCH__) && (__CUDA_ARCH__ == 900 || __CUDA_ARCH__ == 1000)
inline constexpr int threads_at_once = 2048;
#elif defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
inline constexpr int threads_at_once = 1536;
#else
inline constexpr int threads_at_once = 1024;
#endif
/// How many of its blocks a functor wants on a multiprocessor, if it says so (`side_by_side`): a
/// limit of registers. Five sixths of the threads at most: with all of them registers do not do.
template <int Threads, typename Op, typename = void>
inline constexpr int blocks_side_by_side = 0;
template <int Threads, typename Op>
inline constexpr int blocks_side_by_side<Threads, Op, std::enable_if_t<(Op::side_by_side > 0)>> =
    min_of(int{Op::side_by_side}, threads_at_once * 5 / 6 / Threads);

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads, blocks_side_by_side<Threads, Op>)
    per_block_kernel(bool beside, Op op, Args... args) {
  __shared__ typename block_group<Threads>::scratch collectives;
  __shared__ typename Op::scratch scratch;
  block_group<Threads> const g{&collectives};
  int const item = static_cast<int>(blockIdx.x);
  if constexpr (prepares<Op>) { op.prepare(g, scratch, item, args...); }
  begin_launch(beside);
  op(g, scratch, item, args...);
  end_launch(beside);
}

/// What a functor wants of block scratch besides its `scratch`: its extra_bytes(), if it has that.
template <typename Op, typename = void>
struct extra_bytes_of {
  static std::size_t get(Op const&) { return 0; }
};
template <typename Op>
struct extra_bytes_of<Op, decltype(static_cast<void>(std::declval<Op const&>().extra_bytes()))> {
  static std::size_t get(Op const& op) { return op.extra_bytes(); }
};

template <typename Shape>
struct launch;

template <>
struct launch<per_thread> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_order how, int items, Op const& op, Args const&... args) {
    constexpr int threads = 128;
    launch_kernel(&per_thread_kernel<threads, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, threads)), threads, 0, how, items, op,
                  args...);
  }
};

template <>
struct launch<per_warp> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_order how, int items, Op const& op, Args const&... args) {
    constexpr int warps = 4;
    launch_kernel(&per_warp_kernel<warps, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, warps)), warps * 32, 0, how, items, op,
                  args...);
  }
};

template <int N>
struct launch<per_block<N>> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_order how, int items, Op const& op, Args const&... args) {
    static_assert(
        sizeof(typename Op::scratch) + sizeof(typename block_group<N>::scratch) <= 48 * 1024,
        "static shared memory");
    if constexpr (shares_multiprocessors<Op>) {
      most_block_scratch(&per_block_kernel<N, Op, Args...>);
    }
    launch_kernel(&per_block_kernel<N, Op, Args...>, static_cast<unsigned>(items), N,
                  extra_bytes_of<Op>::get(op), how, op, args...);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
