// SPDX-License-Identifier: Apache-2.0
/// @file The order in which introsort leaves equal elements, computed by the threads of a group.
///
/// Introsort (Musser, 1997) is quicksort by medians of three. Ranges that are still long after 2 *
/// floor(log2(n)) successive partitions are sorted by heap sort. Ranges of up to 16 elements are
/// left unsorted. At the end one insertion sort runs over everything. That last sort is stable, so
/// only the partitions and the heap sorts decide the order of equal elements. This file performs
/// those; any stable sort of their result gives the result of introsort. The details on which a
/// result depends are those of std::sort in libstdc++, which is the oracle in
/// tests/kernels/introsort_test.cpp.
///
/// A partition exchanges the i-th element from the left that is not below the pivot with the i-th
/// from the right that is not above it, as long as the first precedes the second. Earlier exchanges
/// do not change which elements these are, so all pairs are found at once. Ranges with the same
/// number of partitions before them are independent of each other: a warp takes one.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Ranges of up to this many elements are not partitioned.
inline constexpr int introsort_leaf = 16;

/// Workspace of introsort in addition to n elements.
/// @tparam Range a pair of members `begin` and `end` that hold 0 to n
/// @tparam Position an integer that holds 0 to n
template <typename Range, typename Position>
struct introsort_workspace {
  Range* ranges;    ///< n: ranges of even levels from the front, of odd levels from the back
  Position* left;   ///< n
  Position* right;  ///< n
  int* open;        ///< 2: numbers of ranges of even and of odd levels so far
};

/// An array whose elements are in memory from the last to the first.
template <typename T>
struct reversed_array {
  T* data;
  int size;
  FT_HOST_DEVICE T& operator[](int i) const { return data[size - 1 - i]; }
};

/// Exchanges two elements.
template <typename Array>
FT_HOST_DEVICE void exchange(Array a, int i, int j) {
  auto const value = a[i];
  a[i] = a[j];
  a[j] = value;
}

/// Position of the median of a[i], a[j] and a[k]. Of equals, the one with which three comparisons
/// in this order end.
template <typename Array, typename Less>
FT_HOST_DEVICE int median_of_three(Array a, int i, int j, int k, Less less) {
  bool const rising = less(a[i], a[j]);
  int const low = rising ? i : j;
  int const high = rising ? j : i;
  if (less(a[high], a[k])) { return high; }
  return less(a[low], a[k]) ? k : low;
}

/// Puts `value` into the heap a[begin, begin + n) at the hole `at`, whose subtrees are heaps. The
/// hole moves down to a leaf along the larger children, the right one of equals. Then `value` rises
/// from there, at most to the hole's first position.
template <typename Array, typename Value, typename Less>
FT_HOST_DEVICE void sift(Array a, int begin, int n, int at, Value value, Less less) {
  int hole = at;
  for (int child = 2 * hole + 1; child < n; child = 2 * hole + 1) {
    if (child + 1 < n && !less(a[begin + child + 1], a[begin + child])) { ++child; }
    a[begin + hole] = a[begin + child];
    hole = child;
  }
  while (hole > at) {
    int const parent = (hole - 1) / 2;
    if (!less(a[begin + parent], value)) { break; }
    a[begin + hole] = a[begin + parent];
    hole = parent;
  }
  a[begin + hole] = value;
}

/// Sorts a[begin, end); one thread.
template <typename Array, typename Less>
FT_HOST_DEVICE void heap_sort(Array a, int begin, int end, Less less) {
  int const n = end - begin;
  for (int at = n / 2 - 1; at >= 0; --at) {
    auto const value = a[begin + at];
    sift(a, begin, n, at, value, less);
  }
  for (int left = n - 1; left > 0; --left) {
    auto const value = a[begin + left];
    a[begin + left] = a[begin];
    sift(a, begin, left, 0, value, less);
  }
}

/// Partitions a[begin, end), more than 3 elements, by the median of the second, the middle and the
/// last, which goes to the front. Returns where the right part begins.
/// @param part a warp, or one thread
/// @param w `left` and `right` are used, in [begin, end)
template <typename Part, typename Array, typename Less, typename Range, typename Position>
FT_HOST_DEVICE int partition_by_median(Part part, Array a, int begin, int end, Less less,
                                       introsort_workspace<Range, Position> const& w) {
  int const median = median_of_three(a, begin + 1, begin + (end - begin) / 2, end - 1, less);
  auto const pivot = a[median];
  part.sync();
  if (part.rank() == 0) { exchange(a, begin, median); }
  part.sync();
  Position* const left = w.left + begin;
  Position* const right = w.right + begin;
  int lefts = 0;
  int rights = 0;
  for (int base = begin + 1; base < end; base += part.size()) {
    int const i = base + part.rank();
    bool not_below = false;
    bool not_above = false;
    if (i < end) {
      auto const value = a[i];
      not_below = !less(value, pivot);
      not_above = !less(pivot, value);
    }
    int more_left = 0;
    int more_right = 0;
    int const at_left = lefts + part.exclusive_count(not_below, more_left);
    int const at_right = rights + part.exclusive_count(not_above, more_right);
    if (not_below) { left[at_left] = static_cast<Position>(i); }
    if (not_above) { right[at_right] = static_cast<Position>(i); }
    lefts += more_left;
    rights += more_right;
  }
  part.sync();
  int exchanges = 0;
  for (int i = part.rank(); i < min_of(lefts, rights); i += part.size()) {
    int const from_left = static_cast<int>(left[i]);
    int const from_right = static_cast<int>(right[rights - 1 - i]);
    if (from_left >= from_right) { break; }
    exchange(a, from_left, from_right);
    ++exchanges;
  }
  exchanges = part.reduce(exchanges, sum_op{});
  // The scan from the left ends at the next element that is not below the pivot, at the latest at
  // the last one exchanged.
  int cut = end;
  if (exchanges < lefts) { cut = static_cast<int>(left[exchanges]); }
  if (exchanges > 0) { cut = min_of(cut, static_cast<int>(right[rights - exchanges])); }
  return cut;
}

/// Permutes n elements as introsort does before its last insertion sort: a stable sort of the
/// result is the result of introsort. Every thread of the group must call it, with the same
/// arguments. Writes of the threads before the call are visible in it; its result may be read after
/// a sync(). O(n log n).
/// @param a array by index, in memory that all threads of the group access
/// @param less strict weak order
template <typename Group, typename Array, typename Less, typename Range, typename Position>
FT_HOST_DEVICE void introsort_partitions(Group g, Array a, int n, Less less,
                                         introsort_workspace<Range, Position> const& w) {
  if (n <= introsort_leaf) { return; }
  auto const range_at = [&](int parity, int i) { return w.ranges + (parity == 0 ? i : n - 1 - i); };
  using index = decltype(Range::begin);
  if (g.rank() == 0) {
    *range_at(0, 0) = {index{0}, static_cast<index>(n)};
    w.open[0] = 1;
    w.open[1] = 0;
  }
  g.sync();
  auto const part = g.part();
  int levels = 0;
  while (2 << levels / 2 <= n) { levels += 2; }
  // Fewer than n ranges are partitioned in total, so places are not reused and counts only grow.
  int first = 0;
  int first_of_next = 0;
  for (int level = 0;; ++level) {
    int const parity = level % 2;
    int const last = w.open[parity];
    if (first == last) { break; }
    for (int r = first + g.part_index(); r < last; r += g.parts()) {
      int const begin = static_cast<int>(range_at(parity, r)->begin);
      int const end = static_cast<int>(range_at(parity, r)->end);
      if (level == levels) {
        if (part.rank() == 0) { heap_sort(a, begin, end, less); }
        continue;
      }
      int const cut = partition_by_median(part, a, begin, end, less, w);
      if (part.rank() != 0) { continue; }
      auto const add = [&](int from, int to) {
        if (to - from <= introsort_leaf) { return; }
        *range_at(1 - parity, atomic_add(w.open + 1 - parity, 1)) = {static_cast<index>(from),
                                                                     static_cast<index>(to)};
      };
      add(begin, cut);
      add(cut, end);
    }
    first = first_of_next;
    first_of_next = last;
    g.sync();
  }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
