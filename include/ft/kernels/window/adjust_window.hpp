// SPDX-License-Identifier: Apache-2.0
/// @file Stage: bundle adjustment of small windows of views and points.
#pragma once

#include <cstddef>

#include "ft/containers/window_problem.hpp"
#include "ft/core/arithmetic.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/ordered_sum.hpp"
#include "ft/kernels/window/evaluate.hpp"
#include "ft/kernels/window/reduce.hpp"
#include "ft/kernels/window/solve.hpp"
#include "ft/kernels/window/workspace.hpp"
#include "ft/types/odometry_params.hpp"

namespace ft {
inline namespace FT_ABI {

/// Views and points with the smallest robust reprojection error: Levenberg-Marquardt with the
/// points eliminated.
///
/// An observation costs its squared weighted error, from `huber2` on Huber's function of it, and
/// `no_image` where the point has no image. A disparity of a rectified pair is an observation of
/// its own. A link costs its squared weighted errors; see links.hpp. A step that does not lower the
/// cost is refused, and the next one has ten times the damping. The descent ends after `steps`
/// tried ones, or with one that lowers the cost by a share below `enough`. Problems that have ended
/// skip the remaining launches.
///
/// A problem that is not valid is left as it is: with counts out of range, no view that moves, no
/// point that such a view sees, a view, a link of one that moves, or a point that is not finite, or
/// a first system that cannot be solved. Fixed views give the scale and the frame; without any,
/// damping keeps both near the start.
///
/// Asynchronous on `exec`; allocates nothing; 2 + 3 steps launches for all problems. Results have
/// the same bits on every executor and in every batch. Sources: Triggs and others, "Bundle
/// adjustment - a modern synthesis", 1999; Huber, "Robust estimation of a location parameter",
/// 1964.
/// @param rig rectified_rig, for one camera a view, stereo_rig, for two, or multi_rig
/// @param problems start and result
/// @param selected [batch] in executor memory: problems that are 0 are not touched. Null: all
/// @throws bad_argument for shapes that do not fit together
template <typename Exec, typename Rig>
void adjust_window(Exec const& exec, Rig const& rig, window_problem_view const& problems,
                   int const* selected, window_params const& params, window_workspace const& work) {
  detail::require(problems.cameras <= Rig::cameras,
                  "a window has more cameras a view than its rig");
  detail::require(problems.views == work.views && problems.points == work.points &&
                      problems.batch == work.batch,
                  "a window's workspace has the shape of its problems");
  detail::require_range("steps of an adjustment", params.steps, 0, 1000);
  using block = per_block<sum_lanes>;
  int const groups = problems.batch * work.groups();
  std::size_t const matrix = sizeof(double) * static_cast<std::size_t>(work.side()) *
                             static_cast<std::size_t>(work.side());
  std::size_t const extra =
      min_of(matrix, extra_scratch<sum_lanes, detail::solve_window>(exec, problems.batch));
  for_each_item<block>(exec, groups, detail::start_window<Rig>{rig, params}, problems, work,
                       selected);
  for (int turn = 0; turn < params.steps; ++turn) {
    for_each_item<block>(exec, problems.batch * work.pairs() * 2,
                         detail::reduce_window{params, turn}, problems, work);
    for_each_item<block>(exec, problems.batch, detail::solve_window{turn + 1, extra}, problems,
                         work);
    for_each_item<block>(exec, groups, detail::try_points<Rig>{rig, params, turn + 1}, problems,
                         work);
  }
  for_each_item<block>(exec, groups, detail::finish_window<Rig>{rig, params, params.steps},
                       problems, work);
}

}  // namespace FT_ABI
}  // namespace ft
