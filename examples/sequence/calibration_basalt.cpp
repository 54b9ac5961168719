// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <iterator>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq {
namespace {

using namespace detail;

struct known_model {
  char const* name;
  lens model;
  std::vector<char const*> keys;
};

known_model const& model_of(yaml_file const& camera) {
  static std::vector<known_model> const known = {
      {"pinhole", lens::pinhole, {}},
      {"pinhole-radtan8",
       lens::radial_tangential,
       {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}},
      {"kb4", lens::kannala_brandt, {"k1", "k2", "k3", "k4"}},
      {"ds", lens::double_sphere, {"xi", "alpha"}},
      {"eucm", lens::extended_unified, {"alpha", "beta"}},
      {"ucm", lens::extended_unified, {"alpha"}},  // with a beta of 1
  };
  std::string const type = camera.text("camera_type");
  auto const found = std::find_if(known.begin(), known.end(),
                                  [&](known_model const& k) { return k.name == type; });
  if (found == known.end()) {
    throw error(camera.path() + ": camera_type = " + type +
                ": must be pinhole, pinhole-radtan8, kb4, ds, eucm or ucm");
  }
  return *found;
}

camera_intrinsics read_camera(yaml_file const& camera) {
  known_model const& model = model_of(camera);
  yaml_file const numbers = camera.part("intrinsics");
  camera_intrinsics result;
  result.model = model.model;
  result.fx = numbers.number("fx", focal_limits);
  result.fy = numbers.number("fy", focal_limits);
  result.cx = numbers.number("cx", centre_limits);
  result.cy = numbers.number("cy", centre_limits);
  for (char const* key : model.keys) {
    result.distortion.push_back(numbers.number(key, coefficient_limits));
  }
  if (model.model == lens::extended_unified && model.keys.size() == 1) {
    result.distortion.push_back(1);
  }
  drop_zero_distortion(result);
  return result;
}

Eigen::Isometry3d read_mount(yaml_file const& mount) {
  double v[7];
  char const* const names[] = {"px", "py", "pz", "qx", "qy", "qz", "qw"};
  for (int k = 0; k < 7; ++k) { v[k] = mount.number(names[k], {-1e6, 1e6}); }
  Eigen::Quaterniond const turn(v[6], v[3], v[4], v[5]);
  check_number(turn.norm(), {0.98, 1.02}, mount.path(), "norm of the quaternion");
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  T.linear() = turn.normalized().toRotationMatrix();
  return T;
}

imu_calibration read_imu(yaml_file const& file) {
  auto const noise = [&](char const* key) {
    std::vector<double> const axes = file.list(key, density_limits);
    if (axes.empty()) { throw error(file.path() + ": " + key + " is empty"); }
    return *std::max_element(axes.begin(), axes.end());
  };
  imu_calibration imu;
  imu.rate_hz = file.number("imu_update_rate", imu_rate_limits);
  imu.noise = {noise("gyro_noise_std"), noise("accel_noise_std"), noise("gyro_bias_std"),
               noise("accel_bias_std")};
  return imu;
}

void warn_of_biases(yaml_file const& file, std::vector<std::string>& warnings) {
  for (char const* key : {"calib_accel_bias", "calib_gyro_bias"}) {
    if (!file.is_list(key)) { continue; }
    std::vector<double> const values = file.list(key, {-1e6, 1e6});
    if (std::any_of(values.begin(), values.end(), [](double v) { return v != 0; })) {
      warnings.push_back(file.path() + ": " + key +
                         " is not applied: bias, scale and misalignment of the IMU");
    }
  }
}

/// A camera of the visual navigation course of the Technical University of Munich, whose format is
/// that of basalt's beginnings: numbers are p1 to p4, of any model.
camera_intrinsics read_visnav_camera(yaml_file const& camera) {
  struct numbered_model {
    char const* name;
    lens model;
    int count;
  };
  constexpr numbered_model known[] = {{"pinhole", lens::pinhole, 0},
                                      {"kb4", lens::kannala_brandt, 4},
                                      {"ds", lens::double_sphere, 2},
                                      {"eucm", lens::extended_unified, 2}};
  std::string const type = camera.text("cam_type");
  auto const* const model = std::find_if(std::begin(known), std::end(known),
                                         [&](auto const& k) { return k.name == type; });
  if (model == std::end(known)) {
    throw error(camera.path() + ": cam_type = " + type + ": must be pinhole, kb4, ds or eucm");
  }
  camera_intrinsics result;
  result.model = model->model;
  result.fx = camera.number("fx", focal_limits);
  result.fy = camera.number("fy", focal_limits);
  result.cx = camera.number("cx", centre_limits);
  result.cy = camera.number("cy", centre_limits);
  for (int i = 1; i <= model->count; ++i) {
    result.distortion.push_back(camera.number("p" + std::to_string(i), coefficient_limits));
  }
  result.width = camera.integer("width", side_limits);
  result.height = camera.integer("height", side_limits);
  drop_zero_distortion(result);
  return result;
}

/// The frame i of T_i_c is the IMU's, or the left camera's where that is at its origin.
calibration read_visnav(yaml_file const& file, std::string const& path, camera_kind kind) {
  calibration result;
  result.rig.left = read_visnav_camera(file.part("cam.intrinsics", 0));
  result.rig.T_body_left = read_mount(file.part("cam.T_i_c", 0));
  result.has_body_frame = !result.rig.T_body_left.isApprox(Eigen::Isometry3d::Identity(), 1e-9);
  if (is_pair(kind)) {
    result.rig.right = read_visnav_camera(file.part("cam.intrinsics", 1));
    result.rig.T_left_right =
        result.rig.T_body_left.inverse() * read_mount(file.part("cam.T_i_c", 1));
  } else {
    set_one_camera(result.rig, kind);
  }
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace

calibration read_basalt_calibration(std::string const& path, camera_kind kind) {
  yaml_file const whole(path);
  yaml_file const file = whole.part("value0");
  if (file.has("cam.intrinsics")) { return read_visnav(file, path, kind); }
  bool const pair = is_pair(kind);
  int rows = 0;
  int cols = 0;
  std::vector<double> const sizes = file.matrix("resolution", rows, cols);
  if (cols != 2 || rows < (pair ? 2 : 1)) {
    throw error(file.path() + ": resolution is " + std::to_string(rows) + " x " +
                std::to_string(cols) + ", must have two numbers for each camera" +
                (pair ? " of a pair" : ""));
  }
  auto const camera = [&](std::size_t i) {
    camera_intrinsics c = read_camera(file.part("intrinsics", i));
    for (std::size_t k = 2 * i; k < 2 * i + 2; ++k) {
      check_number(sizes[k], side_limits, file.path(), "resolution");
    }
    c.width = static_cast<int>(sizes[2 * i]);
    c.height = static_cast<int>(sizes[2 * i + 1]);
    return c;
  };
  calibration result;
  result.has_body_frame = true;
  result.rig.left = camera(0);
  result.rig.T_body_left = read_mount(file.part("T_imu_cam", 0));
  if (pair) {
    result.rig.right = camera(1);
    result.rig.T_left_right =
        result.rig.T_body_left.inverse() * read_mount(file.part("T_imu_cam", 1));
  } else {
    set_one_camera(result.rig, kind);
  }
  if (file.has("imu_update_rate")) { result.imu = read_imu(file); }
  if (file.has("cam_time_offset_ns")) {
    result.imu_time_offset_s = 1e-9 * file.number("cam_time_offset_ns", {-1e10, 1e10});
  }
  warn_of_biases(file, result.warnings);
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace seq
