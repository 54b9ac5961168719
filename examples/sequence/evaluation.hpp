// SPDX-License-Identifier: Apache-2.0
/// @file Trajectory files in TUM format, and the two usual errors against ground truth.
#pragma once

#include <optional>
#include <string>

#include "examples/sequence/types.hpp"

namespace seq {

/// "time tx ty tz qx qy qz qw", seconds with 9 decimals; lines starting with # are comments.
/// @throws seq::error with file and line
trajectory read_tum(std::string const& path);
void write_tum(std::string const& path, trajectory const& poses);

/// Position (and orientation by slerp) of `reference` at `time_ns`, linear between neighbours.
/// Nothing outside its range or inside a gap longer than `max_gap_ns`.
std::optional<Eigen::Isometry3d> interpolate(trajectory const& reference, std::int64_t time_ns,
                                             std::int64_t max_gap_ns = 500'000'000);

struct trajectory_error {
  int pairs = 0;            ///< poses with ground truth
  double path_m = 0;        ///< length of the estimated path (over all estimated poses)
  double truth_path_m = 0;  ///< length of the ground truth's path at the same instants as the pairs
  double estimate_path_m = 0;  ///< length of the estimated path over the pairs
  std::optional<double>
      ate_rmse_m;  ///< after SE(3) alignment (Umeyama/Horn without scale); needs 3 pairs
  std::optional<double>
      rpe_rmse_m;  ///< translation part of relative pose error over `rpe_interval_s`
  Eigen::Isometry3d T_truth_estimate = Eigen::Isometry3d::Identity();  ///< the alignment
};

/// @param orientation ground truth has orientations; without, RPE compares the lengths of the
/// relative
///   translations after alignment
trajectory_error evaluate(trajectory const& estimate, trajectory const& truth, bool orientation,
                          double rpe_interval_s = 1.0);

}  // namespace seq
