// SPDX-License-Identifier: Apache-2.0
/// @file Groups: the threads that compute one item together.
///
/// A stage's body sees `rank()`, `size()`, `sync()` and collectives only, and is written once.
/// Every thread of a group must call a collective. Loops read
/// `for (i = g.rank(); i < n; i += g.size())`.
#pragma once

#include <algorithm>
#include <cstdint>
#include <type_traits>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

struct sum_op {
  template <typename T>
  FT_HOST_DEVICE T operator()(T a, T b) const {
    return a + b;
  }
};
/// Four sums in one reduction.
struct four_sums {
  int of[4];
  friend FT_HOST_DEVICE four_sums operator+(four_sums a, four_sums b) {
    return {{a.of[0] + b.of[0], a.of[1] + b.of[1], a.of[2] + b.of[2], a.of[3] + b.of[3]}};
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

/// One thread: every item on the host, and `per_thread` items on a device. Its members are the
/// contract; warp_group and block_group (core/detail/cuda_groups.hpp) have the same ones, except
/// that some are for certain sizes only.
struct single_group {
  static constexpr int max_threads = 1;
  /// Dynamic shared memory of the size that a functor's extra_bytes() returns, aligned to 16 bytes.
  /// Blocks only.
  FT_HOST_DEVICE static unsigned char* extra() { return nullptr; }
  FT_HOST_DEVICE static constexpr int rank() { return 0; }
  FT_HOST_DEVICE static constexpr int size() { return 1; }
  FT_HOST_DEVICE static void sync() {}
  /// This thread's warp, of a block; otherwise the group itself.
  FT_HOST_DEVICE static single_group part() { return {}; }
  FT_HOST_DEVICE static constexpr int part_index() { return 0; }
  FT_HOST_DEVICE static constexpr int parts() { return 1; }
  /// Reduction over all threads' values; every thread gets the result.
  template <typename T, typename Op>
  FT_HOST_DEVICE T reduce(T value, Op) const {
    return value;
  }
  /// Whether the flag of any thread is true.
  FT_HOST_DEVICE static bool any(bool flag) { return flag; }
  /// Threads that `reduce_lanes<Most>` reduces together: `Most`, or 1 if the group is one thread.
  FT_HOST_DEVICE static constexpr int lanes(int) { return 1; }
  /// `reduce` within each run of `lanes(Most)` consecutive ranks.
  /// @tparam Most a power of two up to 32
  template <int Most, typename T, typename Op>
  FT_HOST_DEVICE T reduce_lanes(T value, Op) const {
    return value;
  }
  /// Bit i is the flag of rank i. Groups of up to 32 threads.
  FT_HOST_DEVICE static unsigned ballot(bool flag) { return static_cast<unsigned>(flag); }
  /// The value of rank `from`. Groups of up to 32 threads.
  template <typename T>
  FT_HOST_DEVICE static T shuffle(T value, int /*from*/) {
    return value;
  }
  /// Sum of the lower ranks' values; `total` gets the sum of all.
  FT_HOST_DEVICE int exclusive_scan(int value, int& total) const {
    total = value;
    return 0;
  }
  /// Number of lower ranks whose flag is true; `total` gets the number of all.
  FT_HOST_DEVICE int exclusive_count(bool flag, int& total) const {
    total = static_cast<int>(flag);
    return 0;
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

// Copies of objects by groups.

/// Copies an object, a word each by the threads of a group. The copy is complete after the group's
/// next sync().
/// @tparam T trivially copyable, of whole words
template <typename T, typename Group>
FT_HOST_DEVICE void copy_object(Group g, T& to, T const& from) {
  static_assert(std::is_trivially_copyable<T>::value, "copied by words");
  static_assert(sizeof(T) % sizeof(std::uint32_t) == 0 && alignof(T) % alignof(std::uint32_t) == 0,
                "of whole words");
#if defined(__CUDA_ARCH__)
  using word = std::uint32_t __attribute__((__may_alias__));
  auto const* const words = reinterpret_cast<word const*>(&from);
  auto* const copies = reinterpret_cast<word*>(&to);
  for (int i = g.rank(); i < static_cast<int>(sizeof(T) / sizeof(word)); i += g.size()) {
    copies[i] = words[i];
  }
#else
  if (g.rank() == 0) { to = from; }
#endif
}

}  // namespace FT_ABI
}  // namespace ft
