// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <filesystem>
#include <string>

#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

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

}  // namespace

calibration read_calibration(std::string const& path, int width, int height, int left_camera,
                             camera_kind kind) {
  std::string const mav0 = find_mav0(path);
  if (!mav0.empty()) { return read_euroc_calibration(mav0, kind); }
  if (detail::is_directory(path)) {
    std::filesystem::path const folder(path);
    std::string const kitti = (folder / "calib.txt").string();
    std::string const tum = (folder / "camera.txt").string();
    if (detail::is_file(kitti)) {
      return read_kitti_calibration(kitti, width, height, left_camera, kind);
    }
    if (kind != camera_kind::stereo && detail::is_file(tum)) {
      return read_camera_txt(tum, width, height, kind);
    }
    throw error(path + ": holds no calibration: neither cam0/sensor.yaml, mav0 nor calib.txt" +
                (kind == camera_kind::stereo ? "" : ", nor camera.txt"));
  }
  bool numbers = true;  // all lines are numbers or comments
  bool any = false;
  for (detail::text_line const& line : detail::read_lines(path)) {
    std::string const text = detail::trim(line.text);
    if (text.size() > 2 && text[0] == 'P' && text[1] >= '0' && text[1] <= '3' && text[2] == ':') {
      return read_kitti_calibration(path, width, height, left_camera, kind);
    }
    if (detail::is_blank_or_comment(text)) { continue; }
    any = true;
    numbers = numbers && text.find_first_not_of("0123456789.+-eE \t,") == std::string::npos;
  }
  if (any && numbers && kind != camera_kind::stereo) {
    return read_camera_txt(path, width, height, kind);
  }
  return read_orb_slam3_settings(path, width, height, kind);
}

}  // namespace seq
