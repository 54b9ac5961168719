// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using namespace detail;

/// The row of 12 numbers after `key`, 3x4.
using projection_matrix = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

/// Intrinsics out of P = K [I | t]; `offset` becomes t.
camera_intrinsics from_projection(projection_matrix const& p, std::string const& path,
                                  std::string const& key, Eigen::Vector3d& offset) {
  check_number(p(0, 0), focal_limits, path, key + "[0] (fx)", to_text(p(0, 0)));
  check_number(p(1, 1), focal_limits, path, key + "[5] (fy)", to_text(p(1, 1)));
  Eigen::Matrix3d const k = p.leftCols<3>();
  double const skew = std::max({std::fabs(k(0, 1)), std::fabs(k(1, 0)), std::fabs(k(2, 0)),
                                std::fabs(k(2, 1)), std::fabs(k(2, 2) - 1)});
  if (!(skew <= 1e-6)) {
    throw error(path + ": " + key + ": not of the form fx 0 cx tx 0 fy cy ty 0 0 1 tz");
  }
  offset = k.inverse() * p.col(3);
  camera_intrinsics camera;
  camera.fx = k(0, 0);
  camera.fy = k(1, 1);
  camera.cx = k(0, 2);
  camera.cy = k(1, 2);
  return camera;
}

/// Says where images are not those that P_rect_0N is for: those of drives named _extract.
void check_rectified_size(std::string const& path, int number, std::string const& text,
                          std::string const& key, int width, int height) {
  std::vector<std::string> const words = split(text, " \t", true);
  if (words.size() != 2 || width == 0) { return; }
  double const w = finite_number(words[0], path, number);
  double const h = finite_number(words[1], path, number);
  if (w == width && h == height) { return; }
  fail_at(path, number,
          key + " is " + to_text(w) + " x " + to_text(h) + ", the images are " +
              size_text(width, height) +
              ": accepted are rectified images, those of a drive named _sync");
}

}  // namespace

calibration read_kitti_calibration(std::string const& path, int width, int height, int left_camera,
                                   camera_kind kind) {
  std::string const left = "P" + std::to_string(left_camera);
  std::string const right = is_pair(kind) ? "P" + std::to_string(left_camera + 1) : left;
  std::map<std::string, projection_matrix> found;
  bool raw = false;
  for (detail::text_line const& line : detail::read_lines(path)) {
    std::size_t const colon = line.text.find(':');
    std::string key =
        colon == std::string::npos ? std::string() : detail::trim(line.text.substr(0, colon));
    if (key == "S_rect_0" + left.substr(1)) {
      check_rectified_size(path, line.number, line.text.substr(colon + 1), key, width, height);
    }
    if (key.compare(0, 8, "P_rect_0") == 0) {  // KITTI raw
      raw = true;
      key = "P" + key.substr(8);
    }
    if (key != left && key != right) {
      continue;  // other cameras, the lidar
    }
    std::vector<std::string> const words = detail::split(line.text.substr(colon + 1), " \t", true);
    if (words.size() != 12) {
      detail::fail_at(path, line.number,
                      key + " has " + std::to_string(words.size()) + " numbers, must have 12");
    }
    projection_matrix p;
    for (int i = 0; i < 12; ++i) {
      p(i / 4, i % 4) =
          detail::finite_number(words[static_cast<std::size_t>(i)], path, line.number);
    }
    if (!found.emplace(key, p).second) {
      detail::fail_at(path, line.number, key + " is given twice");
    }
  }
  for (std::string const& key : {left, right}) {
    if (found.count(key) == 0) { throw error(path + ": " + key + ": line is missing"); }
  }
  calibration result;
  Eigen::Vector3d left_offset;
  Eigen::Vector3d right_offset;
  result.rig.left = from_projection(found[left], path, left, left_offset);
  result.rig.right = from_projection(found[right], path, right, right_offset);
  // x_camera = x_reference + offset for either camera.
  result.rig.T_left_right.translation() = left_offset - right_offset;
  result.T_reference_left.translation() = -left_offset;
  result.rig.left.width = result.rig.right.width = width;
  result.rig.left.height = result.rig.right.height = height;
  if (raw) {
    if (auto const T_imu_reference = read_oxts_mount(path)) {
      result.rig.T_body_left = *T_imu_reference * result.T_reference_left;
      result.has_body_frame = true;
    }
  }
  if (!is_pair(kind)) { set_one_camera(result.rig, kind); }
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace seq
