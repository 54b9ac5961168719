// SPDX-License-Identifier: Apache-2.0
/// @file Sets of keyframes as bits, the votes of map points for keyframes, and the removal of
/// points.
#pragma once

#include <cstdint>
#include <limits>

#include "ft/containers/odometry_map.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/types/poses.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr int mask_words = max_keyframes / 64;

inline constexpr float no_number = std::numeric_limits<float>::quiet_NaN();

/// A set of ring positions, the bits of a mask.
struct position_set {
  std::uint64_t words[mask_words];

  /// The set that a mask of `count` words is. Its loads do not wait for each other.
  FT_HOST_DEVICE static position_set of(std::uint64_t const* mask, int count) {
    position_set s;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { s.words[w] = w < count ? mask[w] : 0; }
    return s;
  }
  FT_HOST_DEVICE void clear() {
    for (int w = 0; w < mask_words; ++w) { words[w] = 0; }
  }
  // No word has an index that is known only at run time: on a device the set stays in registers.
  FT_HOST_DEVICE void add(int position) {
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { words[w] |= bit(position, w); }
  }
  FT_HOST_DEVICE void remove(int position) {
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { words[w] &= ~bit(position, w); }
  }
  FT_HOST_DEVICE bool has(int position) const {
    std::uint64_t found = 0;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { found |= words[w] & bit(position, w); }
    return found != 0;
  }
  /// Makes this the positions of the keyframes with numbers in [first, last].
  FT_HOST_DEVICE void assign(keyframes_view const& keyframes, int first, int last) {
    clear();
    for (int n = first; n <= last; ++n) { add(keyframes.position(n)); }
  }
  FT_HOST_DEVICE int count() const {
    int n = 0;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { n += popcount(words[w]); }
    return n;
  }
  /// Makes a mask of `count` words the set.
  FT_HOST_DEVICE void write(std::uint64_t* mask, int count) const {
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) {
      if (w < count) { mask[w] = words[w]; }
    }
  }
  /// The position of the set that comes first in the ring, from `begin` on; -1 if it is empty.
  FT_HOST_DEVICE int first(int begin) const {
    int from_begin = -1;
    int from_zero = -1;
    FT_UNROLL
    for (int w = mask_words - 1; w >= 0; --w) {
      if (words[w] == 0) { continue; }
      from_zero = 64 * w + trailing_zeros(words[w]);
      std::uint64_t const late = words[w] & not_before(begin, w);
      if (late != 0) { from_begin = 64 * w + trailing_zeros(late); }
    }
    return from_begin >= 0 ? from_begin : from_zero;
  }
  /// The position of the set that comes last in the ring, from `begin` on; -1 if it is empty.
  FT_HOST_DEVICE int last(int begin) const {
    int before_begin = -1;
    int of_all = -1;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) {
      if (words[w] == 0) { continue; }
      of_all = 64 * w + highest_bit(words[w]);
      std::uint64_t const early = words[w] & ~not_before(begin, w);
      if (early != 0) { before_begin = 64 * w + highest_bit(early); }
    }
    return before_begin >= 0 ? before_begin : of_all;
  }
  /// Whether the two sets have a position in common.
  FT_HOST_DEVICE bool meets(position_set const& other) const {
    std::uint64_t both = 0;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { both |= other.words[w] & words[w]; }
    return both != 0;
  }
  /// Whether all positions of the other set are in this one.
  FT_HOST_DEVICE bool contains(position_set const& other) const {
    std::uint64_t others = 0;
    FT_UNROLL
    for (int w = 0; w < mask_words; ++w) { others |= other.words[w] & ~words[w]; }
    return others == 0;
  }

private:
  /// The bit of a position in word w.
  FT_HOST_DEVICE static std::uint64_t bit(int position, int w) {
    return w == position / 64 ? std::uint64_t{1} << (position % 64) : 0;
  }
  /// The bits of word w from position `begin` on.
  FT_HOST_DEVICE static std::uint64_t not_before(int begin, int w) {
    if (w != begin / 64) { return w < begin / 64 ? 0 : ~std::uint64_t{0}; }
    return ~std::uint64_t{0} << (begin % 64);
  }
};

/// Calls visit(position) for each bit of a mask, ascending.
template <typename Visit>
FT_HOST_DEVICE void each_position(std::uint64_t const* mask, int words, Visit const& visit) {
  for (int w = 0; w < words; ++w) {
    for (std::uint64_t rest = mask[w]; rest != 0; rest &= rest - 1) {
      visit(64 * w + trailing_zeros(rest));
    }
  }
}

/// Bit i is condition(i), for 32 conditions. All threads of the warp call, and get all bits.
template <typename Part, typename Condition>
FT_HOST_DEVICE unsigned row_of_flags(Part part, Condition const& condition) {
  if constexpr (Part::max_threads > 1) {
    return part.ballot(condition(part.rank()));
  } else {
    unsigned bits = 0;
    for (int i = 0; i < 32; ++i) { bits |= static_cast<unsigned>(condition(i)) << i; }
    return bits;
  }
}

/// Transposes the 32 x 32 bits of a warp's words: bit r of thread c's result is bit c of thread r's
/// word. Source: H. S. Warren, "Hacker's Delight", 2013, section 7-3.
template <typename Part>
FT_HOST_DEVICE unsigned transposed(Part part, unsigned word) {
  unsigned low = 0x0000ffffu;  // columns that stay in the upper rows of each square
  FT_UNROLL
  for (int step = 16; step > 0; step /= 2) {
    unsigned const other = part.shuffle(word, part.rank() ^ step);
    bool const lower_row = (part.rank() & step) != 0;
    word = lower_row ? (word & ~low) | (other >> step & low) : (word & low) | (other & low) << step;
    low ^= low << (step / 2);
  }
  return word;
}

/// Adds one vote for each position of the masks of a warp's threads.
/// @param mask of this thread, null = none. All threads of the warp call.
template <typename Part>
FT_HOST_DEVICE void add_votes(Part part, int* votes, std::uint64_t const* mask, int words) {
  if constexpr (Part::max_threads > 1) {
    position_set const own = position_set::of(mask, mask != nullptr ? words : 0);
    FT_UNROLL
    for (int w = 0; w < 2 * mask_words; ++w) {
      if (w >= 2 * words) { break; }
      auto const word = static_cast<unsigned>(own.words[w / 2] >> (32 * (w % 2)));
      int const n = popcount(transposed(part, word));
      if (n > 0) { atomic_add(votes + 32 * w + part.rank(), n); }
    }
  } else if (mask != nullptr) {
    each_position(mask, words, [&](int p) { ++votes[p]; });
  }
}

/// Makes a slot free. The counts of the batch entry are the caller's.
FT_HOST_DEVICE inline void free_slot(odometry_map_view const& map, int b, int slot) {
  point_records_view const& records = map.records;
  std::ptrdiff_t const at = records.at(b, slot);
  map_points_view const points = map.points.slice(b);
  get<field::position>(points, slot) = {no_number, no_number, no_number};
  get<field::observations>(points, slot) = 0;
  records.number[at] = 0;
  records.visible[at] = 0;
  records.found[at] = 0;
  records.described[at] = 0;
  for (int w = 0; w < records.words; ++w) { records.mask(b, slot)[w] = 0; }
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft
