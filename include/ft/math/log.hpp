// SPDX-License-Identifier: Apache-2.0
/// @file The natural logarithm of a double, with equal bits on every executor.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr double log_of_zero = -std::numeric_limits<double>::infinity();
inline constexpr double log_of_negative = std::numeric_limits<double>::quiet_NaN();

/// log v, with an error below 0.55 units in the last place. With v = 2^k m and m between sqrt(1/2)
/// and sqrt(2): log v = k log 2 + 2 artanh((m - 1) / (m + 1)). The quotient and the sum are in two
/// parts; only the series after its first term is rounded.
FT_HOST_DEVICE inline strict_double strict_log(strict_double v) {
  double x = v.value;
  if (!(x > 0)) { return x == 0 ? log_of_zero : log_of_negative; }
  if (x == -log_of_zero) { return x; }
  int k = -1023;
  if (x < 2.2250738585072014e-308) {  // not normal
    x *= 18014398509481984.0;         // 2^54
    k -= 54;
  }
  std::uint64_t bits = 0;
  std::memcpy(&bits, &x, sizeof bits);
  k += static_cast<int>(bits >> 52);
  bits = (bits & 0xfffffffffffffull) | 0x3ff0000000000000ull;
  double m = 0;
  std::memcpy(&m, &bits, sizeof m);
  if (m > 1.4142135623730951) {
    m *= 0.5;
    ++k;
  }
  strict_double const above = m - 1.0;  // exact
  strict_double const below = m + 1.0;
  strict_double const below_rest = m - (below.value - 1.0);
  strict_double const q = above / below;
  strict_double const rest = ::fma(-q.value, below.value, above.value);
  strict_double const q_rest = (rest - q * below_rest) / below;
  strict_double const q2 = q * q;
  strict_double series = 1.0 / 23;
  FT_UNROLL
  for (int n = 21; n > 1; n -= 2) { series = series * q2 + strict_double(1.0 / n); }
  strict_double const first = q + q;
  strict_double const tail = q_rest + q * q2 * series;
  // The first part of log 2 has 42 bits, so that its product with k is exact.
  strict_double const whole = strict_double(k) * strict_double(0x1.62e42fefa3800p-1);
  strict_double const whole_rest = strict_double(k) * strict_double(0x1.ef35793c76730p-45);
  strict_double const sum = whole + first;
  strict_double const sum_rest = first - (sum - whole);
  return sum + (sum_rest + (tail + tail + whole_rest));
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
