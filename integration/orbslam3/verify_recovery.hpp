// SPDX-License-Identifier: Apache-2.0
/// @file Poses by RANSAC of CPU and GPU, and how far they may be apart.
///
/// The two draw other samples, and the pose is that of six matches: they are not the same. Compared
/// is whether both found one, and two poses of one frame are close to each other.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "integration/orbslam3/recovery_stages.hpp"
#include "integration/orbslam3/verify_report.hpp"

namespace ft {
namespace orbslam3 {

/// One answer, taken out of the caller's variables.
struct pnp_trial {
  int found;  ///< 1, 0, or recovery_refused
  bool no_more;
  std::vector<bool> inliers;
  int count;
  Eigen::Matrix4f T_cw;

  pnp_trial(int answer, pnp_answer const& from)
      : found(answer),
        no_more(from.no_more),
        inliers(from.inliers),
        count(from.count),
        T_cw(from.T_cw) {}
  void keep(pnp_answer const& to) const {
    to.no_more = no_more;
    to.inliers = inliers;
    to.count = count;
    to.T_cw = T_cw;
  }
  Eigen::Vector3f centre() const {
    return -(T_cw.topLeftCorner<3, 3>().transpose() * T_cw.topRightCorner<3, 1>());
  }
};

/// Angle between two rotations, degrees.
inline double degrees_between(pnp_trial const& a, pnp_trial const& b) {
  Eigen::Matrix3d const Ra = a.T_cw.topLeftCorner<3, 3>().cast<double>();
  Eigen::Matrix3d const Rb = b.T_cw.topLeftCorner<3, 3>().cast<double>();
  double const sine = std::min((Ra - Rb).norm() / std::sqrt(8.0), 1.0);  // of half the angle
  return 2 * std::asin(sine) * 180 / 3.14159265358979323846;
}

/// Distance of the cameras, over the median distance of the first one's inliers.
template <typename MapPoint>
double relative_shift(pnp_trial const& a, pnp_trial const& b,
                      std::vector<MapPoint*> const& matches) {
  std::vector<float> away;
  for (std::size_t i = 0; i < matches.size() && i < a.inliers.size(); ++i) {
    if (!a.inliers[i] || matches[i] == nullptr) { continue; }
    away.push_back((matches[i]->GetWorldPos() - a.centre()).norm());
  }
  if (away.empty()) { return 0; }
  auto const middle = away.begin() + static_cast<std::ptrdiff_t>(away.size() / 2);
  std::nth_element(away.begin(), middle, away.end());
  return static_cast<double>((a.centre() - b.centre()).norm() / *middle);
}

/// Adds what is farther apart than other draws explain.
template <typename MapPoint>
void compare_pnp(difference_log& log, tolerances const& allowed, pnp_trial const& cpu,
                 pnp_trial const& gpu, std::vector<MapPoint*> const& matches) {
  log.compare("pose by RANSAC", -1, cpu.found, gpu.found);
  if (cpu.found != 1 || gpu.found != 1) { return; }
  log.compare("inliers by RANSAC", -1, cpu.count, cpu.count, gpu.count,
              allowed.pnp_inliers * std::max(cpu.count, gpu.count));
  log.compare("degrees between poses by RANSAC", -1, 0.0, 0.0, degrees_between(cpu, gpu),
              allowed.pnp_degrees);
  log.compare("relative distance of poses by RANSAC", -1, 0.0, 0.0,
              relative_shift(cpu, gpu, matches), allowed.pnp_shift);
}

}  // namespace orbslam3
}  // namespace ft
