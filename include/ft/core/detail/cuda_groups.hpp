// SPDX-License-Identifier: Apache-2.0
/// @file The groups of a device: a warp and a block.
///
/// Collectives are written by hand. Those of CUB and cooperative groups do not fit:
/// - the warp's scan has the instructions of cub::WarpScan, whose header takes nvcc six seconds a
///   unit;
/// - reductions: cub::WarpReduce leaves the result in one lane, but every caller needs it in all
///   lanes. The reduce of cooperative groups exchanges both words of a 64-bit minimum in each step,
///   which makes match_left_keypoint 7 % longer than two `redux` instructions do;
/// - the block's scan: in cub::BlockScan each thread adds up the sums of all warps, which makes
///   order_image with its 32 warps a fifth longer; its raking variants need more barriers;
/// - counts of flags: a ballot and a bit count instead of the scan of a 0 or 1;
/// - bitonic_sort: CUB's sorts need the keys in registers, and a bound on their number at compile
///   time.
#pragma once

#include <cstring>
#include <type_traits>

#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Butterfly exchange of any trivially copyable value, word by word.
template <typename T>
__device__ T shuffle_xor(T value, int mask) {
  static_assert(std::is_trivially_copyable<T>::value && sizeof(T) % 4 == 0, "whole words");
  int words[sizeof(T) / 4];
  memcpy(words, &value, sizeof(T));
  FT_UNROLL
  for (int i = 0; i < static_cast<int>(sizeof(T) / 4); ++i) {
    words[i] = __shfl_xor_sync(0xffffffffu, words[i], mask);
  }
  memcpy(&value, words, sizeof(T));
  return value;
}

/// Whether this architecture has a warp reduction instruction for T and Op (redux.sync).
template <typename T, typename Op>
inline constexpr bool has_reduce_instruction =
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
    (std::is_same<T, int>::value || std::is_same<T, unsigned>::value) &&
    (std::is_same<Op, sum_op>::value || std::is_same<Op, min_op>::value ||
     std::is_same<Op, max_op>::value);
#else
    false;
#endif

template <int Lanes = 32, typename T, typename Op>
__device__ T warp_reduce(T value, Op op) {
  constexpr unsigned all = 0xffffffffu;
  constexpr bool is_min = std::is_same<Op, min_op>::value;
  constexpr bool is_sum = std::is_same<Op, sum_op>::value;
  if constexpr (Lanes == 32 && has_reduce_instruction<T, Op>) {
    if constexpr (is_sum) {
      return __reduce_add_sync(all, value);
    } else if constexpr (is_min) {
      return __reduce_min_sync(all, value);
    } else {
      return __reduce_max_sync(all, value);
    }
  } else if constexpr (Lanes == 32 && !is_sum && std::is_same<T, unsigned long long>::value &&
                       has_reduce_instruction<unsigned, Op>) {
    // Reduce the upper words, then the lower words of the lanes that hold the upper result.
    auto const own = static_cast<unsigned>(value >> 32);
    unsigned const high = warp_reduce(own, op);
    unsigned const low =
        warp_reduce(own == high ? static_cast<unsigned>(value) : (is_min ? all : 0u), op);
    return static_cast<T>(high) << 32 | low;
  } else {
    FT_UNROLL
    for (int mask = Lanes / 2; mask > 0; mask /= 2) { value = op(value, shuffle_xor(value, mask)); }
    return value;
  }
}

/// Sum of the lower lanes' values; `total` gets the sum of all. The shuffle's own predicate says
/// whether there is a lane so far below.
__device__ inline int warp_exclusive_scan(int value, int& total) {
  int sum = value;
  FT_UNROLL
  for (int step = 0; step < 5; ++step) {
    int next;
    asm volatile(
        "{ .reg .s32 below; .reg .pred there; shfl.sync.up.b32 below|there, %1, %2, %3, %4;"
        " @there add.s32 below, below, %5; mov.s32 %0, below; }"
        : "=r"(next)
        : "r"(sum), "r"(1 << step), "r"(0), "r"(0xffffffffu), "r"(sum));
    sum = next;
  }
  total = __shfl_sync(0xffffffffu, sum, 31);
  return sum - value;
}

/// Bitonic merge sort of n distinct keys, for any n, by all threads of a group.
template <typename Group, typename Key>
__device__ void bitonic_sort(Group const& g, Key* keys, int n) {
  for (int width = 2; width / 2 < n; width *= 2) {
    // The first step of each merge compares mirrored positions. So every comparison is ascending,
    // and positions past n, which count as +infinity, never move.
    for (int step = width / 2; step > 0; step /= 2) {
      g.sync();
      for (int i = g.rank();; i += g.size()) {
        int const block = i / step;
        int const low = block * 2 * step + i % step;
        if (low >= n) { break; }
        int const high =
            step == width / 2 ? block * 2 * step + 2 * step - 1 - i % step : low + step;
        if (high < n && keys[high] < keys[low]) {
          Key const k = keys[high];
          keys[high] = keys[low];
          keys[low] = k;
        }
      }
    }
  }
  g.sync();
}

}  // namespace detail

/// A warp of 32 threads.
struct warp_group {
  static constexpr int max_threads = 32;
  __device__ static int rank() { return static_cast<int>(threadIdx.x) & 31; }
  __device__ static constexpr int size() { return 32; }
  __device__ static void sync() { __syncwarp(); }
  template <typename T, typename Op>
  __device__ T reduce(T value, Op op) const {
    return detail::warp_reduce(value, op);
  }
  __device__ static bool any(bool flag) { return __any_sync(0xffffffffu, flag) != 0; }
  __device__ static constexpr int lanes(int most) { return most; }
  template <int Most, typename T, typename Op>
  __device__ T reduce_lanes(T value, Op op) const {
    return detail::warp_reduce<Most>(value, op);
  }
  __device__ static unsigned ballot(bool flag) { return __ballot_sync(0xffffffffu, flag); }
  template <typename T>
  __device__ static T shuffle(T value, int from) {
    return __shfl_sync(0xffffffffu, value, from);
  }
  __device__ int exclusive_scan(int value, int& total) const {
    return detail::warp_exclusive_scan(value, total);
  }
  __device__ int exclusive_count(bool flag, int& total) const {
    unsigned const flags = ballot(flag);
    total = popcount(flags);
    return popcount(flags & ((1u << rank()) - 1));
  }
  template <typename Key>
  __device__ void sort(Key* keys, int n) const {
    detail::bitonic_sort(*this, keys, n);
  }
};

/// A thread block of N threads, a multiple of 32. Its collectives use shared memory that the
/// executor provides.
template <int N>
struct block_group {
  static_assert(N % 32 == 0 && N >= 32 && N <= 1024, "whole warps");
  static constexpr int max_threads = N;
  static constexpr int warps = N / 32;
  struct scratch {
    alignas(16) unsigned char words[warps][16];
  };
  scratch* temp;

  __device__ static int rank() { return static_cast<int>(threadIdx.x); }
  __device__ static constexpr int size() { return N; }
  __device__ static void sync() { __syncthreads(); }
  __device__ static unsigned char* extra() {
    extern __shared__ ulonglong2 dynamic_memory[];
    return reinterpret_cast<unsigned char*>(dynamic_memory);
  }
  __device__ static warp_group part() { return {}; }
  __device__ static int part_index() { return static_cast<int>(threadIdx.x) / 32; }
  __device__ static constexpr int parts() { return warps; }
  /// T has at most 16 bytes.
  template <typename T, typename Op>
  __device__ T reduce(T value, Op op) const {
    static_assert(sizeof(T) <= 16, "block scratch holds 16 bytes a warp");
    value = detail::warp_reduce(value, op);
    if ((rank() & 31) == 0) { memcpy(temp->words[rank() / 32], &value, sizeof(T)); }
    sync();
    T result;
    if constexpr ((warps & (warps - 1)) == 0) {
      memcpy(&result, temp->words[rank() % warps], sizeof(T));
      result = detail::warp_reduce<warps>(result, op);
    } else {
      memcpy(&result, temp->words[0], sizeof(T));
      for (int w = 1; w < warps; ++w) {
        T other;
        memcpy(&other, temp->words[w], sizeof(T));
        result = op(result, other);
      }
    }
    sync();
    return result;
  }
  __device__ static bool any(bool flag) { return __syncthreads_or(static_cast<int>(flag)) != 0; }
  __device__ static constexpr int lanes(int most) { return most; }
  template <int Most, typename T, typename Op>
  __device__ T reduce_lanes(T value, Op op) const {
    return detail::warp_reduce<Most>(value, op);
  }
  __device__ int exclusive_scan(int value, int& total) const {
    int of_warp = 0;
    int const before = detail::warp_exclusive_scan(value, of_warp);
    return before + sum_of_warps_before(of_warp, total);
  }
  __device__ int exclusive_count(bool flag, int& total) const {
    int mine = 0;
    int const below = part().exclusive_count(flag, mine);
    return below + sum_of_warps_before(mine, total);
  }
  template <typename Key>
  __device__ void sort(Key* keys, int n) const {
    detail::bitonic_sort(*this, keys, n);
  }

private:
  /// Sum of `mine` over the lower warps; `total` gets the sum over all warps.
  __device__ int sum_of_warps_before(int mine, int& total) const {
    if ((rank() & 31) == 0) { memcpy(temp->words[rank() / 32], &mine, sizeof(int)); }
    sync();
    int const lane = rank() & 31;
    int of_lane = 0;
    if (lane < warps) { memcpy(&of_lane, temp->words[lane], sizeof(int)); }
    sync();
    return __shfl_sync(0xffffffffu, detail::warp_exclusive_scan(of_lane, total), rank() / 32);
  }
};

}  // namespace FT_ABI
}  // namespace ft
