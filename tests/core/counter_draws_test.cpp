// SPDX-License-Identifier: Apache-2.0
#include "ft/core/counter_draws.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace counter_draws_test {

/// The rule as it is said: a pool, of which each draw takes one.
template <int K>
std::vector<int> from_a_pool(ft::counter_draws const& draws, int n, std::uint64_t round) {
  std::vector<int> pool;
  for (int i = 0; i < n; ++i) { pool.push_back(i); }
  std::vector<int> taken;
  for (int k = 0; k < K; ++k) {
    auto const at = static_cast<std::size_t>(draws.below(n - k, round, k));
    taken.push_back(pool[at]);
    pool[at] = pool.back();
    pool.pop_back();
  }
  return taken;
}

TEST(counter_draws, are_those_of_splitmix64) {
  // The generator's first outputs from the state 1234567, as published with it.
  ft::counter_draws const draws{1234567};
  EXPECT_EQ(draws.bits(0, 0), 6457827717110365317ull);
  EXPECT_EQ(draws.bits(0, 1), 3203168211198807973ull);
  EXPECT_EQ(draws.bits(0, 2), 9817491932198370423ull);
}

TEST(counter_draws, take_each_number_of_a_pool_once) {
  for (std::uint64_t seed = 1; seed < 40; ++seed) {
    ft::counter_draws const draws{seed};
    for (int const n : {8, 9, 10, 15, 100, 3000}) {
      for (std::uint64_t round = 0; round < 50; ++round) {
        int six[6];
        draws.distinct(n, round, six);
        ASSERT_EQ(std::vector<int>(six, six + 6), from_a_pool<6>(draws, n, round));
        int eight[8];
        draws.distinct(n, round, eight);
        ASSERT_EQ(std::vector<int>(eight, eight + 8), from_a_pool<8>(draws, n, round));
      }
    }
  }
}

}  // namespace counter_draws_test
