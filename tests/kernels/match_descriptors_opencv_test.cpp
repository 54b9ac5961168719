// SPDX-License-Identifier: Apache-2.0
// Matches of descriptors against cv::BFMatcher: bits, numbers that are integers, and others where
// the best and the second best differ.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <vector>

#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"
#include "tests/support/descriptor_rows.hpp"
#include "tests/support/random.hpp"

namespace match_descriptors_oracle_test {

using test::at;

template <int Bits>
cv::Mat matrix_of(std::vector<ft::binary_descriptor<Bits>> const& rows) {
  cv::Mat all(static_cast<int>(rows.size()), Bits / 8, CV_8U);
  for (int i = 0; i < all.rows; ++i) { std::memcpy(all.ptr(i), rows[at(i)].words, Bits / 8); }
  return all;
}
template <int N>
cv::Mat matrix_of(std::vector<ft::vector_descriptor<float, N>> const& rows) {
  cv::Mat all(static_cast<int>(rows.size()), N, CV_32F);
  for (int i = 0; i < all.rows; ++i) { std::memcpy(all.ptr(i), rows[at(i)].of, N * sizeof(float)); }
  return all;
}

/// Rows, of which some are copies, and some are others with a few changes.
template <typename D, typename Draw>
std::vector<D> rows_like(test::generator& random, std::vector<D> const& others, int count,
                         Draw const& draw) {
  std::vector<D> rows(at(count));
  for (int i = 0; i < count; ++i) {
    int const kind = random.below(10);
    if (kind < 2 && i > 0) {
      rows[at(i)] = rows[at(random.below(i))];
    } else if (kind < 6 && !others.empty()) {
      rows[at(i)] = others[at(random.below(static_cast<int>(others.size())))];
      D some;
      draw(some);
      std::size_t const first = at(random.below(static_cast<int>(sizeof(D) / 4) - 2)) * 4;
      std::memcpy(reinterpret_cast<unsigned char*>(&rows[at(i)]) + first,
                  reinterpret_cast<unsigned char const*>(&some) + first, 8);
    } else {
      draw(rows[at(i)]);
    }
  }
  return rows;
}

struct both {
  int rows = 0, near = 0, mutual = 0;  ///< that were compared
};

/// @param apart least squared distance between the best and the second best; 0 = ties are compared
template <typename D>
both compare(std::vector<D> const& query, std::vector<D> const& train, int norm, double apart) {
  using distance_type = ft::descriptor_distance<D>;
  ft::host_exec const exec(1);
  ft::match_tests<distance_type> tests;
  auto const one_way = test::matches_by(exec, query, train, tests);
  tests.mutual = true;
  auto const mutual = test::matches_by(exec, query, train, tests);
  cv::Mat const q = matrix_of(query), t = matrix_of(train);
  std::vector<std::vector<cv::DMatch>> two;
  cv::BFMatcher(norm).knnMatch(q, t, two, 2);
  std::vector<cv::DMatch> crossed;
  cv::BFMatcher(norm, true).match(q, t, crossed);
  std::vector<int> partner(query.size(), -1);
  for (auto const& m : crossed) { partner[at(m.queryIdx)] = m.trainIdx; }
  both all;
  for (std::size_t i = 0; i < query.size(); ++i) {
    auto const& got = one_way[i];
    std::size_t const found = train.size() < 2 ? train.size() : 2;
    EXPECT_EQ(two[i].size(), found);
    if (found == 0) {
      EXPECT_EQ(got.nearest, -1);
      continue;
    }
    bool const clear =
        found < 2 ||
        static_cast<double>(got.second_distance) - static_cast<double>(got.distance) > apart;
    if (apart > 0 && !clear) { continue; }
    ++all.rows;
    EXPECT_EQ(got.nearest, two[i][0].trainIdx) << "row " << i;
    if (apart <= 0) {
      if (found == 2) { EXPECT_EQ(got.second, two[i][1].trainIdx) << "row " << i; }
      EXPECT_EQ(mutual[i].index, partner[i]) << "row " << i;
    }
    double const d = static_cast<double>(two[i][0].distance);
    double const want = norm == cv::NORM_HAMMING ? d : d * d;
    EXPECT_NEAR(static_cast<double>(got.distance), want, 1e-6 * want + 1e-6) << "row " << i;
    all.near += static_cast<int>(d < static_cast<double>(two[i][found - 1].distance));
    all.mutual += static_cast<int>(mutual[i].index >= 0);
  }
  return all;
}

template <int Bits>
void bits_are_those_of_opencv() {
  using D = ft::binary_descriptor<Bits>;
  test::generator random(Bits);
  auto const draw = [&](D& row) { test::draw(random, row); };
  for (int const count : {1, 2, 63, 700}) {
    auto const train = rows_like<D>(random, {}, count, draw);
    auto const query = rows_like(random, train, 500, draw);
    both const seen = compare(query, train, cv::NORM_HAMMING, 0);
    EXPECT_EQ(seen.rows, 500);
    EXPECT_GE(seen.mutual, 1);
    if (count == 700) { EXPECT_GT(seen.near, 200); }
  }
}

TEST(MatchDescriptorsOracle, BitsAreThoseOfBFMatcher) {
  bits_are_those_of_opencv<128>();
  bits_are_those_of_opencv<256>();
  bits_are_those_of_opencv<488>();
  bits_are_those_of_opencv<512>();
}

template <int N>
void integers_are_those_of_opencv() {
  using D = ft::vector_descriptor<float, N>;
  test::generator random(N);
  // Few different numbers, so that there are ties.
  auto const draw = [&](D& row) {
    for (float& v : row.of) { v = static_cast<float>(random.chance(70) ? 0 : random.below(180)); }
  };
  auto const train = rows_like<D>(random, {}, 600, draw);
  auto const query = rows_like(random, train, 500, draw);
  both const seen = compare(query, train, cv::NORM_L2, 0);
  EXPECT_EQ(seen.rows, 500);
  EXPECT_GT(seen.near, 200);
  EXPECT_GT(seen.mutual, 50);
}

TEST(MatchDescriptorsOracle, IntegersAreThoseOfBFMatcher) {
  integers_are_those_of_opencv<64>();
  integers_are_those_of_opencv<128>();
}

template <int N>
void floats_are_those_of_opencv() {
  using D = ft::vector_descriptor<float, N>;
  test::generator random(N + 1);
  auto const draw = [&](D& row) { test::draw(random, row); };
  auto const train = rows_like<D>(random, {}, 600, draw);
  auto const query = rows_like(random, train, 500, draw);
  both const seen = compare(query, train, cv::NORM_L2, 1e-5);
  EXPECT_GT(seen.rows, 300);
  EXPECT_GT(seen.mutual, 50);
}

TEST(MatchDescriptorsOracle, FloatsAreThoseOfBFMatcher) {
  floats_are_those_of_opencv<64>();
  floats_are_those_of_opencv<128>();
}

}  // namespace match_descriptors_oracle_test
