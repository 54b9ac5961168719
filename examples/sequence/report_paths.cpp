// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/report_paths.hpp"

#include <algorithm>
#include <cstddef>

namespace seq::detail {

positions finite_positions(trajectory const& poses, Eigen::Isometry3d const& transform) {
  positions out;
  out.reserve(poses.size());
  for (stamped_pose const& p : poses) {
    Eigen::Vector3d const at = transform * p.T_world_camera.translation();
    if (at.allFinite()) { out.emplace_back(p.time_ns, at); }
  }
  return out;
}

std::int64_t bridged_gap(positions const& points) {
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < points.size(); ++i) {
    steps.push_back(points[i].first - points[i - 1].first);
  }
  if (steps.empty()) { return 0; }
  auto const middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return *middle * 5 / 2;
}

trajectory covered(trajectory const& truth, std::vector<frame_record> const& records) {
  if (records.empty()) { return truth; }
  auto const [first, last] = std::minmax_element(
      records.begin(), records.end(),
      [](frame_record const& a, frame_record const& b) { return a.time_ns < b.time_ns; });
  trajectory out;
  for (stamped_pose const& p : truth) {
    if (p.time_ns >= first->time_ns && p.time_ns <= last->time_ns) { out.push_back(p); }
  }
  return out.empty() ? truth : out;
}

}  // namespace seq::detail
