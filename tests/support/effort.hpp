// SPDX-License-Identifier: Apache-2.0
/// @file The share of a long test to run, and what the test is built with.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <vector>

/// FT_TEST_ASAN, FT_TEST_TSAN: whether AddressSanitizer or ThreadSanitizer is compiled in.
#if defined(__has_feature)
#define FT_TEST_FEATURE(name) __has_feature(name)
#else
#define FT_TEST_FEATURE(name) 0
#endif
#if defined(__SANITIZE_ADDRESS__) || FT_TEST_FEATURE(address_sanitizer)
#define FT_TEST_ASAN 1
#else
#define FT_TEST_ASAN 0
#endif
#if defined(__SANITIZE_THREAD__) || FT_TEST_FEATURE(thread_sanitizer)
#define FT_TEST_TSAN 1
#else
#define FT_TEST_TSAN 0
#endif

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
