// SPDX-License-Identifier: Apache-2.0
/// @file Bundle adjustment of whole maps.
#pragma once

#include <cstddef>

#include "ft/cameras/camera_model.hpp"
#include "ft/containers/bundle.hpp"
#include "ft/core/config.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/detail/bundle_solver.hpp"
#include "ft/pipelines/detail/descent.hpp"

namespace ft {
inline namespace FT_ABI {

struct map_params {
  int steps = 100;       ///< most steps to try, 0 to 10000
  double enough = 3e-7;  ///< ends with a step that lowers the cost by a smaller share, 0 to 1
  double first_damping = 1e-4;  ///< of the first step, relative to the diagonal, 0 to 1e9
  /// Standard deviations from which an observation's cost grows linearly (Huber's kernel), up to
  /// 1e50; 0: none.
  double huber = 0;
  double no_image = 1e4;       ///< cost of an observation whose point has no image, 0 to 1e50
  int solver_steps = 500;      ///< most steps of conjugate gradients in a step, 1 to 100000
  double solver_enough = 0.1;  ///< these end where their mean gain is this share of one's, 0 to 1
};

/// How an adjustment ended.
enum class map_outcome {
  converged,     ///< a step gained less than asked for
  out_of_steps,  ///< there were not enough steps
  stuck,         ///< no step lowers the cost, and the linear system does not say why
};

/// What became of a map. Costs are sums over the observations of their squared errors, in standard
/// deviations, or of Huber's function of them.
struct map_report {
  map_outcome outcome = map_outcome::converged;
  double first_cost = 0;
  double last_cost = 0;   ///< at most first_cost
  double first_chi2 = 0;  ///< without Huber's kernel, of observations with an image
  double last_chi2 = 0;
  int first_without_image = 0;  ///< observations whose point the camera cannot see
  int last_without_image = 0;
  int steps = 0;               ///< that were tried, refused ones included
  int refused = 0;             ///< of them
  long long solver_steps = 0;  ///< of conjugate gradients, in all of them
  std::size_t bytes = 0;       ///< of executor memory
};

/// @throws bad_argument for a number out of range
inline void check(map_params const& p) {
  detail::require_range("steps of a map's adjustment", p.steps, 0, 10000);
  detail::require_range("enough of a map's adjustment", p.enough, 0.0, 1.0);
  detail::require_range("first_damping of a map's adjustment", p.first_damping, 0.0, 1e9);
  detail::require_range("huber of a map's adjustment", p.huber, 0.0, 1e50);
  detail::require_range("no_image of a map's adjustment", p.no_image, 0.0, 1e50);
  detail::require_range("solver_steps of a map's adjustment", p.solver_steps, 1, 100000);
  detail::require_range("solver_enough of a map's adjustment", p.solver_enough, 0.0, 1.0);
}

/// Bundle adjustment: moves the views of a map that are not fixed, and its points, so that the cost
/// of its observations, with their right images, is as low as near the start. Cameras stay as they
/// are. By Levenberg's and Marquardt's method, points eliminated, the views' system by
/// preconditioned conjugate gradients. Equal bits on every executor. Allocates, and returns when
/// all is done. Memory: linear in views, points and observations, about 150 bytes an observation.
///
/// Fixed views give the frame and, two of them or right images, the scale. With one fixed view and
/// no right image damping keeps the scale near the start.
/// @param map its views and points get the result
/// @throws bad_argument for an invalid map; std::bad_alloc, cuda_error
template <typename Exec, typename Camera>
map_report adjust_map(Exec const& exec, bundle<Camera>& map, map_params const& params = {}) {
  static_assert(assert_camera_model<Camera>::value, "a bundle's camera keeps the camera contract");
  check(params);
  check(map);
  map_report report;
  if (map.observing_view.empty()) { return report; }
  detail::bundle_solver<Exec, Camera> solver(
      exec, map, {{params.huber, params.no_image}, {params.solver_steps, params.solver_enough}});
  report.bytes = solver.bytes();
  auto const first = solver.measure();
  auto const found =
      detail::descend(solver, first, {params.steps, params.enough, params.first_damping});
  report.outcome = found.converged              ? map_outcome::converged
                   : found.steps < params.steps ? map_outcome::stuck
                                                : map_outcome::out_of_steps;
  report.first_cost = first.cost;
  report.last_cost = found.best.cost;
  report.first_chi2 = first.chi2;
  report.last_chi2 = found.best.chi2;
  report.first_without_image = static_cast<int>(first.without_image);
  report.last_without_image = static_cast<int>(found.best.without_image);
  report.steps = found.steps;
  report.refused = found.refused;
  report.solver_steps = solver.solver_steps();
  solver.download(map);
  return report;
}

}  // namespace FT_ABI
}  // namespace ft
