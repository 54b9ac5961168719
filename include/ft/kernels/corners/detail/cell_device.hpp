// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a cell on a device: a block lists candidates and scores only these.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/corners/detail/candidates.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/corners/detail/fast_score.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

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
