// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a cell by a single thread: scores of all pixels, in runs of neighbours. No
/// branch depends on a pixel, so that the compiler makes vectors of a run.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/corners/cell.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline constexpr int run_pixels = 32;

/// Over the 16 arcs of 9 pixels of a circle: the best, by `Across`, of what `Along` leaves of an
/// arc. With min_op and max_op the grey level that some arc exceeds or equals all along.
template <typename Along, typename Across>
FT_HOST_DEVICE FT_INLINE std::uint8_t best_arc(std::uint8_t const (&p)[16], Along along,
                                               Across across) {
  // Runs of 2, 4 and 8 from every second pixel; each is in two arcs of 9, one pixel longer at
  // either end, of which the better one counts.
  std::uint8_t const two[8] = {along(p[0], p[1]),   along(p[2], p[3]),  along(p[4], p[5]),
                               along(p[6], p[7]),   along(p[8], p[9]),  along(p[10], p[11]),
                               along(p[12], p[13]), along(p[14], p[15])};
  std::uint8_t const four[8] = {along(two[0], two[1]), along(two[1], two[2]), along(two[2], two[3]),
                                along(two[3], two[4]), along(two[4], two[5]), along(two[5], two[6]),
                                along(two[6], two[7]), along(two[7], two[0])};
  auto const arcs = [&](int i) {
    return along(along(four[i], four[(i + 2) & 7]),
                 across(p[(2 * i + 8) & 15], p[(2 * i + 15) & 15]));
  };
  return across(across(across(arcs(0), arcs(1)), across(arcs(2), arcs(3))),
                across(across(arcs(4), arcs(5)), across(arcs(6), arcs(7))));
}

/// Corner scores of the pixels c[0, run_pixels): the largest threshold below which each is a
/// corner, 0 where it is none above `threshold`. @param stride of the image
/// @pre the 3 pixels around the run can be read, in its row and in the 3 rows above and below
FT_HOST_DEVICE FT_INLINE void score_run(std::uint8_t const* c, std::ptrdiff_t stride,
                                        std::uint8_t threshold, std::uint8_t* out) {
  std::uint8_t scores[run_pixels];
  for (int k = 0; k < run_pixels; ++k) {
    std::uint8_t const* const q = c + k;
    std::uint8_t const p[16] = {
        q[3 * stride],  q[3 * stride + 1],  q[2 * stride + 2],  q[stride + 3],
        q[3],           q[-stride + 3],     q[-2 * stride + 2], q[-3 * stride + 1],
        q[-3 * stride], q[-3 * stride - 1], q[-2 * stride - 2], q[-stride - 3],
        q[-3],          q[stride - 3],      q[2 * stride - 2],  q[3 * stride - 1]};
    std::uint8_t const v = q[0];
    std::uint8_t const brightest = best_arc(p, min_op{}, max_op{});
    std::uint8_t const darkest = best_arc(p, max_op{}, min_op{});
    auto const bright = static_cast<std::uint8_t>(max_of(brightest, v) - v);
    auto const dark = static_cast<std::uint8_t>(v - min_of(darkest, v));
    std::uint8_t const best = max_of(bright, dark);
    scores[k] = best > threshold ? static_cast<std::uint8_t>(best - 1) : std::uint8_t{0};
  }
  std::memcpy(out, scores, sizeof scores);
}

/// Scores that exceed those of all eight neighbours, else 0. @param p run_pixels scores, in an
/// array of rows at a distance of `pitch`
FT_HOST_DEVICE FT_INLINE void suppress_run(std::uint8_t const* p, int pitch, std::uint8_t* out) {
  std::uint8_t kept[run_pixels];
  for (int k = 0; k < run_pixels; ++k) {
    std::uint8_t const* const q = p + k;
    std::uint8_t const above = max_of(max_of(q[-pitch - 1], q[-pitch]), q[-pitch + 1]);
    std::uint8_t const below = max_of(max_of(q[pitch - 1], q[pitch]), q[pitch + 1]);
    std::uint8_t const around = max_of(max_of(q[-1], q[1]), max_of(above, below));
    kept[k] = q[0] > around ? q[0] : std::uint8_t{0};
  }
  std::memcpy(out, kept, sizeof kept);
}

/// Calls visit(k) for every k, rising, where p[k] is `threshold` or more. @param p run_pixels
/// numbers
template <typename Visit>
FT_HOST_DEVICE FT_INLINE void for_each_above(std::uint8_t const* p, std::uint8_t threshold,
                                             Visit const& visit) {
  std::uint8_t flags[run_pixels];
  for (int k = 0; k < run_pixels; ++k) { flags[k] = static_cast<std::uint8_t>(p[k] >= threshold); }
  for (int first = 0; first < run_pixels; first += 4) {
    std::uint32_t word;
    std::memcpy(&word, flags + first, sizeof word);
    if (word == 0) { continue; }
    for (int k = first; k < first + 4; ++k) {
      if (flags[k] != 0) { visit(k); }
    }
  }
}

/// The same by a single thread: every pixel gets a score, straight from the image, and only then
/// the threshold is chosen.
FT_HOST_DEVICE FT_INLINE int detect_alone(cell_scratch& s, gray_view level, cell_place const& in,
                                          corner_params const& params, corner* list) {
  constexpr int run = run_pixels;
  constexpr int margin = 4;  // columns before a row's first score
  static_assert(margin + max_cell_side < cell_pitch && margin + run < cell_pitch,
                "rows have a rim");
  int const inner_w = in.patch_w - 6;
  int const inner_h = in.patch_h - 6;
  int const runs = ceil_div(inner_w, run);
  // The last run of a row ends with it: it begins in the one before where there is one.
  int const last_start = max_of(inner_w - run, 0);
  auto const start = [&](int r) { return min_of(r * run, last_start); };
  auto const filled = static_cast<std::size_t>(max_of(inner_w, run));
  auto* const scores = reinterpret_cast<std::uint8_t*>(s.scores);
  auto* const kept = reinterpret_cast<std::uint8_t*>(s.pixels);
  auto const width = static_cast<std::size_t>(inner_w);

  int const low = clamp(min_of(params.min_threshold, params.ini_threshold), 0, 255);
  std::memset(scores, 0, cell_pitch);
  for (int y = 0; y < inner_h; ++y) {
    std::uint8_t const* const from = level.row(in.y0 + 3 + y) + in.x0 + 3;
    std::uint8_t* const row = scores + (y + 1) * cell_pitch;
    for (int r = 0; r < runs; ++r) {
      score_run(from + start(r), level.stride, static_cast<std::uint8_t>(low),
                row + margin + start(r));
    }
    std::memset(row, 0, margin);
    std::memset(row + margin + inner_w, 0, cell_pitch - margin - width);
  }
  std::memset(scores + (inner_h + 1) * cell_pitch, 0, cell_pitch);

  std::uint8_t highest[run] = {};
  for (int y = 0; y < inner_h; ++y) {
    std::uint8_t const* const row = scores + (y + 1) * cell_pitch + margin;
    std::uint8_t* const to = kept + y * cell_pitch;
    for (int r = 0; r < runs; ++r) { suppress_run(row + start(r), cell_pitch, to + start(r)); }
    std::memset(to + inner_w, 0, filled - width);
    for (int r = 0; r < runs; ++r) {
      for (int k = 0; k < run; ++k) { highest[k] = max_of(highest[k], to[start(r) + k]); }
    }
  }
  int strongest = 0;
  for (int k = 0; k < run; ++k) { strongest = max_of(strongest, int{highest[k]}); }

  // Scores do not depend on the threshold: what survives suppression at the lenient one and
  // passes the strict one is what the strict one alone gives.
  int const strict_threshold = max_of(params.ini_threshold, 1);
  int const threshold =
      strongest >= strict_threshold ? strict_threshold : max_of(params.min_threshold, 1);
  if (strongest < threshold) { return 0; }
  int found = 0;
  for (int y = 0; y < inner_h; ++y) {
    std::uint8_t const* const row = kept + y * cell_pitch;
    for (int r = 0; r < runs; ++r) {
      int const seen = r * run - start(r);  // by the run before
      for_each_above(row + start(r), static_cast<std::uint8_t>(threshold), [&](int k) {
        if (k < seen) { return; }
        int const x = start(r) + k;
        list[found++] = {static_cast<std::uint16_t>(in.x_rel + 3 + x),
                         static_cast<std::uint16_t>(in.y_rel + 3 + y), row[x]};
      });
    }
  }
  return found;
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
