// SPDX-License-Identifier: Apache-2.0
/// @file Passes of a block over the slots of a map. Each thread reads several slots before it acts
/// on the first one, so that loads do not wait for each other.
#pragma once

#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Slots of a thread that are read together.
template <typename Group>
inline constexpr int slots_together = Group::max_threads > 1 ? 4 : 1;

/// Calls act(slot, read(slot)) for the slots in [begin, end). act() must not write what read()
/// reads of other slots.
template <typename Group, typename Read, typename Act>
FT_HOST_DEVICE void each_slot(Group g, int begin, int end, Read const& read, Act const& act) {
  constexpr int together = slots_together<Group>;
  for (int first = begin + g.rank(); first < end; first += together * g.size()) {
    decltype(read(0)) values[together];
    FT_UNROLL
    for (int t = 0; t < together; ++t) { values[t] = read(min_of(first + t * g.size(), end - 1)); }
    FT_UNROLL
    for (int t = 0; t < together; ++t) {
      if (first + t * g.size() < end) { act(first + t * g.size(), values[t]); }
    }
  }
}

/// Flags of slots, a bit each, in rows of 32. Each warp has consecutive rows: it writes and reads
/// them alone.
template <typename Group>
class slot_rows {
public:
  /// @param rows [ceil(end / 32)] memory @param end slots to consider
  FT_HOST_DEVICE slot_rows(Group g, unsigned* rows, int end) : g_(g), rows_(rows), slots_(end) {
    int const all = ceil_div(end, 32);
    int const each = ceil_div(all, g.parts());
    first_ = min_of(g.part_index() * each, all);
    end_ = min_of(first_ + each, all);
  }

  /// Sets the flags to test(slot, read(slot)). test() must not write what read() reads of others.
  template <typename Read, typename Test>
  FT_HOST_DEVICE void flag(Read const& read, Test const& test) const {
    auto const part = g_.part();
    if constexpr (Group::max_threads > 1) {
      constexpr int together = slots_together<Group>;
      for (int row = first_; row < end_; row += together) {
        decltype(read(0)) values[together];
        FT_UNROLL
        for (int t = 0; t < together; ++t) {
          values[t] = read(min_of(32 * (row + t) + part.rank(), slots_ - 1));
        }
        FT_UNROLL
        for (int t = 0; t < together; ++t) {
          int const slot = 32 * (row + t) + part.rank();
          bool const there = row + t < end_ && slot < slots_;
          unsigned const bits = part.ballot(there && test(slot, values[t]));
          if (part.rank() == 0 && row + t < end_) { rows_[row + t] = bits; }
        }
      }
    } else {
      for (int row = first_; row < end_; ++row) {
        unsigned bits = 0;
        for (int i = 0; i < 32 && 32 * row + i < slots_; ++i) {
          int const slot = 32 * row + i;
          bits |= static_cast<unsigned>(test(slot, read(slot))) << i;
        }
        rows_[row] = bits;
      }
    }
    part.sync();
  }

  /// Calls visit(slot, place) for each flagged slot; `place` counts those before it.
  /// @return number of flagged slots
  template <typename Visit>
  FT_HOST_DEVICE int list(Visit const& visit) const {
    auto const part = g_.part();
    int mine = 0;
    for (int row = first_ + part.rank(); row < end_; row += part.size()) {
      mine += popcount(rows_[row]);
    }
    int total = 0;
    int before = part.shuffle(g_.exclusive_scan(mine, total), 0);
    for (int first = first_; first < end_; first += part.size()) {
      int const row = first + part.rank();
      unsigned const own = row < end_ ? rows_[row] : 0;
      for (int r = 0; r < min_of(part.size(), end_ - first); ++r) {
        unsigned const bits = part.shuffle(own, r);
        for (unsigned rest = mine_of(bits); rest != 0; rest &= rest - 1) {
          int const i = trailing_zeros(rest);
          visit(32 * (first + r) + i, before + popcount(bits & ((1u << i) - 1)));
        }
        before += popcount(bits);
      }
    }
    return total;
  }

private:
  /// The flags of a row that this thread visits.
  FT_HOST_DEVICE unsigned mine_of(unsigned bits) const {
    return Group::max_threads > 1 ? bits & 1u << g_.part().rank() : bits;
  }

  Group g_;
  unsigned* rows_;
  int slots_;
  int first_, end_;
};

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
