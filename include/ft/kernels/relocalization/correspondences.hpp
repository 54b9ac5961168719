// SPDX-License-Identifier: Apache-2.0
/// @file Stage: from the matches of a search by words to pose problems.
#pragma once

#include <cstddef>
#include <cstdint>

#include "ft/containers/frame.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {

/// Frames and the matches of their keypoints. Keypoint k of the left camera is number k of a row of
/// `matches`.
struct matched_frames {
  frame_view frame;
  map_points_view map;
  pyramid_geometry geometry;
  word_matches_view matches;
  int const* frame_of = nullptr;  ///< [pairs] batch entry of frame and map; null: entry 0
  int min_matches = 15;           ///< a pair with fewer, in both cameras, is no problem
  float chi2 = 5.991f;            ///< limit of the squared error of an inlier over sigma^2
  std::uint64_t seed = 0;         ///< of the first problem; each further one has the next number
};

namespace detail {

/// Item: a pair, and the pose problem with its number.
struct gather_problem {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int p, matched_frames const& in,
                                 pnp_problems_view const& out, int* active) const {
    int const b = in.frame_of != nullptr ? in.frame_of[p] : 0;
    keypoints_view const kp = in.frame.camera(b, 0);
    map_points_view const points = in.map.slice(b);
    int const* const match =
        in.matches.match + static_cast<std::ptrdiff_t>(p) * in.matches.capacity;
    int const n = min_of(*kp.count, in.matches.capacity);
    int placed = 0;
    for (int base = 0; base < n; base += g.size()) {
      int const k = base + g.rank();
      int const slot = k < n ? match[k] : -1;
      bool const there = slot >= 0 && slot < points.capacity;
      int here = 0;
      int const place = placed + g.exclusive_count(there, here);
      placed += here;
      if (!there) { continue; }
      std::ptrdiff_t const at = out.at(p) + place;
      int const octave = kp.octave(k);
      out.pixel[at] = {in.geometry.column(kp.x(k), octave), in.geometry.row(kp.y(k), octave)};
      out.point[at] = points.position(slot);
      out.max_error2[at] = mul(in.geometry.sigma2[octave], in.chi2);
      out.keypoint[at] = k;
    }
    if (g.rank() != 0) { return; }
    out.count[p] = placed;
    out.seed[p] = in.seed + static_cast<std::uint64_t>(p);
    active[p] = static_cast<int>(in.matches.count[p] >= in.min_matches);
  }
};

}  // namespace detail

/// The pose problems of matched frames: a correspondence for each matched keypoint of the left
/// camera, in order. Writes all of `out` but its rays. Asynchronous on `exec`; allocates nothing;
/// one launch.
/// @param out a problem for each pair
/// @param active [pairs] 1 for pairs with enough matches, else 0; for pnp_problems_view::active
/// @throws bad_argument if the problems are fewer than the pairs, or smaller than a frame
template <typename Exec>
void gather_correspondences(Exec const& exec, matched_frames const& in,
                            pnp_problems_view const& out, int* active) {
  detail::require_range("pose problems", out.problems, in.matches.pairs, 1 << 30);
  detail::require_range("correspondences of a pose problem", out.capacity, in.frame.capacity(),
                        1 << 30);
  for_each_item<per_block<256>>(exec, in.matches.pairs, detail::gather_problem{}, in, out, active);
}

}  // namespace FT_ABI
}  // namespace ft
