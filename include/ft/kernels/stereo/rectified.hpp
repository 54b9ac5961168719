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
#include "ft/kernels/grid.hpp"
#include "ft/kernels/stereo/detail/least_squares.hpp"
#include "ft/kernels/stereo/detail/row_candidates.hpp"
#include "ft/kernels/stereo/outlier_cut.hpp"

namespace ft {
inline namespace FT_ABI {

/// How the column of a match is found between pixels.
enum class column_rule {
  parabola,       ///< ORB-SLAM3's, through three sums of absolute differences
  least_squares,  ///< of the squared differences; see match_stereo_rectified()
};

/// Parameters of rectified stereo matching.
struct stereo_params {
  float bf = 0;             ///< baseline times fx, metres * pixels
  float max_disparity = 0;  ///< bf / baseline, pixels
  /// Matching descriptors differ in fewer bits; of others see detail::search_scale.
  int hamming_limit = detail::descriptor_scale::limit(75);

  FT_HOST_DEVICE stereo_params const& of_pair(int) const { return *this; }
};

/// The same for pairs of `Cameras` kinds that follow each other in a batch.
template <int Cameras>
struct rig_stereo_params {
  stereo_params of[Cameras];

  FT_HOST_DEVICE stereo_params const& of_pair(int pair) const { return of[pair % Cameras]; }
};

namespace detail {

/// Item: a left keypoint. Finds the nearest right one in its band of rows, then refines the column.
template <column_rule Rule = column_rule::parabola>
struct match_left_keypoint {
  static constexpr bool wide_on_host = true;
  using scratch = no_scratch;

  /// Images 2 b and 2 b + 1 of the batch are pair b.
  template <typename Group, typename Params>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, image_pyramid_view const& pyramid,
                                 keypoints_view const& keypoints,
                                 feature_grid_view const& right_rows, Params const& of_pairs,
                                 stereo_matches_view const& out) const {
    int const pair = item / keypoints.capacity;
    stereo_params const& params = of_pairs.of_pair(pair);
    int const i = item % keypoints.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    // Loaded together, although the entry may turn out to be past the count.
    int const count = *left.count;
    row_feature const mine{left.x(i), left.y(i), left.octave(i), left.orb(i)};
    if (g.rank() == 0) {
      out.right_x(item) = -1;
      out.depth(item) = -1;
      out.score(item) = -1;
      if (i == 0) { out.count[pair] = count; }
    }
    if (i >= count) { return; }

    int const octave = mine.octave;
    feature_grid_view const rows = right_rows.slice(pair);
    int const row = row_cell::of(rows.geometry, 0, mine.y);
    if (row < 0 || mine.x < 0) { return; }
    auto const level_l = pyramid.level(2 * pair, octave);
    auto const level_r = pyramid.level(2 * pair + 1, octave);
    float const inv = pyramid.geometry.inv_scale[octave];
    int const ul = round_away(mul(mine.x, inv));
    int const vl = round_away(mul(mine.y, inv));
    // Extracted keypoints are at least 19 pixels inside; a caller's own keypoints may be anywhere.
    if (ul < window_half || ul + window_half >= level_l.width || vl < window_half ||
        vl + window_half >= level_l.height) {
      return;
    }
    // Right keypoints whose band may contain this row.
    int const reach = row_reach(pyramid.geometry, octave);
    int const begin = rows.start[max_of(row - reach, 0)];
    int const end = rows.start[min_of(row + reach, pyramid.geometry.height[0] - 1) + 1];
    window_part const part(g, level_l, ul, vl);  // in flight while candidates are compared
    g.sync();  // keeps the compiler from making these loads wait for those of the rows
    span<int const> const listed{rows.indices + begin, end - begin};
    candidate_band const band(pyramid.geometry, mine, row, params.max_disparity);
    row_candidate const found =
        nearest_in_rows(g, mine.orb, band, right, listed, params.hamming_limit);
    int const j = found.keypoint;
    if (j < 0) { return; }
    bool const rival =
        has_rival(g, mine, band, pyramid.geometry, right, listed, found, params.hamming_limit);
    int const ur = round_away(mul(right.x(j), inv));
    if (ur < 2 * window_half || ur + window_side >= level_r.width) { return; }  // as above

    int sums[window_side];
    if constexpr (Group::max_threads == 1) {
      sum_differences(level_l, level_r, ul, ur, vl, sums);
    } else {
      part.sum_differences(g, level_r, ur, vl, sums);
    }
    refined const r = refined_by_rule(g, {level_l, level_r, ul, vl}, pyramid.geometry, mine,
                                      {ur, sums, params.max_disparity});
    if (!r.valid || g.rank() != 0) { return; }
    out.depth(item) = (params.bf / r.disparity).value;
    out.right_x(item) = r.column.value;
    out.score(item) = r.score;
    out.rival(item) = rival ? 1 : 0;
    out.row_difference(item) = right.y(j) - mine.y;
  }

private:
  /// The right column with sub-pixel precision.
  struct refined {
    strict_float column, disparity;
    int score;
    bool valid;
  };
  /// Fits a parabola to the sums of the best shift and its neighbours.
  FT_HOST_DEVICE static refined refine(pyramid_geometry const& geometry, row_feature const& left,
                                       int ur, int const (&sums)[window_side],
                                       float max_disparity) {
    refined const none{0.0f, 0.0f, 0, false};
    int first = sums[0] << 4;  // the smallest sum, and its first shift
    FT_UNROLL
    for (int shift = 1; shift < window_side; ++shift) {
      first = min_of(first, sums[shift] << 4 | shift);
    }
    int const best = first & 15;
    int const lowest = first >> 4;
    if (best == 0 || best == window_side - 1) { return none; }
    int before = 0;
    int after = 0;
    // Constant indices keep the sums in registers.
    FT_UNROLL
    for (int shift = 1; shift + 1 < window_side; ++shift) {
      before = shift == best ? sums[shift - 1] : before;
      after = shift == best ? sums[shift + 1] : after;
    }

    strict_float const d1 = static_cast<float>(before);
    strict_float const d2 = static_cast<float>(lowest);
    strict_float const d3 = static_cast<float>(after);
    strict_float const delta = (d1 - d3) / (2.0f * (d1 + d3 - 2.0f * d2));
    if (!(delta >= -1.0f && delta <= 1.0f)) { return none; }
    strict_float const column =
        geometry.scale[left.octave] *
        (strict_float(static_cast<float>(ur)) + static_cast<float>(best - window_half) + delta);
    strict_float const disparity = left.x - column;
    if (!(disparity >= 0.0f && disparity < max_disparity)) { return none; }
    // left.x - 0.01 in double, rounded, is the same float for every column of an image.
    if (disparity <= 0.0f) { return {left.x - 0.01f, 0.01f, lowest, true}; }
    return {column, disparity, lowest, true};
  }

  /// The sums of differences around the column `ur`.
  struct shifted_sums {
    int ur;
    int const (&of)[window_side];
    float max_disparity;
  };
  template <typename Group>
  FT_HOST_DEVICE static refined refined_by_rule(Group g, column_windows const& windows,
                                                pyramid_geometry const& geometry,
                                                row_feature const& left, shifted_sums const& sums) {
    if constexpr (Rule == column_rule::parabola) {
      return refine(geometry, left, sums.ur, sums.of, sums.max_disparity);
    }
    strict_float const scale = geometry.scale[left.octave];
    strict_float const u = static_cast<float>(windows.u);
    row_feature at_pixel = left;
    at_pixel.x = (scale * u).value;
    refined r = refine(geometry, at_pixel, sums.ur, sums.of, sums.max_disparity);
    if (!r.valid) { return r; }
    strict_float const disparity = scale * (u - windows.best_column(g, u - r.disparity / scale));
    if (disparity > 0.0f && disparity < sums.max_disparity) { r.disparity = disparity; }
    r.column = left.x - r.disparity;
    return r;
  }
};

}  // namespace detail

/// Sorts the right keypoints by rows: the first step of match_stereo_rectified(). Asynchronous on
/// `exec`; allocates nothing; one launch.
/// @param rows a grid of one column and a row per row of the image
template <typename Exec>
void sort_right_rows(Exec const& exec, keypoints_view const& keypoints,
                     feature_grid_view const& rows) {
  build_grid<row_cell>(exec, keypoints, 1, 2, keypoints.batch / 2, rows);
}

/// The other steps, if another stage has sorted the right keypoints. Asynchronous on `exec`;
/// allocates nothing; two launches, of which only the first is concurrent with its predecessor if
/// `exec` says so.
/// @tparam Rule how columns are found between pixels
/// @param params stereo_params or rig_stereo_params
/// @param right_rows result of sort_right_rows()
template <column_rule Rule = column_rule::parabola, typename Exec, typename Params>
void match_sorted_rows(Exec const& exec, image_pyramid_view const& pyramid,
                       keypoints_view const& keypoints, Params const& params,
                       stereo_matches_view const& out, feature_grid_view const& right_rows) {
  int const pairs = keypoints.batch / 2;
  for_each_item<per_warp>(exec, pairs * keypoints.capacity, detail::match_left_keypoint<Rule>{},
                          pyramid, keypoints, right_rows, params, out);
  cut_outliers(detail::with_order(exec, detail::launch_order::serial), keypoints, out);
}

/// Finds right column and depth of every left keypoint of every pair; images 2 b and 2 b + 1 are
/// pair b.
///
/// With column_rule::least_squares the window of 11 x 11 pixels goes on from ORB-SLAM3's column to
/// where its squared differences are smallest, up to a constant, less than a pixel away. That
/// column belongs to the pixel of its level which the left keypoint is in; a keypoint between
/// pixels has the same disparity.
///
/// Asynchronous on `exec`; allocates nothing; three launches, of which only the first is
/// concurrent with its predecessor if `exec` says so.
/// @param right_rows workspace: a grid of one column and `image height` rows per pair
template <column_rule Rule = column_rule::parabola, typename Exec>
void match_stereo_rectified(Exec const& exec, image_pyramid_view const& pyramid,
                            keypoints_view const& keypoints, stereo_params const& params,
                            stereo_matches_view const& out, feature_grid_view const& right_rows) {
  sort_right_rows(exec, keypoints, right_rows);
  match_sorted_rows<Rule>(detail::with_order(exec, detail::launch_order::serial), pyramid,
                          keypoints, params, out, right_rows);
}

}  // namespace FT_ABI
}  // namespace ft
