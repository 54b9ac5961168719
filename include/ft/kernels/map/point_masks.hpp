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
#include "ft/core/geometry.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

inline constexpr int mask_words = max_keyframes / 64;

inline constexpr float no_number = std::numeric_limits<float>::quiet_NaN();

struct or_op {
  template <typename T>
  FT_HOST_DEVICE T operator()(T a, T b) const {
    return a | b;
  }
};

/// A set of ring positions, the bits of a mask.
struct position_set {
  std::uint64_t words[mask_words];

  FT_HOST_DEVICE void clear() {
    for (int w = 0; w < mask_words; ++w) { words[w] = 0; }
  }
  FT_HOST_DEVICE void add(int position) {
    words[position / 64] |= std::uint64_t{1} << (position % 64);
  }
  FT_HOST_DEVICE bool has(int position) const {
    return (words[position / 64] >> (position % 64) & 1) != 0;
  }
  /// Makes this the positions of the keyframes with numbers in [first, last].
  FT_HOST_DEVICE void assign(keyframes_view const& keyframes, int first, int last) {
    clear();
    for (int n = first; n <= last; ++n) { add(keyframes.position(n)); }
  }
  /// Whether a mask has one of the positions.
  FT_HOST_DEVICE bool meets(std::uint64_t const* mask, int count) const {
    std::uint64_t both = 0;
    for (int w = 0; w < count; ++w) { both |= mask[w] & words[w]; }
    return both != 0;
  }
  /// Whether a mask has no other positions.
  FT_HOST_DEVICE bool contains(std::uint64_t const* mask, int count) const {
    std::uint64_t others = 0;
    for (int w = 0; w < count; ++w) { others |= mask[w] & ~words[w]; }
    return others == 0;
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

/// Calls visit(position) for each keyframe in use that a mask names, oldest first.
template <typename Visit>
FT_HOST_DEVICE void each_observer(keyframes_view const& keyframes, int b, std::uint64_t const* mask,
                                  Visit const& visit) {
  int const last = keyframes.made[b];
  for (int n = keyframes.oldest(b); n <= last; ++n) {
    int const p = keyframes.position(n);
    if ((mask[p / 64] >> (p % 64) & 1) != 0) { visit(p); }
  }
}

/// Adds one vote for each position of the masks of a warp's threads.
/// @param mask of this thread, null = none. All threads of the warp call.
template <typename Part>
FT_HOST_DEVICE void add_votes(Part part, int* votes, std::uint64_t const* mask, int words) {
  for (int w = 0; w < words; ++w) {
    std::uint64_t const own = mask != nullptr ? mask[w] : 0;
    for (std::uint64_t rest = part.reduce(own, or_op{}); rest != 0; rest &= rest - 1) {
      int const bit = trailing_zeros(rest);
      int const n = popcount(part.ballot((own >> bit & 1) != 0));
      if (part.rank() == 0) { atomic_add(votes + 64 * w + bit, n); }
    }
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
