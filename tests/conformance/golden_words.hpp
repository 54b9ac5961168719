// SPDX-License-Identifier: Apache-2.0
/// @file Compares the stages of words, recovery and monocular start with golden_words: a folder for
/// each stage, named as in FORMAT.md there.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "ft/core/counter_draws.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words_pnp.hpp"
#include "tests/conformance/golden_words_reloc.hpp"
#include "tests/conformance/golden_words_searches.hpp"
#include "tests/conformance/golden_words_start.hpp"
#include "tests/conformance/golden_words_two_view.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// Whether a folder holds the recorded answers of words and recovery.
inline bool is_words(std::string const& folder) {
  return std::filesystem::is_directory(folder + "/two_view");
}

/// The samples of a case, from the seed of the case.
template <int K>
void compare_draws(conformance_table& table, std::string const& folder, int among) {
  auto const seed = read_npy<std::uint64_t>(folder + "/seed.npy");
  auto const want = read_npy<std::int32_t>(folder + "/samples.npy");
  ft::counter_draws const draws{seed(0)};
  for (int round = 0; among >= K && round < want.rows(); ++round) {
    int taken[K];
    draws.distinct(among, static_cast<std::uint64_t>(round), taken);
    for (int k = 0; k < K; ++k) { table["counter_draws"].add(taken[k] == want(round, k)); }
  }
}

template <typename Exec>
void run_words(Exec const& exec, std::string const& folder, conformance_table& table) {
  for (auto const& at : cases_of(folder, "pnp")) {
    compare_draws<6>(table, at, read_npy<float>(at + "/X.npy").rows());
    compare_pnp(exec, at, folder, table);
  }
  for (auto const& at : cases_of(folder, "two_view")) {
    compare_draws<8>(table, at, read_npy<std::int32_t>(at + "/matches.npy").rows());
    compare_two_view(exec, at, table);
  }
  compare_words_searches(exec, folder, table);
  compare_starts(exec, folder, table["monocular_start"]);
  compare_relocalizations(exec, folder, table);
}

}  // namespace test
