// SPDX-License-Identifier: Apache-2.0
/// @file Lists the pixels of a cell that can be corners, by several threads.
#pragma once

#include <cstdint>

#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// Appends to `list` place(k) for every bit k that a thread has in `flags`, in any order; what no
/// longer fits is counted only. Every thread of the group calls it, as often as every other of its
/// warp. @param place of an unsigned bit number @param count in scratch
template <typename Group, typename Place>
FT_HOST_DEVICE void append_flagged(Group, unsigned flags, Place const& place, std::uint16_t* list,
                                   int capacity, int* count) {
  int const own = popcount(flags);
  int at = 0;
#if defined(__CUDA_ARCH__)
  if constexpr (Group::max_threads >= 32) {
    if (__ballot_sync(0xffffffffu, flags != 0) == 0) { return; }
    unsigned const upto = 0xffffffffu >> (31u - (threadIdx.x & 31u));
    int sum = 0;  // of this lane and those below
    FT_UNROLL
    for (int bit = 0; bit < 6; ++bit) {
      sum += __popc(__ballot_sync(0xffffffffu, (own >> bit & 1) != 0) & upto) << bit;
    }
    if ((threadIdx.x & 31u) == 31u) { at = atomicAdd(count, sum); }
    at = __shfl_sync(0xffffffffu, at, 31) + sum - own;
  } else
#endif
  {
    at = own != 0 ? atomic_add(count, own) : 0;
  }
  if (at + own > capacity) { return; }
  for (; flags != 0; flags &= flags - 1) {
    list[at++] = static_cast<std::uint16_t>(place(static_cast<unsigned>(trailing_zeros(flags))));
  }
}

/// Tells which of four differences exceed a threshold, by the highest bit of each byte; other bits
/// may be anything. A byte may carry into the next one: then one that is equal to the threshold
/// passes, too. @param rest from threshold_rest()
FT_HOST_DEVICE inline std::uint32_t exceeding(std::uint32_t differences, std::uint32_t rest) {
  return (differences + rest) | differences;
}
/// What takes a difference above the threshold to 128. @param threshold 0 to 255; above 127 as 127
FT_HOST_DEVICE inline std::uint32_t threshold_rest(int threshold) {
  return static_cast<std::uint32_t>(127 - min_of(threshold, 127)) * 0x01010101u;
}

/// The words that can hold corners, row by row: each is an item, with those `3 k` rows below it.
struct word_items {
  int first;  ///< column of a row's first word, in words
  int n;      ///< of a row
  int count;
  small_divider row_of;

  FT_HOST_DEVICE word_items(int first_x, int inner_w, int inner_h)
      : first(first_x / 4),
        n((first_x + inner_w + 3) / 4 - first),
        count(n * 3 * ceil_div(inner_h, 3 * cell_chain)),
        row_of(n) {}
  /// Row of the patch 3 above an item's first pixels, and column of the word.
  struct position {
    int y, w;
  };
  FT_HOST_DEVICE position operator()(int i) const {
    int const row = row_of(i);
    return {row + row / 3 * (3 * (cell_chain - 1)), first + i - row * n};
  }
};
/// Lists pixels by the flags of an item: bit 8 - cell_chain + k of byte j is pixel j of row k.
template <typename Group>
FT_HOST_DEVICE void append(Group g, cell_scratch& s, word_items::position const& item,
                           std::uint32_t flags, int listed, int* count) {
  int const at = (item.y + 3 - 3 * (8 - cell_chain)) * cell_pitch + 4 * item.w;
  append_flagged(
      g, flags,
      [&](unsigned bit) { return at + static_cast<int>(bit % 8 * (3 * cell_pitch) + bit / 8); },
      s.candidates + listed, cell_list_size - listed, count);
}

/// Lists the places of pixels that can be corners at the strict threshold, by all threads of a
/// group: each time a word of a few rows, 3 apart, so that a row is above and below others. Notes
/// the others that can be corners at the lenient one. Nine in a row on the circle hold one of
/// each opposite pair, so one of both pairs on the axes must differ by more than the threshold: a
/// few that are no corners pass, no corner fails.
template <typename Group>
FT_HOST_DEVICE void list_by_words(Group g, cell_scratch& s, int first_x, int inner_w, int inner_h,
                                  int strict, int lenient) {
  constexpr int step = 3 * cell_pitch / 4;
  constexpr std::uint32_t signs = 0x80808080u;
  word_items const items(first_x, inner_w, inner_h);
  std::uint32_t const strict_rest = threshold_rest(strict);
  std::uint32_t const lenient_rest = threshold_rest(lenient);
  for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
    int const i = min_of(base + g.rank(), items.count - 1);
    auto const item = items(i);
    std::uint32_t const* p = s.pixels + item.y * (cell_pitch / 4) + item.w;
    std::uint32_t strict_flags = 0;
    std::uint32_t flags = 0;
    std::uint32_t middle = p[step];
    std::uint32_t difference = differences_of_4(p[0], middle);
    std::uint32_t strict_above = exceeding(difference, strict_rest);
    std::uint32_t above = exceeding(difference, lenient_rest);
    FT_UNROLL
    for (int k = 0; k < cell_chain; ++k) {
      p += step;
      std::uint32_t const down = p[step];
      std::uint32_t const before = differences_of_4(permute_bytes(p[-1], middle, 0x4321), middle);
      std::uint32_t const after = differences_of_4(permute_bytes(middle, p[1], 0x6543), middle);
      difference = differences_of_4(middle, down);
      std::uint32_t const strict_below = exceeding(difference, strict_rest);
      std::uint32_t const below = exceeding(difference, lenient_rest);
      std::uint32_t const strict_beside =
          exceeding(before, strict_rest) | exceeding(after, strict_rest);
      std::uint32_t const beside = exceeding(before, lenient_rest) | exceeding(after, lenient_rest);
      strict_flags = strict_flags >> 1 | ((strict_above | strict_below) & strict_beside & signs);
      flags = flags >> 1 | ((above | below) & beside & signs);
      strict_above = strict_below;
      above = below;
      middle = down;
    }
    // Not those beside or below the cell's.
    int const left = max_of(first_x - 4 * item.w, 0);
    int const right = max_of(4 * item.w + 4 - first_x - inner_w, 0);
    int const rows = min_of((inner_h - item.y + 2) / 3, cell_chain);
    std::uint32_t const inside = ((1u << rows) - 1) * (0x01010101u << (8 - cell_chain)) &
                                 0xffffffffu << (8 * left) & 0xffffffffu >> (8 * right);
    bool const own = base + g.rank() < items.count;
    strict_flags = own ? strict_flags & inside : 0;
    if (own) { s.lenient[i] = flags & inside & ~strict_flags; }
    append(g, s, item, strict_flags, 0, &s.candidate_count[0]);
  }
}
/// Lists the pixels that the same threads have noted, after the others.
template <typename Group>
FT_HOST_DEVICE void list_lenient(Group g, cell_scratch& s, int first_x, int inner_w, int inner_h) {
  word_items const items(first_x, inner_w, inner_h);
  int const listed = min_of(s.candidate_count[0], cell_list_size);
  for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
    int const i = min_of(base + g.rank(), items.count - 1);
    append(g, s, items(i), base + g.rank() < items.count ? s.lenient[i] : 0, listed,
           &s.candidate_count[1]);
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
