// SPDX-License-Identifier: Apache-2.0
// Introsort in parallel against std::sort of libstdc++, whose order of equal elements it gives.
#include "ft/kernels/distribution/last_rounds.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "tests/support/backends.hpp"

#if defined(__GLIBCXX__)

namespace introsort {

using element = std::uint64_t;  ///< key << 32 | number in the order given
using array_list = std::vector<std::vector<element>>;

struct key_less {
  FT_HOST_DEVICE bool operator()(element a, element b) const { return a >> 32 < b >> 32; }
};

struct range {
  int begin, end;
};

/// Arrays one after the other: where each begins, and the workspace.
struct arrays_view {
  element* data;
  int const* first;
  range* ranges;
  int* left;
  int* right;
  int* open;
  bool reversed;
};

struct partition_array {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, arrays_view const& v) const {
    int const first = v.first[item];
    int const n = v.first[item + 1] - first;
    ft::detail::introsort_workspace<range, int> const w{v.ranges + first, v.left + first,
                                                        v.right + first, v.open + 2 * item};
    if (v.reversed) {
      ft::detail::reversed_array<element> const a{v.data + first, n};
      ft::detail::introsort_partitions(g, a, n, key_less{}, w);
    } else {
      ft::detail::introsort_partitions(g, v.data + first, n, key_less{}, w);
    }
  }
};

/// Keys that make medians of three as uneven as can be: a comparison that decides the order while
/// std::sort asks (McIlroy, "A killer adversary for quicksort", 1999).
std::vector<int> killer(int n) {
  std::vector<int> key(static_cast<std::size_t>(n), n);  // n: not decided yet
  std::vector<int> item(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) { item[static_cast<std::size_t>(i)] = i; }
  int decided = 0;
  int candidate = 0;
  std::sort(item.begin(), item.end(), [&](int a, int b) {
    auto& of_a = key[static_cast<std::size_t>(a)];
    auto& of_b = key[static_cast<std::size_t>(b)];
    if (of_a == n && of_b == n) { (a == candidate ? of_a : of_b) = decided++; }
    if (of_a == n) {
      candidate = a;
    } else if (of_b == n) {
      candidate = b;
    }
    return of_a < of_b;
  });
  return key;
}

enum class pattern { random, few, equal, sorted, reverse, organ_pipe, killer, killer_ties, count };

std::vector<int> make_keys(pattern p, int n, std::mt19937& random) {
  if (p == pattern::killer) { return killer(n); }
  if (p == pattern::killer_ties) {
    auto keys = killer(n);
    for (int& k : keys) { k /= 3; }
    return keys;
  }
  std::vector<int> keys;
  int const kinds = 1 + static_cast<int>(random() % 40);
  for (int i = 0; i < n; ++i) {
    int key = 5;
    if (p == pattern::random) { key = static_cast<int>(random() & 0x7fffffff); }
    if (p == pattern::few) { key = static_cast<int>(random() % static_cast<unsigned>(kinds)); }
    if (p == pattern::sorted) { key = i / kinds; }
    if (p == pattern::reverse) { key = (n - i) / kinds; }
    if (p == pattern::organ_pipe) { key = std::min(i, n - i) / kinds; }
    keys.push_back(key);
  }
  return keys;
}

template <typename Backend>
class introsort_test : public test::on_backend<Backend> {
protected:
  /// What the partitions leave, sorted stably.
  array_list run(array_list const& in, bool reversed) {
    Backend backend;
    std::vector<element> all;
    std::vector<int> first{0};
    for (auto const& a : in) {
      all.insert(all.end(), a.begin(), a.end());
      if (reversed) { std::reverse(all.end() - static_cast<std::ptrdiff_t>(a.size()), all.end()); }
      first.push_back(static_cast<int>(all.size()));
    }
    auto const n = all.size();
    auto data = test::to_exec(backend.exec, all);
    auto const begins = test::to_exec(backend.exec, first);
    auto ranges = test::to_exec(backend.exec, std::vector<range>(n));
    auto left = test::to_exec(backend.exec, std::vector<int>(n));
    auto right = test::to_exec(backend.exec, std::vector<int>(n));
    auto open = test::to_exec(backend.exec, std::vector<int>(2 * in.size()));
    arrays_view const v{data.data(),  begins.data(), ranges.data(), left.data(),
                        right.data(), open.data(),   reversed};
    ft::for_each_item<ft::per_block<512>>(backend.exec, static_cast<int>(in.size()),
                                          partition_array{}, v);
    all = test::from_exec(backend.exec, data.data(), n);
    array_list out;
    for (std::size_t i = 0; i < in.size(); ++i) {
      out.emplace_back(all.begin() + first[i], all.begin() + first[i + 1]);
      if (reversed) { std::reverse(out.back().begin(), out.back().end()); }
      std::stable_sort(out.back().begin(), out.back().end(), key_less{});
    }
    return out;
  }

  void compare(array_list const& in) {
    for (bool const reversed : {false, true}) {
      auto const out = run(in, reversed);
      for (std::size_t i = 0; i < in.size(); ++i) {
        auto want = in[i];
        std::sort(want.begin(), want.end(), key_less{});
        ASSERT_EQ(out[i], want) << "array " << i << " of " << want.size()
                                << (reversed ? " elements, reversed" : " elements");
      }
    }
  }
};
TYPED_TEST_SUITE(introsort_test, test::backends);

std::vector<element> numbered(std::vector<int> const& keys) {
  std::vector<element> a;
  for (int const k : keys) { a.push_back(static_cast<element>(k) << 32 | a.size()); }
  return a;
}

TYPED_TEST(introsort_test, orders_equals_as_std_sort_does) {
  std::mt19937 random(7);
  array_list list;
  for (int p = 0; p < static_cast<int>(pattern::count); ++p) {
    for (int n = 0; n <= 5000; n += n < 150 ? 1 : 97 + static_cast<int>(random() % 300)) {
      list.push_back(numbered(make_keys(static_cast<pattern>(p), n, random)));
    }
  }
  this->compare(list);
}

TYPED_TEST(introsort_test, random_arrays_with_many_ties) {
  std::mt19937 random(11);
  array_list list;
  for (int i = 0; i < test::effort(2000); ++i) {
    int const n = static_cast<int>(random() % (i % 10 == 0 ? 5001u : 400u));
    list.push_back(numbered(make_keys(pattern::few, n, random)));
  }
  this->compare(list);
}

/// Whether partitions alone leave a range too long after as many in a row as introsort makes.
bool reaches_heap_sort(std::vector<element> a) {
  struct open_range {
    int begin, end, levels;
  };
  auto const n = static_cast<int>(a.size());
  std::vector<int> left(a.size());
  std::vector<int> right(a.size());
  ft::detail::introsort_workspace<open_range, int> const w{nullptr, left.data(), right.data(),
                                                           nullptr};
  int levels = 0;
  for (int m = n; m > 1; m /= 2) { levels += 2; }
  for (std::vector<open_range> open{{0, n, levels}}; !open.empty();) {
    open_range const r = open.back();
    open.pop_back();
    if (r.end - r.begin <= ft::detail::introsort_leaf) { continue; }
    if (r.levels == 0) { return true; }
    int const cut = ft::detail::partition_by_median(ft::single_group{}, a.data(), r.begin, r.end,
                                                    key_less{}, w);
    open.push_back({r.begin, cut, r.levels - 1});
    open.push_back({cut, r.end, r.levels - 1});
  }
  return false;
}

TYPED_TEST(introsort_test, adversaries_end_in_the_heap_sort) {
  std::mt19937 random(13);
  array_list list;
  for (int n = 200; n <= 3000; n += 100) {
    for (auto const p : {pattern::killer, pattern::killer_ties}) {
      list.push_back(numbered(make_keys(p, n, random)));
      EXPECT_TRUE(p == pattern::killer_ties || reaches_heap_sort(list.back())) << n << " elements";
    }
  }
  this->compare(list);
}

}  // namespace introsort

#endif  // __GLIBCXX__
