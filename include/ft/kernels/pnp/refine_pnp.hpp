// SPDX-License-Identifier: Apache-2.0
/// @file Stage: poses from all inliers of a RANSAC's poses. Source: Urban, Leitloff and Hinz,
/// "MLPnP: a real-time maximum likelihood solution to the perspective-n-point problem", ISPRS
/// Annals 2016, without covariances.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/pnp/hypotheses.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pnp/refine_pose.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Item: a problem.
template <typename Camera>
struct refine_from_inliers {
  using scratch = mlpnp_scratch;
  Camera camera;  ///< of strict_float

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int b, pnp_problems_view const& problems,
                                 pnp_results_view const& coarse, pnp_results_view const& out,
                                 pnp_workspace const& work) const {
    if (!problems.is_active(b)) { return; }
    pnp_problem const from = problems.of(b);
    std::ptrdiff_t const first = problems.at(b);
    int* const listed = work.listed + first;
    std::uint8_t const* const inlier = coarse.inlier + first;
    int n = 0;
    FT_NO_UNROLL
    for (int base = 0; base < from.count; base += g.size()) {
      int const i = base + g.rank();
      bool const in = i < from.count && inlier[i] != 0;
      int more = 0;
      int const place = n + g.exclusive_count(in, more);
      if (in) { listed[place] = i; }
      n += more;
    }
    g.sync();
    pnp_result result = coarse.result[b];
    pnp_pose found{};
    found.valid = false;
    if (n >= pnp_sample) { found = mlpnp(g, s, {from.ray, from.point, listed, n}); }
    std::uint8_t* const marked = out.inlier + first;
    if (found.valid) {
      result.T_cw = found.T_cw.template cast<float>();
      result.inliers = mark_inliers(g, camera, &found.T_cw, from, {marked, out.capacity});
    } else {
      for (int i = g.rank(); i < out.capacity; i += g.size()) { marked[i] = inlier[i]; }
    }
    g.sync();  // all have read the coarse result
    if (g.rank() == 0) { out.result[b] = result; }
  }
};

}  // namespace detail

/// The pose of each active problem from all its inliers by MLPnP, and the inliers of that pose.
/// Status and number of iterations stay; with fewer than six inliers, or if they give no pose, the
/// pose stays, too. The reference does not use such a pose. Asynchronous on `exec`; allocates
/// nothing; one launch, a warp per problem. Equal bits on every executor.
/// @param camera model of the pixels; its scalar does not matter
/// @param coarse results of solve_pnp() or continue_pnp()
/// @param out may be `coarse`
/// @throws bad_argument for views of other shapes
template <typename Exec, typename Camera>
void refine_pnp(Exec const& exec, Camera const& camera, pnp_problems_view const& problems,
                pnp_results_view const& coarse, pnp_results_view const& out,
                pnp_workspace const& work) {
  detail::require_pnp(problems, coarse);
  detail::require_pnp(problems, out);
  detail::require_pnp(problems, work);
  auto const strict_camera = camera.template cast<strict_float>();
  for_each_item<per_warp>(
      exec, problems.problems,
      detail::refine_from_inliers<std::decay_t<decltype(strict_camera)>>{strict_camera}, problems,
      coarse, out, work);
}

}  // namespace FT_ABI
}  // namespace ft
