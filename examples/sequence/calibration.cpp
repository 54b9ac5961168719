// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using detail::to_text;

constexpr double max_focal = 1e5;       // pixels
constexpr int max_side = 16384;         // pixels
constexpr double min_baseline = 1e-4;   // metres
constexpr double max_baseline = 100.0;  // metres
constexpr double max_coefficient = 1e4;

/// Allowed values of a number; the lower end may be excluded.
struct limits {
  double low;
  double high;
  bool above_low = false;
};
constexpr limits focal_limits{0, max_focal, true};
constexpr limits centre_limits{-max_focal, max_focal};
constexpr limits coefficient_limits{-max_coefficient, max_coefficient};
constexpr limits side_limits{1, max_side};
constexpr limits fps_limits{0, 1e5};
constexpr limits imu_rate_limits{1, 2e4};
constexpr limits density_limits{0, 1e3, true};

std::string describe(limits const& range) {
  return "must be " + std::string(range.above_low ? "above " : "at least ") + to_text(range.low) +
         " and at most " + to_text(range.high);
}

void check_number(double value, limits const& range, std::string const& path,
                  std::string const& key, std::string const& text) {
  std::string const where = path + ": " + key + " = " + text + ": ";
  if (!std::isfinite(value)) { throw error(where + "must be finite"); }
  bool const low_enough = range.above_low ? value > range.low : value >= range.low;
  if (!low_enough || value > range.high) { throw error(where + describe(range)); }
}

/// The closest rotation. @throws seq::error if `m` is farther than 1e-3 from every rotation
Eigen::Matrix3d checked_rotation(Eigen::Matrix3d const& m, std::string const& path,
                                 std::string const& key) {
  double const residual = (m * m.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  double const determinant = m.determinant();
  if (!(residual <= 1e-3) || !(determinant > 0)) {
    throw error(path + ": " + key + ": not a rotation: determinant " + to_text(determinant) +
                ", |R R^T - I| = " + to_text(residual) + ", at most 0.001 allowed");
  }
  if (residual <= 1e-12) {
    return m;  // keeps an exact identity exact
  }
  Eigen::JacobiSVD<Eigen::Matrix3d> const svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

/// From 16 (or 12: without the last row) numbers, row-major.
Eigen::Isometry3d checked_transform(std::vector<double> const& m, std::string const& path,
                                    std::string const& key) {
  if (m.size() == 16) {
    std::array<double, 4> const last{0, 0, 0, 1};
    for (std::size_t i = 0; i < 4; ++i) {
      if (!(std::fabs(m[12 + i] - last[i]) <= 1e-6)) {
        throw error(path + ": " + key + ": last row holds " + to_text(m[12 + i]) +
                    ", must be 0 0 0 1");
      }
    }
  }
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor> const> const rows(m.data());
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = checked_rotation(rows.leftCols<3>(), path, key);
  result.translation() = rows.col(3);
  return result;
}

/// A YAML file whose top level is a map, with checked access.
class yaml_file {
public:
  /// @throws seq::error
  explicit yaml_file(std::string const& path) : path_(path) {
    std::string text;
    for (detail::text_line const& line : detail::read_lines(path)) {
      // OpenCV writes "%YAML:1.0", which is not a valid YAML directive.
      bool const directive = line.text.compare(0, 5, "%YAML") == 0;
      text += directive ? "#" : line.text;
      text += '\n';
    }
    try {
      root_ = YAML::Load(text);
    } catch (YAML::Exception const& e) {
      detail::fail_at(path, e.mark.line + 1, "not valid YAML: " + e.msg);
    }
    if (!root_.IsMap()) { throw error(path + ": no 'key: value' pairs at the top level"); }
  }

  std::string const& path() const { return path_; }
  bool has(std::string const& key) const {
    YAML::Node const node = find(key);
    return node.IsDefined() && !node.IsNull();
  }

  /// @throws seq::error if missing, not a number, not finite or out of range
  double number(std::string const& key, limits const& range) const {
    return to_checked(required(key), key, range);
  }
  double number_or(std::string const& key, limits const& range, double otherwise) const {
    return has(key) ? number(key, range) : otherwise;
  }
  /// A whole number, in any format ("20", "20.0", "2e1").
  int integer(std::string const& key, limits const& range) const {
    double const value = number(key, range);
    if (value != std::floor(value)) {
      throw error(path_ + ": " + key + " = " + to_text(value) + ": must be a whole number");
    }
    return static_cast<int>(value);
  }
  std::string text(std::string const& key) const {
    YAML::Node const node = required(key);
    if (!node.IsScalar()) { throw error(path_ + ": " + key + ": must be a single value"); }
    return node.Scalar();
  }
  /// A sequence of numbers, each within `range`.
  std::vector<double> list(std::string const& key, limits const& range) const {
    return to_list(required(key), key, range);
  }
  /// The numbers of an OpenCV matrix (rows, cols, data).
  std::vector<double> matrix(std::string const& key, int& rows, int& cols) const {
    YAML::Node const node = required(key);
    if (!node.IsMap()) { throw error(path_ + ": " + key + ": must hold rows, cols and data"); }
    rows = dimension(node, key, "rows");
    cols = dimension(node, key, "cols");
    YAML::Node const data = node["data"];
    if (!data.IsDefined()) { throw error(path_ + ": " + key + ".data is missing"); }
    std::vector<double> values = to_list(data, key + ".data", {-1e9, 1e9});
    if (values.size() != static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols)) {
      throw error(path_ + ": " + key + ".data has " + std::to_string(values.size()) +
                  " numbers, must have " + std::to_string(rows) + " x " + std::to_string(cols));
    }
    return values;
  }
  /// As above with a fixed shape.
  std::vector<double> matrix_of(std::string const& key, int rows, int cols) const {
    int actual_rows = 0;
    int actual_cols = 0;
    std::vector<double> values = matrix(key, actual_rows, actual_cols);
    if (actual_rows != rows || actual_cols != cols) {
      throw error(path_ + ": " + key + " is " + std::to_string(actual_rows) + " x " +
                  std::to_string(actual_cols) + ", must be " + std::to_string(rows) + " x " +
                  std::to_string(cols));
    }
    return values;
  }
  /// A 4x4, or 3x4, rigid transform.
  Eigen::Isometry3d transform(std::string const& key) const {
    int rows = 0;
    int cols = 0;
    std::vector<double> const values = matrix(key, rows, cols);
    if ((rows != 3 && rows != 4) || cols != 4) {
      throw error(path_ + ": " + key + " is " + std::to_string(rows) + " x " +
                  std::to_string(cols) + ", must be 4 x 4 or 3 x 4");
    }
    return checked_transform(values, path_, key);
  }

private:
  YAML::Node find(std::string const& key) const {
    YAML::Node const& root = root_;  // const access does not insert
    return root[key];
  }
  YAML::Node required(std::string const& key) const {
    if (!has(key)) { throw error(path_ + ": " + key + " is missing"); }
    return find(key);
  }
  double to_checked(YAML::Node const& node, std::string const& key, limits const& range) const {
    if (!node.IsScalar()) { throw error(path_ + ": " + key + ": must be a single number"); }
    double value = 0;
    if (!detail::to_number(node.Scalar(), value)) {
      throw error(path_ + ": " + key + " = " + node.Scalar() + ": not a number");
    }
    check_number(value, range, path_, key, node.Scalar());
    return value;
  }
  std::vector<double> to_list(YAML::Node const& node, std::string const& key,
                              limits const& range) const {
    if (!node.IsSequence()) { throw error(path_ + ": " + key + ": must be a list of numbers"); }
    std::vector<double> values;
    for (YAML::Node const& item : node) {
      values.push_back(to_checked(item, key + "[" + std::to_string(values.size()) + "]", range));
    }
    return values;
  }
  int dimension(YAML::Node const& node, std::string const& key, std::string const& name) const {
    YAML::Node const item = node[name];
    if (!item.IsDefined()) { throw error(path_ + ": " + key + "." + name + " is missing"); }
    return static_cast<int>(to_checked(item, key + "." + name, {1, 64}));
  }

  std::string path_;
  YAML::Node root_;
};

/// If all coefficients are zero, the model becomes a plain pinhole (except Kannala-Brandt, where r
/// = f theta then).
void drop_zero_distortion(camera_intrinsics& camera) {
  bool const zero = std::all_of(camera.distortion.begin(), camera.distortion.end(),
                                [](double k) { return k == 0; });
  if (camera.model == lens::radial_tangential && zero) {
    camera.model = lens::pinhole;
    camera.distortion.clear();
  }
}

/// One EuRoC camera; T_BS goes to `T_body_camera`, rate_hz to `fps`.
camera_intrinsics read_sensor(std::string const& path, Eigen::Isometry3d& T_body_camera,
                              double& fps) {
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
  return camera;
}

/// Keys `prefix`fx, fy, cx, cy.
void read_projection(yaml_file const& file, std::string const& prefix, camera_intrinsics& camera) {
  camera.fx = file.number(prefix + "fx", focal_limits);
  camera.fy = file.number(prefix + "fy", focal_limits);
  camera.cx = file.number(prefix + "cx", centre_limits);
  camera.cy = file.number(prefix + "cy", centre_limits);
}

/// Keys `prefix`k1, k2, p1, p2 and, if given, k3; without any, a pinhole.
void read_radial_tangential(yaml_file const& file, std::string const& prefix,
                            camera_intrinsics& camera) {
  camera.model = lens::pinhole;
  camera.distortion.clear();
  bool any = false;
  for (char const* name : {"k1", "k2", "p1", "p2", "k3"}) { any = any || file.has(prefix + name); }
  if (!any) { return; }
  camera.model = lens::radial_tangential;
  for (char const* name : {"k1", "k2", "p1", "p2"}) {
    camera.distortion.push_back(file.number(prefix + name, coefficient_limits));
  }
  if (file.has(prefix + "k3")) {
    camera.distortion.push_back(file.number(prefix + "k3", coefficient_limits));
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

Eigen::Matrix3d read_rotation(yaml_file const& file, std::string const& key) {
  std::vector<double> const values = file.matrix_of(key, 3, 3);
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const> const m(values.data());
  return checked_rotation(m, file.path(), key);
}

/// The format with Camera1.*
void read_new_settings(yaml_file const& file, stereo_rig& rig) {
  std::string const type = file.text("Camera.type");
  read_projection(file, "Camera1.", rig.left);
  if (type == "Rectified") {
    rig.right = rig.left;
    double const baseline = file.number("Stereo.b", {0, max_baseline, true});
    rig.T_left_right.translation() = Eigen::Vector3d(baseline, 0, 0);
    return;
  }
  bool const fisheye = type == "KannalaBrandt8";
  if (!fisheye && type != "PinHole") {
    throw error(file.path() + ": Camera.type = " + type +
                ": must be PinHole, Rectified or KannalaBrandt8");
  }
  if (!file.has("Camera2.fx")) {
    throw error(file.path() + ": Camera2.fx is missing: not the calibration of a stereo pair");
  }
  read_projection(file, "Camera2.", rig.right);
  if (fisheye) {
    read_kannala_brandt(file, "Camera1.", rig.left);
    read_kannala_brandt(file, "Camera2.", rig.right);
  } else {
    read_radial_tangential(file, "Camera1.", rig.left);
    read_radial_tangential(file, "Camera2.", rig.right);
  }
  rig.T_left_right = file.transform("Stereo.T_c1_c2");
}

/// The older format with Camera.fx
void read_old_settings(yaml_file const& file, stereo_rig& rig) {
  std::string const type = file.has("Camera.type") ? file.text("Camera.type") : "PinHole";
  if (type == "KannalaBrandt8") {
    read_projection(file, "Camera.", rig.left);
    read_kannala_brandt(file, "Camera.", rig.left);
    if (!file.has("Camera2.fx")) {
      throw error(file.path() + ": Camera2.fx is missing: not the calibration of a stereo pair");
    }
    read_projection(file, "Camera2.", rig.right);
    read_kannala_brandt(file, "Camera2.", rig.right);
    rig.T_left_right = file.transform("Tlr");
    return;
  }
  if (type != "PinHole" && type != "Rectified") {
    throw error(file.path() + ": Camera.type = " + type +
                ": must be PinHole, Rectified or KannalaBrandt8");
  }
  if (file.has("LEFT.K")) {
    // Raw cameras, and the rectification that the reference applies: x_rectified = R x_raw. In the
    // rectified frames the right camera is at (b, 0, 0), P_right = [f 0 cx -f b; ...].
    read_raw_camera(file, "LEFT", rig.left);
    read_raw_camera(file, "RIGHT", rig.right);
    Eigen::Matrix3d const R_left = read_rotation(file, "LEFT.R");
    Eigen::Matrix3d const R_right = read_rotation(file, "RIGHT.R");
    std::vector<double> const p = file.matrix_of("RIGHT.P", 3, 4);
    check_number(p[0], focal_limits, file.path(), "RIGHT.P[0] (fx)", to_text(p[0]));
    double const baseline = -p[3] / p[0];
    check_number(baseline, {0, max_baseline, true}, file.path(), "RIGHT.P: baseline -P[3] / P[0]",
                 to_text(baseline));
    rig.T_left_right.linear() = R_left.transpose() * R_right;
    rig.T_left_right.translation() = R_left.transpose() * Eigen::Vector3d(baseline, 0, 0);
    return;
  }
  read_projection(file, "Camera.", rig.left);
  read_radial_tangential(file, "Camera.", rig.left);
  rig.right = rig.left;
  double const bf = file.number("Camera.bf", {0, max_focal * max_baseline, true});
  rig.T_left_right.translation() = Eigen::Vector3d(bf / rig.left.fx, 0, 0);
}

void read_orb(yaml_file const& file, orb_settings& orb) {
  auto const integer = [&](char const* key, limits const& range, std::optional<int>& to) {
    if (file.has(key)) { to = file.integer(key, range); }
  };
  auto const number = [&](char const* key, limits const& range, std::optional<double>& to) {
    if (file.has(key)) { to = file.number(key, range); }
  };
  integer("ORBextractor.nFeatures", {1, 1e6}, orb.features);
  integer("ORBextractor.nLevels", {1, 32}, orb.levels);
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

/// mav0 for a path to it, to the folder around it, or to one of its cam0/sensor.yaml; else empty.
std::string find_mav0(std::string const& path) {
  namespace fs = std::filesystem;
  fs::path const p(path);
  if (detail::is_directory(path)) {
    for (fs::path const& candidate : {p, p / "mav0"}) {
      if (detail::is_directory((candidate / "cam0").string())) { return candidate.string(); }
    }
    return {};
  }
  fs::path const absolute = fs::absolute(p);
  if (p.filename() == "sensor.yaml" && absolute.parent_path().filename() == "cam0") {
    return absolute.parent_path().parent_path().string();
  }
  return {};
}

void check_camera(camera_intrinsics const& camera, std::string const& side,
                  std::string const& source) {
  auto const check = [&](char const* name, double value, limits const& range) {
    check_number(value, range, source, side + " camera: " + name, to_text(value));
  };
  check("width", camera.width, side_limits);
  check("height", camera.height, side_limits);
  check("fx", camera.fx, focal_limits);
  check("fy", camera.fy, focal_limits);
  check("cx", camera.cx, {-1.0 * camera.width, 2.0 * camera.width});
  check("cy", camera.cy, {-1.0 * camera.height, 2.0 * camera.height});
  for (double const k : camera.distortion) {
    check("distortion coefficient", k, coefficient_limits);
  }
  std::size_t const n = camera.distortion.size();
  bool const count_ok = camera.model == lens::pinhole          ? n == 0
                        : camera.model == lens::kannala_brandt ? n == 4
                                                               : n == 4 || n == 5 || n == 8;
  if (!count_ok) {
    char const* allowed = camera.model == lens::pinhole          ? "none"
                          : camera.model == lens::kannala_brandt ? "4"
                                                                 : "4, 5 or 8";
    throw error(source + ": " + side + " camera: " + std::to_string(n) +
                " distortion coefficients, must have " + allowed);
  }
}

}  // namespace

bool stereo_rig::rectified() const {
  auto const ideal = [](camera_intrinsics const& camera) {
    return camera.model == lens::pinhole ||
           (camera.model == lens::radial_tangential &&
            std::all_of(camera.distortion.begin(), camera.distortion.end(),
                        [](double k) { return k == 0; }));
  };
  constexpr double pixel_tolerance = 1e-3;
  // 1e-5 rad is a few thousandths of a pixel; text files round to 6 digits and more.
  constexpr double angle_tolerance = 1e-5;
  bool const same = left.width == right.width && left.height == right.height &&
                    std::fabs(left.fx - right.fx) <= pixel_tolerance &&
                    std::fabs(left.fy - right.fy) <= pixel_tolerance &&
                    std::fabs(left.cx - right.cx) <= pixel_tolerance &&
                    std::fabs(left.cy - right.cy) <= pixel_tolerance;
  Eigen::Vector3d const t = T_left_right.translation();
  double const turn = (T_left_right.linear() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  return ideal(left) && ideal(right) && same && turn <= angle_tolerance && t.x() > 0 &&
         std::fabs(t.y()) <= angle_tolerance * t.x() && std::fabs(t.z()) <= angle_tolerance * t.x();
}

void check_rig(stereo_rig const& rig, std::string const& source) {
  check_camera(rig.left, "left", source);
  check_camera(rig.right, "right", source);
  if (rig.left.width != rig.right.width || rig.left.height != rig.right.height) {
    throw error(source + ": left camera is " + std::to_string(rig.left.width) + " x " +
                std::to_string(rig.left.height) + ", right camera " +
                std::to_string(rig.right.width) + " x " + std::to_string(rig.right.height) +
                ": must be equal");
  }
  if (!rig.T_left_right.matrix().allFinite() || !rig.T_body_left.matrix().allFinite()) {
    throw error(source + ": camera extrinsics are not finite");
  }
  checked_rotation(rig.T_left_right.linear(), source, "T_left_right");
  checked_rotation(rig.T_body_left.linear(), source, "T_body_left");
  check_number(rig.baseline(), {min_baseline, max_baseline}, source, "baseline",
               to_text(rig.baseline()) + " m");
  check_number(rig.fps, fps_limits, source, "frames per second", to_text(rig.fps));
}

calibration read_euroc_calibration(std::string const& mav0) {
  namespace fs = std::filesystem;
  std::string const left_path = (fs::path(mav0) / "cam0" / "sensor.yaml").string();
  std::string const right_path = (fs::path(mav0) / "cam1" / "sensor.yaml").string();
  calibration result;
  Eigen::Isometry3d T_body_right;
  double right_fps = 0;
  result.rig.left = read_sensor(left_path, result.rig.T_body_left, result.rig.fps);
  result.rig.right = read_sensor(right_path, T_body_right, right_fps);
  result.rig.T_left_right = result.rig.T_body_left.inverse() * T_body_right;
  result.has_body_frame = true;
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
  imu.noise.gyro = file.number("gyroscope_noise_density", density_limits);
  imu.noise.gyro_walk = file.number("gyroscope_random_walk", density_limits);
  imu.noise.accel = file.number("accelerometer_noise_density", density_limits);
  imu.noise.accel_walk = file.number("accelerometer_random_walk", density_limits);
  return imu;
}

calibration read_kitti_calibration(std::string const& path, int width, int height,
                                   int left_camera) {
  std::string const left = "P" + std::to_string(left_camera);
  std::string const right = "P" + std::to_string(left_camera + 1);
  std::map<std::string, projection_matrix> found;
  for (detail::text_line const& line : detail::read_lines(path)) {
    std::size_t const colon = line.text.find(':');
    std::string const key =
        colon == std::string::npos ? std::string() : detail::trim(line.text.substr(0, colon));
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
  check_rig(result.rig, path);
  return result;
}

calibration read_orb_slam3_settings(std::string const& path, int width, int height) {
  yaml_file const file(path);
  calibration result;
  stereo_rig& rig = result.rig;
  if (file.has("Camera.width") || file.has("Camera.height")) {
    width = file.integer("Camera.width", side_limits);
    height = file.integer("Camera.height", side_limits);
  }
  if (file.has("Camera1.fx")) {
    read_new_settings(file, rig);
  } else if (file.has("Camera.fx") || file.has("LEFT.K")) {
    read_old_settings(file, rig);
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
  check_rig(rig, path);
  return result;
}

calibration read_calibration(std::string const& path, int width, int height, int left_camera) {
  std::string const mav0 = find_mav0(path);
  if (!mav0.empty()) { return read_euroc_calibration(mav0); }
  if (detail::is_directory(path)) {
    std::string const inside = (std::filesystem::path(path) / "calib.txt").string();
    if (!detail::is_file(inside)) {
      throw error(path + ": holds no calibration: neither cam0/sensor.yaml, mav0 nor calib.txt");
    }
    return read_kitti_calibration(inside, width, height, left_camera);
  }
  for (detail::text_line const& line : detail::read_lines(path)) {
    std::string const text = detail::trim(line.text);
    if (text.compare(0, 3, "P0:") == 0 || text.compare(0, 3, "P1:") == 0) {
      return read_kitti_calibration(path, width, height, left_camera);
    }
  }
  return read_orb_slam3_settings(path, width, height);
}

}  // namespace seq
