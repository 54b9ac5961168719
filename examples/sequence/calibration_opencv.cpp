// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq {
namespace {

using namespace detail;

using name_list = std::vector<std::string>;

/// The first of the names that is a key of the file; empty without any.
std::string first_of(yaml_file const& file, name_list const& keys) {
  for (std::string const& key : keys) {
    if (file.has(key)) { return key; }
  }
  return {};
}

/// What programs call a matrix of camera `side` (0, 1) of a pair, or of the one of a file (-1).
name_list with_side(name_list const& stems, int side) {
  if (side < 0) { return stems; }
  name_list all;
  for (std::string const& stem : stems) {
    for (char const* word :
         {side == 0 ? "1" : "2", side == 0 ? "_1" : "_2", side == 0 ? "_left" : "_right",
          side == 0 ? "Left" : "Right", side == 0 ? "L" : "R", side == 0 ? "_l" : "_r"}) {
      all.push_back(stem + word);
    }
    all.push_back((side == 0 ? "left_" : "right_") + stem);
  }
  return all;
}

std::string matrix_key(yaml_file const& file, int side) {
  name_list stems = {
      "M",          "K",        "camera_matrix", "cameraMatrix", "CameraMatrix", "Camera_Matrix",
      "intrinsics", "intrinsic"};
  if (side < 0) { stems.push_back("k"); }  // of a ROS 2 message
  return first_of(file, with_side(stems, side));
}

std::string coefficients_key(yaml_file const& file, int side) {
  name_list stems = {"D",          "distortion_coefficients", "distCoeffs", "dist_coeffs",
                     "DistCoeffs", "Distortion_Coefficients", "distortion"};
  if (side < 0) { stems.push_back("d"); }
  return first_of(file, with_side(stems, side));
}

name_list const rotation_names = {"R", "rotation", "Rotation", "rotation_matrix", "R_stereo"};
name_list const translation_names = {
    "T", "t", "translation", "Translation", "translation_vector", "T_stereo"};

bool has_place(yaml_file const& file) {
  return !first_of(file, rotation_names).empty() && !first_of(file, translation_names).empty();
}

/// Nine numbers of a matrix, or of a list as ROS prints messages.
std::vector<double> nine(yaml_file const& file, std::string const& key) {
  int rows = 0;
  int cols = 0;
  std::vector<double> const m = file.matrix(key, rows, cols);
  if (m.size() != 9 || (rows != 3 && rows != 1)) {
    throw error(file.path() + ": " + key + " is " + std::to_string(rows) + " x " +
                std::to_string(cols) + ", must be 3 x 3");
  }
  return m;
}

void read_size(yaml_file const& file, int& width, int& height) {
  std::string const pair =
      first_of(file, {"imageSize", "image_size", "ImageSize", "img_size", "resolution", "size"});
  if (!pair.empty()) {
    std::vector<double> const v = file.list(pair, side_limits);
    if (v.size() != 2) {
      throw error(file.path() + ": " + pair + " has " + std::to_string(v.size()) +
                  " numbers, must have 2");
    }
    width = static_cast<int>(v[0]);
    height = static_cast<int>(v[1]);
    return;
  }
  std::string const w = first_of(file, {"image_width", "image_Width", "width", "imageWidth"});
  std::string const h = first_of(file, {"image_height", "image_Height", "height", "imageHeight"});
  if (w.empty() || h.empty()) { return; }
  width = file.integer(w, side_limits);
  height = file.integer(h, side_limits);
}

/// The model that the file names; empty without a name.
std::string model_in(yaml_file const& file) {
  std::string const named = first_of(file, {"distortion_model", "camera_model", "model"});
  if (!named.empty() && file.text(named) != "pinhole") { return file.text(named); }
  std::string const flag = first_of(file, {"fisheye_model", "fisheye", "is_fisheye"});
  if (flag.empty()) { return {}; }
  std::string const value = file.text(flag);
  bool const is = value != "0" && value != "false" && value != "False";
  return is ? "fisheye" : "plumb_bob";
}

/// Adds head + key + tail; where it is said of the other camera already, that of both.
void warn_of(std::string const& head, std::string const& key, std::string const& tail,
             std::vector<std::string>& warnings) {
  for (std::string& said : warnings) {
    bool const same = said.size() > head.size() + tail.size() &&
                      said.compare(0, head.size(), head) == 0 &&
                      said.compare(said.size() - tail.size(), tail.size(), tail) == 0;
    if (!same) { continue; }
    said.insert(said.size() - tail.size(), " and " + key);
    return;
  }
  warnings.push_back(head + key + tail);
}

camera_intrinsics read_one(yaml_file const& file, int side, int width, int height,
                           std::vector<std::string>& warnings) {
  camera_intrinsics camera;
  read_size(file, width, height);
  if (width == 0 || height == 0) { throw error(file.path() + ": image_width is missing"); }
  camera.width = width;
  camera.height = height;
  std::string const k = matrix_key(file, side);
  if (k.empty()) {
    throw error(file.path() + ": " +
                (side < 0    ? "camera_matrix (or K)"
                 : side == 0 ? "M1 (or K1, cameraMatrix1, camera_matrix_left)"
                             : "M2 (or K2, cameraMatrix2, camera_matrix_right)") +
                " is missing");
  }
  set_camera_matrix(camera, nine(file, k), file.path(), k);
  std::string const d = coefficients_key(file, side);
  if (d.empty()) {
    warn_of(file.path() + ": no distortion coefficients beside ", k, ": taken for a pinhole",
            warnings);
    return camera;
  }
  int rows = 0;
  int cols = 0;
  std::vector<double> const values = file.matrix(d, rows, cols);
  std::string model = model_in(file);
  if (model.empty()) {
    model = values.size() > 5 ? "rational_polynomial" : "plumb_bob";
    if (values.size() == 4) {
      warn_of(file.path() + ": ", d,
              ": four numbers, and no distortion_model is named: taken for k1 k2 p1 p2; of a "
              "fisheye lens, add distortion_model: equidistant",
              warnings);
    }
  }
  set_distortion(camera, model, values, file.path(), d);
  return camera;
}

/// R as a matrix, or as a rotation vector.
Eigen::Matrix3d read_rotation(yaml_file const& file, std::string const& key) {
  int rows = 0;
  int cols = 0;
  std::vector<double> const m = file.matrix(key, rows, cols);
  if (m.size() == 3) {
    Eigen::Vector3d const v(m[0], m[1], m[2]);
    double const angle = v.norm();
    if (angle == 0) { return Eigen::Matrix3d::Identity(); }
    return Eigen::AngleAxisd(angle, v / angle).toRotationMatrix();
  }
  std::vector<double> const full = nine(file, key);
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const> const map(full.data());
  return checked_rotation(map, file.path(), key);
}

/// Where the cameras are, of R and T: x_right = R x_left + T.
void read_place(yaml_file const& file, stereo_rig& rig) {
  std::string const t = first_of(file, translation_names);
  int rows = 0;
  int cols = 0;
  std::vector<double> const v = file.matrix(t, rows, cols);
  if (v.size() != 3) {
    throw error(file.path() + ": " + t + " is " + std::to_string(rows) + " x " +
                std::to_string(cols) + ", must be 3 x 1");
  }
  Eigen::Isometry3d T_right_left = Eigen::Isometry3d::Identity();
  T_right_left.linear() = read_rotation(file, first_of(file, rotation_names));
  T_right_left.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  rig.T_left_right = T_right_left.inverse();
  check_baseline(rig, file.path(), t);
}

/// Where the cameras of two camera_info are: x_rectified = R x_raw, and in the rectified frames the
/// right camera is at -P(:, 3) / f.
void read_rectification(yaml_file const& left, yaml_file const& right, stereo_rig& rig) {
  name_list const projection = {"projection_matrix", "P", "p"};
  name_list const rotation = {"rectification_matrix", "R", "r"};
  std::string const p = first_of(right, projection);
  std::string const r[] = {first_of(left, rotation), first_of(right, rotation)};
  if (p.empty() || r[0].empty() || r[1].empty()) {
    throw error((p.empty() || r[1].empty() ? right : left).path() +
                ": rectification_matrix or projection_matrix is missing: where is the right "
                "camera? R and T in an extrinsics file beside them say it, too");
  }
  int rows = 0;
  int cols = 0;
  std::vector<double> const m = right.matrix(p, rows, cols);
  if (m.size() != 12) {
    throw error(right.path() + ": " + p + " is " + std::to_string(rows) + " x " +
                std::to_string(cols) + ", must be 3 x 4");
  }
  check_number(m[0], focal_limits, right.path(), p + "[0] (fx)");
  check_number(m[5], focal_limits, right.path(), p + "[5] (fy)");
  if (m[3] == 0 && m[7] == 0) {
    throw error(right.path() + ": " + p + "[3] is 0: no baseline; is it that of one camera?");
  }
  Eigen::Matrix3d const R_left = read_rotation(left, r[0]);
  Eigen::Matrix3d const R_right = read_rotation(right, r[1]);
  rig.T_left_right.linear() = R_left.transpose() * R_right;
  rig.T_left_right.translation() =
      R_left.transpose() * Eigen::Vector3d(-m[3] / m[0], -m[7] / m[5], 0);
  check_baseline(rig, right.path(), p);
}

/// Both cameras' files, of the one that was named.
void read_two_files(std::string const& path, int width, int height, calibration& result) {
  pair_of_files const pair = camera_files(path);
  if (pair.second.empty()) {
    throw error(path +
                ": is the calibration of one camera; of a pair the files' names have left and "
                "right, or cam0 and cam1, and " +
                path + " has no such partner beside it");
  }
  yaml_file const left(pair.first);
  yaml_file const right(pair.second);
  result.rig.left = read_one(left, -1, width, height, result.warnings);
  result.rig.right = read_one(right, -1, width, height, result.warnings);
  std::string const extrinsics = extrinsics_file(pair.first);
  if (extrinsics.empty()) {
    read_rectification(left, right, result.rig);
  } else {
    read_place(yaml_file(extrinsics), result.rig);
  }
}

}  // namespace

calibration read_opencv_calibration(std::string const& path, int width, int height,
                                    camera_kind kind) {
  calibration result;
  std::string const intrinsics = intrinsics_file(path);
  yaml_file const file(intrinsics);
  bool const of_pair = !matrix_key(file, 0).empty();
  if (!is_pair(kind)) {
    result.rig.left = read_one(file, of_pair ? 0 : -1, width, height, result.warnings);
    set_one_camera(result.rig, kind);
  } else if (!of_pair) {
    read_two_files(intrinsics, width, height, result);
  } else {
    result.rig.left = read_one(file, 0, width, height, result.warnings);
    result.rig.right = read_one(file, 1, width, height, result.warnings);
    std::string const other = extrinsics_file(intrinsics);
    if (!has_place(file) && other.empty()) {
      throw error(intrinsics +
                  ": R and T are missing: where is the right camera? They are in this "
                  "file, or in an extrinsics file beside it");
    }
    read_place(has_place(file) ? file : yaml_file(other), result.rig);
  }
  check_rig(result.rig, path, kind);
  return result;
}

namespace detail {

bool is_opencv_calibration(yaml_file const& file) {
  for (int const side : {0, -1}) {
    std::string const key = matrix_key(file, side);
    if (!key.empty() && (file.is_map(key) || file.is_list(key))) { return true; }
  }
  return false;
}

bool is_opencv_extrinsics(yaml_file const& file) { return has_place(file); }

}  // namespace detail
}  // namespace seq
