// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo matching of a rectified pair, with sub-pixel refinement and a cut of
/// outliers. Source: specification section 5.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/feature_grid.hpp"

namespace ft {
inline namespace FT_ABI {

struct stereo_params {
  float bf = 0;             ///< baseline times fx, metres x pixels
  float max_disparity = 0;  ///< bf / baseline, pixels
  int max_distance = 75;    ///< descriptors must differ in fewer bits than this
};

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
    if (g.rank() == 0) {
      get<field::right_x>(out, item) = -1;
      get<field::depth>(out, item) = -1;
      get<field::score>(out, item) = -1;
      if (i == 0) { out.count[pair] = *left.count; }
    }
    if (i >= *left.count) { return; }

    float const u = get<field::x>(left, i);
    int const octave = get<field::octave>(left, i);
    int const j = nearest(g, pyramid.geometry, left, i, right, right_rows.slice(pair), params);
    if (j < 0) { return; }

    auto const level_l = pyramid.level(2 * pair, octave);
    auto const level_r = pyramid.level(2 * pair + 1, octave);
    float const inv = pyramid.geometry.inv_scale[octave];
    int const ul = round_away(detail::mul(u, inv));
    int const vl = round_away(detail::mul(get<field::y>(left, i), inv));
    int const ur = round_away(detail::mul(get<field::x>(right, j), inv));
    if (ur < 0 || ur + side >= level_r.width) { return; }
    // Cannot happen for extracted keypoints, which stay 19 px inside; a caller's own may be
    // anywhere.
    if (ur < 2 * half || ul < half || ul + half >= level_l.width || vl < half ||
        vl + half >= level_l.height) {
      return;
    }

    int sums[side] = {};
    for (int p = g.rank(); p < side * side; p += g.size()) {
      int const dx = p % side - half;
      int const y = vl + p / side - half;
      int const mine = level_l(ul + dx, y);
      std::uint8_t const* const theirs = level_r.row(y) + ur - half + dx;
      FT_UNROLL
      for (int shift = 0; shift < side; ++shift) {
        int const d = mine - theirs[shift];
        sums[shift] += d < 0 ? -d : d;
      }
    }
    FT_UNROLL
    for (int shift = 0; shift < side; ++shift) { sums[shift] = g.reduce(sums[shift], sum_op{}); }
    if (g.rank() != 0) { return; }
    int best = 0;
    for (int shift = 1; shift < side; ++shift) {
      if (sums[shift] < sums[best]) { best = shift; }
    }
    if (best == 0 || best == side - 1) { return; }
    int before = 0;
    int after = 0;
    for (int shift = 1; shift + 1 < side; ++shift) {  // constant indices keep the sums in registers
      if (shift == best) {
        before = sums[shift - 1];
        after = sums[shift + 1];
      }
    }
    int lowest = before;
    for (int shift = 0; shift < side; ++shift) { lowest = min_of(lowest, sums[shift]); }

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
  /// Index of the right keypoint with the nearest descriptor, the first of equals; -1 for none near
  /// enough.
  template <typename Group>
  FT_HOST_DEVICE static int nearest(Group g, pyramid_geometry const& geometry,
                                    keypoints_view const& left, int i, keypoints_view const& right,
                                    feature_grid_view const& rows, stereo_params const& params) {
    float const u = get<field::x>(left, i);
    float const y = get<field::y>(left, i);
    int const octave = get<field::octave>(left, i);
    descriptor const mine = get<field::orb>(left, i);
    int const height = geometry.height[0];
    int const row = row_cell::of(rows.geometry, 0, y);
    float const lowest_u = u - params.max_disparity;
    if (row < 0 || u < 0) { return -1; }
    int const reach =
        static_cast<int>(2.0f * geometry.scale[min_of(octave + 1, geometry.levels - 1)]) + 2;
    int const begin = rows.start[max_of(row - reach, 0)];
    int const end = rows.start[min_of(row + reach, height - 1) + 1];
    unsigned long long best = ~0ull;
    for (int k = begin + g.rank(); k < end; k += g.size()) {
      int const j = rows.indices[k];
      int const o = get<field::octave>(right, j);
      float const x = get<field::x>(right, j);
      if (o < octave - 1 || o > octave + 1 || x < lowest_u || x > u) { continue; }
      float const yr = get<field::y>(right, j);
      float const band = 2.0f * geometry.scale[o];
      if (row < static_cast<int>(::floorf(yr - band)) ||
          row > static_cast<int>(::ceilf(yr + band))) {
        continue;
      }
      int const distance = hamming(mine, get<field::orb>(right, j));
      best =
          min_of(best, static_cast<unsigned long long>(distance) << 32 | static_cast<unsigned>(j));
    }
    best = g.reduce(best, min_op{});
    return static_cast<int>(best >> 32) < params.max_distance && best != ~0ull
               ? static_cast<int>(best & 0xffffffffu)
               : -1;
  }
};

/// One pair: drops the matches whose score is too far above the median.
struct cut_stereo_outliers {
  static constexpr int fine_bits = 6;
  static constexpr int fine_bins = 1 << fine_bits;
  static constexpr int coarse_bins = 1 << (16 - fine_bits);  ///< scores are below 2^16
  static constexpr int kept = 3;                             ///< scores that a thread reads once
  struct scratch {
    int coarse[coarse_bins];
    int fine[fine_bins];
    int bin;   ///< of the median
    int rank;  ///< of the median inside its bin
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int pair,
                                 stereo_matches_view const& matches) const {
    stereo_matches_view const m = matches.slice(pair);
    int const n = *m.count;
    int first[kept];
    FT_UNROLL
    for (int k = 0; k < kept; ++k) {
      int const i = g.rank() + k * g.size();
      first[k] = i < n ? get<field::score>(m, i) : -1;
    }
    auto const each_score = [&](auto const& visit) {
      FT_UNROLL
      for (int k = 0; k < kept; ++k) {
        if (first[k] >= 0) { visit(g.rank() + k * g.size(), first[k]); }
      }
      for (int i = g.rank() + kept * g.size(); i < n; i += g.size()) {
        int const score = get<field::score>(m, i);
        if (score >= 0) { visit(i, score); }
      }
    };
    for (int b = g.rank(); b < coarse_bins; b += g.size()) { s.coarse[b] = 0; }
    for (int b = g.rank(); b < fine_bins; b += g.size()) { s.fine[b] = 0; }
    g.sync();
    each_score([&](int, int score) { atomic_add(s.coarse + (score >> fine_bits), 1); });
    g.sync();

    // The score of rank found / 2: first its bin, then its place in that.
    int const chunk = ceil_div(coarse_bins, g.size());
    int const begin = min_of(g.rank() * chunk, coarse_bins);
    int const end = min_of(begin + chunk, coarse_bins);
    int mine = 0;
    for (int b = begin; b < end; ++b) { mine += s.coarse[b]; }
    int found = 0;
    int before = g.exclusive_scan(mine, found);
    if (found == 0) { return; }
    if (before <= found / 2 && found / 2 < before + mine) {
      int b = begin;
      for (; before + s.coarse[b] <= found / 2; ++b) { before += s.coarse[b]; }
      s.bin = b;
      s.rank = found / 2 - before;
    }
    g.sync();
    int const bin = s.bin;
    each_score([&](int, int score) {
      if (score >> fine_bits == bin) { atomic_add(s.fine + (score & (fine_bins - 1)), 1); }
    });
    g.sync();
    int const median = bin << fine_bits | place_of(g.part(), s.fine, s.rank);

    float const limit = detail::mul(detail::mul(1.5f, 1.4f), static_cast<float>(median));
    each_score([&](int i, int score) {
      if (static_cast<float>(score) >= limit) {
        get<field::right_x>(m, i) = -1;
        get<field::depth>(m, i) = -1;
        get<field::score>(m, i) = -1;
      }
    });
  }

private:
  /// The bin that holds a rank, by each warp for itself.
  template <typename Part>
  FT_HOST_DEVICE static int place_of(Part part, int const* bins, int rank) {
    int const chunk = ceil_div(fine_bins, part.size());
    int const begin = part.rank() * chunk;
    int mine = 0;
    for (int b = begin; b < begin + chunk; ++b) { mine += bins[b]; }
    int total = 0;
    int before = part.exclusive_scan(mine, total);
    bool const here = before <= rank && rank < before + mine;
    int b = begin;
    for (; here && before + bins[b] <= rank; ++b) { before += bins[b]; }
    return part.shuffle(b, trailing_zeros(part.ballot(here)));
  }
};

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
  for_each_item<per_warp>(exec, pairs * keypoints.capacity, match_left_keypoint{}, pyramid,
                          keypoints, right_rows, params, out);
}

/// The last part.
template <typename Exec>
void cut_outliers(Exec const& exec, keypoints_view const& keypoints,
                  stereo_matches_view const& out) {
  for_each_item<per_block<512>>(exec, keypoints.batch / 2, cut_stereo_outliers{}, out);
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
