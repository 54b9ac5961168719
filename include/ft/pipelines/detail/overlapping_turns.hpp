// SPDX-License-Identifier: Apache-2.0
/// @file The last turns of a body, and the sum of those that overlap a later one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ft/core/config.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Turns that overlap share their errors where a map drifts. Allocates nothing.
/// @tparam Turn has its end `to_ns`, and add() of another one @tparam Most that overlap a later one
template <typename Turn, int Most>
class overlapping_turns {
public:
  void clear() { count_ = 0; }
  /// The sum of those that end after a time, the newest one first.
  Turn sum_after(std::int64_t from_ns) const {
    Turn sum{};
    for (std::size_t k = 0; k < count_; ++k) {
      if (last_[k].to_ns > from_ns) { sum.add(last_[k]); }
    }
    return sum;
  }
  /// @param t ends after those before it
  void keep(Turn const& t) {
    if (count_ < last_.size()) { ++count_; }
    for (std::size_t k = count_ - 1; k > 0; --k) { last_[k] = last_[k - 1]; }
    last_[0] = t;
  }

private:
  std::array<Turn, Most> last_{};  ///< newest first
  std::size_t count_ = 0;          ///< of them
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
