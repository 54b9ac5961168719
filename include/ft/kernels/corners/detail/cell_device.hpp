// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a cell on a device: a block lists candidates and scores only these.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/corners/detail/fast_score.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

// Lists the pixels of a cell that can be corners, by several threads.
//
// Nine consecutive pixels of the circle contain one of each opposite pair. So at least one pixel
// of the vertical and one of the horizontal pair must differ by more than the threshold. Some
// pixels that are no corners pass; no corner fails.

namespace detail {

/// Appends place(k) to `list` for every bit k of a thread's `flags`, in any order. Entries beyond
/// the capacity are counted but not written. All threads of a warp must call it equally often.
/// @param place called with an unsigned bit number
/// @param count in scratch
template <typename Group, typename Place>
FT_HOST_DEVICE void append_flagged(Group, unsigned flags, Place const& place, std::uint16_t* list,
                                   int capacity, int* count) {
  int const own = popcount(flags);
  int at = 0;
#if defined(__CUDA_ARCH__)
  if constexpr (Group::max_threads >= 32) {
    if (__ballot_sync(0xffffffffu, flags != 0) == 0) { return; }
    unsigned const upto = 0xffffffffu >> (31u - (threadIdx.x & 31u));
    int sum = 0;  // over this lane and the lower ones
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

/// Compares four differences with a threshold. The highest bit of each byte is set if its
/// difference is larger; the other bits are undefined. A byte may carry into the next one, which
/// then also passes with a difference equal to the threshold.
/// @param rest from threshold_rest()
FT_HOST_DEVICE inline std::uint32_t exceeding(std::uint32_t differences, std::uint32_t rest) {
  return (differences + rest) | differences;
}
/// The addend that takes a difference above the threshold to 128. @param threshold 0 to 255; values
/// above 127 count as 127
FT_HOST_DEVICE inline std::uint32_t threshold_rest(int threshold) {
  return static_cast<std::uint32_t>(127 - min_of(threshold, 127)) * 0x01010101u;
}

/// Items of the candidate search: a word of four pixels in `cell_chain` rows, 3 apart. The vertical
/// pairs of such a chain share their rows. Items are numbered row by row.
struct word_items {
  int first;  ///< first column, in words
  int n;      ///< items of a row
  int count;
  small_divider row_of;

  FT_HOST_DEVICE explicit word_items(cell_inner const& inner)
      : first(inner.first_x / 4),
        n((inner.first_x + inner.w + 3) / 4 - first),
        count(n * 3 * ceil_div(inner.h, 3 * cell_chain)),
        row_of(n) {}
  /// Row of the patch 3 above an item's first pixels, and column in words.
  struct position {
    int y, w;
  };
  FT_HOST_DEVICE position operator()(int i) const {
    int const row = row_of(i);
    return {row + row / 3 * (3 * (cell_chain - 1)), first + i - row * n};
  }
};

/// Flags of an item's pixels at both thresholds: bit 8 - cell_chain + k of byte j is pixel j of
/// row k.
struct item_flags {
  std::uint32_t strict, lenient;
};

/// Appends the flagged pixels of an item to the list behind its first `listed` entries.
template <typename Group>
FT_HOST_DEVICE void append(Group g, cell_scratch& s, word_items::position const& item,
                           std::uint32_t flags, int listed, int* count) {
  int const at = (item.y + 3 - 3 * (8 - cell_chain)) * cell_pitch + 4 * item.w;
  append_flagged(
      g, flags,
      [&](unsigned bit) { return at + static_cast<int>(bit % 8 * (3 * cell_pitch) + bit / 8); },
      s.candidates + listed, cell_list_size - listed, count);
}

/// Flags of all pixels of an item. @param p the word 3 rows above the item's first one
FT_HOST_DEVICE inline item_flags flags_of_item(std::uint32_t const* p, std::uint32_t strict_rest,
                                               std::uint32_t lenient_rest) {
  constexpr int step = 3 * cell_pitch / 4;
  constexpr std::uint32_t signs = 0x80808080u;
  item_flags flags{0, 0};
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
    std::uint32_t const strict_sides =
        exceeding(before, strict_rest) | exceeding(after, strict_rest);
    std::uint32_t const sides = exceeding(before, lenient_rest) | exceeding(after, lenient_rest);
    flags.strict = flags.strict >> 1 | ((strict_above | strict_below) & strict_sides & signs);
    flags.lenient = flags.lenient >> 1 | ((above | below) & sides & signs);
    strict_above = strict_below;
    above = below;
    middle = down;
  }
  return flags;
}

/// Lists the candidates of the strict threshold, and notes the additional ones of the lenient
/// threshold in `s.lenient`.
template <typename Group>
FT_HOST_DEVICE void list_candidates_of_cell(Group g, cell_scratch& s, cell_inner const& inner,
                                            int strict, int lenient) {
  word_items const items(inner);
  std::uint32_t const strict_rest = threshold_rest(strict);
  std::uint32_t const lenient_rest = threshold_rest(lenient);
  for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
    int const i = min_of(base + g.rank(), items.count - 1);
    auto const item = items(i);
    item_flags flags =
        flags_of_item(s.pixels + item.y * (cell_pitch / 4) + item.w, strict_rest, lenient_rest);
    // Clear the pixels to the left, to the right and below the cell.
    int const left = max_of(inner.first_x - 4 * item.w, 0);
    int const right = max_of(4 * item.w + 4 - inner.first_x - inner.w, 0);
    int const rows = min_of((inner.h - item.y + 2) / 3, cell_chain);
    std::uint32_t const inside = ((1u << rows) - 1) * (0x01010101u << (8 - cell_chain)) &
                                 0xffffffffu << (8 * left) & 0xffffffffu >> (8 * right);
    bool const own = base + g.rank() < items.count;
    flags.strict = own ? flags.strict & inside : 0;
    if (own) { s.lenient[i] = flags.lenient & inside & ~flags.strict; }
    append(g, s, item, flags.strict, 0, &s.candidate_count[0]);
  }
}
/// Appends the candidates noted in `s.lenient` to the list. Each thread reads only its own notes.
template <typename Group>
FT_HOST_DEVICE void list_lenient_candidates(Group g, cell_scratch& s, cell_inner const& inner) {
  word_items const items(inner);
  int const listed = min_of(s.candidate_count[0], cell_list_size);
  for (int base = 0; base + g.rank() / 32 * 32 < items.count; base += g.size()) {
    int const i = min_of(base + g.rank(), items.count - 1);
    append(g, s, items(i), base + g.rank() < items.count ? s.lenient[i] : 0, listed,
           &s.candidate_count[1]);
  }
}

/// The score if it exceeds the scores of all eight neighbours, else 0.
FT_HOST_DEVICE inline int suppressed_score(std::uint8_t const* p) {
  int const v = p[0];
  if (v == 0) { return 0; }
  int const beside = max_of(p[-1], p[1]);
  int const above = max_of(max_of(p[-cell_pitch - 1], p[-cell_pitch]), p[-cell_pitch + 1]);
  int const below = max_of(max_of(p[cell_pitch - 1], p[cell_pitch]), p[cell_pitch + 1]);
  return v > max_of(beside, max_of(above, below)) ? v : 0;
}

/// Distance from a pixel to its score: the first row of scores is that of the patch's row 2.
inline constexpr int score_offset = -2 * cell_pitch;

/// Loads the patch and clears scores and counters; ends with a sync().
template <typename Group>
FT_HOST_DEVICE void stage_cell(Group g, cell_scratch& s, gray_view level, cell_place const& in,
                               cell_inner const& inner) {
  stage_rectangle<6>(g, level, {in.x0, in.y0, in.patch_w, in.patch_h}, s.pixels, cell_pitch / 4);
  for (int i = g.rank(); i < (inner.h + 2) * cell_pitch / 16; i += g.size()) { s.scores[i] = {}; }
  if (g.rank() == 0) {
    s.candidate_count[0] = 0;
    s.candidate_count[1] = 0;
    s.kept = 0;
  }
  g.sync();
}

/// Finds the corners of a staged cell: `s.kept` and `s.kept_places()`. Ends with a sync().
///
/// Scores do not depend on the threshold. A score that is suppressed at the strict threshold is
/// also suppressed at the lenient one, so candidates of the lenient threshold are scored only if
/// the strict one leaves nothing.
template <typename Group>
FT_HOST_DEVICE void keep_strongest(Group g, cell_scratch& s, cell_inner const& inner,
                                   corner_params const& params) {
  constexpr fast_circle circle(cell_pitch);
  auto const* const pixels = reinterpret_cast<std::uint8_t const*>(s.pixels);
  auto* const scores = reinterpret_cast<std::uint8_t*>(s.scores);
  bool const has_lenient = params.min_threshold < params.ini_threshold;
  int const strict = max_of(params.ini_threshold, 0);
  int const low = has_lenient ? max_of(params.min_threshold, 0) : strict;
  list_candidates_of_cell(g, s, inner, strict, low);
  g.sync();
  int candidates = 0;
  bool listed = true;
  auto const place = [&](int i) {
    if (listed) { return static_cast<int>(s.candidates[i]); }
    int const y = i / inner.w;
    return (y + 3) * cell_pitch + inner.first_x + i - y * inner.w;
  };
  for (bool lenient = false;; lenient = true) {
    int const scored = candidates;
    candidates = s.candidate_count[0] + (lenient ? s.candidate_count[1] : 0);
    if (candidates > cell_list_size) {  // the list is too short: score every pixel
      listed = false;
      candidates = inner.w * inner.h;
    }
    if (candidates > 0) {
      for (int i = (listed ? scored : 0) + g.rank(); i < candidates; i += g.size()) {
        int const at = place(i);
        int const score = fast_score_of_pairs(pixels + at, circle, low);
        scores[at + score_offset] = static_cast<std::uint8_t>(score);
      }
      g.sync();
      int const least = max_of(lenient ? low : strict, 1);
      for (int i = g.rank(); i < candidates; i += g.size()) {
        int const at = place(i);
        if (suppressed_score(scores + at + score_offset) < least) { continue; }
        s.kept_places()[atomic_add(&s.kept, 1)] = static_cast<std::uint16_t>(at);
      }
      g.sync();
    }
    if (s.kept != 0 || lenient || !has_lenient) { break; }
    list_lenient_candidates(g, s, inner);
    g.sync();
  }
}

/// Appends the kept corners to the level's list.
template <typename Group>
FT_HOST_DEVICE void write_corners(Group g, cell_scratch& s, cell_place const& in,
                                  cell_inner const& inner, level_list const& list) {
  auto const* const scores = reinterpret_cast<std::uint8_t const*>(s.scores);
  int const found = s.kept;
  std::uint16_t const* const kept = s.kept_places();
  if (g.rank() == 0) { s.first = list.finish_cell(found); }
  g.sync();
  for (int i = g.rank(); i < found; i += g.size()) {
    int const at = kept[i];
    int const y = at / cell_pitch;
    list.to[s.first + i] = {
        static_cast<std::uint16_t>(in.x_rel + corner_margin + at - y * cell_pitch - inner.first_x),
        static_cast<std::uint16_t>(in.y_rel + y), scores[at + score_offset]};
  }
}

/// Detects the corners of a cell by a block.
template <typename Group>
FT_HOST_DEVICE void detect_together(Group g, cell_scratch& s, gray_view level, cell_place const& in,
                                    corner_params const& params, level_list const& list) {
  cell_inner const inner{(in.x0 & 3) + 3, in.patch_w - 6, in.patch_h - 6};
  stage_cell(g, s, level, in, inner);
  keep_strongest(g, s, inner, params);
  write_corners(g, s, in, inner, list);
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
