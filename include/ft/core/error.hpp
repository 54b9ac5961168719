// SPDX-License-Identifier: Apache-2.0
/// @file Checks at the host edge of the library.
#pragma once

#include <algorithm>
#include <clocale>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <type_traits>

#include "ft/core/config.hpp"
#include "ft/types/errors.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// A number as text, with a decimal point in every locale. Floating-point values get the fewest
/// digits that read back as the same value, so 1e-07 does not become 0.000000.
template <typename T>
std::string number_text(T value) {
  if constexpr (std::is_floating_point<T>::value) {
    char text[40];
    for (int digits = 6; digits <= std::numeric_limits<T>::max_digits10; ++digits) {
      std::snprintf(text, sizeof text, "%.*g", digits, static_cast<double>(value));
      if (!(static_cast<T>(std::strtod(text, nullptr)) != value)) { break; }
    }
    std::string all = text;
    std::replace(all.begin(), all.end(), *std::localeconv()->decimal_point, '.');
    return all;
  } else {
    return std::to_string(value);
  }
}

template <typename T>
void require_range(char const* name, T value, T low, T high) {
  if (!(value >= low && value <= high)) {  // also rejects NaN
    throw bad_argument(std::string("ft: ") + name + " is " + number_text(value) + ", must be in [" +
                       number_text(low) + ", " + number_text(high) + "]");
  }
}

inline void require(bool condition, char const* message) {
  if (!condition) { throw bad_argument(std::string("ft: ") + message); }
}

inline void require_finite(char const* name, double value) {
  if (!std::isfinite(value)) {
    throw bad_argument(std::string("ft: ") + name + " is " + number_text(value) +
                       ", must be finite");
  }
}

/// Runs a check of one entry of an array; what it throws names the entry.
template <typename Check>
void check_named(char const* what, std::size_t at, Check const& check_one) {
  try {
    check_one();
  } catch (bad_argument const& e) {
    throw bad_argument(std::string(e.what()) + " (" + what + " " + std::to_string(at) + ")");
  }
}

/// Runs a check of settings that are a member of others; what it throws names the member, too.
/// @param prefix of the name of the setting: "orb."
template <typename Check>
void check_member(char const* prefix, Check const& check_all) {
  try {
    check_all();
  } catch (bad_argument const& e) {
    std::string text = e.what();
    throw bad_argument(text.insert(text.rfind("ft: ", 0) == 0 ? 4 : 0, prefix));
  }
}

/// Product of sizes. @throws bad_argument if it overflows
inline std::size_t checked_mul(std::size_t a, std::size_t b) {
  if (a != 0 && b > std::numeric_limits<std::size_t>::max() / a) {
    throw bad_argument("ft: size overflow: " + std::to_string(a) + " x " + std::to_string(b));
  }
  return a * b;
}

/// Checks that an int can count the items of one launch. @throws bad_argument if not
inline void require_items(char const* name, std::size_t batch, std::size_t each) {
  std::size_t const limit = static_cast<std::size_t>(std::numeric_limits<int>::max());
  if (checked_mul(batch, each) > limit) {
    throw bad_argument(std::string("ft: ") + name + ": " + std::to_string(batch) + " x " +
                       std::to_string(each) + ", must be at most " + std::to_string(limit));
  }
}

}  // namespace detail

namespace detail {

/// @param name of the matrix in messages
/// @throws bad_argument unless all products of rows are those of a rotation to 1e-3, and for
///   reflections
inline void require_rotation(mat3<double> const& R, char const* name = "the matrix") {
  // Inside frames, too: a text is made for who is refused alone.
  for (double v : R.m) {
    if (!std::isfinite(v)) { require_finite((std::string("an entry of ") + name).c_str(), v); }
  }
  mat3<double> const RRt = R * R.transposed();
  for (int i = 0; i < 9; ++i) {
    double const wanted = i % 4 == 0 ? 1.0 : 0.0;
    if (!(std::abs(RRt.m[i] - wanted) < 1e-3)) {
      throw bad_argument(std::string("ft: ") + name +
                         " is not a rotation: the product of its rows " + std::to_string(i / 3) +
                         " and " + std::to_string(i % 3) + " is " + number_text(RRt.m[i]) +
                         ", must be " + number_text(wanted));
    }
  }
  auto const& m = R.m;
  double const determinant = m[0] * (m[4] * m[8] - m[5] * m[7]) -
                             m[1] * (m[3] * m[8] - m[5] * m[6]) +
                             m[2] * (m[3] * m[7] - m[4] * m[6]);
  if (!(determinant > 0)) {
    throw bad_argument(std::string("ft: ") + name +
                       " is not a rotation but a reflection: its determinant is " +
                       number_text(determinant) + ", must be 1");
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
