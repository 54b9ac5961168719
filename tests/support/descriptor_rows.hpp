// SPDX-License-Identifier: Apache-2.0
/// @file Random descriptors, and matches found one distance after the other.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <vector>

#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/descriptors/binary_descriptor.hpp"
#include "ft/descriptors/vector_descriptor.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/random.hpp"

namespace test {

/// Random bits, also where none count.
template <int Bits>
void draw(generator& random, ft::binary_descriptor<Bits>& row) {
  for (auto& w : row.words) {
    w = static_cast<std::uint32_t>(random.below(1 << 16)) << 16 |
        static_cast<std::uint32_t>(random.below(1 << 16));
  }
}
template <typename T, int N, typename Metric>
void draw(generator& random, ft::vector_descriptor<T, N, Metric>& row) {
  for (auto& v : row.of) {
    if constexpr (std::is_same<T, std::int8_t>::value) {
      v = static_cast<std::int8_t>(random.from_to(-128, 127));
    } else if constexpr (std::is_same<T, float>::value) {
      v = random.real(-1, 1);
    } else {
      v = ft::float16::nearest(random.real(-1, 1));
    }
  }
}

/// Random rows; some are copies of others, so that distances are equal.
template <typename D>
std::vector<D> random_rows(generator& random, int count) {
  std::vector<D> rows(at(count));
  for (int i = 0; i < count; ++i) {
    if (i > 0 && random.chance(20)) {
      rows[at(i)] = rows[at(random.below(i))];
    } else {
      draw(random, rows[at(i)]);
    }
  }
  return rows;
}

/// False for NaN and infinities.
template <typename Distance>
bool is_usable(Distance d) {
  return d <= std::numeric_limits<Distance>::max() && d >= std::numeric_limits<Distance>::lowest();
}

template <typename D>
using matches_of = std::vector<ft::descriptor_match<ft::descriptor_distance<D>>>;

/// What match_descriptors() finds, by its definition, from distances [query][train].
template <typename Distance>
std::vector<ft::descriptor_match<Distance>> plain_matches(
    std::vector<std::vector<Distance>> const& distance, std::size_t trains,
    ft::match_tests<Distance> const& tests) {
  /// The lowest of the nearest of n, without one of them; -1 = there is none.
  auto const nearest = [](std::size_t n, int but, auto const& to) {
    int found = -1;
    for (int k = 0; k < static_cast<int>(n); ++k) {
      if (k != but && is_usable(to(k)) && (found < 0 || to(k) < to(found))) { found = k; }
    }
    return found;
  };
  std::vector<ft::descriptor_match<Distance>> all;
  for (std::vector<Distance> const& row : distance) {
    auto const of_row = [&](int j) { return row[at(j)]; };
    int const best = nearest(trains, -1, of_row);
    int const second = best < 0 ? -1 : nearest(trains, best, of_row);
    Distance const d = best < 0 ? 0 : row[at(best)], other = second < 0 ? 0 : row[at(second)];
    bool accepted = best >= 0 && d <= tests.most;
    if (accepted && tests.ratio_den != 0 && second >= 0) {
      accepted = static_cast<Distance>(tests.ratio_den) * std::max(d, Distance{}) <
                 static_cast<Distance>(tests.ratio_num) * std::max(other, Distance{});
    }
    if (accepted && tests.mutual) {
      int const back =
          nearest(distance.size(), -1, [&](int i) { return distance[at(i)][at(best)]; });
      accepted = back == static_cast<int>(all.size());
    }
    all.push_back({accepted ? best : -1, best, second, d, other});
  }
  return all;
}
template <typename D>
std::vector<std::vector<ft::descriptor_distance<D>>> plain_distances(std::vector<D> const& query,
                                                                     std::vector<D> const& train) {
  std::vector<std::vector<ft::descriptor_distance<D>>> all(query.size());
  for (std::size_t i = 0; i < query.size(); ++i) {
    for (D const& row : train) { all[i].push_back(D::distance(query[i], row)); }
  }
  return all;
}
template <typename D>
matches_of<D> plain_matches(std::vector<D> const& query, std::vector<D> const& train,
                            ft::match_tests<ft::descriptor_distance<D>> const& tests) {
  return plain_matches(plain_distances(query, train), train.size(), tests);
}

/// The same by match_descriptors(). @param counts rows that there are, of query and train; empty =
/// all
template <typename D, typename Exec>
matches_of<D> matches_by(Exec const& exec, std::vector<D> const& query, std::vector<D> const& train,
                         ft::match_tests<ft::descriptor_distance<D>> const& tests,
                         std::vector<int> const& counts = {}) {
  using distance_type = ft::descriptor_distance<D>;
  int const queries = static_cast<int>(query.size()), trains = static_cast<int>(train.size());
  auto const q = to_exec(exec, query);
  auto const t = to_exec(exec, train);
  auto const n = to_exec(exec, counts);
  ft::owner<ft::match_workspace<distance_type>, Exec::space> const work(
      [&](ft::carver& c, ft::match_workspace<distance_type>& v) { carve(c, v, queries, trains); });
  ft::buffer<ft::descriptor_match<distance_type>, Exec::space> const out(query.size());
  int const* const of_query = counts.empty() ? nullptr : n.data();
  int const* const of_train = counts.empty() ? nullptr : n.data() + 1;
  ft::match_descriptors(exec, ft::descriptor_rows<D>{q.data(), queries, of_query},
                        ft::descriptor_rows<D>{t.data(), trains, of_train}, tests, work.view(),
                        out.data());
  return from_exec(exec, out.data(), query.size());
}

template <typename Distance>
void expect_same(std::vector<ft::descriptor_match<Distance>> const& got,
                 std::vector<ft::descriptor_match<Distance>> const& want) {
  ASSERT_EQ(got.size(), want.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    ASSERT_EQ(got[i].index, want[i].index) << "row " << i;
    ASSERT_EQ(got[i].nearest, want[i].nearest) << "row " << i;
    ASSERT_EQ(got[i].second, want[i].second) << "row " << i;
    if (want[i].nearest >= 0) { ASSERT_EQ(got[i].distance, want[i].distance) << "row " << i; }
    if (want[i].second >= 0) {
      ASSERT_EQ(got[i].second_distance, want[i].second_distance) << "row " << i;
    }
  }
}

}  // namespace test
