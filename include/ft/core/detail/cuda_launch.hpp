// SPDX-License-Identifier: Apache-2.0
/// @file Launches of kernels; no other file launches any. Included by core/cuda_executor.hpp.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/detail/cuda_groups.hpp"
#include "ft/core/stage.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// First call of every kernel. Waits for the preceding grid, unless the launch is concurrent with
/// it, and lets the next kernel start.
/// @param concurrent the preceding grid has waited for the one before it; the fence makes the
///   writes of that one visible
__device__ inline void begin_launch(bool concurrent) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  if (concurrent) {
    __threadfence();
  } else {
    cudaGridDependencySynchronize();
  }
  cudaTriggerProgrammaticLaunchCompletion();
#else
  static_cast<void>(concurrent);
#endif
}
/// Waits for the preceding grid in a kernel that began as a concurrent one.
__device__ inline void wait_for_preceding_grid() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  cudaGridDependencySynchronize();
#endif
}
/// Last call of every kernel. A grid that waits for a concurrent launch thereby waits for its
/// preceding grid, too.
__device__ inline void end_launch(bool concurrent) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  if (concurrent && blockIdx.x == 0) { cudaGridDependencySynchronize(); }
#else
  static_cast<void>(concurrent);
#endif
}

/// Most shared memory that a block can have, and the number of multiprocessors.
struct shared_memory_limits {
  int bytes_per_block = 0;
  int multiprocessors = 0;

  shared_memory_limits() {
    int device = 0;
    throw_on_error(cudaGetDevice(&device), "cudaGetDevice");
    throw_on_error(
        cudaDeviceGetAttribute(&bytes_per_block, cudaDevAttrMaxSharedMemoryPerBlockOptin, device),
        "cudaDeviceGetAttribute");
    throw_on_error(cudaDeviceGetAttribute(&multiprocessors, cudaDevAttrMultiProcessorCount, device),
                   "cudaDeviceGetAttribute");
  }
};

/// Allows launches of a kernel all dynamic shared memory of the device. Always the same amount, so
/// that no launch revokes what another one, or a recording, relies on.
template <typename... Params>
FT_HIDDEN void allow_all_shared_memory(void (*kernel)(Params...)) {
  cudaFuncAttributes facts{};
  throw_on_error(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes");
  throw_on_error(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      shared_memory_limits{}.bytes_per_block -
                                          static_cast<int>(facts.sharedSizeBytes)),
                 "cudaFuncSetAttribute");
}

/// Sets a kernel's preference for the largest share of shared memory.
template <typename... Params>
FT_HIDDEN void prefer_shared_memory(void (*kernel)(Params...)) {
  throw_on_error(cudaFuncSetAttribute(kernel, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      cudaSharedmemCarveoutMaxShared),
                 "cudaFuncSetAttribute");
}

/// The stream of a launch, and its order.
struct launch_target {
  cudaStream_t stream;
  bool programmatic;  ///< programmatic dependent launches are allowed
  launch_order order;

  bool early() const { return programmatic && order != launch_order::full_wave; }
  bool concurrent() const { return programmatic && order == launch_order::concurrent; }
};

/// Launches a kernel, early only if it is compiled for an architecture that has begin_launch().
/// @param extra_bytes of dynamic shared memory
template <typename... Params, typename... Args>
FT_HIDDEN void launch_kernel(void (*kernel)(Params...), unsigned blocks, unsigned threads,
                             std::size_t extra_bytes, launch_target to, Args const&... args) {
  if (extra_bytes > 0) { allow_all_shared_memory(kernel); }
#if CUDART_VERSION >= 12030
  cudaFuncAttributes facts{};
  if (to.early()) {
    throw_on_error(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes");
  }
  cudaLaunchAttribute attribute{};
  attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  attribute.val.programmaticStreamSerializationAllowed = 1;
  cudaLaunchConfig_t config{};
  config.gridDim = dim3(blocks);
  config.blockDim = dim3(threads);
  config.dynamicSmemBytes = extra_bytes;
  config.stream = to.stream;
  config.attrs = &attribute;
  config.numAttrs = to.early() && facts.ptxVersion >= 90 && facts.binaryVersion >= 90 ? 1 : 0;
  throw_on_error(cudaLaunchKernelEx(&config, kernel, to.concurrent(), args...), "kernel launch");
#else
  kernel<<<blocks, threads, extra_bytes, to.stream>>>(to.concurrent(), args...);
  throw_on_error(cudaGetLastError(), "kernel launch");
#endif
}

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads)
    per_thread_kernel(bool concurrent, int items, Op op, Args... args) {
  begin_launch(concurrent);
  int const item = static_cast<int>(blockIdx.x) * Threads + static_cast<int>(threadIdx.x);
  static_assert(!stage_traits<Op>::has_prologue, "a prologue is for warps and blocks");
  if (item < items) {
    typename Op::scratch scratch;
    op(single_group{}, scratch, item, args...);
  }
  end_launch(concurrent);
}

template <int Warps, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Warps * 32)
    per_warp_kernel(bool concurrent, int items, Op op, Args... args) {
  // A prologue must not wait. Only the warps that need the preceding grid wait for it, each for
  // itself.
  constexpr bool early = stage_traits<Op>::has_prologue;
  static_assert(std::is_trivially_default_constructible<typename Op::scratch>::value,
                "shared memory is not initialised");
  begin_launch(early || concurrent);
  __shared__ typename Op::scratch scratch[Warps];
  int const warp = static_cast<int>(threadIdx.x) / 32;
  int const item = static_cast<int>(blockIdx.x) * Warps + warp;
  bool more = item < items;
  if constexpr (early) {
    more = more && run_prologue(op, warp_group{}, scratch[warp], item, args...);
    if (more && !concurrent) { wait_for_preceding_grid(); }
  }
  if (more) { op(warp_group{}, scratch[warp], item, args...); }
  end_launch(early || concurrent);
}

/// Resident threads of a multiprocessor of this architecture, at least.
#if defined(__CUDA_ARCH__) && (__CUDA_ARCH__ == 900 || __CUDA_ARCH__ == 1000)
inline constexpr int resident_threads = 2048;
#elif defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
inline constexpr int resident_threads = 1536;
#else
inline constexpr int resident_threads = 1024;
#endif
/// Capped at 5/6 of the resident threads; beyond that the compiler spills.
template <int Threads, typename Op>
inline constexpr int min_blocks = min_of(stage_traits<Op>::resident_blocks,
                                         resident_threads * 5 / 6 / Threads);

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads, min_blocks<Threads, Op>)
    per_block_kernel(bool concurrent, Op op, Args... args) {
  __shared__ typename block_group<Threads>::scratch collectives;
  __shared__ typename Op::scratch scratch;
  block_group<Threads> const g{&collectives};
  int const item = static_cast<int>(blockIdx.x);
  static_assert(std::is_trivially_default_constructible<typename Op::scratch>::value,
                "shared memory is not initialised");
  static_assert(!prologue_decides<Op, block_group<Threads>, Args...>(),
                "a prologue that decides about its item is for warps");
  if constexpr (stage_traits<Op>::has_prologue) { op.prologue(g, scratch, item, args...); }
  begin_launch(concurrent);
  op(g, scratch, item, args...);
  end_launch(concurrent);
}

template <typename Shape>
struct launch;

template <>
struct launch<per_thread> {
  using group = single_group;

  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_target to, int items, Op const& op, Args const&... args) {
    constexpr int threads = 128;
    launch_kernel(&per_thread_kernel<threads, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, threads)), threads, 0, to, items, op,
                  args...);
  }
};

template <>
struct launch<per_warp> {
  using group = warp_group;

  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_target to, int items, Op const& op, Args const&... args) {
    constexpr int warps = 4;
    launch_kernel(&per_warp_kernel<warps, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, warps)), warps * 32, 0, to, items, op,
                  args...);
  }
};

template <int N>
struct launch<per_block<N>> {
  using group = block_group<N>;

  template <typename Op, typename... Args>
  FT_HIDDEN static void run(launch_target to, int items, Op const& op, Args const&... args) {
    static_assert(
        sizeof(typename Op::scratch) + sizeof(typename block_group<N>::scratch) <= 48 * 1024,
        "static shared memory");
    if constexpr (stage_traits<Op>::prefers_shared) {
      prefer_shared_memory(&per_block_kernel<N, Op, Args...>);
    }
    launch_kernel(&per_block_kernel<N, Op, Args...>, static_cast<unsigned>(items), N,
                  stage_traits<Op>::extra_bytes(op), to, op, args...);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
