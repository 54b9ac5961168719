// SPDX-License-Identifier: Apache-2.0
// The GPS and IMU of KITTI's raw recordings, and where they are.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <system_error>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

namespace fs = std::filesystem;

/// The numbers after "key:", which are `count`. @throws seq::error
std::vector<double> numbers_of(std::string const& path, std::string const& key, std::size_t count) {
  for (text_line const& line : read_lines(path)) {
    if (line.text.compare(0, key.size() + 1, key + ":") != 0) { continue; }
    std::vector<double> values;
    for (std::string const& word : split(line.text.substr(key.size() + 1), " \t", true)) {
      values.push_back(finite_number(word, path, line.number));
    }
    if (values.size() != count) {
      fail_at(path, line.number,
              key + " has " + std::to_string(values.size()) + " numbers, must have " +
                  std::to_string(count));
    }
    return values;
  }
  throw error(path + ": " + key + ": line is missing");
}

Eigen::Matrix3d rotation_of(std::string const& path, std::string const& key) {
  using rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  std::vector<double> const values = numbers_of(path, key, 9);
  return checked_rotation(Eigen::Map<rows const>(values.data()), path, key);
}

/// The lines R and T of a file.
Eigen::Isometry3d rigid_of(std::string const& path) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = rotation_of(path, "R");
  std::vector<double> const t = numbers_of(path, "T", 3);
  T.translation() = Eigen::Vector3d(t[0], t[1], t[2]);
  return T;
}

/// latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad) of a file of one line.
std::vector<double> oxts_packet(std::string const& path) {
  std::vector<text_line> const lines = read_lines(path);
  if (lines.empty()) { throw error(path + ": is empty"); }
  std::vector<std::string> const words = split(lines[0].text, " \t", true);
  if (words.size() < 6) {
    fail_at(path, 1,
            std::to_string(words.size()) +
                " numbers, must have at least 6 (lat lon alt roll pitch yaw)");
  }
  std::vector<double> values;
  for (std::size_t i = 0; i < 6; ++i) { values.push_back(finite_number(words[i], path, 1)); }
  check_number(values[0], {-89, 89}, path, "lat");
  check_number(values[1], {-360, 360}, path, "lon");
  return values;
}

}  // namespace

std::vector<std::int64_t> read_dates(std::string const& path) {
  std::vector<std::int64_t> times;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    times.push_back(date_to_ns(line.text, path, line.number));
  }
  return times;
}

trajectory read_oxts(fs::path const& folder, std::vector<std::string>& warnings) {
  std::vector<std::int64_t> const times = read_dates((folder / "timestamps.txt").string());
  // The formulas are those of the raw data's development kit, readme.txt and convertOxtsToPose.m
  // (https://www.cvlibs.net/datasets/kitti/raw_data.php): a Mercator projection whose scale is that
  // of the first latitude; x to the east, y to the north, z up.
  constexpr double earth_radius = 6378137;  // m
  double const degree = std::acos(-1.0) / 180;
  double scale = 0;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::vector<std::int64_t> taken_times;
  trajectory poses;
  for (auto const& [number, file] : list_numbered(folder / "data", ".txt")) {
    auto const i = static_cast<std::size_t>(number);
    if (i >= times.size()) {
      throw error((folder / "timestamps.txt").string() + ": " + std::to_string(times.size()) +
                  " times, none for " + file);
    }
    std::vector<double> const v = oxts_packet(file);
    bool const first = poses.empty();
    if (first) { scale = std::cos(v[0] * degree); }
    Eigen::Vector3d const place(scale * earth_radius * v[1] * degree,
                                scale * earth_radius * std::log(std::tan((90 + v[0]) * degree / 2)),
                                v[2]);
    if (first) { origin = place; }
    stamped_pose pose{times[i]};
    pose.T_world_camera.linear() = (Eigen::AngleAxisd(v[5], Eigen::Vector3d::UnitZ()) *
                                    Eigen::AngleAxisd(v[4], Eigen::Vector3d::UnitY()) *
                                    Eigen::AngleAxisd(v[3], Eigen::Vector3d::UnitX()))
                                       .toRotationMatrix();
    pose.T_world_camera.translation() = place - origin;
    taken_times.push_back(pose.time_ns);
    poses.push_back(pose);
  }
  trajectory taken;
  for (std::size_t const i :
       ordered_lines(taken_times, disordered::left_out, (folder / "timestamps.txt").string(),
                     "poses", warnings)) {
    taken.push_back(poses[i]);
  }
  return taken;
}

std::optional<Eigen::Isometry3d> read_oxts_mount(std::string const& cam_to_cam) {
  fs::path const folder = fs::path(cam_to_cam).parent_path();
  std::string const imu = (folder / "calib_imu_to_velo.txt").string();
  std::string const velodyne = (folder / "calib_velo_to_cam.txt").string();
  if (!is_file(imu) || !is_file(velodyne)) { return std::nullopt; }
  Eigen::Isometry3d T_reference_cam0 = Eigen::Isometry3d::Identity();
  T_reference_cam0.linear() = rotation_of(cam_to_cam, "R_rect_00");
  return (T_reference_cam0 * rigid_of(velodyne) * rigid_of(imu)).inverse();
}

}  // namespace seq::detail
