// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/reader.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/rectify.hpp"

namespace seq {
namespace {

namespace fs = std::filesystem;

constexpr char const* image_extensions[] = {".png", ".jpg", ".jpeg"};

/// A stereo pair on disk.
struct pair_files {
  std::int64_t time_ns = 0;
  std::string left;
  std::string right;
};

/// Poses in the file's frame.
struct raw_ground_truth {
  enum frame { body, raw_left, kitti_reference };
  trajectory poses;
  frame of = raw_left;
  bool orientation = false;
};

std::string size_text(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

/// `folder`/`name`, or the same stem with another image extension; empty if neither exists.
std::string find_image(fs::path const& folder, std::string const& name) {
  fs::path const listed = folder / name;
  if (detail::is_file(listed.string())) { return listed.string(); }
  for (char const* extension : image_extensions) {
    std::string const other = fs::path(listed).replace_extension(extension).string();
    if (detail::is_file(other)) { return other; }
  }
  return {};
}

/// time stamp -> file name, of an EuRoC camera's data.csv
std::map<std::int64_t, std::string> read_image_list(std::string const& path) {
  std::map<std::int64_t, std::string> images;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const fields = detail::split(line.text, ",", false);
    if (fields.size() != 2) {
      detail::fail_at(path, line.number,
                      std::to_string(fields.size()) + " fields, must have 2 (time stamp, file)");
    }
    std::int64_t const time_ns = detail::nanoseconds(fields[0], path, line.number);
    std::string const name = detail::trim(fields[1]);
    if (name.empty()) { detail::fail_at(path, line.number, "no file name"); }
    if (!images.emplace(time_ns, name).second) {
      detail::fail_at(path, line.number, "time stamp " + std::to_string(time_ns) + " occurs twice");
    }
  }
  return images;
}

/// The pairs of a sequence, and how many images have no partner.
struct found_pairs {
  std::vector<pair_files> pairs;
  unpaired_images unpaired;
};

found_pairs find_euroc_pairs(fs::path const& mav0) {
  std::map<std::int64_t, std::string> lists[2];
  for (std::size_t camera = 0; camera < 2; ++camera) {
    fs::path const folder = mav0 / ("cam" + std::to_string(camera));
    if (!detail::is_directory(folder.string())) {
      throw error(folder.string() + ": no such folder: not a stereo sequence");
    }
    std::string const csv = (folder / "data.csv").string();
    lists[camera] = read_image_list(csv);
    if (lists[camera].empty()) { throw error(csv + ": lists no images"); }
  }
  found_pairs found;
  int common = 0;
  auto const file_of = [&](char const* camera, std::string const& name) {
    return find_image(mav0 / camera / "data", name);
  };
  for (auto const& [time_ns, name] : lists[0]) {
    std::string const left = file_of("cam0", name);
    auto const other = lists[1].find(time_ns);
    if (other == lists[1].end()) {
      found.unpaired.left += static_cast<int>(!left.empty());
      continue;
    }
    ++common;
    std::string const right = file_of("cam1", other->second);
    if (!left.empty() && !right.empty()) {
      found.pairs.push_back({time_ns, left, right});
    } else {
      found.unpaired.left += static_cast<int>(!left.empty());
      found.unpaired.right += static_cast<int>(!right.empty());
    }
  }
  for (auto const& [time_ns, name] : lists[1]) {
    if (lists[0].count(time_ns) == 0 && !file_of("cam1", name).empty()) { ++found.unpaired.right; }
  }
  if (found.pairs.empty()) {
    throw error(mav0.string() + ": no stereo pair: cam0 lists " + std::to_string(lists[0].size()) +
                " images, cam1 " + std::to_string(lists[1].size()) + ", " + std::to_string(common) +
                " with equal time stamps, 0 with both files present");
  }
  return found;
}

/// frame number -> file, of a folder of numbered images; other files are ignored.
std::map<int, std::string> list_numbered_images(fs::path const& folder) {
  std::map<int, std::string> images;
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    fs::path const path = it->path();
    std::string extension = path.extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    std::string const stem = path.stem().string();
    bool const numbered =
        !stem.empty() && stem.size() <= 9 &&
        std::all_of(stem.begin(), stem.end(), [](char c) { return c >= '0' && c <= '9'; });
    bool const known = std::find(std::begin(image_extensions), std::end(image_extensions),
                                 extension) != std::end(image_extensions);
    if (!numbered || !known) { continue; }
    auto const [place, added] = images.emplace(std::stoi(stem), path.string());
    if (!added) { throw error(path.string() + ": same frame number as " + place->second); }
  }
  if (failure) { throw error(folder.string() + ": cannot be read: " + failure.message()); }
  return images;
}

std::vector<std::int64_t> read_times(std::string const& path) {
  std::vector<std::int64_t> times;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    times.push_back(detail::seconds_to_ns(line.text, path, line.number));
    if (times.size() > 1 && times.back() <= times[times.size() - 2]) {
      detail::fail_at(path, line.number, "time stamps must increase");
    }
  }
  return times;
}

/// @param left_camera number of the left camera: the images are in image_0 and image_1, or in
///   image_2 and image_3
found_pairs find_kitti_pairs(fs::path const& root, std::vector<std::int64_t> const& times,
                             int left_camera) {
  std::map<int, std::string> images[2];
  std::string names[2];
  for (std::size_t side = 0; side < 2; ++side) {
    names[side] = "image_" + std::to_string(left_camera + static_cast<int>(side));
    fs::path const folder = root / names[side];
    if (!detail::is_directory(folder.string())) {
      throw error(folder.string() + ": no such folder: not a stereo sequence");
    }
    images[side] = list_numbered_images(folder);
    if (images[side].empty()) {
      throw error(folder.string() + ": no images (000000.png, .jpg or .jpeg, numbered)");
    }
  }
  found_pairs found;
  for (auto const& [number, left] : images[0]) {
    auto const right = images[1].find(number);
    if (right == images[1].end()) { continue; }
    if (static_cast<std::size_t>(number) >= times.size()) {
      throw error((root / "times.txt").string() + ": " + std::to_string(times.size()) +
                  " times, none for " + left);
    }
    found.pairs.push_back({times[static_cast<std::size_t>(number)], left, right->second});
  }
  if (found.pairs.empty()) {
    throw error(root.string() + ": no stereo pair: " + names[0] + " holds " +
                std::to_string(images[0].size()) + " images, " + names[1] + " " +
                std::to_string(images[1].size()) + ", none with equal numbers");
  }
  found.unpaired.left = static_cast<int>(images[0].size() - found.pairs.size());
  found.unpaired.right = static_cast<int>(images[1].size() - found.pairs.size());
  return found;
}

/// EuRoC state_groundtruth_estimate0 and TUM-VI mocap0: time, position, quaternion w x y z; further
/// columns are ignored.
trajectory read_euroc_truth(std::string const& path) {
  trajectory poses;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const fields = detail::split(line.text, ",", false);
    if (fields.size() < 8) {
      detail::fail_at(path, line.number,
                      std::to_string(fields.size()) + " fields, must have at least 8");
    }
    stamped_pose pose;
    pose.T_world_camera = detail::pose_of_fields(
        fields.data() + 1, detail::quaternion_order::w_first, path, line.number);
    pose.time_ns = detail::nanoseconds(fields[0], path, line.number);
    if (!poses.empty() && pose.time_ns <= poses.back().time_ns) {
      detail::fail_at(path, line.number, "time stamps must increase");
    }
    poses.push_back(pose);
  }
  return poses;
}

/// KITTI poses.txt: 12 numbers a frame, 3x4 row-major; one line for each of `times`.
trajectory read_kitti_poses(std::string const& path, std::vector<std::int64_t> const& times) {
  trajectory poses;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const words = detail::split(line.text, " \t", true);
    if (words.size() != 12) {
      detail::fail_at(path, line.number, std::to_string(words.size()) + " numbers, must have 12");
    }
    Eigen::Matrix<double, 3, 4> m;
    for (int i = 0; i < 12; ++i) {
      m(i / 4, i % 4) =
          detail::finite_number(words[static_cast<std::size_t>(i)], path, line.number);
    }
    Eigen::Matrix3d const R = m.leftCols<3>();
    double const residual = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
    if (!(residual <= 0.02) || !(R.determinant() > 0)) {
      detail::fail_at(
          path, line.number,
          "not a rotation: |R R^T - I| = " + detail::to_text(residual) + ", at most 0.02 allowed");
    }
    stamped_pose pose;
    if (poses.size() < times.size()) { pose.time_ns = times[poses.size()]; }
    pose.T_world_camera.linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
    pose.T_world_camera.translation() = m.col(3);
    poses.push_back(pose);
  }
  if (poses.size() != times.size()) {
    throw error(path + ": " + std::to_string(poses.size()) + " poses, must have one for each of " +
                std::to_string(times.size()) + " frames");
  }
  return poses;
}

bool any_rotation(trajectory const& poses) {
  return std::any_of(poses.begin(), poses.end(), [](stamped_pose const& pose) {
    Eigen::Matrix3d const R = pose.T_world_camera.linear();
    return (R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-9;
  });
}

/// @param mav0 empty for the KITTI layout @param times of all frames, for poses.txt
raw_ground_truth find_ground_truth(fs::path const& root, fs::path const& mav0,
                                   std::vector<std::int64_t> const& times) {
  raw_ground_truth truth;
  std::string const euroc = (mav0 / "state_groundtruth_estimate0" / "data.csv").string();
  std::string const mocap = (mav0 / "mocap0" / "data.csv").string();
  std::string const tum = (root / "groundtruth.txt").string();
  std::string const kitti = (root / "poses.txt").string();
  if (!mav0.empty() && (detail::is_file(euroc) || detail::is_file(mocap))) {
    truth.poses = read_euroc_truth(detail::is_file(euroc) ? euroc : mocap);
    truth.of = raw_ground_truth::body;
    truth.orientation = !truth.poses.empty();
  } else if (detail::is_file(tum)) {
    truth.poses = read_tum(tum);
    truth.orientation = any_rotation(truth.poses);
  } else if (detail::is_file(kitti)) {
    truth.poses = read_kitti_poses(kitti, times);
    truth.of = raw_ground_truth::kitti_reference;
    truth.orientation = any_rotation(truth.poses);
  }
  return truth;
}

void check_image_size(std::string const& path, int width, int height,
                      camera_intrinsics const& camera) {
  if (width != camera.width || height != camera.height) {
    throw error(path + ": image is " + size_text(width, height) + " pixels, the calibration has " +
                size_text(camera.width, camera.height));
  }
}

image read_checked(std::string const& path, camera_intrinsics const& camera) {
  image picture = read_image(path);
  check_image_size(path, picture.width, picture.height, camera);
  return picture;
}

}  // namespace

std::vector<imu_sample> read_imu_samples(std::string const& path) {
  std::vector<imu_sample> samples;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const fields = detail::split(line.text, ",", false);
    if (fields.size() < 7) {
      detail::fail_at(path, line.number,
                      std::to_string(fields.size()) + " fields, must have at least 7");
    }
    imu_sample s;
    s.time_ns = detail::nanoseconds(fields[0], path, line.number);
    for (int i = 0; i < 3; ++i) {
      auto const k = static_cast<std::size_t>(i);
      s.gyro[i] = detail::finite_number(fields[1 + k], path, line.number);
      s.accel[i] = detail::finite_number(fields[4 + k], path, line.number);
    }
    if (!samples.empty() && s.time_ns <= samples.back().time_ns) {
      detail::fail_at(path, line.number, "time stamps must increase");
    }
    samples.push_back(s);
  }
  if (samples.empty()) { throw error(path + ": no samples"); }
  return samples;
}

struct sequence::impl {
  std::string name;
  std::string layout;
  stereo_rig raw;  ///< of the files
  stereo_rig rig;  ///< of the loaded frames
  bool fisheye = false;
  bool has_body_frame = false;
  bool has_orientation = false;
  orb_settings settings;
  std::vector<pair_files> pairs;
  unpaired_images unpaired;
  std::optional<rectifier> rectify;
  trajectory truth;
  std::optional<imu_recording> imu;
};

namespace {

/// A sequence on disk, with its pairs found.
struct layout_of_files {
  std::string name;  ///< "euroc" or "kitti"
  fs::path root;
  fs::path mav0;                    ///< empty for the KITTI layout
  int left_camera = 0;              ///< KITTI: 0 or 2
  std::vector<std::int64_t> times;  ///< of all frames, for poses.txt
  found_pairs found;
};

layout_of_files find_layout(std::string const& directory) {
  if (!detail::is_directory(directory)) { throw error(directory + ": no such folder"); }
  layout_of_files l;
  std::error_code failure;
  l.root = fs::canonical(directory, failure);
  if (failure) { throw error(directory + ": cannot be read: " + failure.message()); }
  auto const has = [&](char const* name) { return detail::is_directory((l.root / name).string()); };
  if (has("mav0")) {
    l.mav0 = l.root / "mav0";
  } else if (has("cam0")) {
    l.mav0 = l.root;
    l.root = l.root.parent_path();
  }
  if (!l.mav0.empty()) {
    l.name = "euroc";
    l.found = find_euroc_pairs(l.mav0);
    for (pair_files const& pair : l.found.pairs) { l.times.push_back(pair.time_ns); }
  } else if (has("image_0") || has("image_2")) {
    l.name = "kitti";
    l.left_camera = has("image_0") ? 0 : 2;
    l.times = read_times((l.root / "times.txt").string());
    l.found = find_kitti_pairs(l.root, l.times, l.left_camera);
  } else {
    throw error(directory +
                ": no sequence found: neither mav0/cam0 (EuRoC) nor image_0 or image_2 (KITTI)");
  }
  return l;
}

/// The calibration that was named, or else the sequence's own, compared with the first images.
calibration find_calibration(layout_of_files const& l, std::string const& named) {
  pair_files const& first = l.found.pairs.front();
  int width = 0;
  int height = 0;
  read_image_size(first.left, width, height);
  auto const own = [](fs::path const& file) {
    if (!detail::is_file(file.string())) {
      throw missing_calibration(file.string() + ": no such file");
    }
    return file.string();
  };
  calibration calib;
  if (!named.empty()) {
    calib = read_calibration(named, width, height, l.left_camera);
    if (!calib.has_body_frame && !l.mav0.empty() &&
        detail::is_file((l.mav0 / "cam0" / "sensor.yaml").string())) {
      // The replacement does not contain the body frame, which the ground truth needs.
      calib.rig.T_body_left = read_euroc_body_frame(l.mav0.string());
      calib.has_body_frame = true;
    }
  } else if (!l.mav0.empty()) {
    own(l.mav0 / "cam0" / "sensor.yaml");
    own(l.mav0 / "cam1" / "sensor.yaml");
    calib = read_euroc_calibration(l.mav0.string());
  } else {
    calib = read_kitti_calibration(own(l.root / "calib.txt"), width, height, l.left_camera);
  }
  check_image_size(first.left, width, height, calib.rig.left);
  read_image_size(first.right, width, height);
  check_image_size(first.right, width, height, calib.rig.right);
  return calib;
}

/// @param T_body_left of loaded frames
std::optional<imu_recording> find_imu(layout_of_files const& l, calibration const& calib,
                                      Eigen::Isometry3d const& T_body_left) {
  if (l.mav0.empty() || !calib.has_body_frame) { return std::nullopt; }
  std::string const samples = (l.mav0 / "imu0" / "data.csv").string();
  std::string const sensor = (l.mav0 / "imu0" / "sensor.yaml").string();
  if (!detail::is_file(samples) || (!calib.imu && !detail::is_file(sensor))) {
    return std::nullopt;
  }
  imu_recording imu;
  imu.calibration = calib.imu ? *calib.imu : read_euroc_imu_calibration(sensor);
  imu.T_imu_left = imu.calibration.T_body_imu.inverse() * T_body_left;
  imu.samples = read_imu_samples(samples);
  return imu;
}

/// What turns poses of a ground truth's frame into those of the left camera of loaded frames.
/// @param T_raw_loaded maps points of that camera into the raw one
Eigen::Isometry3d given_to_loaded(raw_ground_truth::frame given, calibration const& calib,
                                  stereo_rig const& loaded, Eigen::Isometry3d const& T_raw_loaded) {
  switch (given) {
    case raw_ground_truth::body:
      return loaded.T_body_left;  // contains the rectifying rotation
    case raw_ground_truth::kitti_reference:
      return calib.T_reference_left * T_raw_loaded;
    case raw_ground_truth::raw_left:
      break;
  }
  return T_raw_loaded;
}

}  // namespace

sequence::sequence(std::unique_ptr<impl> p) : impl_(std::move(p)) {}
sequence::sequence(sequence&&) noexcept = default;
sequence& sequence::operator=(sequence&&) noexcept = default;
sequence::~sequence() = default;

sequence sequence::open(std::string const& directory, open_options const& options) {
  if (options.max_frames < 0) {
    throw error(directory + ": max_frames = " + std::to_string(options.max_frames) +
                ": must be at least 0");
  }
  layout_of_files files = find_layout(directory);
  calibration const calib = find_calibration(files, options.calibration);
  auto p = std::make_unique<impl>();
  p->name = files.root.filename().string();
  p->layout = files.name;
  p->settings = calib.settings;
  p->raw = calib.rig;
  p->rig = calib.rig;
  p->has_body_frame = calib.has_body_frame;
  bool const fisheye_pair =
      calib.rig.left.model == lens::kannala_brandt && calib.rig.right.model == lens::kannala_brandt;
  Eigen::Isometry3d T_raw_loaded = Eigen::Isometry3d::Identity();
  if (fisheye_pair && options.keep_fisheye) {
    p->fisheye = true;
  } else if (!calib.rig.rectified()) {
    std::string const source = options.calibration.empty() ? directory : options.calibration;
    try {
      p->rectify.emplace(calib.rig);
    } catch (error const& e) { throw error(source + ": " + e.what()); }
    p->rig = p->rectify->rig();
    T_raw_loaded.linear() = p->rectify->left_rotation().transpose();
  }

  raw_ground_truth truth = find_ground_truth(files.root, files.mav0, files.times);
  p->has_orientation = truth.orientation;
  p->truth = std::move(truth.poses);
  if (truth.orientation) {
    p->truth = poses_of(p->truth, given_to_loaded(truth.of, calib, p->rig, T_raw_loaded));
  }
  if (options.read_imu) { p->imu = find_imu(files, calib, p->rig.T_body_left); }
  p->pairs = std::move(files.found.pairs);
  p->unpaired = files.found.unpaired;
  if (options.max_frames > 0 && p->pairs.size() > static_cast<std::size_t>(options.max_frames)) {
    p->pairs.resize(static_cast<std::size_t>(options.max_frames));
  }
  return sequence(std::move(p));
}

std::string const& sequence::name() const { return impl_->name; }
std::string const& sequence::layout() const { return impl_->layout; }
stereo_rig const& sequence::rig() const { return impl_->rig; }
bool sequence::fisheye() const { return impl_->fisheye; }
bool sequence::has_body_frame() const { return impl_->has_body_frame; }
unpaired_images sequence::unpaired() const { return impl_->unpaired; }
orb_settings const& sequence::settings() const { return impl_->settings; }
int sequence::size() const { return static_cast<int>(impl_->pairs.size()); }

std::int64_t sequence::time_ns(int i) const {
  if (i < 0 || i >= size()) {
    throw error(impl_->name + ": frame " + std::to_string(i) + " of " + std::to_string(size()));
  }
  return impl_->pairs[static_cast<std::size_t>(i)].time_ns;
}

stereo_frame sequence::load(int i) const {
  stereo_frame frame;
  frame.time_ns = time_ns(i);
  pair_files const& pair = impl_->pairs[static_cast<std::size_t>(i)];
  frame.left = read_checked(pair.left, impl_->raw.left);
  frame.right = read_checked(pair.right, impl_->raw.right);
  if (impl_->rectify) {
    frame.left = impl_->rectify->left(frame.left);
    frame.right = impl_->rectify->right(frame.right);
  }
  return frame;
}

trajectory const& sequence::ground_truth() const { return impl_->truth; }
std::optional<imu_recording> const& sequence::imu() const { return impl_->imu; }
bool sequence::ground_truth_has_orientation() const { return impl_->has_orientation; }

}  // namespace seq
