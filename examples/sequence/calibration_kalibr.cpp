// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq {
namespace {

using namespace detail;
namespace fs = std::filesystem;

/// The numbers of `intrinsics`: those of the sphere, then fu, fv, pu, pv.
void read_intrinsics(yaml_file const& file, std::size_t shape, camera_intrinsics& camera) {
  std::vector<double> const v = file.list("intrinsics", {-max_focal, max_focal});
  if (v.size() != shape + 4) {
    throw error(file.path() + ": intrinsics has " + std::to_string(v.size()) +
                " numbers, must have " + std::to_string(shape + 4) +
                " for camera_model = " + file.text("camera_model"));
  }
  camera.distortion.assign(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(shape));
  double const* const projection = v.data() + shape;
  for (std::size_t i = 0; i < 2; ++i) {
    check_number(projection[i], focal_limits, file.path(),
                 "intrinsics[" + std::to_string(shape + i) + (i == 0 ? "] (fu)" : "] (fv)"));
  }
  camera.fx = projection[0];
  camera.fy = projection[1];
  camera.cx = projection[2];
  camera.cy = projection[3];
}

/// Kalibr's line_delay, the time from a row to the next one: seconds, or nanoseconds where it is 1
/// or more, which no row takes in seconds.
void read_line_delay(yaml_file const& file, camera_intrinsics& camera) {
  double delay = file.number_or("line_delay", {0, 1e8}, 0);
  if (delay >= 1) { delay *= 1e-9; }
  camera.readout_s = delay * (camera.height - 1);
  check_number(camera.readout_s, readout_limits, file.path(),
               "line_delay times the number of rows");
}

camera_intrinsics read_kalibr_camera(yaml_file const& file) {
  camera_intrinsics camera;
  std::vector<double> const size = file.list("resolution", side_limits);
  if (size.size() != 2) {
    throw error(file.path() + ": resolution has " + std::to_string(size.size()) +
                " numbers, must have 2");
  }
  camera.width = static_cast<int>(size[0]);
  camera.height = static_cast<int>(size[1]);
  read_line_delay(file, camera);
  std::string const model = file.text("camera_model");
  std::string const distortion = file.text_or("distortion_model", "none");
  std::vector<double> coefficients;
  if (file.has("distortion_coeffs")) {
    coefficients = file.list("distortion_coeffs", coefficient_limits);
  }
  auto const set_shape = [&](lens of) {
    read_intrinsics(file, static_cast<std::size_t>(shape_parameters(of)), camera);
    return camera.distortion;
  };
  if (model == "pinhole") {
    set_shape(lens::pinhole);
    set_distortion(camera, distortion, coefficients, file.path(), "distortion_coeffs");
    return camera;
  }
  lens const of = model == "omni"   ? lens::unified
                  : model == "ds"   ? lens::double_sphere
                  : model == "eucm" ? lens::extended_unified
                                    : lens::pinhole;
  if (of == lens::pinhole) {
    throw error(file.path() + ": camera_model = " + model + ": must be pinhole, omni, ds or eucm");
  }
  std::vector<double> shape = set_shape(of);
  set_distortion(camera, distortion, coefficients, file.path(), "distortion_coeffs");
  std::vector<double> rest = camera.distortion;
  bool const fits =
      camera.model == lens::pinhole ||
      (of == lens::unified && camera.model == lens::radial_tangential && rest.size() <= 4);
  if (!fits) {
    throw error(file.path() + ": distortion_model = " + distortion + " with camera_model = " +
                model + ": must be " + (of == lens::unified ? "radtan or none" : "none"));
  }
  if (of == lens::unified) { rest.resize(4); }
  shape.insert(shape.end(), rest.begin(), rest.end());
  camera.model = of;
  camera.distortion = std::move(shape);
  return camera;
}

/// T_cam_imu, or OpenVINS's T_imu_cam, as what maps camera points into the IMU's frame.
bool read_mount(yaml_file const& camera, Eigen::Isometry3d& T_imu_camera) {
  if (camera.has("T_cam_imu")) {
    T_imu_camera = camera.transform("T_cam_imu").inverse();
  } else if (camera.has("T_imu_cam")) {
    T_imu_camera = camera.transform("T_imu_cam");
  } else {
    return false;
  }
  return true;
}

/// The IMU's file that lies beside a chain: imu.yaml, or of the chain's name.
std::string find_imu_file(fs::path const& chain) {
  std::vector<std::string> names = {"imu.yaml", "imu0.yaml", "kalibr_imu_chain.yaml",
                                    "imu_config.yaml"};
  std::string const own = chain.filename().string();
  for (char const* part : {"camchain-imucam", "imucam_chain", "camchain", "imucam"}) {
    std::size_t const at = own.find(part);
    if (at == std::string::npos) { continue; }
    std::string other = own;
    other.replace(at, std::string(part).size(),
                  part == std::string("imucam_chain") ? "imu_chain" : "imu");
    names.insert(names.begin(), other);
    break;
  }
  for (std::string const& name : names) {
    std::string const path = (chain.parent_path() / name).string();
    if (is_file(path)) { return path; }
  }
  return {};
}

imu_calibration read_kalibr_imu(std::string const& path, std::vector<std::string>& warnings) {
  yaml_file const whole(path);
  yaml_file const file = whole.is_map("imu0") ? whole.part("imu0") : whole;
  imu_calibration imu;
  imu.rate_hz = file.number("update_rate", imu_rate_limits);
  imu.noise.gyro = file.number("gyroscope_noise_density", density_limits);
  imu.noise.gyro_walk = file.number("gyroscope_random_walk", density_limits);
  imu.noise.accel = file.number("accelerometer_noise_density", density_limits);
  imu.noise.accel_walk = file.number("accelerometer_random_walk", density_limits);
  if (file.has("T_i_b")) { imu.T_body_imu = file.transform("T_i_b").inverse(); }
  std::string const model = file.text_or("model", "calibrated");
  if (model != "calibrated" && model != "kalibr") {
    warnings.push_back(path + ": model = " + model +
                       ": scale and misalignment of the IMU are not applied");
  }
  return imu;
}

/// Says what of a camera is not taken.
void warn_of_rest(yaml_file const& camera, std::vector<std::string>& warnings) {
  for (char const* key :
       {"cam_overlaps", "rostopic", "T_cn_cnm1", "T_cam_imu", "T_imu_cam", "timeshift_cam_imu"}) {
    camera.skip(key);
  }
  for (std::string const& key : camera.unread()) {
    warnings.push_back(camera.path() + ": " + key + " is not known and was not taken");
  }
}

/// Maps points of camera k into the one before it.
Eigen::Isometry3d previous_from(yaml_file const& camera, int k, bool mounted,
                                Eigen::Isometry3d const& T_imu_previous) {
  Eigen::Isometry3d T_imu_camera;
  if (camera.has("T_cn_cnm1")) { return camera.transform("T_cn_cnm1").inverse(); }
  if (mounted && read_mount(camera, T_imu_camera)) {
    return T_imu_previous.inverse() * T_imu_camera;
  }
  throw error(camera.path() + ": T_cn_cnm1 is missing: where is cam" + std::to_string(k) + "?");
}

/// cam2 and those after it.
void read_more(yaml_file const& file, calibration& result) {
  stereo_rig& rig = result.rig;
  Eigen::Isometry3d T_left_previous = rig.T_left_right;
  for (int k = 2; file.is_map("cam" + std::to_string(k)); ++k) {
    yaml_file const part = file.part("cam" + std::to_string(k));
    auto const add = [&] {
      T_left_previous = T_left_previous * previous_from(part, k, result.has_body_frame,
                                                        rig.T_body_left * T_left_previous);
      rig.more.push_back({read_kalibr_camera(part), T_left_previous});
      warn_of_rest(part, result.warnings);
    };
    if (!added_camera(rig, k, file.path(), add, result.warnings)) { return; }
  }
}

}  // namespace

calibration read_kalibr_calibration(std::string const& path, camera_kind kind) {
  yaml_file const file(path);
  calibration result;
  stereo_rig& rig = result.rig;
  yaml_file const left = file.part("cam0");
  rig.left = read_kalibr_camera(left);
  result.has_body_frame = read_mount(left, rig.T_body_left);
  if (is_pair(kind)) {
    if (!file.is_map("cam1")) {
      throw error(path + ": cam1 is missing: not the calibration of a stereo pair");
    }
    yaml_file const right = file.part("cam1");
    rig.right = read_kalibr_camera(right);
    rig.T_left_right = previous_from(right, 1, result.has_body_frame, rig.T_body_left);
    check_baseline(rig, path, "T_cn_cnm1");
    warn_of_rest(right, result.warnings);
  } else {
    set_one_camera(rig, kind);
  }
  if (left.has("timeshift_cam_imu")) {
    result.imu_time_offset_s = left.number("timeshift_cam_imu", time_offset_limits);
  }
  std::string const imu = find_imu_file(path);
  if (!imu.empty() && result.has_body_frame) { result.imu = read_kalibr_imu(imu, result.warnings); }
  if (kind == camera_kind::mixed) { read_more(file, result); }
  check_rig(rig, path, kind);
  warn_of_rest(left, result.warnings);
  if (kind != camera_kind::mixed && file.has("cam2")) {
    result.warnings.push_back(path + ": cameras after cam1 are not taken: --rig mixed takes them");
  }
  return result;
}

}  // namespace seq
