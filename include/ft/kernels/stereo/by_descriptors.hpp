// SPDX-License-Identifier: Apache-2.0
/// @file Stage: stereo partners of a rectified pair by descriptors alone, without images.
#pragma once

#include <cstddef>

#include "ft/containers/feature_grid.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/atomics.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/views.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/stereo/detail/row_candidates.hpp"
#include "ft/kernels/stereo/rectified.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Work memory of match_by_descriptors(), executor memory.
struct partner_proposals {
  int* partner = nullptr;              ///< [pairs][capacity] right keypoint, -1 = none
  unsigned long long* best = nullptr;  ///< [pairs][capacity] of right keypoints, as in key()

  /// Of a left keypoint: less is better.
  FT_HOST_DEVICE static unsigned long long key(int distance, int left) {
    return static_cast<unsigned long long>(distance) << 32 | static_cast<unsigned>(left);
  }
};
inline void carve(carver& c, partner_proposals& v, int capacity, int pairs) {
  c.place({pairs, capacity}, v.partner, v.best);
}

/// Item: a left keypoint. Proposes itself to the nearest right one of its rows.
struct propose_partner {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int item, pyramid_geometry const& geometry,
                                 keypoints_view const& keypoints,
                                 feature_grid_view const& right_rows, stereo_params const& params,
                                 partner_proposals const& out,
                                 stereo_matches_view const& matches) const {
    int const pair = item / keypoints.capacity;
    int const i = item % keypoints.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    if (g.rank() == 0) { out.partner[item] = -1; }
    if (i >= *left.count) { return; }
    row_feature const mine{left.x(i), left.y(i), left.octave(i), left.orb(i)};
    feature_grid_view const rows = right_rows.slice(pair);
    int const row = row_cell::of(rows.geometry, 0, mine.y);
    if (row < 0) { return; }
    int const reach = row_reach(geometry, mine.octave);
    int const begin = rows.start[max_of(row - reach, 0)];
    int const end = rows.start[min_of(row + reach, geometry.height[0] - 1) + 1];
    candidate_band const band(geometry, mine, row, params.max_disparity);
    span<int const> const listed{rows.indices + begin, end - begin};
    row_candidate const found =
        nearest_in_rows(g, mine.orb, band, right, listed, params.hamming_limit);
    if (found.keypoint < 0) { return; }
    bool const rival =
        has_rival(g, mine, band, geometry, right, listed, found, params.hamming_limit);
    if (g.rank() != 0) { return; }
    matches.rival(item) = rival ? 1 : 0;
    out.partner[item] = found.keypoint;
    atomic_min(out.best + static_cast<std::ptrdiff_t>(pair) * keypoints.capacity + found.keypoint,
               partner_proposals::key(found.distance, i));
  }
};

/// Item: a left keypoint. Keeps its partner if no other one is nearer to that.
struct keep_partner {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, pyramid_geometry const& geometry,
                                 keypoints_view const& keypoints, stereo_params const& params,
                                 partner_proposals const& proposed,
                                 stereo_matches_view const& out) const {
    int const pair = item / keypoints.capacity;
    int const i = item % keypoints.capacity;
    keypoints_view const left = keypoints.slice(2 * pair);
    keypoints_view const right = keypoints.slice(2 * pair + 1);
    out.right_x(item) = out.depth(item) = -1;
    out.score(item) = -1;
    if (i == 0) { out.count[pair] = *left.count; }
    if (i >= *left.count) { return; }
    int const j = proposed.partner[item];
    if (j < 0) { return; }
    unsigned long long const best =
        proposed.best[static_cast<std::ptrdiff_t>(pair) * keypoints.capacity + j];
    if (static_cast<int>(best & 0xffffffffu) != i) { return; }
    // Octaves count their pixels from different places.
    int const octave = left.octave(i);
    float const column = geometry.column(right.x(j), right.octave(j));
    strict_float const disparity = strict_float(geometry.column(left.x(i), octave)) - column;
    if (!(disparity > 0.0f)) { return; }
    out.right_x(item) = geometry.level_column(column, octave);
    out.depth(item) = geometry.level_depth((params.bf / disparity).value, octave);
    out.score(item) = static_cast<int>(best >> 32);
    out.row_difference(item) =
        (strict_float(geometry.row(right.y(j), right.octave(j))) - geometry.row(left.y(i), octave))
            .value;
  }
};

}  // namespace detail

/// Finds the partner of every left keypoint of every pair: of the right ones in its rows, within an
/// octave and up to params.max_disparity to the left, the one with the nearest descriptor, the
/// first of equals, if it differs in fewer than params.hamming_limit bits. Of left keypoints with
/// the same partner the nearest has it, the lower one of equals. Columns are those of the
/// keypoints; one that is not left of its partner's gives no depth. The score of a match is the
/// distance.
///
/// Images 2 b and 2 b + 1 are pair b. Asynchronous on `exec`; allocates nothing; two launches.
/// @param right_rows result of sort_right_rows()
/// @param work overwritten
template <typename Exec>
void match_by_descriptors(Exec const& exec, pyramid_geometry const& geometry,
                          keypoints_view const& keypoints, feature_grid_view const& right_rows,
                          stereo_params const& params, detail::partner_proposals const& work,
                          stereo_matches_view const& out) {
  int const items = keypoints.batch / 2 * keypoints.capacity;
  fill_bytes(exec, work.best, 0xff, static_cast<std::size_t>(items) * sizeof *work.best);
  for_each_item<per_warp>(exec, items, detail::propose_partner{}, geometry, keypoints, right_rows,
                          params, work, out);
  for_each_item<per_thread>(exec, items, detail::keep_partner{}, geometry, keypoints, params, work,
                            out);
}

}  // namespace FT_ABI
}  // namespace ft
