// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/calibration_files.hpp"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <map>
#include <system_error>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace detail {
namespace {

namespace fs = std::filesystem;

/// The file whose name has `to` in place of the last `from`; empty if there is none, or no such
/// file.
std::string with_word(std::string const& path, std::string const& from, std::string const& to) {
  std::string name = fs::path(path).filename().string();
  std::size_t const at = name.rfind(from);
  if (at == std::string::npos) { return {}; }
  name.replace(at, from.size(), to);
  std::string const other = (fs::path(path).parent_path() / name).string();
  return is_file(other) ? other : std::string();
}

constexpr char const* sides[][2] = {
    {"left", "right"},      {"Left", "Right"},        {"LEFT", "RIGHT"}, {"cam0", "cam1"},
    {"camera0", "camera1"}, {"camera_0", "camera_1"}, {"cam_0", "cam_1"}};

}  // namespace

calibration_format format_of(std::string const& path) {
  bool numbers = true;  // all lines are numbers or comments
  bool any = false;
  bool plain = true;  // neither YAML nor XML nor JSON
  bool camera = false;
  for (text_line const& line : read_lines(path)) {
    std::string const text = trim(line.text);
    if (text.size() > 2 && text[0] == 'P' && text[1] >= '0' && text[1] <= '3' && text[2] == ':') {
      return calibration_format::kitti;
    }
    if (text.compare(0, 8, "P_rect_0") == 0) { return calibration_format::kitti; }
    if (is_realsense_stream(text)) { return calibration_format::realsense; }
    if (is_blank_or_comment(text)) { continue; }
    if (!any && is_colmap_camera(text)) { return calibration_format::colmap; }
    any = true;
    numbers = numbers && text.find_first_not_of("0123456789.+-eE \t,") == std::string::npos;
    plain = plain && text.find_first_of(":{<") == std::string::npos;
    std::vector<std::string> const words = split(text, " \t,", true);
    double ignored = 0;
    camera = camera || std::count_if(words.begin(), words.end(), [&](std::string const& word) {
                         return to_number(word, ignored);
                       }) >= 4;
  }
  // With a word among the numbers it is one, too: its reader says which.
  if (any && (numbers || (plain && camera))) { return calibration_format::camera_txt; }
  yaml_file const file(path);
  if (file.is_map("cam0")) { return calibration_format::kalibr; }
  if (file.is_map("value0")) { return calibration_format::basalt; }
  if (file.is_list("cameraData")) { return calibration_format::depthai; }
  for (char const* key :
       {"Camera1.fx", "Camera.fx", "Camera.type", "LEFT.K", "ORBextractor.nLevels"}) {
    if (file.has(key)) { return calibration_format::orb_slam3; }
  }
  if (file.has("T_BS")) {
    return file.has("intrinsics") ? calibration_format::euroc : calibration_format::unknown;
  }
  if (is_opencv_calibration(file)) { return calibration_format::opencv; }
  return is_opencv_extrinsics(file) ? calibration_format::extrinsics : calibration_format::unknown;
}

pair_of_files camera_files(std::string const& path) {
  for (auto const& [left, right] : sides) {
    std::string const second = with_word(path, left, right);
    if (!second.empty()) { return {path, second}; }
    std::string const first = with_word(path, right, left);
    if (!first.empty()) { return {first, path}; }
  }
  return {path, {}};
}

std::string intrinsics_file(std::string const& path) {
  std::string const other = with_word(path, "extrinsic", "intrinsic");
  return other.empty() ? path : other;
}

std::string extrinsics_file(std::string const& path) {
  std::vector<std::string> found = {with_word(path, "intrinsic", "extrinsic")};
  for (auto const& side : sides) { found.push_back(with_word(path, side[0], "extrinsics")); }
  fs::path const extension = fs::path(path).extension();
  for (char const* name : {"extrinsics", "extrinsic"}) {
    std::string const beside =
        (fs::path(path).parent_path() / name).replace_extension(extension).string();
    if (is_file(beside)) { found.push_back(beside); }
  }
  for (std::string const& file : found) {
    if (!file.empty() && file != path) { return file; }
  }
  return {};
}

}  // namespace detail

std::string find_calibration_file(std::string const& folder) {
  using namespace detail;
  std::map<std::string, std::string> found;  // what is one calibration once
  std::map<std::string, std::string> plain;  // .txt, which count where there are no others
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    std::string extension = it->path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    bool const text =
        extension == ".yaml" || extension == ".yml" || extension == ".xml" || extension == ".json";
    bool const listing = extension == ".txt";
    constexpr std::uintmax_t largest = 1 << 20;
    std::error_code ignored;
    std::string const path = it->path().string();
    if (!(text || listing) || !is_file(path) || fs::file_size(path, ignored) > largest) {
      continue;
    }
    calibration_format format = calibration_format::unknown;
    try {
      format = format_of(path);
    } catch (error const&) { continue; }  // another program's file
    if (format == calibration_format::unknown || format == calibration_format::extrinsics ||
        format == calibration_format::euroc) {
      continue;
    }
    if (listing && format != calibration_format::colmap &&
        format != calibration_format::realsense) {
      continue;
    }
    std::string const first =
        format == calibration_format::opencv ? camera_files(path).first : path;
    (listing ? plain : found)[first] = first;
  }
  if (found.empty()) { found = plain; }
  if (found.size() > 1) {
    std::string all;
    for (auto const& [name, path] : found) {
      all += (all.empty() ? "" : ", ") + fs::path(path).filename().string();
    }
    throw error(folder + ": several calibrations: " + all + "; name one (--calibration); " +
                accepted_calibrations);
  }
  return found.empty() ? std::string() : found.begin()->second;
}

char const* const accepted_calibrations =
    "accepted are Kalibr's chain (cam0, cam1), OpenCV's files in YAML, XML or JSON (of one camera "
    "camera_matrix, distortion_coefficients; of a pair M1, D1, "
    "M2, D2, R, T), ROS camera_info (left.yaml, right.yaml), basalt's and visnav's JSON (value0), "
    "what "
    "rs-enumerate-devices -c prints, DepthAI's JSON (eepromToJsonFile), COLMAP's cameras.txt, "
    "ORB-SLAM3 settings, EuRoC's cam0/sensor.yaml, KITTI's calib.txt or calib_cam_to_cam.txt, and "
    "of one camera camera.txt "
    "(fx fy cx "
    "cy)";

}  // namespace seq
