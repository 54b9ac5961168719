// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq {
namespace {

using namespace detail;

/// Keys `prefix`fx, fy, cx, cy.
void read_projection(yaml_file const& file, std::string const& prefix, camera_intrinsics& camera) {
  camera.fx = file.number(prefix + "fx", focal_limits);
  camera.fy = file.number(prefix + "fy", focal_limits);
  camera.cx = file.number(prefix + "cx", centre_limits);
  camera.cy = file.number(prefix + "cy", centre_limits);
}

/// Keys `prefix`k1, k2, p1, p2, and k3, and k4 to k6 where they are; without any, a pinhole.
void read_radial_tangential(yaml_file const& file, std::string const& prefix,
                            camera_intrinsics& camera) {
  camera.model = lens::pinhole;
  camera.distortion.clear();
  constexpr char const* names[] = {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  int given = 0;  // up to the last one
  for (int i = 0; i < 8; ++i) { given = file.has(prefix + names[i]) ? i + 1 : given; }
  if (given == 0) { return; }
  camera.model = lens::radial_tangential;
  int const count = given > 5 ? 8 : std::max(given, 4);
  for (int i = 0; i < count; ++i) {
    camera.distortion.push_back(file.number(prefix + names[i], coefficient_limits));
  }
  drop_zero_distortion(camera);
}

void read_kannala_brandt(yaml_file const& file, std::string const& prefix,
                         camera_intrinsics& camera) {
  camera.model = lens::kannala_brandt;
  camera.distortion.clear();
  for (char const* name : {"k1", "k2", "k3", "k4"}) {
    camera.distortion.push_back(file.number(prefix + name, coefficient_limits));
  }
}

/// LEFT.K, LEFT.D or RIGHT.K, RIGHT.D.
void read_raw_camera(yaml_file const& file, std::string const& side, camera_intrinsics& camera) {
  std::vector<double> const k = file.matrix_of(side + ".K", 3, 3);
  check_number(k[0], focal_limits, file.path(), side + ".K[0] (fx)", to_text(k[0]));
  check_number(k[4], focal_limits, file.path(), side + ".K[4] (fy)", to_text(k[4]));
  camera.fx = k[0];
  camera.fy = k[4];
  camera.cx = k[2];
  camera.cy = k[5];
  int rows = 0;
  int cols = 0;
  camera.model = lens::radial_tangential;
  camera.distortion = file.matrix(side + ".D", rows, cols);
  drop_zero_distortion(camera);
  if (file.has(side + ".width") || file.has(side + ".height")) {
    camera.width = file.integer(side + ".width", side_limits);
    camera.height = file.integer(side + ".height", side_limits);
  }
}

Eigen::Matrix3d read_matrix(yaml_file const& file, std::string const& key) {
  std::vector<double> const values = file.matrix_of(key, 3, 3);
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const> const m(values.data());
  return checked_rotation(m, file.path(), key);
}

[[noreturn]] void fail_not_a_pair(yaml_file const& file) {
  throw error(file.path() + ": Camera2.fx is missing: not the calibration of a stereo pair");
}

/// @return whether it is KannalaBrandt8 @throws seq::error for another type
bool is_fisheye(yaml_file const& file, std::string const& type) {
  if (type == "KannalaBrandt8") { return true; }
  if (type != "PinHole" && type != "Rectified") {
    throw error(file.path() + ": Camera.type = " + type +
                ": must be PinHole, Rectified or KannalaBrandt8");
  }
  return false;
}

void read_camera(yaml_file const& file, std::string const& prefix, bool fisheye,
                 camera_intrinsics& camera) {
  read_projection(file, prefix, camera);
  if (fisheye) {
    read_kannala_brandt(file, prefix, camera);
  } else {
    read_radial_tangential(file, prefix, camera);
  }
}

/// The format with Camera1.*
void read_new_settings(yaml_file const& file, camera_kind kind, stereo_rig& rig) {
  std::string const type = file.text("Camera.type");
  bool const fisheye = is_fisheye(file, type);
  bool const rectified = type == "Rectified";
  if (rectified) {
    read_projection(file, "Camera1.", rig.left);
  } else {
    read_camera(file, "Camera1.", fisheye, rig.left);
  }
  limits const range{0, max_baseline, true};
  if (!is_pair(kind)) {
    set_one_camera(rig, kind);
    if (kind == camera_kind::rgbd && file.has("Stereo.b")) {
      rig.T_left_right.translation().x() = file.number("Stereo.b", range);
    }
    return;
  }
  if (rectified) {
    rig.right = rig.left;
    rig.T_left_right.translation().x() = file.number("Stereo.b", range);
    return;
  }
  if (!file.has("Camera2.fx")) { fail_not_a_pair(file); }
  read_camera(file, "Camera2.", fisheye, rig.right);
  rig.T_left_right = file.transform("Stereo.T_c1_c2");
}

/// Raw cameras, and the rectification that the reference applies: x_rectified = R x_raw. In the
/// rectified frames the right camera is at (b, 0, 0), P_right = [f 0 cx -f b; ...].
void read_raw_pair(yaml_file const& file, stereo_rig& rig) {
  read_raw_camera(file, "LEFT", rig.left);
  read_raw_camera(file, "RIGHT", rig.right);
  Eigen::Matrix3d const R_left = read_matrix(file, "LEFT.R");
  Eigen::Matrix3d const R_right = read_matrix(file, "RIGHT.R");
  std::vector<double> const p = file.matrix_of("RIGHT.P", 3, 4);
  check_number(p[0], focal_limits, file.path(), "RIGHT.P[0] (fx)");
  double const baseline = -p[3] / p[0];
  check_number(baseline, {0, max_baseline, true}, file.path(), "RIGHT.P: baseline -P[3] / P[0]");
  rig.T_left_right.linear() = R_left.transpose() * R_right;
  rig.T_left_right.translation() = R_left.transpose() * Eigen::Vector3d(baseline, 0, 0);
}

/// The older format with Camera.fx
void read_old_settings(yaml_file const& file, camera_kind kind, stereo_rig& rig) {
  bool const fisheye =
      is_fisheye(file, file.has("Camera.type") ? file.text("Camera.type") : "PinHole");
  bool const raw = !fisheye && file.has("LEFT.K");
  if (raw && is_pair(kind)) { return read_raw_pair(file, rig); }
  if (raw) {
    read_raw_camera(file, "LEFT", rig.left);
  } else {
    read_camera(file, "Camera.", fisheye, rig.left);
  }
  if (fisheye && is_pair(kind)) {
    if (!file.has("Camera2.fx")) { fail_not_a_pair(file); }
    read_camera(file, "Camera2.", true, rig.right);
    rig.T_left_right = file.transform("Tlr");
    return;
  }
  set_one_camera(rig, kind);
  if (is_pair(kind) || (kind == camera_kind::rgbd && file.has("Camera.bf"))) {
    double const bf = file.number("Camera.bf", {0, max_focal * max_baseline, true});
    rig.T_left_right.translation().x() = bf / rig.left.fx;
  }
}

/// Metres per unit, of a factor in units per metre.
std::optional<double> read_depth_unit(yaml_file const& file) {
  for (char const* key : {"RGBD.DepthMapFactor", "DepthMapFactor"}) {
    if (!file.has(key)) { continue; }
    return 1 / file.number(key, {1 / depth_unit_limits.high, 1 / depth_unit_limits.low});
  }
  return std::nullopt;
}

bool begins_with(std::string const& text, char const* part) { return text.rfind(part, 0) == 0; }

/// What changes a result of the reference and is not taken here.
void warn_of_unread(yaml_file const& file, camera_kind kind, std::vector<std::string>& warnings) {
  for (char const* key : {"Camera.newWidth", "Camera.newHeight", "Camera.imageScale"}) {
    if (!file.has(key)) { continue; }
    warnings.push_back(file.path() + ": " + key + " = " + file.text(key) +
                       " is not applied: images keep their size");
  }
  for (char const* key :
       {"Camera.RGB", "Camera1.overlappingBegin", "Camera1.overlappingEnd",
        "Camera2.overlappingBegin", "Camera2.overlappingEnd", "Camera.lappingBegin",
        "Camera.lappingEnd", "Camera2.lappingBegin", "Camera2.lappingEnd", "IMU.InsertKFsWhenLost",
        "IMU.fastInit", "RGBD.DepthMapFactor", "Camera.bf", "Stereo.b", "Stereo.T_c1_c2",
        "LEFT.P"}) {
    file.skip(key);
  }
  for (std::string const& key : file.unread()) {
    // The rectified cameras beside raw ones, which the rectification here chooses itself; the right
    // camera where one is enough.
    bool const beside = file.has("LEFT.K") && begins_with(key, "Camera.");
    bool const other = !is_pair(kind) && (begins_with(key, "Camera2.") ||
                                          begins_with(key, "RIGHT.") || key == "LEFT.R");
    if (beside || other) { continue; }
    for (char const* part :
         {"Camera", "Stereo.", "IMU.", "RGBD.", "LEFT.", "RIGHT.", "ORBextractor."}) {
      if (!begins_with(key, part)) { continue; }
      warnings.push_back(file.path() + ": " + key + " is not known and was not taken");
      break;
    }
  }
}

void read_orb(yaml_file const& file, orb_settings& orb) {
  auto const integer = [&](char const* key, limits const& range, std::optional<int>& to) {
    if (file.has(key)) { to = file.integer(key, range); }
  };
  auto const number = [&](char const* key, limits const& range, std::optional<double>& to) {
    if (file.has(key)) { to = file.number(key, range); }
  };
  integer("ORBextractor.nFeatures", {1, 1e6}, orb.features);
  integer("ORBextractor.nLevels", {1, 16}, orb.levels);
  number("ORBextractor.scaleFactor", {1, 4, true}, orb.scale_factor);
  integer("ORBextractor.iniThFAST", {1, 255}, orb.ini_threshold);
  integer("ORBextractor.minThFAST", {1, 255}, orb.min_threshold);
  number("Stereo.ThDepth", {0, 1e6, true}, orb.depth_threshold);
  if (!orb.depth_threshold) {
    number("ThDepth", {0, 1e6, true}, orb.depth_threshold);  // older format
  }
}

/// IMU.*; the body is the IMU.
std::optional<imu_calibration> read_orb_imu(yaml_file const& file, bool has_body_frame) {
  bool any = false;
  for (char const* key :
       {"IMU.NoiseGyro", "IMU.NoiseAcc", "IMU.GyroWalk", "IMU.AccWalk", "IMU.Frequency"}) {
    any = any || file.has(key);
  }
  if (!any) { return std::nullopt; }
  imu_calibration imu;
  imu.noise.gyro = file.number("IMU.NoiseGyro", density_limits);
  imu.noise.accel = file.number("IMU.NoiseAcc", density_limits);
  imu.noise.gyro_walk = file.number("IMU.GyroWalk", density_limits);
  imu.noise.accel_walk = file.number("IMU.AccWalk", density_limits);
  imu.rate_hz = file.number("IMU.Frequency", imu_rate_limits);
  if (!has_body_frame) {
    throw error(file.path() + ": IMU.T_b_c1 (or Tbc) is missing, but there is IMU.NoiseGyro");
  }
  return imu;
}

}  // namespace

calibration read_orb_slam3_settings(std::string const& path, int width, int height,
                                    camera_kind kind) {
  yaml_file const file(path);
  calibration result;
  stereo_rig& rig = result.rig;
  if (file.has("Camera.width") || file.has("Camera.height")) {
    width = file.integer("Camera.width", side_limits);
    height = file.integer("Camera.height", side_limits);
  }
  if (file.has("Camera1.fx")) {
    read_new_settings(file, kind, rig);
  } else if (file.has("Camera.fx") || file.has("LEFT.K")) {
    read_old_settings(file, kind, rig);
  } else {
    throw error(path + ": neither Camera1.fx nor Camera.fx: not an ORB-SLAM3 settings file");
  }
  for (camera_intrinsics* camera : {&rig.left, &rig.right}) {
    if (camera->width == 0) {
      camera->width = width;
      camera->height = height;
    }
    if (camera->width == 0 || camera->height == 0) {
      throw error(path + ": Camera.width is missing");
    }
  }
  rig.fps = file.number_or("Camera.fps", fps_limits, 0);
  for (char const* key : {"IMU.T_b_c1", "Tbc"}) {
    if (file.has(key) && !result.has_body_frame) {
      rig.T_body_left = file.transform(key);
      result.has_body_frame = true;
    }
  }
  result.imu = read_orb_imu(file, result.has_body_frame);
  read_orb(file, result.settings);
  result.depth_unit = read_depth_unit(file);
  check_rig(rig, path, kind);
  warn_of_unread(file, kind, result.warnings);
  return result;
}

}  // namespace seq
