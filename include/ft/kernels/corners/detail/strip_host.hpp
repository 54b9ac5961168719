// SPDX-License-Identifier: Apache-2.0
/// @file Corners of a strip of cells on the host: one thread scores all pixels, in runs of
/// neighbours. No branch depends on a pixel, so the compiler vectorises a run.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/corners.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/host_simd.hpp"
#include "ft/core/group.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/corners/cell.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

inline constexpr int run_pixels = 32;

/// Reduces each of the 16 arcs of 9 pixels by `along`, and the results by `across`. With min_op and
/// max_op: the highest grey level that all pixels of some arc reach.
template <typename Along, typename Across>
FT_HOST_DEVICE FT_INLINE std::uint8_t best_arc(std::uint8_t const (&p)[16], Along along,
                                               Across across) {
  // Reduce runs of 2, 4 and 8 pixels from every second pixel on. A run of 8 is part of two arcs,
  // one pixel longer at either end; the better of these two pixels counts.
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

/// Corner scores of the pixels c[0, N), equal to those of fast_score_of_pairs().
/// @param stride of the image
/// @pre 3 pixels around the run can be read, in its row and in the 3 rows above and below
template <int N = run_pixels>
FT_HOST_DEVICE FT_INLINE void score_run(std::uint8_t const* c, std::ptrdiff_t stride,
                                        std::uint8_t threshold, std::uint8_t* out) {
  std::uint8_t scores[N];
  for (int k = 0; k < N; ++k) {
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

struct run_of_scores {
  std::uint8_t of[run_pixels];
};

/// Scores that exceed the scores of all eight neighbours, else 0. @param p run_pixels scores
/// @param pitch distance of two rows of scores
FT_HOST_DEVICE FT_INLINE run_of_scores suppress_run(std::uint8_t const* p, int pitch) {
  run_of_scores kept;
  for (int k = 0; k < run_pixels; ++k) {
    std::uint8_t const* const q = p + k;
    std::uint8_t const above = max_of(max_of(q[-pitch - 1], q[-pitch]), q[-pitch + 1]);
    std::uint8_t const below = max_of(max_of(q[pitch - 1], q[pitch]), q[pitch + 1]);
    std::uint8_t const around = max_of(max_of(q[-1], q[1]), max_of(above, below));
    kept.of[k] = q[0] > around ? q[0] : std::uint8_t{0};
  }
  return kept;
}

/// Calls visit(k) for every k with p[k] >= threshold, in ascending order. @param p [run_pixels]
/// @param threshold 1 or more
template <typename Visit>
FT_HOST_DEVICE FT_INLINE void for_each_above(std::uint8_t const* p, std::uint8_t threshold,
                                             Visit const& visit) {
  static_assert(run_pixels == 32, "a bit for each number");
  for (std::uint32_t above = reached_by_32(p, threshold); above != 0; above &= above - 1) {
    visit(trailing_zeros(above));
  }
}

/// Runs of `run_pixels` that cover a row of `width` scores. The last run ends with the row and may
/// overlap the one before it.
struct row_runs {
  int width;
  FT_HOST_DEVICE int count() const { return ceil_div(width, run_pixels); }
  FT_HOST_DEVICE int start(int r) const {
    return min_of(r * run_pixels, max_of(width - run_pixels, 0));
  }
};

/// Columns of zeros before a row's first score.
inline constexpr int score_margin = 4;
static_assert(score_margin + max_cell_side < cell_pitch && score_margin + run_pixels < cell_pitch,
              "rows have a rim");

/// Cells of a row that are scored together.
inline constexpr int strip_cells = 8;

/// Scratch of a strip of cells.
struct strip_scratch {
  std::uint8_t line[strip_cells * max_cell_side + run_pixels];
  std::uint8_t scores[strip_cells][(max_cell_side + 2) * cell_pitch];  ///< with a rim of zeros
  std::uint8_t kept[max_cell_side * cell_pitch];
  std::uint16_t places[cell_scratch::max_kept];
};

/// Scores of all pixels of neighbouring cells, read from the image, each with a rim of zeros.
/// Runs do not end with the cells, which are little wider than a run.
/// @param cells their places, from left to right; all but the last one are equally wide
FT_HOST_DEVICE FT_INLINE void score_strip(strip_scratch& s, gray_view level,
                                          cell_place const* cells, int count,
                                          std::uint8_t threshold) {
  cell_place const& first = cells[0];
  int const w = first.patch_w - 6;
  int const h = first.patch_h - 6;
  int const width = (count - 1) * w + cells[count - 1].patch_w - 6;
  row_runs const runs{width};
  for (int c = 0; c < count; ++c) {
    std::memset(s.scores[c], 0, cell_pitch);
    std::memset(s.scores[c] + (h + 1) * cell_pitch, 0, cell_pitch);
  }
  for (int y = 0; y < h; ++y) {
    std::uint8_t const* const from = level.row(first.y0 + 3 + y) + first.x0 + 3;
    for (int r = 0; r < runs.count(); ++r) {
      score_run(from + runs.start(r), level.stride, threshold, s.line + runs.start(r));
    }
    for (int c = 0; c < count; ++c) {
      std::uint8_t* const row = s.scores[c] + (y + 1) * cell_pitch;
      auto const own = static_cast<std::size_t>(cells[c].patch_w - 6);
      std::memset(row, 0, cell_pitch);
      std::memcpy(row + score_margin, s.line + c * w, own);
    }
  }
}

/// Suppresses the scores of a cell into `kept`. Returns the strongest score.
FT_HOST_DEVICE FT_INLINE int suppress_cell(cell_inner const& inner, std::uint8_t const* scores,
                                           std::uint8_t* kept) {
  row_runs const runs{inner.w};
  std::uint8_t highest[run_pixels] = {};
  for (int r = 0; r < runs.count(); ++r) {
    std::uint8_t const* const from = scores + cell_pitch + score_margin + runs.start(r);
    for (int y = 0; y < inner.h; ++y) {
      run_of_scores const run = suppress_run(from + y * cell_pitch, cell_pitch);
      for (int k = 0; k < run_pixels; ++k) { highest[k] = max_of(highest[k], run.of[k]); }
      std::memcpy(kept + y * cell_pitch + runs.start(r), run.of, sizeof run.of);
    }
  }
  int strongest = 0;
  for (int k = 0; k < run_pixels; ++k) { strongest = max_of(strongest, int{highest[k]}); }
  return strongest;
}

/// Lists the places of the scores of at least a threshold, row * cell_pitch + column, in raster
/// order. Returns their number.
FT_HOST_DEVICE FT_INLINE int list_scores(cell_inner const& inner, std::uint8_t const* kept,
                                         int threshold, std::uint16_t* places) {
  row_runs const runs{inner.w};
  int found = 0;
  for (int y = 0; y < inner.h; ++y) {
    for (int r = 0; r < runs.count(); ++r) {
      int const start = y * cell_pitch + runs.start(r);
      int const seen = r * run_pixels - runs.start(r);  // by the run before
      for_each_above(kept + start, static_cast<std::uint8_t>(threshold), [&](int k) {
        if (k >= seen) { places[found++] = static_cast<std::uint16_t>(start + k); }
      });
    }
  }
  return found;
}

/// Suppresses the scores of a cell and lists its corners.
///
/// Scores do not depend on the threshold. The corners of the strict threshold are those of the
/// lenient one whose score reaches it, so the threshold is chosen last.
FT_HOST_DEVICE FT_INLINE void list_cell(strip_scratch& s, std::uint8_t const* scores,
                                        cell_place const& in, corner_params const& params,
                                        level_list const& list) {
  cell_inner const inner{0, in.patch_w - 6, in.patch_h - 6};
  int const strongest = suppress_cell(inner, scores, s.kept);
  int const strict = max_of(params.ini_threshold, 1);
  int const threshold = strongest >= strict ? strict : max_of(params.min_threshold, 1);
  int const found = strongest < threshold ? 0 : list_scores(inner, s.kept, threshold, s.places);
  corner* const to = list.to + list.finish_cell(found);
  for (int i = 0; i < found; ++i) {
    int const at = s.places[i];
    int const y = at / cell_pitch;
    to[i] = {static_cast<std::uint16_t>(in.x_rel + corner_margin + at - y * cell_pitch),
             static_cast<std::uint16_t>(in.y_rel + corner_margin + y), s.kept[at]};
  }
}

}  // namespace detail

}  // namespace FT_ABI
}  // namespace ft
