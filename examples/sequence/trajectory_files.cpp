// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <cinttypes>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <locale>
#include <string>
#include <vector>

#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/evaluation.hpp"

namespace seq {
namespace {

/// A file for numbers with nine decimals, and a point in any locale. @throws seq::error
std::ofstream opened(std::string const& path) {
  std::ofstream out(path, std::ios::binary);
  if (!out) { throw error(path + ": cannot be written"); }
  out.imbue(std::locale::classic());
  out.precision(9);
  return out;
}

}  // namespace

trajectory read_tum(std::string const& path, std::vector<std::string>* warnings) {
  std::vector<std::int64_t> times;
  trajectory poses;
  std::size_t read = 0;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const words = detail::split(line.text, " \t", true);
    if (words.size() != 8) {
      detail::fail_at(
          path, line.number,
          std::to_string(words.size()) + " numbers, must have 8 (time tx ty tz qx qy qz qw)");
    }
    ++read;
    if (warnings != nullptr && detail::is_no_pose(words.data() + 1)) { continue; }
    stamped_pose pose;
    pose.T_world_camera = detail::pose_of_fields(words.data() + 1, detail::quaternion_order::w_last,
                                                 path, line.number);
    times.push_back(detail::seconds_to_ns(words[0], path, line.number));
    pose.time_ns = times.back();
    poses.push_back(pose);
  }
  std::vector<std::string> ignored;
  if (warnings != nullptr) { detail::say_no_poses(path, read - poses.size(), read, *warnings); }
  trajectory taken;
  for (std::size_t const i : detail::ordered_lines(times, detail::disordered::sorted, path, "poses",
                                                   warnings != nullptr ? *warnings : ignored)) {
    taken.push_back(poses[i]);
  }
  return taken;
}

void write_tum(std::string const& path, trajectory const& poses, std::string const& of) {
  std::ofstream out = opened(path);
  out << std::fixed << "# time tx ty tz qx qy qz qw (seconds, metres; " << of << " to world)\n";
  for (stamped_pose const& pose : poses) {
    Eigen::Vector3d const t = pose.T_world_camera.translation();
    Eigen::Quaterniond q(pose.T_world_camera.linear());
    q.normalize();
    if (q.w() < 0) { q.coeffs() = -q.coeffs(); }
    constexpr std::int64_t second = 1'000'000'000;
    bool const negative = pose.time_ns < 0;
    std::int64_t const whole = pose.time_ns / second;
    std::int64_t const part = pose.time_ns % second;
    char stamp[48];
    std::snprintf(stamp, sizeof stamp, "%s%" PRId64 ".%09" PRId64, negative ? "-" : "",
                  negative ? -whole : whole, negative ? -part : part);
    double const numbers[] = {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
    if (!t.allFinite() || !q.coeffs().allFinite()) {
      throw error(path + ": pose at " + stamp + " s is not finite");
    }
    out << stamp;
    for (double const number : numbers) { out << ' ' << number; }
    out << '\n';
  }
  out.flush();
  if (!out) { throw error(path + ": write failed (disk full?)"); }
}

void write_kitti_poses(std::string const& path, trajectory const& poses) {
  std::ofstream out = opened(path);
  out << std::scientific;
  for (stamped_pose const& pose : poses) {
    for (int i = 0; i < 12; ++i) {
      double const value = pose.T_world_camera.matrix()(i / 4, i % 4);
      if (!std::isfinite(value)) { throw error(path + ": a pose is not finite"); }
      out << (i == 0 ? "" : " ") << value;
    }
    out << '\n';
  }
  out.flush();
  if (!out) { throw error(path + ": write failed (disk full?)"); }
}

trajectory poses_of(trajectory const& cameras, Eigen::Isometry3d const& T_camera_other) {
  trajectory poses = cameras;
  for (stamped_pose& pose : poses) { pose.T_world_camera = pose.T_world_camera * T_camera_other; }
  return poses;
}

}  // namespace seq
