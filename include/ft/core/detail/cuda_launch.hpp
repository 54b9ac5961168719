// SPDX-License-Identifier: Apache-2.0
/// @file The one place where kernels are launched. Included by execution.hpp under a CUDA compiler.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <utility>

#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

struct per_thread;
struct per_warp;
template <int N>
struct per_block;

namespace detail {

/// First in every kernel: waits for the launch ahead where this one began early, and lets the next
/// one begin.
__device__ inline void await_launch_ahead() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900 && CUDART_VERSION >= 12030
  cudaGridDependencySynchronize();
  cudaTriggerProgrammaticLaunchCompletion();
#endif
}

/// Bytes of block scratch that one block may have, and how many multiprocessors there are.
struct block_scratch_facts {
  int most = 0;
  int processors = 0;

  block_scratch_facts() {
    int device = 0;
    check(cudaGetDevice(&device), "cudaGetDevice");
    check(cudaDeviceGetAttribute(&most, cudaDevAttrMaxSharedMemoryPerBlockOptin, device),
          "cudaDeviceGetAttribute");
    check(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device),
          "cudaDeviceGetAttribute");
  }
};

/// Lets launches of a kernel have what the device has: always the same, so that nobody takes back
/// what another, or a recording, relies on.
template <typename... Params>
FT_HIDDEN void allow_all_block_scratch(void (*kernel)(Params...)) {
  cudaFuncAttributes facts{};
  check(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes");
  check(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                             block_scratch_facts{}.most - static_cast<int>(facts.sharedSizeBytes)),
        "cudaFuncSetAttribute");
}

/// Launches a kernel. @param early while the launch ahead is still running; only kernels compiled
/// for architectures that know await_launch_ahead() do @param extra_bytes of block scratch besides
/// what the kernel declares
template <typename... Params, typename... Args>
FT_HIDDEN void launch_kernel(void (*kernel)(Params...), unsigned blocks, unsigned threads,
                             std::size_t extra_bytes, cudaStream_t stream, bool early,
                             Args const&... args) {
  if (extra_bytes > 0) { allow_all_block_scratch(kernel); }
#if CUDART_VERSION >= 12030
  cudaFuncAttributes facts{};
  if (early) { check(cudaFuncGetAttributes(&facts, kernel), "cudaFuncGetAttributes"); }
  cudaLaunchAttribute attribute{};
  attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  attribute.val.programmaticStreamSerializationAllowed = 1;
  cudaLaunchConfig_t config{};
  config.gridDim = dim3(blocks);
  config.blockDim = dim3(threads);
  config.dynamicSmemBytes = extra_bytes;
  config.stream = stream;
  config.attrs = &attribute;
  config.numAttrs = early && facts.ptxVersion >= 90 && facts.binaryVersion >= 90 ? 1 : 0;
  check(cudaLaunchKernelEx(&config, kernel, args...), "kernel launch");
#else
  static_cast<void>(early);
  kernel<<<blocks, threads, extra_bytes, stream>>>(args...);
  check(cudaGetLastError(), "kernel launch");
#endif
}

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads)
    per_thread_kernel(int items, Op op, Args... args) {
  await_launch_ahead();
  int const item = static_cast<int>(blockIdx.x) * Threads + static_cast<int>(threadIdx.x);
  if (item < items) {
    typename Op::scratch scratch;
    op(single_group{}, scratch, item, args...);
  }
}

template <int Warps, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Warps * 32)
    per_warp_kernel(int items, Op op, Args... args) {
  await_launch_ahead();
  __shared__ typename Op::scratch scratch[Warps];
  int const warp = static_cast<int>(threadIdx.x) / 32;
  int const item = static_cast<int>(blockIdx.x) * Warps + warp;
  if (item < items) { op(warp_group{}, scratch[warp], item, args...); }
}

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads) per_block_kernel(Op op, Args... args) {
  await_launch_ahead();
  __shared__ typename block_group<Threads>::scratch collectives;
  __shared__ typename Op::scratch scratch;
  op(block_group<Threads>{&collectives}, scratch, static_cast<int>(blockIdx.x), args...);
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
  FT_HIDDEN static void run(cudaStream_t stream, bool early, int items, Op const& op,
                            Args const&... args) {
    constexpr int threads = 128;
    launch_kernel(&per_thread_kernel<threads, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, threads)), threads, 0, stream, early, items,
                  op, args...);
  }
};

template <>
struct launch<per_warp> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(cudaStream_t stream, bool early, int items, Op const& op,
                            Args const&... args) {
    constexpr int warps = 4;
    launch_kernel(&per_warp_kernel<warps, Op, Args...>,
                  static_cast<unsigned>(ceil_div(items, warps)), warps * 32, 0, stream, early,
                  items, op, args...);
  }
};

template <int N>
struct launch<per_block<N>> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(cudaStream_t stream, bool early, int items, Op const& op,
                            Args const&... args) {
    static_assert(
        sizeof(typename Op::scratch) + sizeof(typename block_group<N>::scratch) <= 48 * 1024,
        "static shared memory");
    launch_kernel(&per_block_kernel<N, Op, Args...>, static_cast<unsigned>(items), N,
                  extra_bytes_of<Op>::get(op), stream, early, op, args...);
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
