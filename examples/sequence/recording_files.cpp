// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/image_io.hpp"

namespace seq::detail {

std::string size_text(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

namespace {

/// What to do with images that hold both of a pair; empty for others.
std::string halves_text(int width, int height, camera_intrinsics const& camera) {
  bool const beside = width == 2 * camera.width && height == camera.height;
  bool const below = width == camera.width && height == 2 * camera.height;
  if (!beside && !below) { return {}; }
  return std::string(": are both images of a pair in one, ") +
         (beside ? "side by side" : "one above the other") +
         "? They must be apart, in left and right; of a video: ffmpeg -i VIDEO -vf crop=" +
         (beside ? "iw/2:ih:0:0 left.mp4, crop=iw/2:ih:iw/2:0 right.mp4"
                 : "iw:ih/2:0:0 left.mp4, crop=iw:ih/2:0:ih/2 right.mp4");
}

}  // namespace

void check_image_size(std::string const& path, int width, int height,
                      camera_intrinsics const& camera) {
  if (width != camera.width || height != camera.height) {
    throw error(path + ": image is " + size_text(width, height) + " pixels, the calibration has " +
                size_text(camera.width, camera.height) + halves_text(width, height, camera) +
                (width * camera.height == height * camera.width
                     ? "; scale fx, fy, cx, cy with the images"
                     : ""));
  }
}

namespace {

namespace fs = std::filesystem;

/// What is known of a calibration that is not there, for its message.
std::string published_calibration(layout_of_files const& l) {
  if (!l.y_up_truth.empty()) {
    return "; of ICL-NUIM 481.2 -480 319.5 239.5 are published, in a camera.txt";
  }
  if (l.name != "7scenes") { return {}; }
  return "; for the Kinect of 7-Scenes, which was not calibrated, 585 585 320 240 are published";
}

/// The calibration in the sequence's folder. @param width,height of its images
calibration own_calibration(layout_of_files const& l, camera_kind kind, int width, int height,
                            std::string& path) {
  auto const there = [&](fs::path const& file) {
    path = file.string();
    return is_file(path);
  };
  if (!l.mav0.empty() && there(l.mav0 / "cam0" / "sensor.yaml")) {
    if (is_pair(kind) && !is_file((l.mav0 / "cam1" / "sensor.yaml").string())) {
      throw missing_calibration((l.mav0 / "cam1" / "sensor.yaml").string() + ": no such file");
    }
    return read_euroc_calibration(l.mav0.string(), kind);
  }
  bool const folders = l.name == "folders";
  if (l.name == "kitti" && there(l.root / "calib.txt")) {
    return read_kitti_calibration(path, width, height, l.left_camera, kind);
  }
  if (l.name == "kitti_raw" && (there(l.root / "calib_cam_to_cam.txt") ||
                                there(l.root.parent_path() / "calib_cam_to_cam.txt"))) {
    return read_kitti_calibration(path, width, height, l.left_camera, kind);
  }
  if (folders && there(l.root / "calib.txt")) {
    return read_calibration(path, width, height, l.left_camera, kind);
  }
  bool const one = !is_pair(kind);
  bool const of_depths = l.name == "tum" || l.name == "openloris" || l.name == "7scenes";
  if ((of_depths || (folders && one)) && there(l.root / "camera.txt")) {
    return read_camera_txt(path, width, height, kind);
  }
  std::string const missing = path;
  bool const whole = l.mav0.empty() || l.mav0.filename() == "mav0";  // root is the recording's own
  // TUM-VI has Kalibr's chain in dso.
  for (fs::path const& folder :
       {l.mav0, whole ? l.root : fs::path(), whole ? l.root / "dso" : fs::path()}) {
    path = folder.empty() ? std::string() : find_calibration_file(folder.string());
    if (!path.empty()) { return read_calibration(path, width, height, l.left_camera, kind); }
  }
  if (l.freiburg >= 1 && l.freiburg <= 3) {
    path = "of freiburg" + std::to_string(l.freiburg) + ", as TUM publishes it";
    return published_tum_calibration(l.freiburg, kind);
  }
  throw missing_calibration(
      (folders ? l.root.string() + ": holds no calibration" : missing + ": no such file") + "; " +
      accepted_calibrations + published_calibration(l));
}

}  // namespace

calibration find_calibration(layout_of_files const& l, open_options const& options,
                             recording_source& source) {
  frame_files const& first = l.frames.front();
  int width = 0;
  int height = 0;
  read_image_size(first.left, width, height);
  camera_kind const kind = options.rig == camera_kind::mixed ? options.rig : l.kind;
  calibration calib;
  if (options.calibration.empty()) {
    calib = own_calibration(l, kind, width, height, source.calibration);
  } else {
    source.calibration = options.calibration;
    calib = read_calibration(options.calibration, width, height, l.left_camera, kind);
  }
  if (!calib.has_body_frame && !l.mav0.empty() &&
      is_file((l.mav0 / "cam0" / "sensor.yaml").string())) {
    // The replacement does not contain the body frame, which the ground truth needs.
    calib.rig.T_body_left = read_euroc_body_frame(l.mav0.string());
    calib.has_body_frame = true;
  }
  check_image_size(first.left, width, height, calib.rig.left);
  if (l.kind == camera_kind::stereo) {
    read_image_size(first.second, width, height);
    check_image_size(first.second, width, height, calib.rig.right);
  }
  return calib;
}

void check_second_camera(layout_of_files& files, open_options const& options,
                         calibration const& calib) {
  // A settings file of a camera with depth images has the baseline of a virtual pair.
  bool const by_itself = files.kind == camera_kind::mono && options.rig == camera_kind::any;
  if (!by_itself || files.name == "tum" || files.name == "openloris" || calib.depth_unit) {
    return;
  }
  camera_intrinsics const& left = calib.rig.left;
  try {
    std::string ignored;
    calibration const pair =
        options.calibration.empty()
            ? own_calibration(files, camera_kind::stereo, left.width, left.height, ignored)
            : read_calibration(options.calibration, left.width, left.height, files.left_camera,
                               camera_kind::stereo);
    if (!(pair.rig.baseline() > 0)) { return; }
  } catch (error const&) { return; }  // it is one camera's
  files.warnings.push_back(
      files.root.string() +
      ": the calibration has two cameras, and there are no images of the second one" +
      (files.second_folder.empty() ? "" : " (" + files.second_folder + ")") +
      ": tracked as one camera; --rig mono (rig=\"mono\") says that it is meant so");
}

namespace {

/// The file with the samples of an IMU; empty without, which `warnings` says of an IMU's folder.
std::string find_imu_samples(layout_of_files const& l, std::vector<std::string>& warnings) {
  std::string missing;
  for (fs::path const& folder : {l.mav0, l.root}) {
    if (folder.empty()) { continue; }
    std::string const file = (folder / "imu0" / "data.csv").string();
    if (is_file(file)) { return file; }
    if (missing.empty() && is_directory((folder / "imu0").string())) { missing = file; }
  }
  std::string const beside = (l.root / "imu.csv").string();
  if (is_file(beside)) { return beside; }
  if (!missing.empty()) {
    warnings.push_back(missing + ": no such file: the samples of the IMU are not used");
  }
  return {};
}

}  // namespace

std::optional<imu_recording> find_imu(layout_of_files const& l, calibration const& calib,
                                      Eigen::Isometry3d const& T_body_left,
                                      recording_source& source,
                                      std::vector<std::string>& warnings) {
  std::string const samples = find_imu_samples(l, warnings);
  std::string const sensor = (fs::path(samples).parent_path() / "sensor.yaml").string();
  if (samples.empty()) {
    source.imu_left_out = "no samples (imu0/data.csv, imu.csv)";
  } else if (!calib.has_body_frame) {
    source.imu_left_out = "the calibration does not say where the IMU is";
  } else if (!calib.imu && !is_file(sensor)) {
    source.imu_left_out =
        "nothing says its noise (sensor.yaml beside the samples; Kalibr's "
        "imu.yaml beside the chain)";
  }
  if (!source.imu_left_out.empty()) {
    if (!samples.empty()) {
      warnings.push_back(samples + ": the samples of the IMU are not used: " + source.imu_left_out);
    }
    return std::nullopt;
  }
  try {
    imu_recording imu;
    imu.calibration = calib.imu ? *calib.imu : read_euroc_imu_calibration(sensor);
    if (calib.imu_time_offset_s) { imu.calibration.time_offset_s = *calib.imu_time_offset_s; }
    imu.T_imu_left = imu.calibration.T_body_imu.inverse() * T_body_left;
    imu.samples = read_imu_samples(samples, &warnings);
    check_imu(imu, samples, warnings);
    return imu;
  } catch (error const& e) {
    throw error(std::string(e.what()) + "; --imu off (imu=False) tracks the images alone");
  }
}

}  // namespace seq::detail
