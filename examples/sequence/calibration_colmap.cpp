// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using namespace detail;

struct colmap_model {
  char const* name;
  lens model;
  std::size_t focal_lengths;
  std::size_t coefficients;  ///< in the file
  std::size_t all;           ///< with the zeros after them
};

constexpr colmap_model colmap_models[] = {{"SIMPLE_PINHOLE", lens::pinhole, 1, 0, 0},
                                          {"PINHOLE", lens::pinhole, 2, 0, 0},
                                          {"SIMPLE_RADIAL", lens::radial_tangential, 1, 1, 4},
                                          {"RADIAL", lens::radial_tangential, 1, 2, 4},
                                          {"OPENCV", lens::radial_tangential, 2, 4, 4},
                                          {"FULL_OPENCV", lens::radial_tangential, 2, 8, 8},
                                          {"SIMPLE_RADIAL_FISHEYE", lens::kannala_brandt, 1, 1, 4},
                                          {"RADIAL_FISHEYE", lens::kannala_brandt, 1, 2, 4},
                                          {"OPENCV_FISHEYE", lens::kannala_brandt, 2, 4, 4}};

struct numbered_camera {
  std::string id;
  camera_intrinsics camera;
};

/// A line "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]". COLMAP's (0.5, 0.5) is the centre of the first
/// pixel, which is (0, 0) here.
numbered_camera read_camera(text_line const& line, std::string const& path) {
  std::vector<std::string> const fields = split(line.text, " \t", true);
  if (fields.size() < 4) {
    fail_at(path, line.number, "not of the form CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]");
  }
  auto const model = std::find_if(std::begin(colmap_models), std::end(colmap_models),
                                  [&](colmap_model const& k) { return fields[1] == k.name; });
  if (model == std::end(colmap_models)) {
    std::string names;
    for (colmap_model const& k : colmap_models) {
      names += (names.empty() ? "" : ", ") + std::string(k.name);
    }
    fail_at(path, line.number, "camera model " + fields[1] + ": must be one of " + names);
  }
  std::size_t const wanted = model->focal_lengths + 2 + model->coefficients;
  if (fields.size() != 4 + wanted) {
    fail_at(path, line.number,
            fields[1] + " has " + std::to_string(fields.size() - 4) + " parameters, must have " +
                std::to_string(wanted));
  }
  std::string const where = path + ":" + std::to_string(line.number);
  auto const number = [&](std::size_t i, limits const& range, char const* name) {
    double const value = finite_number(fields[i], path, line.number);
    check_number(value, range, where, name, fields[i]);
    return value;
  };
  numbered_camera result;
  result.id = fields[0];
  camera_intrinsics& camera = result.camera;
  camera.model = model->model;
  camera.width = static_cast<int>(number(2, side_limits, "WIDTH"));
  camera.height = static_cast<int>(number(3, side_limits, "HEIGHT"));
  std::size_t next = 4;
  camera.fx = number(next++, focal_limits, "fx");
  camera.fy = model->focal_lengths == 2 ? number(next++, focal_limits, "fy") : camera.fx;
  camera.cx = number(next++, centre_limits, "cx") - 0.5;
  camera.cy = number(next++, centre_limits, "cy") - 0.5;
  while (next < fields.size()) {
    camera.distortion.push_back(number(next++, coefficient_limits, "distortion coefficient"));
  }
  camera.distortion.resize(model->all);
  drop_zero_distortion(camera);
  return result;
}

numbered_camera const& camera_of(std::vector<numbered_camera> const& all, std::string const& id,
                                 std::string const& path) {
  auto const same = [&](numbered_camera const& c) { return c.id == id; };
  auto const found = std::find_if(all.begin(), all.end(), same);
  if (found == all.end()) { throw error(path + ": camera " + id + " is missing"); }
  if (std::any_of(found + 1, all.end(), same)) {
    throw error(path + ": camera " + id + " is there twice");
  }
  return *found;
}

/// The rig of two cameras of rigs.txt: "RIG_ID NUM_SENSORS REF_TYPE REF_ID", then for each other
/// sensor "TYPE ID HAS_POSE [QW QX QY QZ TX TY TZ]", which maps points of the rig, that is of its
/// first sensor, into this one. Other rigs are left out.
void read_rig(std::string const& path, std::string const& cameras,
              std::vector<numbered_camera> const& all, calibration& result) {
  bool found = false;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const f = split(line.text, " \t", true);
    if (f.size() != 14 || f[1] != "2" || f[2] != "CAMERA" || f[4] != "CAMERA" || f[6] != "1") {
      continue;
    }
    if (found) { fail_at(path, line.number, "a second rig of two cameras: keep the line of one"); }
    found = true;
    double v[7];
    for (std::size_t i = 0; i < 7; ++i) { v[i] = finite_number(f[7 + i], path, line.number); }
    Eigen::Isometry3d T_right_left = Eigen::Isometry3d::Identity();
    T_right_left.linear() =
        unit_quaternion(v[0], v[1], v[2], v[3], path, line.number).toRotationMatrix();
    T_right_left.translation() = Eigen::Vector3d(v[4], v[5], v[6]);
    result.rig.left = camera_of(all, f[3], cameras).camera;
    result.rig.right = camera_of(all, f[5], cameras).camera;
    result.rig.T_left_right = T_right_left.inverse();
  }
  if (!found) {
    throw error(path +
                ": has no rig of two cameras: RIG_ID 2 CAMERA ID CAMERA ID 1 QW QX QY QZ TX TY TZ");
  }
  check_baseline(result.rig, path, "TX TY TZ");
  result.warnings.push_back(path + ": COLMAP's unit of length is that of its reconstruction: " +
                            to_text(result.rig.baseline()) + " is taken for metres");
}

}  // namespace

namespace detail {

bool is_colmap_camera(std::string const& line) {
  std::vector<std::string> const fields = split(line, " \t", true);
  auto const digits = [](std::string const& word) {
    return word.find_first_not_of("0123456789") == std::string::npos;
  };
  return fields.size() > 4 && digits(fields[0]) && digits(fields[2]) && digits(fields[3]) &&
         fields[1].find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789") ==
             std::string::npos &&
         fields[1].find_first_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ") == 0;
}

}  // namespace detail

calibration read_colmap_calibration(std::string const& path, camera_kind kind) {
  std::vector<numbered_camera> cameras;
  for (text_line const& line : read_lines(path)) {
    if (!is_blank_or_comment(line.text)) { cameras.push_back(read_camera(line, path)); }
  }
  if (cameras.empty()) { throw error(path + ": has no camera"); }
  calibration result;
  if (is_pair(kind)) {
    std::string const rigs = (std::filesystem::path(path).parent_path() / "rigs.txt").string();
    if (!is_file(rigs)) {
      throw error(path +
                  ": does not say where the right camera is: rigs.txt, which COLMAP 3.12 "
                  "and later write, is missing beside it");
    }
    read_rig(rigs, path, cameras, result);
  } else {
    result.rig.left = cameras.front().camera;
    set_one_camera(result.rig, kind);
    if (cameras.size() > 1) {
      result.warnings.push_back(path + ": has " + std::to_string(cameras.size()) +
                                " cameras; the first, " + cameras.front().id + ", is taken");
    }
  }
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace seq
