// SPDX-License-Identifier: Apache-2.0
/// @file Groups: the threads that work on one item together.
///
/// A stage's body sees `rank()`, `size()`, `sync()` and collectives only, and is written once.
/// Every thread of a group must call a collective. Loops read `for (i = g.rank(); i < n; i +=
/// g.size())`.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/core/math.hpp"

namespace ft {
inline namespace FT_ABI {

struct sum_op {
  template <typename T>
  FT_HOST_DEVICE T operator()(T a, T b) const {
    return a + b;
  }
};
struct min_op {
  template <typename T>
  FT_HOST_DEVICE T operator()(T a, T b) const {
    return b < a ? b : a;
  }
};
struct max_op {
  template <typename T>
  FT_HOST_DEVICE T operator()(T a, T b) const {
    return a < b ? b : a;
  }
};

namespace detail {

/// Functors for blocks say `static constexpr bool prepares = true` where they have a member
/// `prepare(group, scratch, item, args...)`: what needs nothing of the launches ahead, and is done
/// while those end.
template <typename Op, typename = void>
inline constexpr bool prepares = false;
template <typename Op>
inline constexpr bool prepares<Op, std::enable_if_t<Op::prepares>> = true;

/// Functors for warps say `static constexpr bool begins_beside = true` where they have a member
/// `bool begin(group, scratch, item, args...)`: what they do, in a launch that is beside() another,
/// before they wait for that one. False ends the item.
template <typename Op, typename = void>
inline constexpr bool begins_beside = false;
template <typename Op>
inline constexpr bool begins_beside<Op, std::enable_if_t<Op::begins_beside>> = true;

}  // namespace detail

/// One thread: every item on the host, and items of a single thread on the device.
struct single_group {
  static constexpr int max_threads = 1;
  /// The scratch that a functor's extra_bytes() asked for, aligned to 16 bytes; blocks only.
  FT_HOST_DEVICE static unsigned char* extra() { return nullptr; }
  FT_HOST_DEVICE static constexpr int rank() { return 0; }
  FT_HOST_DEVICE static constexpr int size() { return 1; }
  FT_HOST_DEVICE static void sync() {}
  /// The groups that this one is made of: itself; of a block its warps.
  FT_HOST_DEVICE static single_group part() { return {}; }
  FT_HOST_DEVICE static constexpr int part_index() { return 0; }
  FT_HOST_DEVICE static constexpr int parts() { return 1; }
  template <typename T, typename Op>
  FT_HOST_DEVICE T reduce(T value, Op) const {
    return value;
  }
  /// Whether any thread says yes.
  FT_HOST_DEVICE static bool any(bool flag) { return flag; }
  /// How many neighbouring threads `reduce_lanes<Most>` takes together: `Most`, a power of two up
  /// to 32, or 1 where the group is one thread.
  FT_HOST_DEVICE static constexpr int lanes(int) { return 1; }
  /// As `reduce`, over each `lanes(Most)` threads of neighbouring ranks for itself.
  template <int Most, typename T, typename Op>
  FT_HOST_DEVICE T reduce_lanes(T value, Op) const {
    return value;
  }
  /// Bit i is what rank i says; groups of up to 32 threads.
  FT_HOST_DEVICE static unsigned ballot(bool flag) { return static_cast<unsigned>(flag); }
  /// What rank `from` says; groups of up to 32 threads.
  template <typename T>
  FT_HOST_DEVICE static T shuffle(T value, int /*from*/) {
    return value;
  }
  /// Sum over the lower ranks' values; `total` gets the sum over all.
  FT_HOST_DEVICE int exclusive_scan(int value, int& total) const {
    total = value;
    return 0;
  }
  /// How many lower ranks say yes; `total` gets how many say so at all.
  FT_HOST_DEVICE int exclusive_count(bool flag, int& total) const {
    total = static_cast<int>(flag);
    return 0;
  }
  /// Exclusive sum over data[0, n) in place; returns the total.
  FT_HOST_DEVICE int exclusive_scan_array(int* data, int n) const {
    int sum = 0;
    for (int i = 0; i < n; ++i) {
      int const v = data[i];
      data[i] = sum;
      sum += v;
    }
    return sum;
  }
  /// Ascending sort of distinct keys.
  template <typename Key>
  FT_HOST_DEVICE void sort(Key* keys, int n) const {
#if defined(__CUDA_ARCH__)
    for (int i = 1; i < n; ++i) {
      Key const k = keys[i];
      int j = i - 1;
      for (; j >= 0 && k < keys[j]; --j) { keys[j + 1] = keys[j]; }
      keys[j + 1] = k;
    }
#else
    std::sort(keys, keys + n);
#endif
  }
};

#if defined(__CUDACC__)

namespace detail {

/// Exchanges any trivially copyable value between lanes, word by word.
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

/// Whether this architecture reduces a T over a warp in one instruction.
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
    // The upper words, then the lower ones of those who have the upper one.
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

__device__ inline int warp_inclusive_scan(int value) {
  int const lane = static_cast<int>(threadIdx.x) & 31;
  FT_UNROLL
  for (int d = 1; d < 32; d *= 2) {
    int const other = __shfl_up_sync(0xffffffffu, value, static_cast<unsigned>(d));
    if (lane >= d) { value += other; }
  }
  return value;
}

/// Bitonic merge sort of n distinct keys, any n, by all threads of a group.
template <typename Group, typename Key>
__device__ void bitonic_sort(Group const& g, Key* keys, int n) {
  for (int width = 2; width / 2 < n; width *= 2) {
    // The first step of each merge mirrors, so that every comparison is ascending and indices past
    // n, which count as +infinity, never move.
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
    int const inclusive = detail::warp_inclusive_scan(value);
    total = __shfl_sync(0xffffffffu, inclusive, 31);
    return inclusive - value;
  }
  __device__ int exclusive_count(bool flag, int& total) const {
    unsigned const flags = ballot(flag);
    total = popcount(flags);
    return popcount(flags & ((1u << rank()) - 1));
  }
  __device__ int exclusive_scan_array(int* data, int n) const {
    int carry = 0;
    for (int base = 0; base < n; base += 32) {
      int const i = base + rank();
      int total = 0;
      int const v = exclusive_scan(i < n ? data[i] : 0, total);
      if (i < n) { data[i] = carry + v; }
      carry += total;
    }
    sync();
    return carry;
  }
  template <typename Key>
  __device__ void sort(Key* keys, int n) const {
    detail::bitonic_sort(*this, keys, n);
  }
};

/// A thread block of N threads, a multiple of 32. Its collectives use scratch that the executor
/// owns.
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
    extern __shared__ ulonglong2 extra_scratch[];
    return reinterpret_cast<unsigned char*>(extra_scratch);
  }
  __device__ static warp_group part() { return {}; }
  __device__ static int part_index() { return static_cast<int>(threadIdx.x) / 32; }
  __device__ static constexpr int parts() { return warps; }
  /// The same value in every thread; T of at most 16 bytes.
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
    int const inclusive = detail::warp_inclusive_scan(value);
    return inclusive - value + sum_of_warps_before(__shfl_sync(0xffffffffu, inclusive, 31), total);
  }
  __device__ int exclusive_count(bool flag, int& total) const {
    int mine = 0;
    int const below = part().exclusive_count(flag, mine);
    return below + sum_of_warps_before(mine, total);
  }
  __device__ int exclusive_scan_array(int* data, int n) const {
    int carry = 0;
    for (int base = 0; base < n; base += N) {
      int const i = base + rank();
      int total = 0;
      int const v = exclusive_scan(i < n ? data[i] : 0, total);
      if (i < n) { data[i] = carry + v; }
      carry += total;
    }
    sync();
    return carry;
  }
  template <typename Key>
  __device__ void sort(Key* keys, int n) const {
    detail::bitonic_sort(*this, keys, n);
  }

private:
  /// Each warp gives a number. Returns the sum of those of the warps before; `total` gets all.
  __device__ int sum_of_warps_before(int mine, int& total) const {
    if ((rank() & 31) == 0) { memcpy(temp->words[rank() / 32], &mine, sizeof(int)); }
    sync();
    int const lane = rank() & 31;
    int of_lane = 0;
    if (lane < warps) { memcpy(&of_lane, temp->words[lane], sizeof(int)); }
    sync();
    int const inclusive = detail::warp_inclusive_scan(of_lane);
    total = __shfl_sync(0xffffffffu, inclusive, 31);
    return __shfl_sync(0xffffffffu, inclusive - of_lane, rank() / 32);
  }
};

#endif  // __CUDACC__

// ---- atomics on integers: what ends up in memory does not depend on the order of the calls
// -------

/// Adds and returns the value before.
FT_HOST_DEVICE inline int atomic_add(int* address, int value) {
#if defined(__CUDA_ARCH__)
  return atomicAdd(address, value);
#else
  return __atomic_fetch_add(address, value, __ATOMIC_RELAXED);
#endif
}

/// Stores and returns the value before.
FT_HOST_DEVICE inline int atomic_exchange(int* address, int value) {
#if defined(__CUDA_ARCH__)
  return atomicExch(address, value);
#else
  return __atomic_exchange_n(address, value, __ATOMIC_RELAXED);
#endif
}

/// Returns the value before.
template <typename T>
FT_HOST_DEVICE T atomic_min(T* address, T value) {
#if defined(__CUDA_ARCH__)
  return atomicMin(address, value);
#else
  T seen = __atomic_load_n(address, __ATOMIC_RELAXED);
  while (value < seen && !__atomic_compare_exchange_n(address, &seen, value, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {}
  return seen;
#endif
}

template <typename T>
FT_HOST_DEVICE void atomic_max(T* address, T value) {
#if defined(__CUDA_ARCH__)
  atomicMax(address, value);
#else
  T seen = __atomic_load_n(address, __ATOMIC_RELAXED);
  while (seen < value && !__atomic_compare_exchange_n(address, &seen, value, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {}
#endif
}

}  // namespace FT_ABI
}  // namespace ft
