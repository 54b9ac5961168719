// SPDX-License-Identifier: Apache-2.0
/// @file Stage: pose problems from a frame's keypoints and the map points that they may show.
#pragma once

#include <cstddef>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pose/optimize_frame.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a problem.
struct gather_correspondences {
  using scratch = no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch&, int b, frames_in_map const& in,
                                 int const* match, pnp_problems_view const& out) const {
    if (!out.is_active(b)) { return; }
    keypoints_view const kp = in.frame.camera(0, 0);
    map_points_view const map = in.map.slice(0);
    int const* const row = match + static_cast<std::ptrdiff_t>(b) * kp.capacity;
    int const keypoints = clamp(*kp.count, 0, kp.capacity);
    int n = 0;
    FT_NO_UNROLL
    for (int base = 0; base < keypoints; base += g.size()) {
      int const k = base + g.rank();
      int const slot = k < keypoints ? row[k] : -1;
      bool const matched = slot >= 0 && slot < map.capacity;
      int more = 0;
      std::ptrdiff_t const to = out.at(b) + n + g.exclusive_count(matched, more);
      if (matched) {
        int const octave = kp.octave(k);
        out.pixel[to] = {in.geometry.column(kp.x(k), octave), in.geometry.row(kp.y(k), octave)};
        out.point[to] = map.position(slot);
        out.max_error2[to] = (strict_float(in.geometry.sigma2[octave]) * 5.991f).value;
        out.keypoint[to] = k;
      }
      n += more;
    }
    if (g.rank() == 0) { out.count[b] = n; }
  }
};

}  // namespace detail

/// Correspondences of a frame's matches with several keyframes, a problem each: in the order of the
/// keypoints, those of the first camera of batch entry 0. An inlier's squared error is below 5.991
/// (95 % of two degrees of freedom) times sigma2 of its octave. Asynchronous on `exec`; allocates
/// nothing; one launch, a warp per problem.
/// @param in `holder` of the frame is not read
/// @param match [problems][keypoints] slot of a map point, or -1
/// @param out count, pixel, point, max_error2 and keypoint of active problems are written; seeds
///   and rays are not
/// @throws bad_argument for fewer correspondences than keypoints, or a null match
template <typename Exec>
void gather_pnp(Exec const& exec, frames_in_map const& in, int const* match,
                pnp_problems_view const& out) {
  detail::require(match != nullptr || out.problems == 0, "the matches are null");
  detail::require_range("correspondences of a pose problem", out.capacity,
                        in.frame.keypoints.capacity, 1 << 30);
  for_each_item<per_warp>(exec, out.problems, detail::gather_correspondences{}, in, match, out);
}

}  // namespace FT_ABI
}  // namespace ft
