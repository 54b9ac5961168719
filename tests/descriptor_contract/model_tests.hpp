// SPDX-License-Identifier: Apache-2.0
/// @file What a user says of her descriptor, and the tests of it. Part of
/// tests/descriptor_contract.hpp.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"
#include "tests/camera_contract/description.hpp"

namespace descriptor_contract {
inline namespace FT_ABI {

using camera_contract::executor_name;
using camera_contract::from_exec;
using camera_contract::host_executor;
using camera_contract::to_exec;

/// Base of a description; the user adds `draw(random)`, and hides with her own what does not fit.
template <typename D>
struct description {
  using model = D;

  /// Rows that are drawn and compared, each with each.
  static constexpr int rows = 150;
  /// False where a row may be nearer to another one than to itself.
  static constexpr bool nearest_to_itself = true;
};

/// Executor and description of a suite.
template <typename Executor, typename Description>
struct setting {
  using executor = Executor;
  using description = Description;
};
#if defined(__CUDACC__)
template <typename Description>
using settings = ::testing::Types<setting<host_executor, Description>,
                                  setting<camera_contract::cuda_executor, Description>>;
#else
template <typename Description>
using settings = ::testing::Types<setting<host_executor, Description>>;
#endif

/// Item: a pair of rows, [n][n].
template <typename D>
struct compare_pair {
  using scratch = ft::no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, D const* rows, int n,
                                 ft::descriptor_distance<D>* out) const {
    out[item] = D::distance(rows[item / n], rows[item % n]);
  }
};

template <typename Setting>
class on_executor : public ::testing::Test {
protected:
  using executor = typename Setting::executor;
  using description = typename Setting::description;
  using model = typename description::model;
  using distance_type = ft::descriptor_distance<model>;

  void SetUp() override {
    if (!executor::available()) { GTEST_SKIP() << "no CUDA device"; }
  }
  /// Drawn rows, some of them twice.
  static std::vector<model> rows(unsigned seed, int count = description::rows) {
    std::mt19937 random(seed);
    std::vector<model> all;
    for (int i = 0; i < count; ++i) {
      all.push_back(i % 7 == 6 ? all[static_cast<std::size_t>(i / 2)] : description::draw(random));
    }
    return all;
  }
  /// Of each row to each, by the executor.
  static std::vector<distance_type> distances(std::vector<model> const& rows) {
    executor on;
    auto const there = to_exec(on.exec, rows);
    int const n = static_cast<int>(rows.size());
    std::size_t const pairs = rows.size() * rows.size();
    ft::buffer<distance_type, decltype(on.exec)::space> const out(pairs);
    ft::for_each_item<ft::per_thread>(on.exec, n * n, compare_pair<model>{},
                                      static_cast<model const*>(there.data()), n, out.data());
    return from_exec(on.exec, out.data(), pairs);
  }
};

// ---- the model alone

template <typename Setting>
class descriptor_model : public on_executor<Setting> {};
TYPED_TEST_SUITE_P(descriptor_model);

TYPED_TEST_P(descriptor_model, keeps_the_contract) {
  using row = typename TestFixture::model;
  EXPECT_TRUE(ft::is_descriptor_model_v<row>);
  EXPECT_GT(std::string(row::name).size(), 0u);
}

TYPED_TEST_P(descriptor_model, the_rules_agree_with_each_other) {
  auto const rules = TestFixture::model::rules;
  EXPECT_LT(rules.least, rules.greatest);
  EXPECT_GT(rules.near, rules.least) << "nothing is near";
  EXPECT_LT(rules.near, rules.greatest) << "everything is near";
  EXPECT_GT(rules.ratio_num, 0);
  EXPECT_LE(rules.ratio_num, rules.ratio_den) << "the best would be farther than the second best";
}

TYPED_TEST_P(descriptor_model, distances_are_symmetric_and_in_their_range) {
  auto const rules = TestFixture::model::rules;
  auto const rows = TestFixture::rows(1);
  auto const got = TestFixture::distances(rows);
  std::size_t const n = rows.size();
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      auto const d = got[i * n + j];
      ASSERT_EQ(d, got[j * n + i]) << "rows " << i << " and " << j;
      ASSERT_TRUE(d >= rules.least && d <= rules.greatest) << "rows " << i << " and " << j;
    }
  }
}

TYPED_TEST_P(descriptor_model, drawn_rows_differ) {
  auto const rows = TestFixture::rows(2);
  auto const got = TestFixture::distances(rows);
  EXPECT_LT(*std::min_element(got.begin(), got.end()), *std::max_element(got.begin(), got.end()))
      << "distance() does not read the rows, or draw() gives the same one again";
}

TYPED_TEST_P(descriptor_model, a_row_is_nearest_to_itself) {
  if (!TestFixture::description::nearest_to_itself) { GTEST_SKIP() << "says the description"; }
  auto const rows = TestFixture::rows(3);
  auto const got = TestFixture::distances(rows);
  std::size_t const n = rows.size();
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      ASSERT_LE(got[i * n + i], got[i * n + j]) << "rows " << i << " and " << j;
    }
  }
}

TYPED_TEST_P(descriptor_model, parts_give_the_distance) {
  using row = typename TestFixture::model;
  if constexpr (ft::detail::descriptor_has<ft::detail::descriptor_parts, row>) {
    auto const rows = TestFixture::rows(4);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      auto const& other = rows[(i * 31 + 5) % rows.size()];
      ASSERT_EQ(row::distance(rows[i], other), ft::distance_by_parts(rows[i], other));
    }
  } else {
    GTEST_SKIP() << "it has no parts";
  }
}

TYPED_TEST_P(descriptor_model, distances_are_the_same_bits_as_on_the_host) {
  using row = typename TestFixture::model;
  auto const rows = TestFixture::rows(5);
  auto const got = TestFixture::distances(rows);
  std::size_t const n = rows.size();
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) {
      auto const here = row::distance(rows[i], rows[j]);
      ASSERT_EQ(std::memcmp(&got[i * n + j], &here, sizeof here), 0)
          << got[i * n + j] << " and " << here << " of rows " << i << " and " << j;
    }
  }
}

REGISTER_TYPED_TEST_SUITE_P(descriptor_model, keeps_the_contract, the_rules_agree_with_each_other,
                            distances_are_symmetric_and_in_their_range, drawn_rows_differ,
                            a_row_is_nearest_to_itself, parts_give_the_distance,
                            distances_are_the_same_bits_as_on_the_host);

// ---- the model in match_descriptors()

template <typename Setting>
class descriptor_stages : public on_executor<Setting> {
protected:
  using base = on_executor<Setting>;
  using model = typename base::model;
  using distance_type = typename base::distance_type;
  using match = ft::descriptor_match<distance_type>;
  using workspace = ft::match_workspace<distance_type>;

  static std::vector<match> matches(std::vector<model> const& query,
                                    std::vector<model> const& train,
                                    ft::match_tests<distance_type> const& tests) {
    typename base::executor on;
    int const queries = static_cast<int>(query.size()), trains = static_cast<int>(train.size());
    auto const q = to_exec(on.exec, query);
    auto const t = to_exec(on.exec, train);
    constexpr auto space = decltype(on.exec)::space;
    ft::owner<workspace, space> const work(
        [&](ft::carver& c, workspace& v) { carve(c, v, queries, trains); });
    ft::buffer<match, space> const out(query.size());
    ft::match_descriptors(on.exec, ft::descriptor_rows<model>{q.data(), queries},
                          ft::descriptor_rows<model>{t.data(), trains}, tests, work.view(),
                          out.data());
    return from_exec(on.exec, out.data(), query.size());
  }
  /// The nearest of rows, of equals the lowest, without one of them.
  static int nearest(model const& row, std::vector<model> const& rows, int but) {
    int found = -1;
    for (int j = 0; j < static_cast<int>(rows.size()); ++j) {
      if (j != but && (found < 0 || distance(row, rows, j) < distance(row, rows, found))) {
        found = j;
      }
    }
    return found;
  }
  static distance_type distance(model const& row, std::vector<model> const& rows, int j) {
    return model::distance(row, rows[static_cast<std::size_t>(j)]);
  }
};
TYPED_TEST_SUITE_P(descriptor_stages);

TYPED_TEST_P(descriptor_stages, matches_are_those_of_a_plain_loop) {
  auto const query = TestFixture::rows(6);
  auto const train = TestFixture::rows(7, TestFixture::description::rows + 31);
  auto const got = TestFixture::matches(query, train, {});
  for (std::size_t i = 0; i < query.size(); ++i) {
    int const best = TestFixture::nearest(query[i], train, -1);
    int const second = TestFixture::nearest(query[i], train, best);
    ASSERT_EQ(got[i].nearest, best) << "row " << i;
    ASSERT_EQ(got[i].index, best) << "row " << i;
    ASSERT_EQ(got[i].second, second) << "row " << i;
    ASSERT_EQ(got[i].distance, TestFixture::distance(query[i], train, best)) << "row " << i;
    ASSERT_EQ(got[i].second_distance, TestFixture::distance(query[i], train, second));
  }
}

TYPED_TEST_P(descriptor_stages, mutual_matches_are_each_others_best) {
  auto const query = TestFixture::rows(8);
  auto const train = TestFixture::rows(9, TestFixture::description::rows + 31);
  ft::match_tests<typename TestFixture::distance_type> tests;
  tests.mutual = true;
  auto const got = TestFixture::matches(query, train, tests);
  for (std::size_t i = 0; i < query.size(); ++i) {
    int const best = TestFixture::nearest(query[i], train, -1);
    auto const& other = train[static_cast<std::size_t>(best)];
    bool const mutual = TestFixture::nearest(other, query, -1) == static_cast<int>(i);
    ASSERT_EQ(got[i].index, mutual ? best : -1) << "row " << i;
  }
}

REGISTER_TYPED_TEST_SUITE_P(descriptor_stages, matches_are_those_of_a_plain_loop,
                            mutual_matches_are_each_others_best);

}  // namespace FT_ABI
}  // namespace descriptor_contract
