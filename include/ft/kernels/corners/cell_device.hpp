// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a cell by several threads: scores of listed candidates only.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/corners/candidates.hpp"
#include "ft/kernels/corners/cell.hpp"
#include "ft/kernels/corners/fast_score.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The score where it exceeds those of all eight neighbours, else 0.
FT_HOST_DEVICE inline int suppressed_score(std::uint8_t const* p) {
  int const v = p[0];
  if (v == 0) { return 0; }
  int const beside = max_of(p[-1], p[1]);
  int const above = max_of(max_of(p[-cell_pitch - 1], p[-cell_pitch]), p[-cell_pitch + 1]);
  int const below = max_of(max_of(p[cell_pitch - 1], p[cell_pitch]), p[cell_pitch + 1]);
  return v > max_of(beside, max_of(above, below)) ? v : 0;
}

/// Returns the number of corners.
template <typename Group>
FT_HOST_DEVICE int detect_together(Group g, cell_scratch& s, gray_view level, cell_place const& in,
                                   corner_params const& params, corner* list,
                                   entry_list const& entered) {
  int const x0 = in.x0;
  int const y0 = in.y0;
  int const patch_w = in.patch_w;
  int const patch_h = in.patch_h;
  int const inner_w = patch_w - 6;
  int const inner_h = patch_h - 6;
  int const first_x = (x0 & 3) + 3;  // column of the first pixel that can be a corner
  auto const* const pixels = reinterpret_cast<std::uint8_t const*>(s.pixels);
  auto* const scores = reinterpret_cast<std::uint8_t*>(s.scores);
  constexpr int score_offset = -2 * cell_pitch;

  stage_rectangle<6>(g, level, x0, y0, patch_w, patch_h, s.pixels, cell_pitch / 4);
  for (int i = g.rank(); i < (inner_h + 2) * cell_pitch / 16; i += g.size()) { s.scores[i] = {}; }
  if (g.rank() == 0) {
    s.candidate_count[0] = 0;
    s.candidate_count[1] = 0;
    s.kept = 0;
  }
  g.sync();

  constexpr fast_circle circle(cell_pitch);
  // Scores do not depend on the threshold, and none that is suppressed at the strict one survives
  // at the lenient: pixels for that one are only tried where nothing is found.
  bool const has_lenient = params.min_threshold < params.ini_threshold;
  int const strict = max_of(params.ini_threshold, 0);
  int const low = has_lenient ? max_of(params.min_threshold, 0) : strict;
  list_by_words(g, s, first_x, inner_w, inner_h, strict, low);
  g.sync();
  int candidates = 0;
  bool listed = true;
  auto const place = [&](int i) {
    if (listed) { return static_cast<int>(s.candidates[i]); }
    int const y = i / inner_w;
    return (y + 3) * cell_pitch + first_x + i - y * inner_w;
  };
  for (bool lenient = false;; lenient = true) {
    int const scored = candidates;
    candidates = s.candidate_count[0] + (lenient ? s.candidate_count[1] : 0);
    if (candidates > cell_list_size) {
      listed = false;
      candidates = inner_w * inner_h;
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
    list_lenient(g, s, first_x, inner_w, inner_h);
    g.sync();
  }
  // A corner's place in raster order is how many are before it. There are few: each is compared
  // with all, in place of scans with their barriers. A warp takes its entries for itself.
  int const found = s.kept;
  std::uint16_t const* const kept = s.kept_places();
  auto const warp = g.part();
  for (int base = g.part_index() * warp.size(); base < found; base += g.size()) {
    int entry = 0;
    if (entered.to != nullptr && warp.rank() == 0) {
      entry = atomic_add(entered.count, min_of(warp.size(), found - base));
    }
    int const i = base + warp.rank();
    int const at = kept[min_of(i, found - 1)];
    int to = 0;
    for (int k = 0; k < found; ++k) { to += static_cast<int>(kept[k] < at); }
    entry = warp.shuffle(entry, 0) + warp.rank();
    if (i >= found) { continue; }
    int const y = at / cell_pitch;
    corner const c{static_cast<std::uint16_t>(in.x_rel + 3 + at - y * cell_pitch - first_x),
                   static_cast<std::uint16_t>(in.y_rel + y), scores[at + score_offset]};
    list[to] = c;
    if (entered.to != nullptr) { entered.write(entry, to, c); }
  }
  return found;
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
