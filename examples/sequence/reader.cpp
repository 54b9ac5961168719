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

/// Poses in the file's frame: of the body or of the raw left camera.
struct raw_ground_truth {
  trajectory poses;
  bool body = false;
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

std::vector<pair_files> find_euroc_pairs(fs::path const& mav0) {
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
  std::vector<pair_files> pairs;
  int common = 0;
  for (auto const& [time_ns, name] : lists[0]) {
    auto const other = lists[1].find(time_ns);
    if (other == lists[1].end()) { continue; }
    ++common;
    std::string const left = find_image(mav0 / "cam0" / "data", name);
    std::string const right = find_image(mav0 / "cam1" / "data", other->second);
    if (!left.empty() && !right.empty()) { pairs.push_back({time_ns, left, right}); }
  }
  if (pairs.empty()) {
    throw error(mav0.string() + ": no stereo pair: cam0 lists " + std::to_string(lists[0].size()) +
                " images, cam1 " + std::to_string(lists[1].size()) + ", " + std::to_string(common) +
                " with equal time stamps, 0 with both files present");
  }
  return pairs;
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

std::vector<pair_files> find_kitti_pairs(fs::path const& root,
                                         std::vector<std::int64_t> const& times) {
  std::map<int, std::string> images[2];
  for (std::size_t camera = 0; camera < 2; ++camera) {
    fs::path const folder = root / ("image_" + std::to_string(camera));
    if (!detail::is_directory(folder.string())) {
      throw error(folder.string() + ": no such folder: not a stereo sequence");
    }
    images[camera] = list_numbered_images(folder);
    if (images[camera].empty()) {
      throw error(folder.string() + ": no images (000000.png, .jpg or .jpeg, numbered)");
    }
  }
  std::vector<pair_files> pairs;
  for (auto const& [number, left] : images[0]) {
    auto const right = images[1].find(number);
    if (right == images[1].end()) { continue; }
    if (static_cast<std::size_t>(number) >= times.size()) {
      throw error((root / "times.txt").string() + ": " + std::to_string(times.size()) +
                  " times, none for " + left);
    }
    pairs.push_back({times[static_cast<std::size_t>(number)], left, right->second});
  }
  if (pairs.empty()) {
    throw error(root.string() + ": no stereo pair: image_0 holds " +
                std::to_string(images[0].size()) + " images, image_1 " +
                std::to_string(images[1].size()) + ", none with equal numbers");
  }
  return pairs;
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
    truth.body = true;
    truth.orientation = !truth.poses.empty();
  } else if (detail::is_file(tum)) {
    truth.poses = read_tum(tum);
    truth.orientation = any_rotation(truth.poses);
  } else if (detail::is_file(kitti)) {
    truth.poses = read_kitti_poses(kitti, times);
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

struct sequence::impl {
  std::string name;
  std::string layout;
  stereo_rig raw;  ///< of the files
  stereo_rig rig;  ///< of the loaded frames
  bool fisheye = false;
  bool has_orientation = false;
  orb_settings settings;
  std::vector<pair_files> pairs;
  std::optional<rectifier> rectify;
  trajectory truth;
};

sequence::sequence(std::unique_ptr<impl> p) : impl_(std::move(p)) {}
sequence::sequence(sequence&&) noexcept = default;
sequence& sequence::operator=(sequence&&) noexcept = default;
sequence::~sequence() = default;

sequence sequence::open(std::string const& directory, open_options const& options) {
  if (options.max_frames < 0) {
    throw error(directory + ": max_frames = " + std::to_string(options.max_frames) +
                ": must be at least 0");
  }
  if (!detail::is_directory(directory)) { throw error(directory + ": no such folder"); }
  auto p = std::make_unique<impl>();
  std::error_code failure;
  fs::path root = fs::canonical(directory, failure);
  if (failure) { throw error(directory + ": cannot be read: " + failure.message()); }

  fs::path mav0;
  std::vector<std::int64_t> times;  // of all frames, for poses.txt
  if (detail::is_directory((root / "mav0").string())) {
    mav0 = root / "mav0";
  } else if (detail::is_directory((root / "cam0").string())) {
    mav0 = root;
    root = root.parent_path();
  }
  if (!mav0.empty()) {
    p->layout = "euroc";
    p->pairs = find_euroc_pairs(mav0);
    for (pair_files const& pair : p->pairs) { times.push_back(pair.time_ns); }
  } else if (detail::is_directory((root / "image_0").string())) {
    p->layout = "kitti";
    times = read_times((root / "times.txt").string());
    p->pairs = find_kitti_pairs(root, times);
  } else {
    throw error(directory + ": no sequence found: neither mav0/cam0 (EuRoC) nor image_0 (KITTI)");
  }
  p->name = root.filename().string();

  int width = 0;
  int height = 0;
  read_image_size(p->pairs.front().left, width, height);
  calibration calib;
  if (!options.calibration.empty()) {
    calib = read_calibration(options.calibration, width, height);
    if (!calib.has_body_frame && !mav0.empty() &&
        detail::is_file((mav0 / "cam0" / "sensor.yaml").string())) {
      // The replacement does not contain the body frame, which the ground truth needs.
      calib.rig.T_body_left = read_euroc_body_frame(mav0.string());
    }
  } else if (!mav0.empty()) {
    calib = read_euroc_calibration(mav0.string());
  } else {
    calib = read_kitti_calibration((root / "calib.txt").string(), width, height);
  }
  check_image_size(p->pairs.front().left, width, height, calib.rig.left);
  read_image_size(p->pairs.front().right, width, height);
  check_image_size(p->pairs.front().right, width, height, calib.rig.right);

  p->settings = calib.settings;
  p->raw = calib.rig;
  p->rig = calib.rig;
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

  raw_ground_truth truth = find_ground_truth(root, mav0, times);
  p->has_orientation = truth.orientation;
  if (truth.orientation) {
    // rig.T_body_left already contains the rectifying rotation.
    Eigen::Isometry3d const T_given_camera = truth.body ? p->rig.T_body_left : T_raw_loaded;
    for (stamped_pose& pose : truth.poses) {
      pose.T_world_camera = pose.T_world_camera * T_given_camera;
    }
  }
  p->truth = std::move(truth.poses);

  if (options.max_frames > 0 && p->pairs.size() > static_cast<std::size_t>(options.max_frames)) {
    p->pairs.resize(static_cast<std::size_t>(options.max_frames));
  }
  return sequence(std::move(p));
}

std::string const& sequence::name() const { return impl_->name; }
std::string const& sequence::layout() const { return impl_->layout; }
stereo_rig const& sequence::rig() const { return impl_->rig; }
bool sequence::fisheye() const { return impl_->fisheye; }
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
bool sequence::ground_truth_has_orientation() const { return impl_->has_orientation; }

}  // namespace seq
