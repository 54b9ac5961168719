// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo matching of a rectified pair, with sub-pixel refinement and a cut of
/// outliers. Source: specification section 5.
#pragma once

#include <cstdint>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/stereo/outlier_cut.hpp"

namespace ft {
inline namespace FT_ABI {

struct stereo_params {
  float bf = 0;             ///< baseline times fx, metres x pixels
  float max_disparity = 0;  ///< bf / baseline, pixels
  int max_distance = 75;    ///< descriptors must differ in fewer bits than this
};

namespace detail {

/// One left keypoint: its best right one on the row band, then the refined column.
struct match_left_keypoint {
  static constexpr bool wide_on_host = true;
  static constexpr int half = 5;  ///< of the window, and the largest shift
  static constexpr int side = 2 * half + 1;
  using scratch = no_scratch;

  /// Images 2 b and 2 b + 1 of the batch are pair b.
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 keypoints_view const& keypoints,
                                 feature_grid_view const& right_rows, stereo_params const& params,
                                 stereo_matches_view const& out) const {
    int const pair = item / keypoints.capacity;
    int const i = item % keypoints.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    // All of them under way together, also for an entry that turns out to have no keypoint.
    int const count = *left.count;
    feature const mine{get<field::x>(left, i), get<field::y>(left, i), get<field::octave>(left, i),
                       get<field::orb>(left, i)};
    if (g.rank() == 0) {
      get<field::right_x>(out, item) = -1;
      get<field::depth>(out, item) = -1;
      get<field::score>(out, item) = -1;
      if (i == 0) { out.count[pair] = count; }
    }
    if (i >= count) { return; }

    float const u = mine.x;
    int const octave = mine.octave;
    feature_grid_view const rows = right_rows.slice(pair);
    int const row = row_cell::of(rows.geometry, 0, mine.y);
    if (row < 0 || u < 0) { return; }
    auto const level_l = pyramid.level(2 * pair, octave);
    auto const level_r = pyramid.level(2 * pair + 1, octave);
    float const inv = pyramid.geometry.inv_scale[octave];
    int const ul = round_away(mul(u, inv));
    int const vl = round_away(mul(mine.y, inv));
    // Cannot happen for extracted keypoints, which stay 19 px inside; a caller's own may be
    // anywhere.
    if (ul < half || ul + half >= level_l.width || vl < half || vl + half >= level_l.height) {
      return;
    }
    // Right keypoints that may have a band with this row in it.
    int const reach = reach_of(pyramid.geometry, octave);
    int const begin = rows.start[max_of(row - reach, 0)];
    int const end = rows.start[min_of(row + reach, pyramid.geometry.height[0] - 1) + 1];
    window_part const part(g, level_l, ul, vl);  // is under way while the candidates are compared
    g.sync();  // else the compiler has these loads wait for those of the rows
    span<int const> const listed{rows.indices + begin, end - begin};
    int const j = nearest(g, pyramid.geometry, mine, row, right, listed, params);
    if (j < 0) { return; }
    int const ur = round_away(mul(get<field::x>(right, j), inv));
    if (ur < 2 * half || ur + side >= level_r.width) { return; }  // below 0: as above

    int sums[side];
    if constexpr (Group::max_threads == 1) {
      sum_differences(level_l, level_r, ul, ur, vl, sums);
    } else {
      part.sum_differences(g, level_r, ur, vl, sums);
    }
    if (g.rank() != 0) { return; }
    int first = sums[0] << 4;  // the smallest sum, and where it is first
    FT_UNROLL
    for (int shift = 1; shift < side; ++shift) { first = min_of(first, sums[shift] << 4 | shift); }
    int const best = first & 15;
    int const lowest = first >> 4;
    if (best == 0 || best == side - 1) { return; }
    int before = 0;
    int after = 0;
    FT_UNROLL
    for (int shift = 1; shift + 1 < side; ++shift) {  // constant indices keep the sums in registers
      before = shift == best ? sums[shift - 1] : before;
      after = shift == best ? sums[shift + 1] : after;
    }

    strict_float const d1 = static_cast<float>(before);
    strict_float const d2 = static_cast<float>(lowest);
    strict_float const d3 = static_cast<float>(after);
    strict_float const delta = (d1 - d3) / (2.0f * (d1 + d3 - 2.0f * d2));
    if (!(delta >= -1.0f && delta <= 1.0f)) { return; }
    strict_float column =
        pyramid.geometry.scale[octave] *
        (strict_float(static_cast<float>(ur)) + static_cast<float>(best - half) + delta);
    strict_float disparity = u - column;
    if (!(disparity >= 0.0f && disparity < params.max_disparity)) { return; }
    if (disparity <= 0.0f) {
      disparity = 0.01f;
      column = u - 0.01f;
    }
    get<field::depth>(out, item) = (params.bf / disparity).value;
    get<field::right_x>(out, item) = column.value;
    get<field::score>(out, item) = lowest;
  }

private:
  /// What is read of a left keypoint.
  struct feature {
    float x, y;
    int octave;
    descriptor orb;
  };

  /// Sums of absolute differences of the windows, one a shift, by a single thread.
  FT_HOST_DEVICE static void sum_differences(gray_view left, gray_view right, int ul, int ur, int v,
                                             int (&sums)[side]) {
    for (int& sum : sums) { sum = 0; }
    for (int p = 0; p < side * side; ++p) {
      int const dx = p % side - half;
      int const y = v + p / side - half;
      int const mine = left(ul + dx, y);
      std::uint8_t const* const theirs = right.row(y) + ur - half + dx;
      for (int shift = 0; shift < side; ++shift) {
        int const d = mine - theirs[shift];
        sums[shift] += d < 0 ? -d : d;
      }
    }
  }

  /// The part of the left window that a thread of a warp compares: half a row of it, six pixels or
  /// five. A single thread has no part.
  class window_part {
  public:
    template <typename Group>
    FT_HOST_DEVICE window_part(Group g, gray_view left, int u, int v) {
      if constexpr (Group::max_threads > 1) {
        static_assert(Group::max_threads == 32, "two threads for each of 11 rows");
        std::uint8_t const* const at = left.row(row(g, v)) + u - half + column(g);
        skew_ = static_cast<int>(reinterpret_cast<std::uintptr_t>(at) & 3u);
        std::uint8_t const* const from = at - skew_;
        words_[0] = load_word(from);
        words_[1] = load_word(from + 4);
        words_[2] = load_word(from + ((skew_ + pixels(g) - 1) & ~3));
      }
    }

    /// The sums for every thread, if the right window is at column u where nothing is shifted.
    template <typename Group>
    FT_HOST_DEVICE void sum_differences(Group g, gray_view right, int u, int v,
                                        int (&sums)[side]) const {
      std::uint32_t theirs[4];
      load_bytes(right.row(row(g, v)) + u - 2 * half + column(g), pixels(g) + 2 * half, theirs);
      bool const compares = g.rank() < 2 * side;
      std::uint32_t const mine[2] = {bytes_from(words_[0], words_[1], skew_),
                                     bytes_from(words_[1], words_[2], skew_) & rest(g)};
      auto const difference = [&](int shift) {
        auto const from = [&](int byte) {
          return bytes_from(theirs[byte / 4], theirs[min_of(byte / 4 + 1, 3)], byte % 4);
        };
        return difference_of_4(mine[0], from(shift),
                               difference_of_4(mine[1], from(shift + 4) & rest(g), 0));
      };
      // Two sums a word: 11 x 11 x 255 has 15 bits.
      FT_UNROLL
      for (int shift = 0; shift < side; shift += 2) {
        std::uint32_t two = difference(shift);
        if (shift + 1 < side) { two |= difference(shift + 1) << 16; }
        two = g.reduce(compares ? two : 0, sum_op{});
        sums[shift] = static_cast<int>(two & 0xffffu);
        if (shift + 1 < side) { sums[shift + 1] = static_cast<int>(two >> 16); }
      }
    }

  private:
    /// Threads for whom no row is left read the last one again.
    template <typename Group>
    FT_HOST_DEVICE static int row(Group g, int v) {
      return v - half + min_of(g.rank() / 2, side - 1);
    }
    template <typename Group>
    FT_HOST_DEVICE static int column(Group g) {
      return g.rank() % 2 * 6;
    }
    template <typename Group>
    FT_HOST_DEVICE static int pixels(Group g) {
      return 6 - g.rank() % 2;
    }
    /// The bytes of the second word that are pixels.
    template <typename Group>
    FT_HOST_DEVICE static std::uint32_t rest(Group g) {
      return g.rank() % 2 == 0 ? 0xffffu : 0xffu;
    }

    /// The words that have the pixels, as they were loaded: to shift them is to wait for them.
    std::uint32_t words_[3];
    int skew_;
  };

  /// How many rows away a right keypoint can be.
  FT_HOST_DEVICE static int reach_of(pyramid_geometry const& geometry, int octave) {
    return static_cast<int>(2.0f * geometry.scale[min_of(octave + 1, geometry.levels - 1)]) + 2;
  }

  /// Index of the right keypoint with the nearest descriptor, the first of equals; -1 for none near
  /// enough.
  template <typename Group>
  FT_HOST_DEVICE static int nearest(Group g, pyramid_geometry const& geometry, feature const& mine,
                                    int row, keypoints_view const& right, span<int const> listed,
                                    stereo_params const& params) {
    float const u = mine.x;
    int const octave = mine.octave;
    float const lowest_u = u - params.max_disparity;
    // Half the height of a right keypoint's band, by its octave.
    float const finer_band = 2.0f * geometry.scale[max_of(octave - 1, 0)];
    float const band = 2.0f * geometry.scale[octave];
    float const coarser_band = 2.0f * geometry.scale[min_of(octave + 1, geometry.levels - 1)];
    // Without a branch, so that no load waits for another one's number.
    auto const is_candidate = [&](float x, float y, int o) {
      float const b = o == octave ? band : (o < octave ? finer_band : coarser_band);
      bool const on_octave = (o >= octave - 1) & (o <= octave + 1);
      bool const off_columns = (x < lowest_u) | (x > u);
      // That row, which is whole, is in [floor(y - b), ceil(y + b)].
      bool const on_rows =
          (y - b < static_cast<float>(row + 1)) & (y + b > static_cast<float>(row - 1));
      return on_octave & !off_columns & on_rows;
    };
    // Of so many candidates the loads of a thread are under way together; some are taken twice.
    constexpr int together = Group::max_threads == 1 ? 1 : 3;
    unsigned long long best = ~0ull;
    for (int k = 0; k < listed.size; k += together * g.size()) {
      int j[together];
      bool near[together];
      descriptor theirs[together];
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        j[n] = listed[min_of(k + n * g.size() + g.rank(), listed.size - 1)];
      }
      g.sync();  // else the compiler has some of these loads wait for what others bring
      float x[together];
      float y[together];
      int o[together];
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        x[n] = get<field::x>(right, j[n]);
        y[n] = get<field::y>(right, j[n]);
        o[n] = get<field::octave>(right, j[n]);
      }
      g.sync();
      FT_UNROLL
      for (int n = 0; n < together; ++n) { near[n] = is_candidate(x[n], y[n], o[n]); }
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        if (near[n]) { theirs[n] = get<field::orb>(right, j[n]); }
      }
      FT_UNROLL
      for (int n = 0; n < together; ++n) {
        if (!near[n]) { continue; }
        int const distance = hamming(mine.orb, theirs[n]);
        best = min_of(
            best, static_cast<unsigned long long>(distance) << 32 | static_cast<unsigned>(j[n]));
      }
    }
    best = g.reduce(best, min_op{});
    return static_cast<int>(best >> 32) < params.max_distance && best != ~0ull
               ? static_cast<int>(best & 0xffffffffu)
               : -1;
  }
};

}  // namespace detail

/// Right keypoints by rows, which matching needs. Asynchronous on `exec`; allocates nothing; one
/// launch. @param rows a grid of one column and a row per row of the image
template <typename Exec>
void sort_right_rows(Exec const& exec, keypoints_view const& keypoints,
                     feature_grid_view const& rows) {
  build_grid<row_cell>(exec, keypoints, 1, 2, keypoints.batch / 2, rows);
}

/// The part after sort_right_rows(): matches, of which the outliers are still to be cut.
template <typename Exec>
void match_sorted_rows(Exec const& exec, image_pyramid_view const& pyramid,
                       keypoints_view const& keypoints, stereo_params const& params,
                       stereo_matches_view const& out, feature_grid_view const& right_rows) {
  int const pairs = keypoints.batch / 2;
  for_each_item<per_warp>(exec, pairs * keypoints.capacity, detail::match_left_keypoint{}, pyramid,
                          keypoints, right_rows, params, out);
}

/// Right column and depth of every left keypoint of every pair; images 2 b and 2 b + 1 are pair b.
/// Asynchronous on `exec`; allocates nothing; three launches. @param right_rows a grid of one
/// column and `image height` rows per pair; workspace
template <typename Exec>
void match_stereo_rectified(Exec const& exec, image_pyramid_view const& pyramid,
                            keypoints_view const& keypoints, stereo_params const& params,
                            stereo_matches_view const& out, feature_grid_view const& right_rows) {
  sort_right_rows(exec, keypoints, right_rows);
  match_sorted_rows(exec, pyramid, keypoints, params, out, right_rows);
  cut_outliers(exec, keypoints, out);
}

}  // namespace FT_ABI
}  // namespace ft
