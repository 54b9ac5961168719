// SPDX-License-Identifier: Apache-2.0
/// @file Stage: which parts of an image change from frame to frame, and which stay as they are
/// while the rest moves: the camera's own bonnet, or dirt on its lens.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/odometry/image_slopes.hpp"

namespace ft {
inline namespace FT_ABI {

/// What is seen of an image, in cells of 32 x 24 that cover it.
struct image_changes {
  static constexpr int columns = 32, rows = 24;
  static constexpr int cells = columns * rows;
  static constexpr int words = cells / 32;
  static constexpr int side = 4;  ///< samples of a cell are side x side pixels
  static constexpr int samples = side * side;
  static constexpr int quarters = 4;  ///< of a cell, 2 x 2 of its samples

  int textured;      ///< cells with contrast, now and before
  int moved;         ///< of these, cells with another content than a frame before
  int still;         ///< and those whose content is where it was
  int same;          ///< 1 = all samples are those of the frame before
  int sum, squares;  ///< of all samples
  int streaked;      ///< 1 = sharp in one direction only: blurred by a motion
  int fixed;         ///< number of cells in `now`
  int rest_moves;    ///< 1 = most of the image moved, so that what stayed is not of the scene
  int by_quarters;   ///< 1 = an eighth of the cells with contrast stays for a few frames, or a
                     ///< sixteenth for many, while the rest moves: quarters of cells are looked at,
                     ///< too, since a cell that is covered in part neither stays nor moves
  unsigned now[words];  ///< cells that stay while the rest moves, in this frame or for a few frames
  unsigned long_since[words];  ///< and those that did for many frames
};

namespace detail {

/// What a row of cells adds to the sums of its image.
struct row_changes {
  four_sums cells;       ///< with contrast, moved since the reference, still, known to be still
  four_sums grey;        ///< samples: sum, squares; cells: changed since the last frame, differ
  four_sums slopes;      ///< as image_slopes
  unsigned still_cells;  ///< a bit for each
};
static_assert(image_changes::columns == 32, "a bit for each cell of a row");

}  // namespace detail

/// Memory of the stage. Executor memory.
struct image_changes_view {
  image_changes* of = nullptr;            ///< [images]
  detail::row_changes* of_row = nullptr;  ///< [images][rows]
  std::uint8_t* reference = nullptr;      ///< [images][samples][cells] since when a cell is still
  std::uint8_t* last = nullptr;           ///< [images][samples][cells] of the last frame
  std::uint8_t* frames = nullptr;  ///< [images][cells] in which a cell was still and others not
  std::uint8_t* quarter_reference = nullptr;  ///< as `reference`, since when a quarter is still
  std::uint8_t* quarter_frames = nullptr;     ///< [images][quarters][cells] as `frames`
  int* begun = nullptr;                       ///< [images] 1 = there was a frame
  /// [rigs] bit i: image i of a rig is not there in this frame; null = all are there
  unsigned const* missing = nullptr;
  int images_of_rig = 1;
  static constexpr int sampled = image_changes::samples * image_changes::cells;
  static constexpr int few_frames = 4, many_frames = 8;  ///< of what stays

  FT_HOST_DEVICE bool is_missing(int image) const {
    return missing != nullptr &&
           (missing[image / images_of_rig] >> image % images_of_rig & 1u) != 0;
  }
  /// Whether a pixel of an image belongs to what is fixed to the camera.
  /// @param sure only if it has been so for long
  FT_HOST_DEVICE bool is_fixed(int image, float x, float y, int width, int height,
                               bool sure) const {
    int const column =
        clamp(static_cast<int>(x) * image_changes::columns / width, 0, image_changes::columns - 1);
    int const row =
        clamp(static_cast<int>(y) * image_changes::rows / height, 0, image_changes::rows - 1);
    int const cell = row * image_changes::columns + column;
    unsigned const* const bits = sure ? of[image].long_since : of[image].now;
    if ((bits[cell / 32] >> cell % 32 & 1u) != 0) { return true; }
    return of[image].by_quarters != 0 && is_quarter_fixed(image, x, y, width, height, sure);
  }

private:
  /// Whether one of the four quarters next to a pixel has stayed for a few frames, or for many.
  FT_HOST_DEVICE bool is_quarter_fixed(int image, float x, float y, int width, int height,
                                       bool sure) const {
    constexpr int across = 2 * image_changes::columns, down = 2 * image_changes::rows;
    int const column = clamp(static_cast<int>(x) * 2 * across / width, 0, 2 * across - 1);
    int const row = clamp(static_cast<int>(y) * 2 * down / height, 0, 2 * down - 1);
    std::uint8_t const* const kept = quarter_frames + static_cast<std::ptrdiff_t>(image) *
                                                          image_changes::quarters *
                                                          image_changes::cells;
    int most = 0;
    FT_UNROLL
    for (int k = 0; k < 4; ++k) {
      int const i = clamp(column - 1 + k % 2 * 2, 0, 2 * across - 1) / 2;
      int const j = clamp(row - 1 + k / 2 * 2, 0, 2 * down - 1) / 2;
      int const quarter = j % 2 * 2 + i % 2;
      int const cell = j / 2 * image_changes::columns + i / 2;
      most = max_of(most, int{kept[quarter * image_changes::cells + cell]});
    }
    return most >= (sure ? many_frames : few_frames);
  }
};

inline void carve(carver& c, image_changes_view& v, int images) {
  c.place({images}, v.of);
  c.place({images, image_changes::rows}, v.of_row);
  c.place({images, image_changes_view::sampled}, v.reference, v.last, v.quarter_reference);
  c.place({images, image_changes::cells}, v.frames);
  c.place({images, image_changes::quarters * image_changes::cells}, v.quarter_frames);
  c.place({images}, v.begun);
}

namespace detail {

/// Item: a row of cells of an image. Threads have cells.
struct compare_cells {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;
  static constexpr int samples = image_changes::samples;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& images,
                                 image_changes_view const& v) const {
    int const i = item / image_changes::rows;
    if (images.absent.has(i) || v.is_missing(i)) { return; }
    auto const image = images.level(i, 0);
    bool const first = v.begun[i] == 0;
    row_changes row{};
    image_slopes slopes;
    for (int k = g.rank(); k < image_changes::columns; k += g.size()) {
      int const c = item % image_changes::rows * image_changes::columns + k;
      compared const to = compare(image, v, i, c, first);
      bool const still = !first && to.is_still();
      std::uint8_t& frames = v.frames[static_cast<std::ptrdiff_t>(i) * image_changes::cells + c];
      row.cells = row.cells +
                  four_sums{{to.is_textured(), to.has_moved(), to.is_still(), still && frames > 0}};
      row.grey = row.grey + four_sums{{to.sum, to.squares, to.has_changed(), to.differs}};
      row.still_cells |= static_cast<unsigned>(still) << k;
      for (int s = 0; s < samples; s += 2) {  // half of them, like a chessboard's squares
        sample const at = slope_of(image, c, s + s / image_changes::side % 2);
        slopes.add(image, at.x, at.y);
      }
      for (int q = 0; q < image_changes::quarters; ++q) { count_quarter(v, i, c, q, first); }
      if (still) { continue; }
      for (int s = 0; s < samples; ++s) { v.reference[place(i, c, s)] = v.last[place(i, c, s)]; }
      frames = 0;
    }
    row.cells = g.reduce(row.cells, sum_op{});
    row.grey = g.reduce(row.grey, sum_op{});
    row.slopes =
        g.reduce(four_sums{{slopes.near_x, slopes.near_y, slopes.far_x, slopes.far_y}}, sum_op{});
    row.still_cells = g.reduce(row.still_cells, sum_op{});
    if (g.rank() == 0) { v.of_row[item] = row; }
  }

private:
  /// A cell now, and as it was. Differences are without that of the means, so that light may
  /// change.
  struct compared {
    int contrast = 0;      ///< now, sum of absolute deviations from the mean
    int was = 0;           ///< likewise of the reference
    int difference = 0;    ///< from the reference
    int lately = 0;        ///< difference from the last frame
    bool differs = false;  ///< from the last frame
    int sum = 0, squares = 0;

    static constexpr int least_contrast = 6 * samples;  // grey levels
    static constexpr int noise = 4 * samples;

    FT_HOST_DEVICE bool is_textured() const {
      return contrast >= least_contrast && was >= least_contrast;
    }
    FT_HOST_DEVICE bool has_moved() const {
      return is_textured() && difference > 6 * samples && 5 * difference > min_of(contrast, was);
    }
    FT_HOST_DEVICE bool has_changed() const {
      return is_textured() && lately > 6 * samples && 5 * lately > min_of(contrast, was);
    }
    FT_HOST_DEVICE bool is_still() const {
      return is_textured() && (difference <= noise || 12 * difference <= min_of(contrast, was));
    }
  };
  /// Counts the frames in which a quarter of a cell was still, by its own samples, and most of the
  /// image moved in the frame before. @pre compare() has written `last`
  FT_HOST_DEVICE static void count_quarter(image_changes_view const& v, int i, int cell, int q,
                                           bool first) {
    constexpr int n = samples / image_changes::quarters;
    std::ptrdiff_t at[n];
    int sum[2] = {}, contrast[2] = {}, difference = 0;  // now, then
    FT_UNROLL
    for (int k = 0; k < n; ++k) {
      at[k] = place(i, cell, (q / 2 * 2 + k / 2) * image_changes::side + q % 2 * 2 + k % 2);
      sum[0] += v.last[at[k]];
      sum[1] += first ? 0 : v.quarter_reference[at[k]];
    }
    FT_UNROLL
    for (int k = 0; k < n; ++k) {
      int const now = n * int{v.last[at[k]]} - sum[0];
      int const then = first ? 0 : n * int{v.quarter_reference[at[k]]} - sum[1];
      contrast[0] += now < 0 ? -now : now;
      contrast[1] += then < 0 ? -then : then;
      difference += now < then ? then - now : now - then;
    }
    int const least = min_of(contrast[0], contrast[1]);
    bool const still =
        !first && least >= 6 * n * n && (difference <= 4 * n * n || 12 * difference <= least);
    std::uint8_t& frames =
        v.quarter_frames[(static_cast<std::ptrdiff_t>(i) * image_changes::quarters + q) *
                             image_changes::cells +
                         cell];
    int const more = still && v.of[i].rest_moves != 0 ? 1 : 0;
    int const count = still ? min_of(frames + more, image_changes_view::many_frames) : 0;
    frames = static_cast<std::uint8_t>(count);
    if (still) { return; }
    FT_UNROLL
    for (int k = 0; k < n; ++k) { v.quarter_reference[at[k]] = v.last[at[k]]; }
  }

  struct sample {
    int x, y;
  };
  FT_HOST_DEVICE static sample sample_of(image_view<std::uint8_t> const& image, int cell, int s) {
    constexpr int across = image_changes::columns * image_changes::side;
    constexpr int down = image_changes::rows * image_changes::side;
    int const x = cell % image_changes::columns * image_changes::side + s % image_changes::side;
    int const y = cell / image_changes::columns * image_changes::side + s / image_changes::side;
    return {(2 * x + 1) * image.width / (2 * across), (2 * y + 1) * image.height / (2 * down)};
  }
  /// Where slopes are asked for: samples beside each other lie in different rows of pixels, and
  /// those above each other in different columns. An edge from side to side of the image, as that
  /// of a bar, would else be met by all samples of a row, or by none.
  FT_HOST_DEVICE static sample slope_of(image_view<std::uint8_t> const& image, int cell, int s) {
    constexpr int across = image_changes::columns * image_changes::side;
    constexpr int down = image_changes::rows * image_changes::side;
    constexpr int parts = 8, step = 5;  // of the distance between samples
    int const i = cell % image_changes::columns * image_changes::side + s % image_changes::side;
    int const j = cell / image_changes::columns * image_changes::side + s / image_changes::side;
    int const x = parts * i + j / 2 * step % parts, y = parts * j + i / 2 * step % parts;
    return {x * image.width / (parts * across), y * image.height / (parts * down)};
  }
  FT_HOST_DEVICE static std::ptrdiff_t place(int i, int cell, int s) {
    return (static_cast<std::ptrdiff_t>(i) * samples + s) * image_changes::cells + cell;
  }
  FT_HOST_DEVICE static compared compare(image_view<std::uint8_t> const& image,
                                         image_changes_view const& v, int i, int cell, bool first) {
    compared out;
    int grey[samples];
    int then[samples];
    int prior[samples];
    int reference = 0, last_sum = 0;
    FT_UNROLL
    for (int k = 0; k < samples; ++k) {
      sample const at = sample_of(image, cell, k);
      grey[k] = image.row(at.y)[at.x];
      then[k] = first ? 0 : v.reference[place(i, cell, k)];
      prior[k] = first ? 0 : v.last[place(i, cell, k)];
      out.differs = out.differs || first || prior[k] != grey[k];
      out.sum += grey[k];
      out.squares += grey[k] * grey[k];
      reference += then[k];
      last_sum += prior[k];
    }
    FT_UNROLL
    for (int k = 0; k < samples; ++k) {
      v.last[place(i, cell, k)] = static_cast<std::uint8_t>(grey[k]);
      int const now = samples * grey[k] - out.sum;
      int const was = first ? 0 : samples * then[k] - reference;
      out.contrast += now < 0 ? -now : now;
      out.was += was < 0 ? -was : was;
      out.difference += now < was ? was - now : now - was;
      int const before = samples * prior[k] - last_sum;
      out.lately += now < before ? before - now : now - before;
    }
    out.contrast /= samples;
    out.was /= samples;
    out.difference /= samples;
    out.lately /= samples;
    return out;
  }
};

/// Item: an image. Threads have rows of cells.
struct judge_changes {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int i, image_pyramid_view const& images,
                                 image_changes_view const& v) const {
    image_changes& out = v.of[i];
    if (images.absent.has(i)) {
      if (g.rank() == 0) { out = {}; }
      return;
    }
    if (v.is_missing(i)) {  // the next one is compared with the last that was there
      if (g.rank() == 0) {
        out.textured = out.moved = out.still = out.same = 0;
        out.sum = out.squares = out.streaked = 0;
      }
      return;
    }
    row_changes const* const rows = v.of_row + static_cast<std::ptrdiff_t>(i) * image_changes::rows;
    row_changes all{};
    for (int r = g.rank(); r < image_changes::rows; r += g.size()) {
      all.cells = all.cells + rows[r].cells;
      all.grey = all.grey + rows[r].grey;
      all.slopes = all.slopes + rows[r].slopes;
    }
    four_sums const cells = g.reduce(all.cells, sum_op{});
    four_sums const grey = g.reduce(all.grey, sum_op{});
    four_sums const steep = g.reduce(all.slopes, sum_op{});
    int const textured = cells.of[0], moved = cells.of[1];
    int const still = cells.of[2], known = cells.of[3];
    // Most of the image moves: what does not is not of the scene. Less is enough where that was so
    // before. With a camera that hardly moves there is much between both.
    bool const first = v.begun[i] == 0;
    bool const most = known != 0 ? 2 * moved > still : 4 * moved > 3 * still;
    bool const rest_moves = !first && most && 5 * (moved + still) > 4 * textured;
    four_sums fixed{};
    for (int r = g.rank(); r < image_changes::rows; r += g.size()) {
      fixed = fixed + count_frames(v, i, r, rows[r].still_cells, rest_moves);
    }
    fixed = g.reduce(fixed, sum_op{});
    if (g.rank() != 0) { return; }
    out.textured = textured;
    out.moved = grey.of[2];
    out.still = still;
    out.same = !first && grey.of[3] == 0 ? 1 : 0;
    out.sum = grey.of[0];
    out.squares = grey.of[1];
    image_slopes const slopes{steep.of[0], steep.of[1], steep.of[2], steep.of[3]};
    out.streaked = slopes.is_streaked() ? 1 : 0;
    out.fixed = fixed.of[0];
    out.rest_moves = rest_moves ? 1 : 0;
    out.by_quarters = 8 * fixed.of[1] > textured || 16 * fixed.of[2] > textured ? 1 : 0;
    v.begun[i] = 1;
  }

private:
  /// Counts the frames in which the cells of a row were still and others were not.
  /// @return numbers of cells: fixed now, for a few frames, for many
  FT_HOST_DEVICE static four_sums count_frames(image_changes_view const& v, int i, int row,
                                               unsigned still_cells, bool rest_moves) {
    constexpr int n = image_changes::columns;
    std::uint8_t* const kept =
        v.frames + static_cast<std::ptrdiff_t>(i) * image_changes::cells + row * n;
    std::uint8_t frames[n];
    memcpy(frames, kept, sizeof frames);
    constexpr int few_frames = image_changes_view::few_frames;
    constexpr int many_frames = image_changes_view::many_frames;
    unsigned now = 0, long_since = 0;
    int few = 0;
    FT_UNROLL
    for (int k = 0; k < n; ++k) {
      int const more = (still_cells >> k & 1u) != 0 && rest_moves ? 1 : 0;
      int const count = min_of(frames[k] + more, many_frames);
      frames[k] = static_cast<std::uint8_t>(count);
      few += static_cast<int>(count >= few_frames);
      now |= static_cast<unsigned>(count >= few_frames || (rest_moves && count > 0)) << k;
      long_since |= static_cast<unsigned>(count >= many_frames) << k;
    }
    memcpy(kept, frames, sizeof frames);
    v.of[i].now[row] = now;
    v.of[i].long_since[row] = long_since;
    return {{popcount(now), few, popcount(long_since), 0}};
  }
};

}  // namespace detail

/// Compares every image that is there with those before it. Asynchronous on `exec`; allocates
/// nothing; two launches.
/// @param images level 0 is read
template <typename Exec>
void watch_images(Exec const& exec, image_pyramid_view const& images, image_changes_view const& v) {
  for_each_item<per_warp>(exec, images.batch * image_changes::rows, detail::compare_cells{}, images,
                          v);
  for_each_item<per_warp>(detail::with_order(exec, detail::launch_order::serial), images.batch,
                          detail::judge_changes{}, images, v);
}

}  // namespace FT_ABI
}  // namespace ft
