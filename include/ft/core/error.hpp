// SPDX-License-Identifier: Apache-2.0
/// @file Exceptions thrown at the host edge of the library, and the checks that throw them.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {

/// Base of everything ft throws.
class error : public std::runtime_error {
public:
  using std::runtime_error::runtime_error;
};

/// An argument out of range; the message names it, its value and the limit.
class bad_argument : public error {
public:
  using error::error;
};

/// A CUDA call failed; the message names the call and CUDA's own words.
class cuda_error : public error {
public:
  using error::error;
};

namespace detail {

template <typename T>
void require_range(char const* name, T value, T low, T high) {
  if (!(value >= low && value <= high)) {  // also rejects NaN
    throw bad_argument(std::string("ft: ") + name + " is " + std::to_string(value) +
                       ", must be in [" + std::to_string(low) + ", " + std::to_string(high) + "]");
  }
}

inline void require(bool condition, char const* message) {
  if (!condition) { throw bad_argument(std::string("ft: ") + message); }
}

inline void require_finite(char const* name, double value) {
  if (!std::isfinite(value)) {
    throw bad_argument(std::string("ft: ") + name + " is " + std::to_string(value) +
                       ", must be finite");
  }
}

/// Product of sizes. @throws bad_argument where it does not fit
inline std::size_t checked_mul(std::size_t a, std::size_t b) {
  if (a != 0 && b > std::numeric_limits<std::size_t>::max() / a) {
    throw bad_argument("ft: size overflow: " + std::to_string(a) + " x " + std::to_string(b));
  }
  return a * b;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
