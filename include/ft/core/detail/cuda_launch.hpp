// SPDX-License-Identifier: Apache-2.0
/// @file The one place where kernels are launched. Included by execution.hpp under a CUDA compiler.
#pragma once

#include <cuda_runtime.h>

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

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads)
    per_thread_kernel(int items, Op op, Args... args) {
  int const item = static_cast<int>(blockIdx.x) * Threads + static_cast<int>(threadIdx.x);
  if (item < items) {
    typename Op::scratch scratch;
    op(single_group{}, scratch, item, args...);
  }
}

template <int Warps, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Warps * 32)
    per_warp_kernel(int items, Op op, Args... args) {
  __shared__ typename Op::scratch scratch[Warps];
  int const warp = static_cast<int>(threadIdx.x) / 32;
  int const item = static_cast<int>(blockIdx.x) * Warps + warp;
  if (item < items) { op(warp_group{}, scratch[warp], item, args...); }
}

template <int Threads, typename Op, typename... Args>
FT_HIDDEN __global__ void __launch_bounds__(Threads) per_block_kernel(Op op, Args... args) {
  __shared__ typename block_group<Threads>::scratch collectives;
  __shared__ typename Op::scratch scratch;
  op(block_group<Threads>{&collectives}, scratch, static_cast<int>(blockIdx.x), args...);
}

template <typename Shape>
struct launch;

template <>
struct launch<per_thread> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(cudaStream_t stream, int items, Op const& op, Args const&... args) {
    constexpr int threads = 128;
    per_thread_kernel<threads>
        <<<static_cast<unsigned>(ceil_div(items, threads)), threads, 0, stream>>>(items, op,
                                                                                  args...);
    check(cudaGetLastError(), "kernel launch");
  }
};

template <>
struct launch<per_warp> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(cudaStream_t stream, int items, Op const& op, Args const&... args) {
    constexpr int warps = 4;
    per_warp_kernel<warps>
        <<<static_cast<unsigned>(ceil_div(items, warps)), warps * 32, 0, stream>>>(items, op,
                                                                                   args...);
    check(cudaGetLastError(), "kernel launch");
  }
};

template <int N>
struct launch<per_block<N>> {
  template <typename Op, typename... Args>
  FT_HIDDEN static void run(cudaStream_t stream, int items, Op const& op, Args const&... args) {
    static_assert(
        sizeof(typename Op::scratch) + sizeof(typename block_group<N>::scratch) <= 48 * 1024,
        "static shared memory");
    per_block_kernel<N><<<static_cast<unsigned>(items), N, 0, stream>>>(op, args...);
    check(cudaGetLastError(), "kernel launch");
  }
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
