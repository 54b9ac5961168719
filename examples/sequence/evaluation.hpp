// SPDX-License-Identifier: Apache-2.0
/// @file Trajectory files in TUM format, and the two usual errors against ground truth.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

/// "time tx ty tz qx qy qz qw", seconds with 9 decimals; lines starting with # are comments. Sorted
/// by time; of lines with one time stamp the first is taken.
/// @param warnings gets a sentence for lines that were left out or out of order
/// @throws seq::error with file and line
trajectory read_tum(std::string const& path, std::vector<std::string>* warnings = nullptr);
/// @param of whose poses they are, for the comment in the first line
void write_tum(std::string const& path, trajectory const& poses, std::string const& of = "camera");

/// KITTI odometry's format: a line of 12 numbers for each pose, 3x4 row-major, without time stamps.
/// @throws seq::error
void write_kitti_poses(std::string const& path, trajectory const& poses);

/// The poses of something that moves with the camera: T_world_camera * T_camera_other for each.
trajectory poses_of(trajectory const& cameras, Eigen::Isometry3d const& T_camera_other);

/// `reference` at the times of `poses`, where it can be interpolated.
trajectory at_times_of(trajectory const& poses, trajectory const& reference);

/// What lengths of `estimate` are multiplied by to fit `truth` best (Umeyama, PAMI 1991); nothing
/// with fewer than 3 poses that have ground truth, or where they do not move.
std::optional<double> scale_to(trajectory const& estimate, trajectory const& truth);

/// How well an estimate fits a ground truth when its lengths are multiplied by what fits best.
struct scale_fit {
  double scale = 1;     ///< that of scale_to()
  int pairs = 0;        ///< poses with ground truth
  double spread_m = 0;  ///< of the estimate, unscaled: RMS distance from its mean
  double error_m = 0;   ///< RMSE that is left
  /// Whether the path has the shape of the truth, so that the scale says something: not of a camera
  /// that stands still, or that was lost.
  bool same_shape() const;
  /// Whether the scale is more than `most` off, as a part of 1, and that is most of the error.
  bool off_by(double most) const;
};
/// Nothing where scale_to() has nothing.
std::optional<scale_fit> fit_scale(trajectory const& estimate, trajectory const& truth);

/// The same poses with all lengths multiplied by `scale`.
trajectory scaled(trajectory const& poses, double scale);

/// Position (and orientation by slerp) of `reference` at `time_ns`, linear between neighbours.
/// Nothing outside its range or inside a gap longer than `max_gap_ns`.
std::optional<Eigen::Isometry3d> interpolate(trajectory const& reference, std::int64_t time_ns,
                                             std::int64_t max_gap_ns = 500'000'000);

/// Angle of a rotation, 0 to 180 degrees.
double angle_deg(Eigen::Matrix3d const& R);

struct trajectory_error {
  int pairs = 0;            ///< poses with ground truth
  double path_m = 0;        ///< length of the estimated path (over all estimated poses)
  double truth_path_m = 0;  ///< length of the ground truth's path at the same instants as the pairs
  double estimate_path_m = 0;  ///< length of the estimated path over the pairs
  std::optional<double>
      ate_rmse_m;  ///< after SE(3) alignment (Umeyama/Horn without scale); needs 3 pairs
  /// The same error along the axes of ground truth's world.
  std::optional<Eigen::Vector3d> ate_axes_m;
  /// Mean error of the translation over stretches of a tenth of ground truth's path, as a share of
  /// their length, percent. Nothing without orientations, and where a stretch is shorter than 0.1
  /// m.
  std::optional<double> drift_percent;
  std::optional<double>
      rpe_rmse_m;  ///< translation part of relative pose error over `rpe_interval_s`
  /// Rotation parts of both errors, degrees; nothing where ground truth has no orientations.
  std::optional<double> ate_rotation_rmse_deg, rpe_rotation_rmse_deg;
  /// Why there is no ate_rotation_rmse_deg though ground truth has orientations; else empty. Poses
  /// that spread less than their error in two directions do not tell how to turn the estimate.
  std::string ate_rotation_missing;
  /// How many pairs of poses a relative error spans, where that is the same everywhere and none of
  /// that span is left out.
  std::optional<int> rpe_span;
  Eigen::Isometry3d T_truth_estimate = Eigen::Isometry3d::Identity();  ///< the alignment
};

/// @param orientation ground truth has orientations; without, RPE compares the lengths of the
/// relative
///   translations after alignment
trajectory_error evaluate(trajectory const& estimate, trajectory const& truth, bool orientation,
                          double rpe_interval_s = 1.0);

}  // namespace seq
