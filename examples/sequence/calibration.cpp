// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/calibration.hpp"

#include <filesystem>
#include <string>

#include "examples/sequence/detail/calibration_files.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

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

namespace {

/// Formats that are recognised by one key, which files of other programs have, too.
calibration read_keyed(std::string const& path, int width, int height, camera_kind kind,
                       detail::calibration_format format) {
  using detail::calibration_format;
  try {
    return format == calibration_format::kalibr ? read_kalibr_calibration(path, kind)
           : format == calibration_format::basalt
               ? read_basalt_calibration(path, kind)
               : read_depthai_calibration(path, width, height, kind);
  } catch (detail::missing_key const& e) {
    throw error(std::string(e.what()) + "; " + accepted_calibrations);
  }
}

/// @throws seq::error that says which formats there are, also for a file that cannot be read
detail::calibration_format known_format(std::string const& path) {
  detail::calibration_format format = detail::calibration_format::unknown;
  try {
    format = detail::format_of(path);
  } catch (error const& e) { throw error(std::string(e.what()) + "; " + accepted_calibrations); }
  if (format == detail::calibration_format::unknown) {
    throw error(path + ": not a calibration that is known; " + accepted_calibrations);
  }
  return format;
}

/// @param path of a file
calibration read_file(std::string const& path, int width, int height, int left_camera,
                      camera_kind kind) {
  using detail::calibration_format;
  calibration_format const format = known_format(path);
  switch (format) {
    case calibration_format::kitti:
      return read_kitti_calibration(path, width, height, left_camera, kind);
    case calibration_format::camera_txt:
      if (is_pair(kind)) {
        throw error(path + ": numbers of one camera, which do not say where the right one is");
      }
      return read_camera_txt(path, width, height, kind);
    case calibration_format::kalibr:
    case calibration_format::basalt:
    case calibration_format::depthai:
      return read_keyed(path, width, height, kind, format);
    case calibration_format::colmap:
      return read_colmap_calibration(path, kind);
    case calibration_format::realsense:
      return read_realsense_calibration(path, width, height, kind);
    case calibration_format::opencv:
    case calibration_format::extrinsics:
      return read_opencv_calibration(path, width, height, kind);
    case calibration_format::orb_slam3:
      return read_orb_slam3_settings(path, width, height, kind);
    case calibration_format::euroc:
      throw error(path + ": one camera's sensor.yaml: name the folder that holds cam0 and cam1");
    case calibration_format::unknown:
      break;  // refused above
  }
  return {};
}

}  // namespace

calibration read_calibration(std::string const& path, int width, int height, int left_camera,
                             camera_kind kind) {
  std::string const mav0 = find_mav0(path);
  bool const own =
      !mav0.empty() && (!detail::is_directory(path) || detail::is_file(mav0 + "/cam0/sensor.yaml"));
  if (own) { return read_euroc_calibration(mav0, kind); }
  if (!detail::is_directory(path)) { return read_file(path, width, height, left_camera, kind); }
  std::filesystem::path const folder(path);
  std::string const kitti = (folder / "calib.txt").string();
  std::string const tum = (folder / "camera.txt").string();
  if (detail::is_file(kitti)) { return read_file(kitti, width, height, left_camera, kind); }
  if (!is_pair(kind) && detail::is_file(tum)) { return read_camera_txt(tum, width, height, kind); }
  std::string const other = find_calibration_file(path);
  if (!other.empty()) { return read_file(other, width, height, left_camera, kind); }
  if (!mav0.empty()) { return read_euroc_calibration(mav0, kind); }  // says what is missing
  throw missing_calibration(path + ": holds no calibration; " + accepted_calibrations);
}

}  // namespace seq
