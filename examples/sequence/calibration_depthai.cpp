// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
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
using json = nlohmann::ordered_json;

constexpr int no_socket = -1;
constexpr int colour_socket = 0;

/// Where a camera is: maps its points into those of the camera at another socket, metres.
struct mount {
  int to = no_socket;
  Eigen::Isometry3d T_to_camera = Eigen::Isometry3d::Identity();
};

struct socket {
  camera_intrinsics camera;
  mount place;
};

/// A whole number of at most 1000, such as that of a socket.
int whole(json const& value, std::string const& path, std::string const& key) {
  double const number = value.get<double>();
  check_number(number, {no_socket, 1000}, path, key);
  return static_cast<int>(number);
}

std::vector<double> matrix_of(json const& rows) {
  std::vector<double> all;
  for (json const& row : rows) {
    for (json const& value : row) { all.push_back(value.get<double>()); }
  }
  return all;
}

mount read_mount(json const& extrinsics, std::string const& path) {
  mount result;
  result.to = whole(extrinsics.at("toCameraSocket"), path, "toCameraSocket");
  if (result.to == no_socket) { return result; }
  std::vector<double> const m = matrix_of(extrinsics.at("rotationMatrix"));
  if (m.size() != 9) {
    throw error(path + ": rotationMatrix has " + std::to_string(m.size()) +
                " numbers, must have 9");
  }
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor> const> const rows(m.data());
  result.T_to_camera.linear() = checked_rotation(rows, path, "rotationMatrix");
  json const& t = extrinsics.at("translation");
  for (int i = 0; i < 3; ++i) {
    constexpr char const* axes[] = {"x", "y", "z"};
    double const value = t.at(axes[i]).get<double>();
    check_number(value, {-1e5, 1e5}, path, std::string("translation: ") + axes[i]);
    result.T_to_camera.translation()[i] =
        0.01 * value;  // centimetres, whatever lengthUnit says: DepthAI ignores it
  }
  return result;
}

socket read_socket(json const& data, std::string const& path) {
  socket result;
  camera_intrinsics& camera = result.camera;
  double const width = data.at("width").get<double>();
  double const height = data.at("height").get<double>();
  check_number(width, side_limits, path, "width");
  check_number(height, side_limits, path, "height");
  camera.width = static_cast<int>(width);
  camera.height = static_cast<int>(height);
  std::vector<double> const k = matrix_of(data.at("intrinsicMatrix"));
  if (k.size() != 9) {
    throw error(path + ": intrinsicMatrix has " + std::to_string(k.size()) +
                " numbers, must have 9");
  }
  set_camera_matrix(camera, k, path, "intrinsicMatrix");
  int const type =
      data.contains("cameraType") ? whole(data.at("cameraType"), path, "cameraType") : 0;
  if (type != 0 && type != 1) {
    throw error(path + ": cameraType is " + std::to_string(type) +
                ": must be 0 (perspective) or 1 (fisheye)");
  }
  std::vector<double> coefficients = data.at("distortionCoeff").get<std::vector<double>>();
  set_distortion(camera, type == 0 ? "rational_polynomial" : "fisheye", std::move(coefficients),
                 path, "distortionCoeff");
  result.place = read_mount(data.at("extrinsics"), path + ": extrinsics");
  return result;
}

using sockets = std::map<int, json>;

socket read_socket(sockets const& all, int which, std::string const& path) {
  auto const found = all.find(which);
  std::string const name = path + ": cameraData of socket " + std::to_string(which);
  if (found == all.end()) { throw error(name + " is missing"); }
  return read_socket(found->second, name);
}

/// Maps points of camera `from` into camera `to` where its chain of at most so many extrinsics
/// leads there.
std::optional<Eigen::Isometry3d> along_chain(sockets const& all, int from, int to, std::size_t most,
                                             std::string const& path) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  int at = from;
  for (std::size_t steps = 0; at != to; ++steps) {
    auto const found = all.find(at);
    if (found == all.end() || steps == most) {
      return std::nullopt;
    }  // it may go round in a circle
    mount const next = read_mount(found->second.at("extrinsics"),
                                  path + ": extrinsics of socket " + std::to_string(at));
    if (next.to == no_socket) { return std::nullopt; }
    T = next.T_to_camera * T;
    at = next.to;
  }
  return T;
}

/// Maps points of camera `from` into camera `to`: by the extrinsics of one of them, by a chain
/// between them, else by chains of both to a third.
Eigen::Isometry3d between(sockets const& all, int from, int to, std::string const& path) {
  for (std::size_t const most : {std::size_t{1}, all.size()}) {
    if (auto const T = along_chain(all, from, to, most, path)) { return *T; }
    if (auto const T = along_chain(all, to, from, most, path)) { return T->inverse(); }
  }
  for (auto const& [third, data] : all) {
    auto const T_from = along_chain(all, from, third, all.size(), path);
    auto const T_to = along_chain(all, to, third, all.size(), path);
    if (T_from && T_to) { return T_to->inverse() * *T_from; }
  }
  throw error(path + ": no extrinsics between the cameras of sockets " + std::to_string(from) +
              " and " + std::to_string(to));
}

/// Images of another size: scaled until they fill it, then cut at the middle, as the device does.
void fit(camera_intrinsics& camera, int width, int height, std::string const& path,
         std::vector<std::string>& warnings) {
  if (width == 0 || (camera.width == width && camera.height == height)) { return; }
  double const scale = std::max(static_cast<double>(width) / camera.width,
                                static_cast<double>(height) / camera.height);
  warnings.push_back(path + ": calibrated at " + std::to_string(camera.width) + "x" +
                     std::to_string(camera.height) + ", scaled to " + std::to_string(width) + "x" +
                     std::to_string(height) + " by " + to_text(scale) + " and cut at the middle");
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx = (camera.cx + 0.5) * scale - 0.5 - (camera.width * scale - width) / 2;
  camera.cy = (camera.cy + 0.5) * scale - 0.5 - (camera.height * scale - height) / 2;
  camera.width = width;
  camera.height = height;
}

/// The IMU, where it is known: it maps points of the IMU into a camera.
void read_imu_place(json const& file, sockets const& all, int left, std::string const& path,
                    calibration& result) {
  if (!file.contains("imuExtrinsics")) { return; }
  json const& extrinsics = file.at("imuExtrinsics");
  std::vector<double> const m = matrix_of(extrinsics.at("rotationMatrix"));
  bool const known = std::any_of(m.begin(), m.end(), [](double v) { return v != 0; });
  if (!known) { return; }
  try {
    mount const imu = read_mount(extrinsics, path + ": imuExtrinsics");
    if (imu.to == no_socket) { return; }
    result.rig.T_body_left = imu.T_to_camera.inverse() * between(all, left, imu.to, path);
    result.has_body_frame = true;
  } catch (error const& e) {
    result.warnings.push_back(std::string("the place of the IMU is not known: ") + e.what());
  }
}

calibration read(json const& file, std::string const& path, int width, int height,
                 camera_kind kind) {
  sockets all;
  for (json const& entry : file.at("cameraData")) {
    all[whole(entry.at(0), path, "cameraData")] = entry.at(1);
  }
  json const& pair = file.at("stereoRectificationData");
  int const left = whole(pair.at("leftCameraSocket"), path, "leftCameraSocket");
  int const right = whole(pair.at("rightCameraSocket"), path, "rightCameraSocket");
  bool const colour = kind == camera_kind::rgbd && all.count(colour_socket) != 0;
  bool const alone = kind == camera_kind::mono && left == no_socket;
  int const first = colour || alone ? colour_socket : left;
  calibration result;
  if (is_pair(kind) && (left == no_socket || right == no_socket)) {
    throw error(path + ": stereoRectificationData names no pair");
  }
  result.rig.left = read_socket(all, first, path).camera;
  fit(result.rig.left, width, height, path, result.warnings);
  if (is_pair(kind)) {
    result.rig.right = read_socket(all, right, path).camera;
    std::vector<std::string> same;
    fit(result.rig.right, width, height, path, same);
    result.rig.T_left_right = between(all, right, left, path);
    check_baseline(result.rig, path, "translation");
  } else {
    set_one_camera(result.rig, kind);
    result.warnings.push_back(path + ": the calibration of socket " + std::to_string(first) +
                              " is taken");
  }
  read_imu_place(file, all, first, path, result);
  check_rig(result.rig, path, kind);
  return result;
}

}  // namespace

calibration read_depthai_calibration(std::string const& path, int width, int height,
                                     camera_kind kind) {
  std::ifstream in(path, std::ios::binary);
  try {
    return read(json::parse(in), path, width, height, kind);
  } catch (json::exception const& e) { throw missing_key(path + ": " + e.what()); }
}

}  // namespace seq
