// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using namespace detail;

/// Metres per unit, of a comment that says "depth in units of 1 mm"; 0 for another comment.
double depth_unit_of(text_line const& line, std::string const& path) {
  std::string const begin = "depth in units of";
  std::size_t const at = line.text.find(begin);
  if (at == std::string::npos) { return 0; }
  std::vector<std::string> const words = split(line.text.substr(at + begin.size()), " \t,;", true);
  if (words.size() < 2) {
    fail_at(path, line.number, "'" + begin + "' needs a number and m or mm");
  }
  double const number = finite_number(words[0], path, line.number);
  for (auto const& [name, metres] :
       {std::pair<char const*, double>{"m", 1}, {"cm", 1e-2}, {"mm", 1e-3}, {"um", 1e-6}}) {
    if (words[1] != name) { continue; }
    check_number(number * metres, depth_unit_limits, path, "depth unit");
    return number * metres;
  }
  fail_at(path, line.number, "depth in units of '" + words[1] + "': must be m, cm, mm or um");
}

}  // namespace

calibration read_camera_txt(std::string const& path, int width, int height, camera_kind kind) {
  calibration result;
  camera_intrinsics& camera = result.rig.left;
  bool found = false;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) {
      double const unit = depth_unit_of(line, path);
      if (unit > 0) { result.depth_unit = unit; }
      continue;
    }
    if (found) { fail_at(path, line.number, "a second camera; one line of numbers is expected"); }
    found = true;
    std::vector<double> values;
    try {
      for (std::string const& word : split(line.text, " \t,", true)) {
        values.push_back(finite_number(word, path, line.number));
      }
    } catch (error const& e) {
      throw error(std::string(e.what()) + "; must be fx fy cx cy [k1 k2 p1 p2 [k3 [k4 k5 k6]]]");
    }
    std::size_t const n = values.size();
    if (n != 4 && n != 8 && n != 9 && n != 12) {
      fail_at(path, line.number,
              std::to_string(n) +
                  " numbers, must have 4 (fx fy cx cy), 8, 9 or 12 (and k1 k2 p1 "
                  "p2 [k3 [k4 k5 k6]])");
    }
    camera.fx = values[0];
    camera.fy = values[1];
    camera.cx = values[2];
    camera.cy = values[3];
    if (n == 4 && camera.fy < 0) {
      camera.fy = -camera.fy;
      result.y_up = true;
      result.warnings.push_back(
          path + ": fy is " + to_text(-camera.fy) +
          ", as ICL-NUIM has it, whose y axis points up: " + to_text(camera.fy) +
          " is taken, and poses of the ground truth are mirrored in y");
    }
    if (n > 4) { camera.model = lens::radial_tangential; }
    camera.distortion.assign(values.begin() + 4, values.end());
    drop_zero_distortion(camera);
  }
  if (!found) { throw error(path + ": no line with fx fy cx cy"); }
  camera.width = width;
  camera.height = height;
  set_one_camera(result.rig, kind);
  check_rig(result.rig, path, kind);
  return result;
}

calibration published_tum_calibration(int camera, camera_kind kind) {
  // https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats, "Calibration of the color
  // camera": fx, fy, cx, cy, then k1, k2, p1, p2, k3. The depth images are registered to the colour
  // images, and their scale is corrected already. Images of freiburg3 are undistorted.
  constexpr double published[3][9] = {
      {517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633},
      {520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172},
      {535.4, 539.2, 320.1, 247.6, 0, 0, 0, 0, 0}};
  double const(&v)[9] = published[camera - 1];
  calibration result;
  result.rig.left = {lens::radial_tangential, 640, 480, v[0], v[1], v[2], v[3], {v + 4, v + 9}};
  drop_zero_distortion(result.rig.left);
  set_one_camera(result.rig, kind);
  result.warnings.push_back(
      "the recording holds no calibration: the one that TUM publishes of freiburg" +
      std::to_string(camera) +
      " is taken, by the recording's name; a camera.txt, or --calibration, says another");
  return result;
}

}  // namespace seq
