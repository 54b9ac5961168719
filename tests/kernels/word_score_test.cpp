// SPDX-License-Identifier: Apache-2.0
// Scores of bags of words: against sums over maps in long double, bags alike and apart, the
// logarithm.
#include "ft/kernels/words/score.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <map>
#include <random>
#include <utility>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/word_database.hpp"

namespace word_score_test {

using ft::word_scoring;
using plain_bag = std::map<std::uint32_t, double>;

constexpr word_scoring all_scorings[] = {word_scoring::l1,
                                         word_scoring::l2,
                                         word_scoring::chi_square,
                                         word_scoring::kl,
                                         word_scoring::bhattacharyya,
                                         word_scoring::dot_product};

test::word_bag flat(plain_bag const& from) {
  test::word_bag to;
  for (auto const& [word, value] : from) {
    to.word.push_back(word);
    to.value.push_back(value);
  }
  return to;
}

/// Words among `among`, values whose absolute sum, or sum of squares, is 1.
plain_bag random_bag(std::mt19937& random, int words, std::uint32_t among, bool squares) {
  std::uniform_int_distribution<std::uint32_t> pick(0, among - 1);
  std::uniform_real_distribution<double> value(0.001, 1.0);
  plain_bag bag;
  for (int i = 0; i < words; ++i) { bag[pick(random)] = value(random); }
  double sum = 0;
  for (auto const& [word, v] : bag) { sum += squares ? v * v : v; }
  for (auto& [word, v] : bag) { v /= squares ? std::sqrt(sum) : sum; }
  return bag;
}

/// The definition, in long double.
long double plain_score(word_scoring scoring, plain_bag const& a, plain_bag const& b) {
  long double sum = 0;
  for (auto const& [word, value] : a) {
    long double const v = value;
    auto const other = b.find(word);
    if (other == b.end()) {
      if (scoring == word_scoring::kl) { sum += v * (std::log(v) - std::log(0x1p-52l)); }
      continue;
    }
    long double const w = other->second;
    switch (scoring) {
      case word_scoring::l1:
        sum += std::abs(v) + std::abs(w) - std::abs(v - w);
        break;
      case word_scoring::chi_square:
        sum += v * w / (v + w);
        break;
      case word_scoring::kl:
        sum += v * std::log(v / w);
        break;
      case word_scoring::bhattacharyya:
        sum += std::sqrt(v * w);
        break;
      case word_scoring::l2:
      case word_scoring::dot_product:
        sum += v * w;
        break;
    }
  }
  if (scoring == word_scoring::l1) { return sum / 2; }
  if (scoring == word_scoring::l2) { return sum >= 1 ? 1 : 1 - std::sqrt(1 - sum); }
  return scoring == word_scoring::chi_square ? 2 * sum : sum;
}

template <typename Exec>
std::vector<double> run(Exec const& exec, std::vector<test::word_bag> const& a,
                        std::vector<test::word_bag> const& b,
                        std::vector<ft::word_list_pair> const& pairs, word_scoring scoring) {
  test::word_bags<Exec> const first(exec, a);
  test::word_bags<Exec> const second(exec, b);
  auto const d_pairs = test::to_exec(exec, pairs);
  auto const scores = test::to_exec(exec, std::vector<double>(pairs.size(), -7.0));
  ft::score_words(exec, first.view(), second.view(),
                  {d_pairs.data(), static_cast<int>(pairs.size())}, scoring, scores.data());
  return test::from_exec(exec, scores.data(), pairs.size());
}

template <typename Backend>
class WordScore : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(WordScore, test::backends);

TYPED_TEST(WordScore, IsThatOfTheDefinition) {
  TypeParam backend;
  std::mt19937 random(1);
  int const sizes[] = {0, 1, 2, 31, 32, 33, 64, 500};
  for (word_scoring const scoring : all_scorings) {
    std::vector<plain_bag> a;
    std::vector<plain_bag> b;
    std::vector<test::word_bag> flat_a;
    std::vector<test::word_bag> flat_b;
    std::vector<ft::word_list_pair> pairs;
    for (std::uint32_t const among : {40u, 600u, 1000000u}) {
      for (int const n : sizes) {
        for (int const m : {1, 30, 200}) {
          a.push_back(random_bag(random, n, among, scoring == word_scoring::l2));
          b.push_back(random_bag(random, m, among, scoring == word_scoring::l2));
          flat_a.push_back(flat(a.back()));
          flat_b.push_back(flat(b.back()));
          pairs.push_back({static_cast<int>(a.size()) - 1, static_cast<int>(b.size()) - 1});
        }
      }
    }
    std::reverse(pairs.begin(), pairs.end());
    auto const got = run(backend.exec, flat_a, flat_b, pairs, scoring);
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      auto const p = static_cast<std::size_t>(pairs[i].a);
      auto const want = static_cast<double>(plain_score(scoring, a[p], b[p]));
      EXPECT_NEAR(got[i], want, 4e-14 * std::max(1.0, std::abs(want)))
          << static_cast<int>(scoring) << " " << a[p].size() << " words and " << b[p].size();
    }
  }
}

TYPED_TEST(WordScore, OfAFrameWithItselfAndWithNothingInCommon) {
  TypeParam backend;
  std::mt19937 random(2);
  for (word_scoring const scoring : all_scorings) {
    bool const squares = scoring == word_scoring::l2 || scoring == word_scoring::dot_product;
    auto const a = random_bag(random, 300, 1000, squares);
    plain_bag b;
    for (auto const& [word, v] : a) { b[word + 1000] = v; }
    auto const got = run(backend.exec, {flat(a), flat(b)}, {flat(a), flat({})},
                         {{0, 0}, {1, 0}, {0, 1}}, scoring);
    bool const divergence = scoring == word_scoring::kl;
    EXPECT_NEAR(got[0], divergence ? 0.0 : 1.0, 1e-7) << static_cast<int>(scoring);
    if (divergence) {
      EXPECT_GT(got[1], 20.0);
      EXPECT_EQ(got[1], got[2]) << "the same values, none shared";
    } else {
      EXPECT_EQ(got[1], 0.0) << static_cast<int>(scoring);
      EXPECT_EQ(got[2], 0.0) << static_cast<int>(scoring);
    }
  }
}

TYPED_TEST(WordScore, AddsInTheOrderOfTheWords) {
  TypeParam backend;
  // Forwards the small ones are lost; backwards they would not be.
  test::word_bag a{{3}, {1e16}};
  for (std::uint32_t i = 0; i < 100; ++i) {
    a.word.push_back(10 + 7 * i);
    a.value.push_back(1.0);
  }
  test::word_bag ones = a;
  std::fill(ones.value.begin(), ones.value.end(), 1.0);
  auto const got = run(backend.exec, {a}, {ones}, {{0, 0}}, word_scoring::dot_product);
  EXPECT_EQ(got[0], 1e16);
}

TYPED_TEST(WordScore, RefusesBadInput) {
  TypeParam backend;
  test::word_bags<typename TypeParam::exec_type> const lists(backend.exec, {flat({{1, 1.0}})});
  auto const pairs = test::to_exec(backend.exec, std::vector<ft::word_list_pair>{{0, 0}});
  auto const scores = test::to_exec(backend.exec, std::vector<double>(1));
  auto const call = [&](ft::word_list_view const& a, word_scoring scoring, double* to) {
    ft::score_words(backend.exec, a, lists.view(), {pairs.data(), 1}, scoring, to);
  };
  EXPECT_NO_THROW(call(lists.view(), word_scoring::l1, scores.data()));
  EXPECT_THROW(call({}, word_scoring::l1, scores.data()), ft::bad_argument);
  EXPECT_THROW(call(lists.view(), word_scoring::l1, nullptr), ft::bad_argument);
  EXPECT_THROW(call(lists.view(), static_cast<word_scoring>(6), scores.data()), ft::bad_argument);
  EXPECT_THROW(call(lists.view(), static_cast<word_scoring>(-1), scores.data()), ft::bad_argument);
  backend.exec.wait();
}

struct take_log {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, double const* x, double* y) const {
    y[i] = ft::detail::strict_log(x[i]).value;
  }
};

TYPED_TEST(WordScore, LogarithmIsWithinItsError) {
  TypeParam backend;
  std::mt19937_64 random(3);
  std::vector<double> x{1.0, 2.0, 0.5, 0x1p-52, 1e308, 5e-324, 2.2250738585072014e-308};
  for (double const near : {1.0, 1.4142135623730951, 0.7071067811865476, 0.5, 2.0}) {
    double up = near;
    double down = near;
    for (int i = 0; i < 200; ++i) {
      x.push_back(up = std::nextafter(up, 4.0));
      x.push_back(down = std::nextafter(down, 0.0));
    }
  }
  std::uniform_real_distribution<double> exponent(-1022, 1023);
  std::uniform_real_distribution<double> moderate(0.0, 3.0);
  for (int i = 0; i < 20000; ++i) {
    x.push_back(std::exp2(exponent(random)));
    x.push_back(moderate(random));
  }
  auto const d_x = test::to_exec(backend.exec, x);
  ft::buffer<double, TypeParam::exec_type::space> y(x.size());
  ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(x.size()), take_log{},
                                    static_cast<double const*>(d_x.data()), y.data());
  auto const got = test::from_exec(backend.exec, y.data(), x.size());
  double worst = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    long double const want = std::log(static_cast<long double>(x[i]));
    double const size = std::abs(static_cast<double>(want));
    double const unit = std::nextafter(size, 1e300) - size;
    worst = std::max(worst,
                     static_cast<double>(std::abs(static_cast<long double>(got[i]) - want)) / unit);
  }
  EXPECT_EQ(got[0], 0.0);
  EXPECT_LT(worst, 0.55);
}

TYPED_TEST(WordScore, LogarithmAtTheEdges) {
  TypeParam backend;
  double const infinity = std::numeric_limits<double>::infinity();
  std::vector<double> const x{0.0,  -0.0,      infinity,
                              -1.0, -infinity, std::numeric_limits<double>::quiet_NaN()};
  auto const d_x = test::to_exec(backend.exec, x);
  ft::buffer<double, TypeParam::exec_type::space> y(x.size());
  ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(x.size()), take_log{},
                                    static_cast<double const*>(d_x.data()), y.data());
  auto const got = test::from_exec(backend.exec, y.data(), x.size());
  EXPECT_EQ(got[0], -infinity);
  EXPECT_EQ(got[1], -infinity);
  EXPECT_EQ(got[2], infinity);
  for (std::size_t i = 3; i < 6; ++i) { EXPECT_TRUE(std::isnan(got[i])) << i; }
}

}  // namespace word_score_test
