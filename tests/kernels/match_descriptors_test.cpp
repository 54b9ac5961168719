// SPDX-License-Identifier: Apache-2.0
// Matches of descriptors, all with all: against one distance after the other, bit for bit on both
// executors; ties, tests, counts and rows that are no numbers.
#include "ft/kernels/matching/match_descriptors.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "ft/core/error.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/descriptor_rows.hpp"
#include "tests/support/random.hpp"

namespace match_descriptors_test {

using test::at;

/// A user's models, without parts: Manhattan distances of a few bytes, and of many.
template <int Bytes>
struct bytes_apart {
  static constexpr char const* name = "bytes_apart";
  static constexpr ft::descriptor_rules<int> rules{0, 255 * Bytes, 40 * Bytes, 4, 5};
  unsigned char of[Bytes];

  FT_HOST_DEVICE static int distance(bytes_apart const& a, bytes_apart const& b) {
    int sum = 0;
    for (int i = 0; i < Bytes; ++i) {
      sum += a.of[i] < b.of[i] ? b.of[i] - a.of[i] : a.of[i] - b.of[i];
    }
    return sum;
  }
};
static_assert(ft::assert_descriptor_model<bytes_apart<13>>::value, "without alignment");

template <int Bytes>
void draw(test::generator& random, bytes_apart<Bytes>& row) {
  for (auto& b : row.of) { b = static_cast<unsigned char>(random.below(256)); }
}

/// All tests of a descriptor's rules, and none.
template <typename D>
std::vector<ft::match_tests<ft::descriptor_distance<D>>> all_tests() {
  using tests = ft::match_tests<ft::descriptor_distance<D>>;
  tests mutual;
  mutual.mutual = true;
  return {tests{}, mutual, tests::by(D::rules), tests::by(D::rules, true)};
}

template <typename D, typename Exec>
void matches_are_those_of_a_plain_loop(Exec const& exec) {
  test::generator random(7);
  std::vector<std::pair<int, int>> const sizes{{0, 0},   {0, 5},   {5, 0},    {1, 1},
                                               {1, 200}, {200, 1}, {63, 65},  {64, 64},
                                               {65, 63}, {130, 2}, {190, 257}};
  for (auto const& size : sizes) {
    SCOPED_TRACE(std::to_string(size.first) + " by " + std::to_string(size.second));
    auto const train = test::random_rows<D>(random, size.second);
    auto query = test::random_rows<D>(random, size.first);
    for (std::size_t i = 0; i < query.size(); ++i) {
      if (i % 3 == 0 && !train.empty()) { query[i] = train[(i * 7) % train.size()]; }
    }
    auto const distances = test::plain_distances(query, train);
    for (auto const& tests : all_tests<D>()) {
      test::expect_same(test::matches_by(exec, query, train, tests),
                        test::plain_matches(distances, train.size(), tests));
    }
  }
}

template <typename Backend>
class MatchDescriptors : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(MatchDescriptors, test::backends);

TYPED_TEST(MatchDescriptors, BitsAreThoseOfAPlainLoop) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<8>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<128>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<256>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<488>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<512>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::binary_descriptor<2048>>(backend.exec);
}

TYPED_TEST(MatchDescriptors, FloatsAreThoseOfAPlainLoop) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<float, 1>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<float, 30>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<float, 64>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<float, 128>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<float, 128, ft::dot_product>>(
      backend.exec);
}

TYPED_TEST(MatchDescriptors, HalvesAreThoseOfAPlainLoop) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<ft::float16, 33>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<ft::float16, 128>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<ft::float16, 128, ft::dot_product>>(
      backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<ft::float16, 256>>(backend.exec);
}

TYPED_TEST(MatchDescriptors, BytesAreThoseOfAPlainLoop) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<std::int8_t, 5>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<std::int8_t, 20>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<std::int8_t, 128>>(backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<std::int8_t, 128, ft::dot_product>>(
      backend.exec);
  matches_are_those_of_a_plain_loop<ft::vector_descriptor<std::int8_t, 304>>(backend.exec);
}

TYPED_TEST(MatchDescriptors, ModelsWithoutPartsAreThoseOfAPlainLoop) {
  TypeParam backend;
  matches_are_those_of_a_plain_loop<bytes_apart<13>>(backend.exec);
  matches_are_those_of_a_plain_loop<bytes_apart<64>>(backend.exec);
  matches_are_those_of_a_plain_loop<bytes_apart<100>>(backend.exec);
}

template <typename D, typename Exec>
void more_tiles_than_strips(Exec const& exec) {
  test::generator random(3);
  auto const few = test::random_rows<D>(random, 90);
  auto const many = test::random_rows<D>(random, 64 * 70 + 5);
  auto tests = ft::match_tests<int>::by(D::rules, true);
  tests.most = D::rules.greatest;
  test::expect_same(test::matches_by(exec, few, many, tests),
                    test::plain_matches(few, many, tests));
  test::expect_same(test::matches_by(exec, many, few, tests),
                    test::plain_matches(many, few, tests));
}

TYPED_TEST(MatchDescriptors, MoreTilesThanStrips) {
  TypeParam backend;
  more_tiles_than_strips<ft::binary_descriptor<128>>(backend.exec);
  more_tiles_than_strips<ft::vector_descriptor<std::int8_t, 20>>(backend.exec);
}

/// @param row that all are
template <typename D, typename Exec>
void of_equals_the_lowest(Exec const& exec, D const& row) {
  for (int const n : {2, 64, 65, 300, 3000}) {
    SCOPED_TRACE(n);
    std::vector<D> const same(at(n), row);
    ft::match_tests<int> tests;
    tests.mutual = true;
    auto const got = test::matches_by(exec, same, same, tests);
    for (int i = 0; i < n; ++i) {
      ASSERT_EQ(got[at(i)].nearest, 0);
      ASSERT_EQ(got[at(i)].second, 1);
      ASSERT_EQ(got[at(i)].index, i == 0 ? 0 : -1);
      ASSERT_EQ(got[at(i)].distance, 0);
      ASSERT_EQ(got[at(i)].second_distance, 0);
    }
  }
}

TYPED_TEST(MatchDescriptors, OfEqualsTheLowest) {
  TypeParam backend;
  of_equals_the_lowest(backend.exec, ft::binary_descriptor<256>{{1, 2, 3}});
  of_equals_the_lowest(backend.exec, ft::vector_descriptor<std::int8_t, 20>{{-128, 127, 3}});
}

TYPED_TEST(MatchDescriptors, CountsBelowAndAboveTheCapacity) {
  TypeParam backend;
  using D = ft::vector_descriptor<float, 64>;
  test::generator random(5);
  auto const query = test::random_rows<D>(random, 150);
  auto const train = test::random_rows<D>(random, 200);
  ft::match_tests<float> tests;
  tests.mutual = true;
  for (std::pair<int, int> const& n : std::vector<std::pair<int, int>>{{0, 0},
                                                                       {0, 200},
                                                                       {150, 0},
                                                                       {1, 1},
                                                                       {70, 65},
                                                                       {149, 64},
                                                                       {150, 200},
                                                                       {900, 999},
                                                                       {-3, -1}}) {
    SCOPED_TRACE(std::to_string(n.first) + " by " + std::to_string(n.second));
    auto const used = [](int count, std::vector<D> rows) {
      rows.resize(std::min(rows.size(), at(std::max(count, 0))));
      return rows;
    };
    auto want = test::plain_matches(used(n.first, query), used(n.second, train), tests);
    want.resize(query.size(), {-1, -1, -1, 0, 0});
    test::expect_same(test::matches_by(backend.exec, query, train, tests, {n.first, n.second}),
                      want);
  }
}

TYPED_TEST(MatchDescriptors, RowsThatAreNoNumbersMatchNothing) {
  TypeParam backend;
  using D = ft::vector_descriptor<float, 64>;
  test::generator random(9);
  auto query = test::random_rows<D>(random, 100);
  auto train = test::random_rows<D>(random, 90);
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  constexpr float large = std::numeric_limits<float>::max();
  for (int i = 0; i < 90; i += 4) { train[at(i)].of[i % 64] = i % 8 == 0 ? nan : large; }
  query[3].of[5] = nan;
  query[4].of[6] = -large;
  ft::match_tests<float> tests;
  for (bool const mutual : {false, true}) {
    tests.mutual = mutual;
    auto const got = test::matches_by(backend.exec, query, train, tests);
    test::expect_same(got, test::plain_matches(query, train, tests));
    EXPECT_EQ(got[3].nearest, -1);
    EXPECT_EQ(got[4].nearest, -1);
    for (auto const& m : got) { EXPECT_NE(m.nearest % 4, 0); }
  }
}

TYPED_TEST(MatchDescriptors, AnInfiniteDistanceIsNoMatch) {
  TypeParam backend;
  using D = ft::vector_descriptor<float, 4, ft::dot_product>;
  D const large{{1e20f, 1e20f, 1e20f, 1e20f}}, one{{1, 0, 0, 0}};
  auto const got = test::matches_by(backend.exec, std::vector<D>{large, one},
                                    std::vector<D>{large, one}, ft::match_tests<float>{});
  EXPECT_EQ(got[0].nearest, 1) << "1 - infinity";
  EXPECT_EQ(got[0].second, -1);
  EXPECT_EQ(got[1].nearest, 0);
}

// Rows a little longer than 127: their distances are below 0.
TYPED_TEST(MatchDescriptors, OfTwoThatAreAlikeNeitherIsClear) {
  TypeParam backend;
  using D = ft::vector_descriptor<std::int8_t, 4, ft::dot_product>;
  D const row{{127, 1, 0, 0}}, other{{0, 0, 127, 0}};
  ASSERT_LT(D::distance(row, row), 0);
  auto const tests = ft::match_tests<int>::by(D::rules);
  auto const two =
      test::matches_by(backend.exec, std::vector<D>{row}, std::vector<D>{row, row}, tests);
  EXPECT_EQ(two[0].nearest, 0);
  EXPECT_EQ(two[0].index, -1);
  auto const clear =
      test::matches_by(backend.exec, std::vector<D>{row}, std::vector<D>{other, row}, tests);
  EXPECT_EQ(clear[0].index, 1);
}

TYPED_TEST(MatchDescriptors, TheSameOnEveryRun) {
  TypeParam backend;
  using D = ft::vector_descriptor<ft::float16, 128>;
  test::generator random(11);
  auto const query = test::random_rows<D>(random, 700);
  auto const train = test::random_rows<D>(random, 650);
  auto const tests = ft::match_tests<float>::by(D::rules, true);
  auto const first = test::matches_by(backend.exec, query, train, tests);
  test::expect_same(first, test::matches_by(ft::host_exec(), query, train, tests));
  for (int round = 0; round < 3; ++round) {
    test::expect_same(test::matches_by(backend.exec, query, train, tests), first);
  }
}

TYPED_TEST(MatchDescriptors, RefusesWhatCannotBe) {
  TypeParam backend;
  using D = ft::binary_descriptor<256>;
  using workspace = ft::match_workspace<int>;
  ft::owner<workspace, TypeParam::exec_type::space> const work(
      [](ft::carver& c, workspace& v) { carve(c, v, 10, 20); });
  ft::buffer<D, TypeParam::exec_type::space> const rows(30);
  ft::buffer<ft::descriptor_match<int>, TypeParam::exec_type::space> const out(30);
  auto const match = [&](int queries, int trains, ft::match_tests<int> const& tests) {
    ft::match_descriptors(backend.exec, ft::descriptor_rows<D>{rows.data(), queries},
                          ft::descriptor_rows<D>{rows.data(), trains}, tests, work.view(),
                          out.data());
    backend.exec.wait();
  };
  EXPECT_NO_THROW(match(10, 20, {}));
  EXPECT_THROW(match(11, 20, {}), ft::bad_argument);
  EXPECT_THROW(match(10, 21, {}), ft::bad_argument);
  EXPECT_THROW(match(-1, 20, {}), ft::bad_argument);
  EXPECT_THROW(match(10, 20, {256, 9, 0, false}), ft::bad_argument);
  EXPECT_THROW(match(10, 20, {256, 0, 10, false}), ft::bad_argument);
  EXPECT_THROW(match(10, 20, {256, -9, 10, false}), ft::bad_argument);
  auto const* const bytes = reinterpret_cast<unsigned char const*>(rows.data());
  ft::descriptor_rows<D> const askew{reinterpret_cast<D const*>(bytes + 8), 5};
  ft::descriptor_rows<D> const straight{rows.data(), 5};
  EXPECT_THROW(ft::match_descriptors(backend.exec, askew, straight, {}, work.view(), out.data()),
               ft::bad_argument);
  EXPECT_THROW(ft::match_descriptors(backend.exec, straight, askew, {}, work.view(), out.data()),
               ft::bad_argument);
  ft::carver measure;
  workspace none;
  EXPECT_THROW(carve(measure, none, -1, 5), ft::bad_argument);
  EXPECT_THROW(carve(measure, none, 5, -1), ft::bad_argument);
}

TYPED_TEST(MatchDescriptors, RefusesALimitThatIsNoNumber) {
  TypeParam backend;
  using D = ft::vector_descriptor<float, 64>;
  ft::match_tests<float> tests;
  tests.most = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW(ft::match_descriptors(backend.exec, ft::descriptor_rows<D>{},
                                     ft::descriptor_rows<D>{}, tests, {}, nullptr),
               ft::bad_argument);
}

}  // namespace match_descriptors_test
