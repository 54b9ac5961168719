// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/evaluation.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

/// An estimated pose and the ground truth at the same time.
struct matched_pose {
  std::int64_t time_ns = 0;
  Eigen::Isometry3d truth = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d estimate = Eigen::Isometry3d::Identity();
};

/// The poses for which there is ground truth, with it.
std::vector<matched_pose> match(trajectory const& estimate, trajectory const& truth) {
  std::vector<matched_pose> pairs;
  for (auto const& pose : estimate) {
    if (auto const at = interpolate(truth, pose.time_ns)) {
      pairs.push_back({pose.time_ns, *at, pose.T_world_camera});
    }
  }
  return pairs;
}

/// Largest difference between the RPE interval and the time between two poses, as a share of the
/// interval.
constexpr double interval_tolerance = 0.1;

/// A square matrix needs no step before it, and the compiler half the time without.
using svd3 = Eigen::JacobiSVD<Eigen::Matrix3d, Eigen::NoQRPreconditioner>;

/// Closest rotation in the least-squares sense; the identity if `m` does not determine it.
Eigen::Matrix3d nearest_rotation(Eigen::Matrix3d const& m) {
  svd3 const svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  if (!(svd.singularValues()(1) > 1e-9)) { return Eigen::Matrix3d::Identity(); }
  Eigen::Vector3d sign = Eigen::Vector3d::Ones();
  sign.z() = svd.matrixU().determinant() * svd.matrixV().determinant() < 0 ? -1 : 1;
  return svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
}

/// A rotation, and how far positions spread that determine it.
struct rotation_fit {
  Eigen::Matrix3d R;
  /// Metres, along the weaker of the two directions that fix R; infinite where orientations do.
  double spread = std::numeric_limits<double>::infinity();
  Eigen::Vector3d stronger = Eigen::Vector3d::Zero();  ///< the other one, in the truth's world
};

/// Rotation R that maximises sum truth_i . R estimate_i over centred points (Kabsch, Umeyama).
///
/// @param covariance sum of truth_i estimate_i^T, m^2
/// @param prior fixes the degrees of freedom that the points leave open: the rotation about the
///   line of collinear points, or all of it for points that coincide
rotation_fit best_rotation(Eigen::Matrix3d const& covariance, double count,
                           Eigen::Matrix3d const& prior) {
  constexpr double coincident = 1e-12;  // m^2: all within a micrometre
  constexpr double collinear = 1e-9;    // of the largest singular value
  svd3 const svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d const s = svd.singularValues();
  if (!(s(0) > coincident * count)) { return {prior}; }
  if (s(1) <= collinear * s(0)) {
    Eigen::Vector3d const to = svd.matrixU().col(0);
    Eigen::Vector3d const from = prior * svd.matrixV().col(0);
    return {shortest_rotation(from, to) * prior, std::sqrt(s(0) / count), Eigen::Vector3d::Zero()};
  }
  return {nearest_rotation(covariance / s(0)), std::sqrt(s(1) / count), svd.matrixU().col(0)};
}

/// Of positions: means, and the sum of truth_i estimate_i^T about them, m^2.
struct moments {
  Eigen::Vector3d truth_mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d estimate_mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

moments moments_of(std::vector<matched_pose> const& pairs) {
  moments m;
  for (matched_pose const& p : pairs) {
    m.truth_mean += p.truth.translation();
    m.estimate_mean += p.estimate.translation();
  }
  m.truth_mean /= static_cast<double>(pairs.size());
  m.estimate_mean /= static_cast<double>(pairs.size());
  for (matched_pose const& p : pairs) {
    m.covariance += (p.truth.translation() - m.truth_mean) *
                    (p.estimate.translation() - m.estimate_mean).transpose();
  }
  return m;
}

/// @param fit gets the alignment's rotation
Eigen::Isometry3d align(std::vector<matched_pose> const& pairs, bool orientation,
                        rotation_fit& fit) {
  double const n = static_cast<double>(pairs.size());
  moments const m = moments_of(pairs);
  Eigen::Matrix3d rotation_sum = Eigen::Matrix3d::Zero();
  for (matched_pose const& p : pairs) {
    rotation_sum += p.truth.linear() * p.estimate.linear().transpose();
  }
  Eigen::Matrix3d const prior =
      orientation ? nearest_rotation(rotation_sum / n) : Eigen::Matrix3d::Identity();
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  fit = best_rotation(m.covariance, n, prior);
  result.linear() = fit.R;
  result.translation() = m.truth_mean - result.linear() * m.estimate_mean;
  return result;
}

/// Two matched poses about the RPE interval apart.
struct pose_step {
  std::size_t from, to;
};

/// For each pose the one nearest to `interval_ns` later, within interval_tolerance.
std::vector<pose_step> steps_over(std::vector<matched_pose> const& pairs,
                                  std::int64_t interval_ns) {
  double const tolerance = interval_tolerance * static_cast<double>(interval_ns);
  std::vector<pose_step> steps;
  std::size_t j = 0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    std::int64_t const wanted = pairs[i].time_ns + interval_ns;
    auto const distance = [&](std::size_t k) {
      return std::fabs(static_cast<double>(pairs[k].time_ns - wanted));
    };
    while (j + 1 < pairs.size() && distance(j + 1) <= distance(j)) { ++j; }
    // At the end of the path the nearest pose is always the last one; for shorter intervals it is
    // not.
    bool const past_end =
        j + 1 == pairs.size() && wanted > pairs[j].time_ns && distance(j) > 0.1 * tolerance;
    if (distance(j) <= tolerance && !past_end) { steps.push_back({i, j}); }
  }
  return steps;
}

double root_mean_square(double sum, std::size_t count) {
  return std::sqrt(sum / static_cast<double>(count));
}

/// What the estimate of the motion between two poses misses.
Eigen::Isometry3d missed_motion(matched_pose const& a, matched_pose const& b) {
  return (a.truth.inverse() * b.truth).inverse() * (a.estimate.inverse() * b.estimate);
}

/// The relative errors; nothing without steps.
void add_relative_errors(std::vector<matched_pose> const& pairs,
                         std::vector<pose_step> const& steps, bool orientation,
                         trajectory_error& result) {
  if (steps.empty()) { return; }
  double translations = 0;
  double rotations = 0;
  bool equal_spans = true;
  std::size_t const span = steps.front().to - steps.front().from;
  for (pose_step const& s : steps) {
    matched_pose const& a = pairs[s.from];
    matched_pose const& b = pairs[s.to];
    equal_spans = equal_spans && s.to - s.from == span;
    if (orientation) {
      Eigen::Isometry3d const miss = missed_motion(a, b);
      translations += miss.translation().squaredNorm();
      double const angle = angle_deg(miss.linear());
      rotations += angle * angle;
    } else {
      double const miss = (b.truth.translation() - a.truth.translation()).norm() -
                          (b.estimate.translation() - a.estimate.translation()).norm();
      translations += miss * miss;
    }
  }
  result.rpe_rmse_m = root_mean_square(translations, steps.size());
  if (orientation) { result.rpe_rotation_rmse_deg = root_mean_square(rotations, steps.size()); }
  if (equal_spans && steps.size() + span == pairs.size()) {
    result.rpe_span = static_cast<int>(span);
  }
}

/// The drift; from each pose to the first one that is a stretch further along the path.
void add_drift(std::vector<matched_pose> const& pairs, trajectory_error& result) {
  constexpr double least_m = 0.1;
  double const stretch = result.truth_path_m / 10;
  if (!(stretch >= least_m)) { return; }
  std::vector<double> along{0};
  for (std::size_t i = 1; i < pairs.size(); ++i) {
    along.push_back(along.back() +
                    (pairs[i].truth.translation() - pairs[i - 1].truth.translation()).norm());
  }
  double sum = 0;
  std::size_t count = 0;
  std::size_t j = 0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    while (j < pairs.size() && along[j] - along[i] < stretch) { ++j; }
    if (j == pairs.size()) { break; }
    sum += missed_motion(pairs[i], pairs[j]).translation().norm() / (along[j] - along[i]);
    ++count;
  }
  if (count > 0) { result.drift_percent = 100 * sum / static_cast<double>(count); }
}

/// The errors after the alignment. Its rotation is not determined where positions spread no more
/// in the weaker direction than they err across the stronger one.
void add_absolute_errors(std::vector<matched_pose> const& pairs, bool orientation,
                         rotation_fit const& fit, trajectory_error& result) {
  Eigen::Array3d translations = Eigen::Array3d::Zero();
  double across = 0;
  double rotations = 0;
  for (matched_pose const& p : pairs) {
    Eigen::Isometry3d const aligned = result.T_truth_estimate * p.estimate;
    Eigen::Vector3d const miss = p.truth.translation() - aligned.translation();
    translations += miss.array().square();
    across += (miss - miss.dot(fit.stronger) * fit.stronger).squaredNorm();
    double const angle = angle_deg(p.truth.linear().transpose() * aligned.linear());
    rotations += angle * angle;
  }
  result.ate_rmse_m = root_mean_square(translations.sum(), pairs.size());
  result.ate_axes_m = (translations / static_cast<double>(pairs.size())).sqrt().matrix();
  if (!orientation) { return; }
  double const error_across = root_mean_square(across, pairs.size());
  if (fit.spread > error_across) {
    result.ate_rotation_rmse_deg = root_mean_square(rotations, pairs.size());
  } else {
    result.ate_rotation_missing =
        "the alignment is not determined: positions spread by " + detail::to_text(fit.spread) +
        " m in the weaker direction, and err by " + detail::to_text(error_across) + " m there";
  }
}

void check_sorted_and_finite(trajectory const& poses, char const* what) {
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (!poses[i].T_world_camera.matrix().allFinite()) {
      throw error(std::string("evaluation: pose ") + std::to_string(i) + " of the " + what +
                  " is not finite");
    }
    if (i > 0 && poses[i].time_ns <= poses[i - 1].time_ns) {
      throw error(std::string("evaluation: time stamps of the ") + what +
                  " must increase, but do not at pose " + std::to_string(i));
    }
  }
}

}  // namespace

trajectory at_times_of(trajectory const& poses, trajectory const& reference) {
  trajectory found;
  for (stamped_pose const& pose : poses) {
    if (auto const at = interpolate(reference, pose.time_ns)) {
      found.push_back({pose.time_ns, *at});
    }
  }
  return found;
}

double angle_deg(Eigen::Matrix3d const& R) {
  constexpr double degree = 180.0 / 3.14159265358979323846;
  return degree * Eigen::AngleAxisd(R).angle();
}

std::optional<Eigen::Isometry3d> interpolate(trajectory const& reference, std::int64_t time_ns,
                                             std::int64_t max_gap_ns) {
  auto const next = std::lower_bound(
      reference.begin(), reference.end(), time_ns,
      [](stamped_pose const& pose, std::int64_t time) { return pose.time_ns < time; });
  if (next == reference.end()) { return std::nullopt; }
  if (next->time_ns == time_ns) { return next->T_world_camera; }
  if (next == reference.begin()) { return std::nullopt; }
  stamped_pose const& a = *(next - 1);
  stamped_pose const& b = *next;
  std::int64_t const gap = b.time_ns - a.time_ns;
  if (gap > max_gap_ns) { return std::nullopt; }
  double const share = static_cast<double>(time_ns - a.time_ns) / static_cast<double>(gap);
  Eigen::Quaterniond const qa(a.T_world_camera.linear());
  Eigen::Quaterniond const qb(b.T_world_camera.linear());
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = qa.slerp(share, qb).normalized().toRotationMatrix();
  pose.translation() =
      (1 - share) * a.T_world_camera.translation() + share * b.T_world_camera.translation();
  return pose;
}

std::optional<scale_fit> fit_scale(trajectory const& estimate, trajectory const& truth) {
  std::vector<matched_pose> const pairs = match(estimate, truth);
  if (pairs.size() < 3) { return std::nullopt; }
  moments const m = moments_of(pairs);
  double spread = 0;
  double truth_spread = 0;
  double size = 0;
  for (matched_pose const& p : pairs) {
    spread += (p.estimate.translation() - m.estimate_mean).squaredNorm();
    truth_spread += (p.truth.translation() - m.truth_mean).squaredNorm();
    size += p.estimate.translation().squaredNorm() + p.truth.translation().squaredNorm();
  }
  // One of them stands still, but for rounding.
  if (!(std::min(spread, truth_spread) > 1e-24 * size)) { return std::nullopt; }
  // Umeyama 1991, equation 42
  svd3 const svd(m.covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d const s = svd.singularValues();
  bool const mirrored = svd.matrixU().determinant() * svd.matrixV().determinant() < 0;
  double const scale = (s.x() + s.y() + (mirrored ? -s.z() : s.z())) / spread;
  // 0 if the truth stands still, not finite if the estimate does
  if (!std::isfinite(scale) || !(scale > 0)) { return std::nullopt; }
  auto const n = static_cast<double>(pairs.size());
  double const left =
      std::max(0.0, truth_spread - scale * scale * spread);  // of the same alignment
  return scale_fit{scale, static_cast<int>(pairs.size()), std::sqrt(spread / n),
                   std::sqrt(left / n)};
}

bool scale_fit::same_shape() const {
  constexpr int least_pairs = 5;
  return pairs >= least_pairs && error_m < 0.25 * scale * spread_m;
}

bool scale_fit::off_by(double most) const {
  bool const off = scale > 1 + most || scale < 1 / (1 + most);
  return off && same_shape() && error_m < 0.5 * std::fabs(1 - scale) * spread_m;
}

std::optional<double> scale_to(trajectory const& estimate, trajectory const& truth) {
  auto const fit = fit_scale(estimate, truth);
  return fit ? std::optional<double>(fit->scale) : std::nullopt;
}

trajectory scaled(trajectory const& poses, double scale) {
  trajectory result = poses;
  for (auto& pose : result) { pose.T_world_camera.translation() *= scale; }
  return result;
}

trajectory_error evaluate(trajectory const& estimate, trajectory const& truth, bool orientation,
                          double rpe_interval_s) {
  if (!(rpe_interval_s > 0) || !(rpe_interval_s <= 1e6)) {
    throw error("evaluation: rpe_interval_s = " + detail::to_text(rpe_interval_s) +
                ": must be above 0 and at most 1e6");
  }
  check_sorted_and_finite(estimate, "estimate");
  check_sorted_and_finite(truth, "ground truth");
  trajectory_error result;
  for (std::size_t i = 1; i < estimate.size(); ++i) {
    result.path_m +=
        (estimate[i].T_world_camera.translation() - estimate[i - 1].T_world_camera.translation())
            .norm();
  }
  std::vector<matched_pose> const pairs = match(estimate, truth);
  result.pairs = static_cast<int>(pairs.size());
  for (std::size_t i = 1; i < pairs.size(); ++i) {
    result.truth_path_m += (pairs[i].truth.translation() - pairs[i - 1].truth.translation()).norm();
    result.estimate_path_m +=
        (pairs[i].estimate.translation() - pairs[i - 1].estimate.translation()).norm();
  }
  if (pairs.empty()) { return result; }
  rotation_fit fit;
  result.T_truth_estimate = align(pairs, orientation, fit);
  if (pairs.size() >= 3) { add_absolute_errors(pairs, orientation, fit, result); }
  auto const interval_ns = static_cast<std::int64_t>(std::llround(rpe_interval_s * 1e9));
  add_relative_errors(pairs, steps_over(pairs, interval_ns), orientation, result);
  if (orientation) { add_drift(pairs, result); }
  return result;
}

}  // namespace seq
