// SPDX-License-Identifier: Apache-2.0
/// @file Stage: which parts of an image change from frame to frame, and which stay as they are
/// while the rest moves: the camera's own bonnet, or dirt on its lens.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/bits.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/group.hpp"
#include "ft/core/memory.hpp"

namespace ft {
inline namespace FT_ABI {

/// What is seen of an image, in cells of 32 x 24 that cover it.
struct image_changes {
  static constexpr int columns = 32, rows = 24;
  static constexpr int cells = columns * rows;
  static constexpr int words = cells / 32;
  static constexpr int side = 4;  ///< samples of a cell are side x side pixels
  static constexpr int samples = side * side;

  int textured;         ///< cells with contrast, now and before
  int moved;            ///< of these, cells with another content than a frame before
  int still;            ///< and those whose content is where it was
  int same;             ///< 1 = all samples are those of the frame before
  int sum, squares;     ///< of all samples
  int streaked;         ///< 1 = sharp in one direction only: blurred by a motion
  int fixed;            ///< number of cells in `now`
  unsigned now[words];  ///< cells that stay while the rest moves, in this frame or for a few frames
  unsigned long_since[words];  ///< and those that did for many frames
};

/// Memory of the stage. Executor memory.
struct image_changes_view {
  image_changes* of = nullptr;        ///< [images]
  std::uint8_t* reference = nullptr;  ///< [images][samples][cells] since when a cell is still
  std::uint8_t* last = nullptr;       ///< [images][samples][cells] of the last frame
  std::uint8_t* frames = nullptr;     ///< [images][cells] in which a cell was still and others not
  int* begun = nullptr;               ///< [images] 1 = there was a frame
  static constexpr int sampled = image_changes::samples * image_changes::cells;

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
    return (bits[cell / 32] >> cell % 32 & 1u) != 0;
  }
};

inline void carve(carver& c, image_changes_view& v, int images) {
  c.place({images}, v.of);
  c.place({images, image_changes_view::sampled}, v.reference, v.last);
  c.place({images, image_changes::cells}, v.frames);
  c.place({images}, v.begun);
}

namespace detail {

/// How sharp an image is along its rows and its columns: squared differences of pixels that are 2
/// and 8 apart. Of an edge that a motion has smeared over L pixels the former is 4 / L and the
/// latter 8 - L / 3, for L from 2 to 8; of a sharp one they are 2 and 8.
struct image_slopes {
  int near_x = 0, near_y = 0, far_x = 0, far_y = 0;
  static constexpr int near = 1, far = 4;  ///< pixels to either side

  FT_HOST_DEVICE void add(image_view<std::uint8_t> const& image, int x, int y) {
    if (min_of(image.width, image.height) <= 2 * far) { return; }
    x = clamp(x, far, image.width - 1 - far);
    y = clamp(y, far, image.height - 1 - far);
    auto const squared = [&](int dx, int dy) {
      int const d = int{image.row(y + dy)[x + dx]} - int{image.row(y - dy)[x - dx]};
      return d * d;
    };
    near_x += squared(near, 0);
    near_y += squared(0, near);
    far_x += squared(far, 0);
    far_y += squared(0, far);
  }
  /// Whether near differences are a part of the far ones that is half as large in one direction as
  /// in the other: a streak of 5 pixels. Not where one direction has no edges, only noise.
  FT_HOST_DEVICE bool is_streaked() const {
    auto const across = std::int64_t{near_x} * far_y, down = std::int64_t{near_y} * far_x;
    bool const both = 8 * std::int64_t{far_x} > far_y && 8 * std::int64_t{far_y} > far_x;
    return both && (2 * across < down || 2 * down < across);
  }
};

/// Item: an image. Threads have cells.
struct watch_image {
  static constexpr bool wide_on_host = true;
  struct scratch {
    std::uint8_t still[image_changes::cells];
  };
  static constexpr int samples = image_changes::samples;
  static constexpr int few_frames = 4, many_frames = 8;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int i, image_pyramid_view const& images,
                                 image_changes_view const& v) const {
    if (images.absent.has(i)) {
      if (g.rank() == 0) { v.of[i] = {}; }
      return;
    }
    auto const image = images.level(i, 0);
    bool const first = v.begun[i] == 0;
    int textured = 0, moved = 0, still = 0, known = 0, differ = 0, changed = 0, sum = 0,
        squares = 0;
    image_slopes slopes;
    for (int c = g.rank(); c < image_changes::cells; c += g.size()) {
      compared const to = compare(image, v, i, c, first);
      textured += static_cast<int>(to.is_textured());
      moved += static_cast<int>(to.has_moved());
      still += static_cast<int>(to.is_still());
      known += static_cast<int>(!first && to.is_still() && v.frames[frames_at(i, c)] > 0);
      differ += static_cast<int>(to.differs);
      changed += static_cast<int>(to.has_changed());
      s.still[c] = to.is_still() ? 1 : 0;
      sum += to.sum;
      squares += to.squares;
      for (int k = 0; k < samples; k += 2) {  // half of them, like a chessboard's squares
        sample const at = sample_of(image, c, k + k / image_changes::side % 2);
        slopes.add(image, at.x, at.y);
      }
    }
    four_sums const counts = g.reduce(four_sums{{textured, moved, still, known}}, sum_op{});
    four_sums const grey = g.reduce(four_sums{{differ, sum, squares, changed}}, sum_op{});
    four_sums const steep =
        g.reduce(four_sums{{slopes.near_x, slopes.near_y, slopes.far_x, slopes.far_y}}, sum_op{});
    slopes = {steep.of[0], steep.of[1], steep.of[2], steep.of[3]};
    textured = counts.of[0];
    moved = counts.of[1];
    still = counts.of[2];
    known = counts.of[3];
    // Most of the image moves: what does not is not of the scene. Less is enough where that was so
    // before. With a camera that hardly moves there is much between both.
    bool const most = known != 0 ? 2 * moved > still : 4 * moved > 3 * still;
    bool const rest_moves = !first && most && 5 * (moved + still) > 4 * textured;
    g.sync();
    if (g.rank() == 0) {
      image_changes& out = v.of[i];
      out = {};
      out.textured = textured;
      out.moved = grey.of[3];
      out.still = still;
      out.same = !first && grey.of[0] == 0 ? 1 : 0;
      out.sum = grey.of[1];
      out.squares = grey.of[2];
      out.streaked = slopes.is_streaked() ? 1 : 0;
      v.begun[i] = 1;
    }
    for (int c = g.rank(); c < image_changes::cells; c += g.size()) {
      count_frames(v, i, c, !first && s.still[c] != 0, rest_moves);
    }
    g.sync();
    int fixed = 0;
    for (int w = g.rank(); w < image_changes::words; w += g.size()) {
      unsigned now = 0, long_since = 0;
      for (int bit = 0; bit < 32; ++bit) {
        int const frames = v.frames[frames_at(i, 32 * w + bit)];
        bool const is_now = frames >= few_frames || (rest_moves && frames > 0);
        now |= static_cast<unsigned>(is_now) << bit;
        long_since |= static_cast<unsigned>(frames >= many_frames) << bit;
      }
      fixed += popcount(now);
      v.of[i].now[w] = now;
      v.of[i].long_since[w] = long_since;
    }
    fixed = g.reduce(fixed, sum_op{});
    if (g.rank() == 0) { v.of[i].fixed = fixed; }
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
  FT_HOST_DEVICE static std::ptrdiff_t frames_at(int i, int cell) {
    return static_cast<std::ptrdiff_t>(i) * image_changes::cells + cell;
  }
  /// Counts the frames in which a cell was still and others were not. A cell that is not still
  /// begins anew.
  FT_HOST_DEVICE static void count_frames(image_changes_view const& v, int i, int cell, bool still,
                                          bool rest_moves) {
    std::uint8_t& frames = v.frames[frames_at(i, cell)];
    if (!still) {
      for (int k = 0; k < samples; ++k) {
        v.reference[place(i, cell, k)] = v.last[place(i, cell, k)];
      }
      frames = 0;
    } else if (rest_moves) {
      frames = static_cast<std::uint8_t>(min_of(frames + 1, many_frames));
    }
  }
};

}  // namespace detail

/// Compares every image with those before it. Asynchronous on `exec`; allocates nothing; one
/// launch.
/// @param images level 0 is read
template <typename Exec>
void watch_images(Exec const& exec, image_pyramid_view const& images, image_changes_view const& v) {
  for_each_item<per_block<1024>>(exec, images.batch, detail::watch_image{}, images, v);
}

}  // namespace FT_ABI
}  // namespace ft
