// SPDX-License-Identifier: Apache-2.0
/// @file The bytes that a fuzzer gives, as numbers; zeros when they have run out.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <type_traits>

namespace fuzz {

class input {
public:
  input(std::uint8_t const* data, std::size_t size) : at_(data), left_(size) {}

  /// Any bits: of a floating-point type also NaN, infinity and subnormal numbers.
  template <typename T>
  T bits() {
    static_assert(std::is_trivially_copyable<T>::value, "made of bytes");
    T value{};
    std::size_t const n = left_ < sizeof(T) ? left_ : sizeof(T);
    if (n > 0) { std::memcpy(&value, at_, n); }
    at_ += n;
    left_ -= n;
    return value;
  }
  /// A number of [low, high], from two bytes.
  int within(int low, int high) {
    auto const span = static_cast<unsigned>(high - low) + 1;
    return low + static_cast<int>(bits<std::uint16_t>() % span);
  }
  bool flag() { return (bits<std::uint8_t>() & 1) != 0; }
  /// Mostly a number near [low, high], sometimes any bits.
  float number(float low, float high) {
    if (bits<std::uint8_t>() < 16) { return bits<float>(); }
    return low + (high - low) * static_cast<float>(bits<std::uint16_t>()) / 65535.0f;
  }

  std::uint8_t const* data() const { return at_; }
  std::size_t left() const { return left_; }

private:
  std::uint8_t const* at_;
  std::size_t left_;
};

/// A property that must hold; the fuzzer keeps the input where it does not.
inline void require(bool holds, char const* promise) {
  if (!holds) {
    std::fprintf(stderr, "broken promise: %s\n", promise);
    std::abort();
  }
}

/// Calls what may refuse its arguments, in the documented way alone. @return true where it did not
template <typename Refusal, typename Call>
bool accepted(Call const& call) {
  try {
    call();
  } catch (Refusal const&) { return false; }
  return true;
}

}  // namespace fuzz
