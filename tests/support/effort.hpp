// SPDX-License-Identifier: Apache-2.0
/// @file The share of a long test to run.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <vector>

namespace test {

/// `count` repetitions, or the share of them given by FT_TEST_EFFORT (percent, 1 to 100): slow
/// checkers need fewer.
inline int effort(int count) {
  char const* const percent = std::getenv("FT_TEST_EFFORT");
  int const share = percent == nullptr ? 100 : std::clamp(std::atoi(percent), 1, 100);
  return std::max(1, count * share / 100);
}

/// Whether FT_TEST_EFFORT leaves out nothing.
inline bool whole_effort() { return effort(100) == 100; }

/// Both values, or the first one alone where FT_TEST_EFFORT asks for less.
inline std::vector<bool> both(bool first) {
  return whole_effort() ? std::vector<bool>{first, !first} : std::vector<bool>{first};
}

}  // namespace test
