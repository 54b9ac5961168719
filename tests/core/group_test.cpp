// SPDX-License-Identifier: Apache-2.0
// Collectives of every group against plain loops, for sizes around and far from the group's own.
#include "ft/core/group.hpp"
#include "ft/core/atomics.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <numeric>
#include <random>
#include <vector>

#include "ft/containers/soa.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "tests/support/backends.hpp"

namespace group_test {

/// Sizes of the items: edges of warps and blocks, and random ones.
inline std::vector<int> item_sizes() {
  std::vector<int> sizes{0,   1,   2,   3,   31,  32,  33,  63,   64,   65,   127,  128,
                         129, 255, 256, 257, 511, 512, 513, 1023, 1024, 1025, 4999, 5000};
  std::mt19937 random(7);
  for (int i = 0; i < 16; ++i) { sizes.push_back(static_cast<int>(random() % 5001u)); }
  return sizes;
}

/// Item i owns elements [start[i], start[i + 1]).
inline std::vector<int> starts_of(std::vector<int> const& sizes) {
  std::vector<int> starts{0};
  for (int const n : sizes) { starts.push_back(starts.back() + n); }
  return starts;
}

/// Fills its extra scratch with numbers of its own and counts those that are not there afterwards.
struct use_extra_scratch {
  using scratch = int;
  std::size_t bytes = 0;
  std::size_t extra_bytes() const { return bytes; }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& misaligned, int item, int* wrong) const {
    auto* const numbers = reinterpret_cast<int*>(g.extra());
    int const n = static_cast<int>(bytes / sizeof(int));
    if (g.rank() == 0) {
      misaligned = n > 0 && reinterpret_cast<std::uintptr_t>(numbers) % 16 != 0 ? 1 : 0;
    }
    for (int i = g.rank(); i < n; i += g.size()) { numbers[i] = 7 * i + item; }
    g.sync();
    int bad = 0;
    for (int i = g.rank(); i < n; i += g.size()) {
      int const at = n - 1 - i;
      bad += static_cast<int>(numbers[at] != 7 * at + item);
    }
    bad = g.reduce(bad, ft::sum_op{});
    if (g.rank() == 0) { wrong[item] = bad + misaligned; }
  }
};

/// Adds up what its prologue wrote.
struct use_prologue {
  struct scratch {
    int of[1024];
  };
  template <typename Group>
  FT_HOST_DEVICE void prologue(Group g, scratch& s, int item, int n, int*) const {
    for (int i = g.rank(); i < n; i += g.size()) { s.of[n - 1 - i] = i + item; }
  }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, int n, int* out) const {
    g.sync();
    int sum = 0;
    for (int i = g.rank(); i < n; i += g.size()) { sum += s.of[i]; }
    sum = g.reduce(sum, ft::sum_op{});
    if (g.rank() == 0) { out[item] = sum; }
  }
};

/// A value of the largest size that a block's collectives take.
struct tally {
  int sum, minimum, maximum, count;
  friend FT_HOST_DEVICE tally operator+(tally a, tally b) {
    return {a.sum + b.sum, ft::min_of(a.minimum, b.minimum), ft::max_of(a.maximum, b.maximum),
            a.count + b.count};
  }
};
static_assert(sizeof(tally) == 16, "the largest that block_group::reduce takes");

/// What every thread of an item must be told; `agree` counts the threads that were told the same.
struct reduced {
  long long sum;
  int minimum, maximum;
  tally all;
  int agree;
};

struct reduce_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* starts, int const* data,
                                 reduced* out, int* threads) const {
    long long sum = 0;
    int minimum = 2147483647;
    int maximum = -2147483647;
    tally all{0, 2147483647, -2147483647, 0};
    for (int i = starts[item] + g.rank(); i < starts[item + 1]; i += g.size()) {
      sum += data[i];
      minimum = ft::min_of(minimum, data[i]);
      maximum = ft::max_of(maximum, data[i]);
      all = all + tally{data[i], data[i], data[i], 1};
    }
    sum = g.reduce(sum, ft::sum_op{});
    minimum = g.reduce(minimum, ft::min_op{});
    maximum = g.reduce(maximum, ft::max_op{});
    all = g.reduce(all, ft::sum_op{});
    if (g.rank() == g.size() - 1) {
      out[item] = {sum, minimum, maximum, all, 0};
      threads[item] = g.size();
    }
    g.sync();
    bool const same = out[item].sum == sum && out[item].minimum == minimum &&
                      out[item].maximum == maximum && out[item].all.sum == all.sum &&
                      out[item].all.count == all.count;
    ft::atomic_add(&out[item].agree, static_cast<int>(same));
  }
};

/// Scans an array in portions of the group's size, one value per thread.
struct scan_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* starts, int const* data,
                                 int* by_portions, int* totals) const {
    int const n = starts[item + 1] - starts[item];
    int before = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      int here = 0;
      int const scanned = g.exclusive_scan(i < n ? data[starts[item] + i] : 0, here);
      if (i < n) { by_portions[starts[item] + i] = before + scanned; }
      before += here;
    }
    if (g.rank() == g.size() - 1) { totals[item] = before; }
  }
};

struct sort_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* starts,
                                 unsigned long long* keys) const {
    g.sort(keys + starts[item], starts[item + 1] - starts[item]);
  }
};

/// Whether any number of an item is 0, as each thread is told, and with what only one says.
struct any_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* starts, int const* data,
                                 int* answers) const {
    bool zero = false;
    for (int i = starts[item] + g.rank(); i < starts[item + 1]; i += g.size()) {
      zero = zero || data[i] == 0;
    }
    int const all_told = g.reduce(static_cast<int>(g.any(zero)), ft::min_op{});
    int const some_told =
        g.reduce(static_cast<int>(g.any(g.rank() == item % g.size())), ft::min_op{});
    int const nobody = g.reduce(static_cast<int>(g.any(false)), ft::max_op{});
    if (g.rank() == g.size() - 1) { answers[item] = all_told + 2 * some_told + 4 * nobody; }
  }
};

/// How many even numbers come before each, and how many there are, by portions.
struct count_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* starts, int const* data,
                                 int* counts, int* totals) const {
    int const n = starts[item + 1] - starts[item];
    int before = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      int here = -1;
      int const counted = g.exclusive_count(i < n && data[starts[item] + i] % 2 == 0, here);
      if (i < n) { counts[starts[item] + i] = before + counted; }
      before += here;
    }
    if (g.rank() == g.size() - 1) { totals[item] = before; }
  }
};

/// What each thread of an item is told of its neighbours, and by the ballot of its warp.
struct neighbours_item {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int const* values, int* sum_of_4,
                                 int* largest_of_16, unsigned* votes, int* sizes) const {
    int const at = 32 * item + g.rank() % 32;
    sum_of_4[at] = g.template reduce_lanes<4>(values[at], ft::sum_op{});
    largest_of_16[at] = g.template reduce_lanes<16>(values[at], ft::max_op{});
    votes[at] = g.part().ballot(values[at] % 3 == 0);
    sizes[at] = g.lanes(16);
  }
};

inline constexpr int sums = 3;

template <typename T>
struct sum_item {
  using scratch = ft::ordered_sum_scratch<sums, T>;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, int const* starts,
                                 double const* data, double* out) const {
    double const* const mine = data + starts[item];
    ft::ordered_sum<sums>(g, s, starts[item + 1] - starts[item],
                          [&](int i, ft::sum_terms<sums, T>& acc) {
                            acc.of[0] += static_cast<T>(mine[i]);
                            acc.of[1] += T(1);
                            acc.of[2] += static_cast<T>(mine[i]) * T(0.5);  // exact
                          });
    if (g.rank() == g.size() - 1) {
      for (int k = 0; k < sums; ++k) { out[sums * item + k] = static_cast<double>(s.total.of[k]); }
    }
  }
};

/// The documented order of additions: 512 lanes, halves of a warp's lanes, then the warps.
template <typename Number>
Number sum_in_order(double const* data, int n) {
  std::vector<Number> lanes(512, Number(0));
  for (int i = 0; i < n; ++i) {
    lanes[static_cast<std::size_t>(i % 512)] += static_cast<Number>(data[i]);
  }
  Number total = 0;
  for (std::size_t warp = 0; warp < 16; ++warp) {
    // In each step the upper half of what is left is added to the lower half.
    std::vector<Number> rest(lanes.begin() + static_cast<std::ptrdiff_t>(32 * warp),
                             lanes.begin() + static_cast<std::ptrdiff_t>(32 * warp + 32));
    while (rest.size() > 1) {
      std::size_t const halved = rest.size() / 2;
      for (std::size_t i = 0; i < halved; ++i) { rest[i] += rest[i + halved]; }
      rest.resize(halved);
    }
    total = warp == 0 ? rest[0] : total + rest[0];
  }
  return total;
}

template <typename Backend>
class group_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
  std::vector<int> sizes = item_sizes();
  std::vector<int> starts = starts_of(sizes);
  int items() const { return static_cast<int>(sizes.size()); }

  std::vector<int> random_values(int low, int high) const {
    std::mt19937 random(11);
    std::uniform_int_distribution<int> value(low, high);
    std::vector<int> values(static_cast<std::size_t>(starts.back()));
    for (auto& v : values) { v = value(random); }
    return values;
  }

  template <typename Shape>
  void check_reduce() {
    auto const data = random_values(-1000, 1000);
    auto const d_starts = test::to_exec(backend.exec, starts);
    auto const d_data = test::to_exec(backend.exec, data);
    auto const d_out = test::to_exec(backend.exec, std::vector<reduced>(sizes.size(), reduced{}));
    auto const d_threads = test::to_exec(backend.exec, std::vector<int>(sizes.size(), -1));
    ft::for_each_item<Shape>(backend.exec, items(), reduce_item{}, d_starts.data(), d_data.data(),
                             d_out.data(), d_threads.data());
    auto const out = test::from_exec(backend.exec, d_out);
    auto const threads = test::from_exec(backend.exec, d_threads);
    for (std::size_t item = 0; item < sizes.size(); ++item) {
      auto const first = data.begin() + starts[item];
      auto const last = data.begin() + starts[item + 1];
      long long const sum = std::accumulate(first, last, 0LL);
      EXPECT_EQ(out[item].sum, sum) << sizes[item];
      EXPECT_EQ(out[item].all.sum, sum) << sizes[item];
      EXPECT_EQ(out[item].all.count, sizes[item]);
      EXPECT_EQ(out[item].minimum, first == last ? 2147483647 : *std::min_element(first, last));
      EXPECT_EQ(out[item].maximum, first == last ? -2147483647 : *std::max_element(first, last));
      EXPECT_EQ(out[item].all.minimum, out[item].minimum);
      EXPECT_EQ(out[item].all.maximum, out[item].maximum);
      EXPECT_EQ(out[item].agree, threads[item]) << "every thread gets the result";
    }
  }

  /// By portions: what comes before each number, and all. @param of(number): what is added
  template <typename Shape, typename Op, typename Of>
  void check_prefixes(Op const& op, Of const& of) {
    auto const data = random_values(0, 9);
    auto const d_starts = test::to_exec(backend.exec, starts);
    auto const d_data = test::to_exec(backend.exec, data);
    auto const d_portions = test::to_exec(backend.exec, std::vector<int>(data.size(), -1));
    auto const d_totals = test::to_exec(backend.exec, std::vector<int>(sizes.size(), -1));
    ft::for_each_item<Shape>(backend.exec, items(), op, d_starts.data(), d_data.data(),
                             d_portions.data(), d_totals.data());
    auto const totals = test::from_exec(backend.exec, d_totals);
    std::vector<int> want(data.size());
    for (std::size_t item = 0; item < sizes.size(); ++item) {
      int sum = 0;
      for (int i = starts[item]; i < starts[item + 1]; ++i) {
        want[static_cast<std::size_t>(i)] = sum;
        sum += of(data[static_cast<std::size_t>(i)]);
      }
      EXPECT_EQ(totals[item], sum) << sizes[item];
    }
    EXPECT_EQ(test::from_exec(backend.exec, d_portions), want);
  }
  template <typename Shape>
  void check_scan() {
    check_prefixes<Shape>(scan_item{}, [](int v) { return v; });
  }
  template <typename Shape>
  void check_count() {
    check_prefixes<Shape>(count_item{}, [](int v) { return static_cast<int>(v % 2 == 0); });
  }

  template <typename Shape>
  void check_sort() {
    // Distinct keys: a random upper half, the position in the lower; some items hold sorted or
    // falling keys.
    std::mt19937_64 random(13);
    std::vector<unsigned long long> keys(static_cast<std::size_t>(starts.back()));
    for (std::size_t i = 0; i < keys.size(); ++i) {
      keys[i] = (random() & 0xffffffff00000000ull) | static_cast<unsigned long long>(i);
    }
    auto const part = [&](std::size_t item) { return keys.begin() + starts[item]; };
    std::sort(part(9), part(10));
    std::sort(part(14), part(15), std::greater<unsigned long long>());
    std::sort(part(23), part(24), std::greater<unsigned long long>());
    auto const d_starts = test::to_exec(backend.exec, starts);
    auto const d_keys = test::to_exec(backend.exec, keys);
    ft::for_each_item<Shape>(backend.exec, items(), sort_item{}, d_starts.data(), d_keys.data());
    auto const got = test::from_exec(backend.exec, d_keys);
    for (std::size_t item = 0; item < sizes.size(); ++item) {
      std::sort(part(item), part(item + 1));
    }
    EXPECT_EQ(got, keys);
  }

  template <typename Shape>
  void check_any() {
    auto const data = random_values(0, 100);
    auto const d_starts = test::to_exec(backend.exec, starts);
    auto const d_data = test::to_exec(backend.exec, data);
    auto const d_answers = test::to_exec(backend.exec, std::vector<int>(sizes.size(), -1));
    ft::for_each_item<Shape>(backend.exec, items(), any_item{}, d_starts.data(), d_data.data(),
                             d_answers.data());
    auto const answers = test::from_exec(backend.exec, d_answers);
    for (std::size_t item = 0; item < sizes.size(); ++item) {
      bool const zero =
          std::count(data.begin() + starts[item], data.begin() + starts[item + 1], 0) > 0;
      EXPECT_EQ(answers[item], 2 + static_cast<int>(zero)) << sizes[item];
    }
  }

  template <typename Shape, typename T>
  void check_ordered_sum() {
    // Magnitudes far apart, so that another order gives other bits.
    std::mt19937 random(17);
    std::uniform_real_distribution<double> mantissa(-1.0, 1.0);
    std::vector<double> data(static_cast<std::size_t>(starts.back()));
    for (auto& v : data) {
      v = std::ldexp(mantissa(random), static_cast<int>(random() % 60u) - 30);
    }
    auto const d_starts = test::to_exec(backend.exec, starts);
    auto const d_data = test::to_exec(backend.exec, data);
    auto const d_out = test::to_exec(backend.exec, std::vector<double>(sums * sizes.size(), -1.0));
    ft::for_each_item<Shape>(backend.exec, items(), sum_item<T>{}, d_starts.data(), d_data.data(),
                             d_out.data());
    auto const out = test::from_exec(backend.exec, d_out);
    int differs_from_plain_order = 0;
    for (std::size_t item = 0; item < sizes.size(); ++item) {
      double const* const mine = data.data() + starts[item];
      double const* const got = &out[sums * item];
      T const want = sum_in_order<T>(mine, sizes[item]);
      EXPECT_EQ(got[0], static_cast<double>(want)) << sizes[item];
      EXPECT_EQ(got[1], sizes[item]);
      EXPECT_EQ(got[2], 0.5 * static_cast<double>(want)) << sizes[item];
      T const plain = std::accumulate(mine, mine + sizes[item], T(0),
                                      [](T sum, double v) { return sum + static_cast<T>(v); });
      differs_from_plain_order += static_cast<int>(plain != want);
    }
    EXPECT_GT(differs_from_plain_order, 5) << "the data must be able to tell orders apart";
  }
};
TYPED_TEST_SUITE(group_unit, test::backends);

TYPED_TEST(group_unit, reduce_over_one_thread) { this->template check_reduce<ft::per_thread>(); }
TYPED_TEST(group_unit, reduce_over_a_warp) { this->template check_reduce<ft::per_warp>(); }
TYPED_TEST(group_unit, reduce_over_blocks) {
  this->template check_reduce<ft::per_block<64>>();
  this->template check_reduce<ft::per_block<128>>();
  this->template check_reduce<ft::per_block<256>>();
  this->template check_reduce<ft::per_block<512>>();
  this->template check_reduce<ft::per_block<32>>();
  this->template check_reduce<ft::per_block<96>>();  // warps that are no power of two
  this->template check_reduce<ft::per_block<1024>>();
}
TYPED_TEST(group_unit, any_of_each_group) {
  this->template check_any<ft::per_thread>();
  this->template check_any<ft::per_warp>();
  this->template check_any<ft::per_block<96>>();
  this->template check_any<ft::per_block<512>>();
}
TYPED_TEST(group_unit, count_over_one_thread) { this->template check_count<ft::per_thread>(); }
TYPED_TEST(group_unit, count_over_a_warp) { this->template check_count<ft::per_warp>(); }
TYPED_TEST(group_unit, count_over_blocks) {
  this->template check_count<ft::per_block<32>>();
  this->template check_count<ft::per_block<96>>();
  this->template check_count<ft::per_block<512>>();
  this->template check_count<ft::per_block<1024>>();
}
TYPED_TEST(group_unit, scan_over_one_thread) { this->template check_scan<ft::per_thread>(); }
TYPED_TEST(group_unit, scan_over_a_warp) { this->template check_scan<ft::per_warp>(); }
TYPED_TEST(group_unit, scan_over_blocks) {
  this->template check_scan<ft::per_block<64>>();
  this->template check_scan<ft::per_block<128>>();
  this->template check_scan<ft::per_block<256>>();
  this->template check_scan<ft::per_block<512>>();
  this->template check_scan<ft::per_block<32>>();
  this->template check_scan<ft::per_block<96>>();
  this->template check_scan<ft::per_block<1024>>();
}
TYPED_TEST(group_unit, sort_over_one_thread) { this->template check_sort<ft::per_thread>(); }
TYPED_TEST(group_unit, sort_over_a_warp) { this->template check_sort<ft::per_warp>(); }
TYPED_TEST(group_unit, sort_over_blocks) {
  this->template check_sort<ft::per_block<64>>();
  this->template check_sort<ft::per_block<128>>();
  this->template check_sort<ft::per_block<256>>();
  this->template check_sort<ft::per_block<512>>();
}
TYPED_TEST(group_unit, neighbouring_lanes_and_ballots) {
  constexpr int items = 50;
  auto const& exec = this->backend.exec;
  std::mt19937 random(5);
  std::vector<int> values(32 * items);
  for (auto& v : values) { v = static_cast<int>(random() % 2001u) - 1000; }
  auto const d_values = test::to_exec(exec, values);
  auto const d_sums = test::to_exec(exec, std::vector<int>(values.size(), 0));
  auto const d_largest = test::to_exec(exec, std::vector<int>(values.size(), 0));
  auto const d_votes = test::to_exec(exec, std::vector<unsigned>(values.size(), 0u));
  auto const d_sizes = test::to_exec(exec, std::vector<int>(values.size(), 0));
  ft::for_each_item<ft::per_block<32>>(exec, items, neighbours_item{}, d_values.data(),
                                       d_sums.data(), d_largest.data(), d_votes.data(),
                                       d_sizes.data());
  auto const of = [&](auto const& d) { return test::from_exec(exec, d.data(), values.size()); };
  auto const sums_of_4 = of(d_sums);
  auto const largest = of(d_largest);
  auto const votes = of(d_votes);
  auto const taken = of(d_sizes);
  for (std::size_t item = 0; item < items; ++item) {
    // On the host a group has one thread: it writes the first of an item's 32 places.
    bool const one = taken[32 * item] == 1;
    for (std::size_t i = 0; i < (one ? 1u : 32u); ++i) {
      auto const* const all = values.data() + 32 * item;
      int sum = 0;
      for (std::size_t k = 0; k < (one ? 1u : 4u); ++k) { sum += all[i / 4 * 4 + k]; }
      unsigned vote = 0;
      for (std::size_t k = 0; k < (one ? 1u : 32u); ++k) {
        vote |= static_cast<unsigned>(all[k] % 3 == 0) << k;
      }
      EXPECT_EQ(sums_of_4[32 * item + i], sum);
      EXPECT_EQ(largest[32 * item + i],
                *std::max_element(all + i / 16 * 16, all + i / 16 * 16 + (one ? 1 : 16)));
      EXPECT_EQ(votes[32 * item + i], vote);
      EXPECT_EQ(taken[32 * item + i], one ? 1 : 16);
    }
  }
}
TYPED_TEST(group_unit, extra_scratch_is_there_up_to_the_limit) {
  constexpr int threads = 96;
  auto const& exec = this->backend.exec;
  for (int const items : {1, 3, 5000}) {
    std::size_t const most = ft::extra_scratch<threads, use_extra_scratch>(exec, items);
    if constexpr (!TypeParam::exec_type::asynchronous) {
      EXPECT_EQ(most, 0u);
    } else {
      EXPECT_GT(most, 40000u);
      // Every device has 64 KiB and more for a block that is alone on its multiprocessor.
      EXPECT_EQ(most > 48 * 1024, items <= 3) << items;
    }
    auto const d_wrong = test::to_exec(exec, std::vector<int>(static_cast<std::size_t>(items), -1));
    for (std::size_t const bytes : {std::size_t{0}, std::size_t{16}, most / 2, most}) {
      use_extra_scratch op;
      op.bytes = std::min(bytes, most) / 4 * 4;
      ft::for_each_item<ft::per_block<threads>>(exec, items, op, d_wrong.data());
      auto const wrong = test::from_exec(exec, d_wrong);
      for (int const w : wrong) { ASSERT_EQ(w, 0) << items << " items, " << op.bytes << " bytes"; }
    }
  }
}

TYPED_TEST(group_unit, what_a_block_prepares_is_there) {
  constexpr int items = 300;
  auto const& exec = this->backend.exec;
  for (int const n : {1, 100, 1024}) {
    auto const out = test::to_exec(exec, std::vector<int>(items, -1));
    int* const to = out.data();
    ft::for_each_item<ft::per_block<256>>(exec, items, use_prologue{}, n, to);
    auto const got = test::from_exec(exec, static_cast<int const*>(to), items);
    for (int item = 0; item < items; ++item) {
      ASSERT_EQ(got[static_cast<std::size_t>(item)], n * (n - 1) / 2 + n * item);
    }
  }
}

TYPED_TEST(group_unit, more_extra_scratch_than_there_is_throws) {
  if constexpr (TypeParam::exec_type::asynchronous) {
    constexpr int threads = 96;
    auto const& exec = this->backend.exec;
    auto const d_wrong = test::to_exec(exec, std::vector<int>(1, -1));
    use_extra_scratch op;
    op.bytes = ft::extra_scratch<threads, use_extra_scratch>(exec, 1) + 4096;
    EXPECT_THROW(ft::for_each_item<ft::per_block<threads>>(exec, 1, op, d_wrong.data()),
                 ft::cuda_error);
    op.bytes = 64;
    ft::for_each_item<ft::per_block<threads>>(exec, 1, op, d_wrong.data());
    EXPECT_EQ(test::from_exec(exec, d_wrong)[0], 0);
  } else {
    EXPECT_EQ(ft::single_group::extra(), nullptr);
  }
}

TYPED_TEST(group_unit, ordered_sum_has_the_documented_bits) {
  this->template check_ordered_sum<ft::per_thread, float>();
  this->template check_ordered_sum<ft::per_block<ft::sum_lanes>, float>();
  this->template check_ordered_sum<ft::per_thread, double>();
  this->template check_ordered_sum<ft::per_block<ft::sum_lanes>, double>();
}

/// Every item adds to the same counters: integers, so any order gives the same.
struct use_atomics {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, int const* values, int* out) const {
    ft::atomic_add(out, values[item]);
    ft::atomic_min(out + 1, values[item]);
    ft::atomic_max(out + 2, values[item]);
  }
};

TYPED_TEST(group_unit, atomics_count_every_item) {
  auto const values = this->random_values(-100000, 100000);
  auto const d_values = test::to_exec(this->backend.exec, values);
  auto const d_out = test::to_exec(this->backend.exec, std::vector<int>{0, 1 << 30, -(1 << 30)});
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(values.size()),
                                    use_atomics{}, d_values.data(), d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out.data(), 3);
  EXPECT_EQ(out[0], std::accumulate(values.begin(), values.end(), 0));
  EXPECT_EQ(out[1], *std::min_element(values.begin(), values.end()));
  EXPECT_EQ(out[2], *std::max_element(values.begin(), values.end()));
}

struct count_visit {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, int* visits) const {
    if (g.rank() == 0) { ft::atomic_add(visits + item, 1); }
  }
};

TYPED_TEST(group_unit, every_item_runs_once) {
  for (int const n : {0, 1, 3, 4, 5, 127, 128, 129, 1000}) {
    auto const visits =
        test::to_exec(this->backend.exec, std::vector<int>(static_cast<std::size_t>(n + 1), 0));
    ft::for_each_item<ft::per_thread>(this->backend.exec, n, count_visit{}, visits.data());
    ft::for_each_item<ft::per_warp>(this->backend.exec, n, count_visit{}, visits.data());
    ft::for_each_item<ft::per_block<64>>(this->backend.exec, n, count_visit{}, visits.data());
    auto const got = test::from_exec(this->backend.exec, visits);
    std::vector<int> want(static_cast<std::size_t>(n), 3);
    want.push_back(0);
    EXPECT_EQ(got, want);
  }
}

TEST(host_exec_unit, takes_a_number_of_threads) {
  EXPECT_THROW(ft::host_exec(-1), ft::bad_argument);
  EXPECT_THROW(ft::host_exec(4097), ft::bad_argument);
  for (int const threads : {0, 1, 2, 3}) {
    ft::host_exec const exec(threads);
    std::vector<int> visits(1000, 0);
    ft::for_each_item<ft::per_thread>(exec, 1000, count_visit{}, visits.data());
    EXPECT_EQ(visits, std::vector<int>(1000, 1)) << threads;
  }
}

}  // namespace group_test
