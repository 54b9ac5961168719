// SPDX-License-Identifier: Apache-2.0
/// @file Random numbers by counter: no state is shared between frames or threads. Not API.
#pragma once

#include <cmath>
#include <cstdint>

namespace seq::detail {

/// The finaliser of splitmix64.
inline std::uint64_t mix(std::uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9ULL;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

/// Where the random_stream of a purpose begins.
inline std::uint64_t key(std::uint64_t seed, std::uint64_t a, std::uint64_t b = 0) {
  constexpr std::uint64_t step = 0x9e3779b97f4a7c15ULL;
  return mix(mix(mix(seed + step) + a * step + step) + b * step + step);
}

class random_stream {
public:
  explicit random_stream(std::uint64_t start) : state_(start) {}
  std::uint64_t next() { return mix(state_ += 0x9e3779b97f4a7c15ULL); }
  double uniform() { return static_cast<double>(next() >> 11) * 0x1p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  int below(int n) { return static_cast<int>(next() % static_cast<std::uint64_t>(n)); }
  double gaussian() {  // Box-Muller, one of the two
    constexpr double two_pi = 2.0 * 3.14159265358979323846;
    double const radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
    return radius * std::cos(two_pi * uniform());
  }

private:
  std::uint64_t state_;
};

}  // namespace seq::detail
