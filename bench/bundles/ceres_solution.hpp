// SPDX-License-Identifier: Apache-2.0
/// @file Bundles by Ceres Solver: the oracle of tests, and what ft's times are compared with.
#pragma once

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <string>
#include <vector>

#include "ft/cameras/radtan.hpp"
#include "ft/containers/bundle.hpp"

namespace bench {

/// The error of an observation, in standard deviations. Derivatives are Ceres' own.
struct sighting_error {
  ft::radtan4<double> camera;
  ft::vec2<double> pixel;
  double weight;

  template <typename T>
  bool operator()(T const* view, T const* point, T* error) const {
    T p[3];
    ceres::AngleAxisRotatePoint(view, point, p);
    for (int k = 0; k < 3; ++k) { p[k] += view[3 + k]; }
    if (p[2] <= 0.0) { return false; }  // refuses the step
    T const x = p[0] / p[2];
    T const y = p[1] / p[2];
    T const r2 = x * x + y * y;
    double const* const d = camera.distortion;
    T const c = 1.0 + r2 * (d[0] + r2 * d[1]);
    T const u = c * x + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x);
    T const v = c * y + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y;
    error[0] = weight * (camera.fx * u + camera.cx - pixel.x);
    error[1] = weight * (camera.fy * v + camera.cy - pixel.y);
    return true;
  }
};

/// The same of a rectified pair: its third number is that of the column in the right image.
struct pair_error {
  sighting_error left;
  sighting_error right;  ///< its `pixel` has this column
  double baseline;

  template <typename T>
  bool operator()(T const* view, T const* point, T* error) const {
    T moved[6];
    std::copy(view, view + 6, moved);
    moved[3] = moved[3] - baseline;
    T other[2];
    if (!left(view, point, error) || !right(moved, point, other)) { return false; }
    error[2] = other[0];
    return true;
  }
};

struct bundle_solution {
  double cost;  ///< as ft counts it: twice Ceres'
  int steps;
  double milliseconds;  ///< construction included
  std::string message;
};

struct ceres_choice {
  bool iterative = true;  ///< Schur complement by conjugate gradients; false: factored, to the end
  int threads = 1;
  double huber = 0;
};

/// Moves views and points to the minimum near them.
inline bundle_solution solve_by_ceres(ft::bundle<ft::radtan4<double>>& map,
                                      ceres_choice const& choice) {
  auto const begin = std::chrono::steady_clock::now();
  std::vector<std::array<double, 6>> views(map.T_cw.size());
  for (std::size_t v = 0; v < views.size(); ++v) {
    ft::rigid<double> const& T = map.T_cw[v];
    ceres::RotationMatrixToAngleAxis(ceres::RowMajorAdapter3x3(T.R.m), views[v].data());
    views[v][3] = T.t.x;
    views[v][4] = T.t.y;
    views[v][5] = T.t.z;
  }
  ceres::Problem problem;
  for (std::size_t o = 0; o < map.pixel.size(); ++o) {
    auto const v = static_cast<std::size_t>(map.observing_view[o]);
    auto const camera =
        static_cast<std::size_t>(map.camera_of_view.empty() ? 0 : map.camera_of_view[v]);
    sighting_error const error{map.cameras[camera], map.pixel[o],
                               1 / (map.sigma.empty() ? 1 : map.sigma[o])};
    ceres::CostFunction* cost = nullptr;
    if (ft::detail::has_right(map, o)) {
      sighting_error right = error;
      right.pixel.x = map.right_x[o];
      cost = new ceres::AutoDiffCostFunction<pair_error, 3, 6, 3>(
          new pair_error{error, right, map.baseline[camera]});
    } else {
      cost = new ceres::AutoDiffCostFunction<sighting_error, 2, 6, 3>(new sighting_error(error));
    }
    problem.AddResidualBlock(cost, choice.huber > 0 ? new ceres::HuberLoss(choice.huber) : nullptr,
                             views[v].data(),
                             &map.position[static_cast<std::size_t>(map.observed_point[o])].x);
  }
  ceres::Solver::Options options;
  options.linear_solver_ordering.reset(new ceres::ParameterBlockOrdering);
  for (auto& X : map.position) { options.linear_solver_ordering->AddElementToGroup(&X.x, 0); }
  bool const anchored =
      std::any_of(map.fixed.begin(), map.fixed.end(), [](unsigned char f) { return f != 0; });
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!problem.HasParameterBlock(views[v].data())) { continue; }
    options.linear_solver_ordering->AddElementToGroup(views[v].data(), 1);
    if (anchored ? map.fixed[v] != 0 : v == 0) {
      problem.SetParameterBlockConstant(views[v].data());
    }
  }
  options.linear_solver_type = choice.iterative ? ceres::ITERATIVE_SCHUR : ceres::DENSE_SCHUR;
  options.preconditioner_type = ceres::SCHUR_JACOBI;
  options.num_threads = choice.threads;
  options.max_num_iterations = 200;
  if (!choice.iterative) {
    options.function_tolerance = 1e-12;
    options.gradient_tolerance = 1e-14;
    options.parameter_tolerance = 1e-14;
  }
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  bundle_solution const found{
      2 * summary.final_cost, static_cast<int>(summary.iterations.size()) - 1,
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count(),
      ceres::TerminationTypeToString(summary.termination_type)};
  for (std::size_t v = 0; v < views.size(); ++v) {
    ft::rigid<double>& T = map.T_cw[v];
    ceres::AngleAxisToRotationMatrix(views[v].data(), ceres::RowMajorAdapter3x3(T.R.m));
    T.t = {views[v][3], views[v][4], views[v][5]};
  }
  return found;
}

}  // namespace bench
