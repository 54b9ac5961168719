// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq {
namespace {

using namespace detail;

/// One EuRoC camera; T_BS goes to `T_body_camera`, rate_hz to `fps`.
camera_intrinsics read_sensor(std::string const& path, Eigen::Isometry3d& T_body_camera,
                              double& fps, std::vector<std::string>& warnings) {
  yaml_file const file(path);
  camera_intrinsics camera;
  if (file.has("camera_model") && file.text("camera_model") != "pinhole") {
    throw error(path + ": camera_model = " + file.text("camera_model") +
                ": only pinhole is supported");
  }
  std::vector<double> const size = file.list("resolution", side_limits);
  if (size.size() != 2) {
    throw error(path + ": resolution has " + std::to_string(size.size()) + " numbers, must have 2");
  }
  camera.width = static_cast<int>(size[0]);
  camera.height = static_cast<int>(size[1]);
  std::vector<double> const f = file.list("intrinsics", centre_limits);
  if (f.size() != 4) {
    throw error(path + ": intrinsics has " + std::to_string(f.size()) +
                " numbers, must have 4 (fu, fv, cu, cv)");
  }
  check_number(f[0], focal_limits, path, "intrinsics[0] (fu)", to_text(f[0]));
  check_number(f[1], focal_limits, path, "intrinsics[1] (fv)", to_text(f[1]));
  camera.fx = f[0];
  camera.fy = f[1];
  camera.cx = f[2];
  camera.cy = f[3];

  std::string const model =
      file.has("distortion_model") ? file.text("distortion_model") : std::string("none");
  std::vector<double> coefficients;
  if (file.has("distortion_coefficients")) {
    coefficients = file.list("distortion_coefficients", coefficient_limits);
  }
  if (model == "radial-tangential" || model == "radtan" || model == "plumb_bob") {
    camera.model = lens::radial_tangential;
  } else if (model == "equidistant") {
    camera.model = lens::kannala_brandt;
  } else if (model == "none") {
    bool const zero =
        std::all_of(coefficients.begin(), coefficients.end(), [](double k) { return k == 0; });
    if (!zero) {
      throw error(path + ": distortion_coefficients are not zero, but distortion_model is none");
    }
    coefficients.clear();
  } else {
    throw error(path + ": distortion_model = " + model +
                ": must be radial-tangential, equidistant or none");
  }
  camera.distortion = coefficients;
  drop_zero_distortion(camera);
  T_body_camera = file.transform("T_BS");
  fps = file.number_or("rate_hz", fps_limits, 0);
  camera.readout_s = file.number_or("readout_s", readout_limits, 0);
  for (char const* key : {"sensor_type", "comment"}) { file.skip(key); }
  for (std::string const& key : file.unread()) {
    warnings.push_back(path + ": " + key + " is not known and was not taken");
  }
  return camera;
}

}  // namespace

calibration read_euroc_calibration(std::string const& mav0, camera_kind kind) {
  namespace fs = std::filesystem;
  std::string const left_path = (fs::path(mav0) / "cam0" / "sensor.yaml").string();
  std::string const right_path = (fs::path(mav0) / "cam1" / "sensor.yaml").string();
  calibration result;
  result.has_body_frame = true;
  result.rig.left = read_sensor(left_path, result.rig.T_body_left, result.rig.fps, result.warnings);
  if (!is_pair(kind)) {
    set_one_camera(result.rig, kind);
    check_rig(result.rig, left_path, kind);
    return result;
  }
  Eigen::Isometry3d T_body_right;
  double right_fps = 0;
  result.rig.right = read_sensor(right_path, T_body_right, right_fps, result.warnings);
  result.rig.T_left_right = result.rig.T_body_left.inverse() * T_body_right;
  for (int k = 2;; ++k) {
    std::string const path =
        (fs::path(mav0) / ("cam" + std::to_string(k)) / "sensor.yaml").string();
    if (!is_file(path)) { break; }
    if (kind == camera_kind::stereo) {
      result.warnings.push_back(mav0 +
                                ": cameras after cam1 are not taken: --rig mixed takes them");
      break;
    }
    auto const add = [&] {
      mounted_camera camera;
      Eigen::Isometry3d T_body_this;
      camera.camera = read_sensor(path, T_body_this, right_fps, result.warnings);
      camera.T_left_this = result.rig.T_body_left.inverse() * T_body_this;
      result.rig.more.push_back(camera);
    };
    if (!added_camera(result.rig, k, path, add, result.warnings)) { break; }
  }
  check_rig(result.rig, left_path + " and cam1/sensor.yaml");
  return result;
}

Eigen::Isometry3d read_euroc_body_frame(std::string const& mav0) {
  namespace fs = std::filesystem;
  return yaml_file((fs::path(mav0) / "cam0" / "sensor.yaml").string()).transform("T_BS");
}

imu_calibration read_euroc_imu_calibration(std::string const& path) {
  yaml_file const file(path);
  imu_calibration imu;
  imu.T_body_imu = file.transform("T_BS");
  imu.rate_hz = file.number("rate_hz", imu_rate_limits);
  imu.time_offset_s = file.number_or("timeshift_cam_imu", time_offset_limits, 0);
  imu.noise.gyro = file.number("gyroscope_noise_density", density_limits);
  imu.noise.gyro_walk = file.number("gyroscope_random_walk", density_limits);
  imu.noise.accel = file.number("accelerometer_noise_density", density_limits);
  imu.noise.accel_walk = file.number("accelerometer_random_walk", density_limits);
  return imu;
}

}  // namespace seq
