// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/reader.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/masks.hpp"
#include "examples/sequence/detail/recording_checks.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/rectify.hpp"

namespace seq {

struct sequence::impl {
  std::string name;
  std::string layout;
  recording_source from;
  camera_kind kind = camera_kind::stereo;
  orb_settings settings;
  stereo_rig raw;
  stereo_rig rig;
  bool fisheye = false;
  bool mixed = false;
  bool has_body_frame = false;
  int image_bits = 16;
  double depth_unit = 0;
  std::uint16_t no_depth = 0;
  std::string depth_unit_from;
  std::optional<rectifier> rectify;
  std::vector<detail::frame_files> frames;
  std::vector<detail::camera_masks> masks;  ///< of the cameras, or empty
  unpaired_images unpaired;
  trajectory truth;
  bool has_orientation = false;
  std::optional<imu_recording> imu;
  std::vector<std::string> warnings;

  Eigen::Isometry3d prepare_images(std::string const& directory, open_options const& options);
  void set_depth_unit(detail::layout_of_files const& files, calibration const& calib,
                      open_options const& options);
  void set_image_bits(open_options const& options);
  void open_masks(std::vector<std::string> const& paths);
};

namespace {

using detail::layout_of_files;
using detail::raw_ground_truth;

namespace fs = std::filesystem;

image read_checked(std::string const& path, camera_intrinsics const& camera, int bits) {
  image picture = read_image(path, bits);
  detail::check_image_size(path, picture.width, picture.height, camera);
  return picture;
}

/// @param none a depth that means none, beside 0
depth_image read_checked_depth(std::string const& path, camera_intrinsics const& camera,
                               std::uint16_t none) {
  depth_image depth = read_depth_image(path);
  if (none != 0) { std::replace(depth.pixels.begin(), depth.pixels.end(), none, std::uint16_t{0}); }
  if (depth.width != camera.width || depth.height != camera.height) {
    throw error(path + ": depth image is " + detail::size_text(depth.width, depth.height) +
                " pixels, the camera's images " + detail::size_text(camera.width, camera.height) +
                ": it must be registered to them");
  }
  return depth;
}

/// The depth of the nearest pixel of the raw image: a mean of two depths is on no surface.
depth_image moved(depth_image const& raw, pixel_map const& from) {
  depth_image out{from.width, from.height, std::vector<std::uint16_t>(from.x.size())};
  for (std::size_t i = 0; i < out.pixels.size(); ++i) {
    long const x = std::lround(from.x[i]);
    long const y = std::lround(from.y[i]);
    if (x < 0 || y < 0 || x >= raw.width || y >= raw.height) { continue; }
    out.pixels[i] = raw.pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(raw.width) +
                               static_cast<std::size_t>(x)];
  }
  return out;
}

void check_options(std::string const& directory, open_options const& options) {
  if (options.max_frames < 0) {
    throw error(directory + ": max_frames = " + std::to_string(options.max_frames) +
                ": must be at least 0");
  }
  if (options.max_time_difference_ns && *options.max_time_difference_ns < 0) {
    throw error(directory + ": max_time_difference_ns = " +
                std::to_string(*options.max_time_difference_ns) + ": must be at least 0");
  }
  if (options.image_bits != 0) {
    detail::check_number(options.image_bits, {8, 16}, directory, "image_bits");
  }
  if (options.fps != 0) {
    detail::check_number(options.fps, {1e-3, 1e5}, directory, "fps");
    if (!options.times.empty()) {
      throw error(directory + ": fps and times are given, must be one of them");
    }
  }
  if (options.depth_unit != 0) {
    detail::check_number(options.depth_unit, detail::depth_unit_limits, directory, "depth_unit");
  }
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

/// Poses of a body of which nobody says where the camera is on it: their positions are kept.
void keep_positions_of_body(raw_ground_truth& truth, layout_of_files const& files,
                            calibration const& calib, std::vector<std::string>& warnings) {
  bool const robot = files.name == "openloris" && !truth.poses.empty();
  bool const imu = files.name == "kitti_raw" && truth.orientation && !calib.has_body_frame;
  if (!robot && !imu) { return; }
  truth.orientation = false;
  for (stamped_pose& pose : truth.poses) { pose.T_world_camera.linear().setIdentity(); }
  warnings.push_back(
      imu ? "ground truth: poses are the IMU's, and no calib_imu_to_velo.txt and "
            "calib_velo_to_cam.txt beside the calibration say where it is: its positions alone are "
            "taken"
          : "ground truth: poses are those of the robot's base (base_link), and where the "
            "camera is on it is not known (trans_matrix.yaml is not read): its positions alone are "
            "taken, and errors contain the camera's distance from it where the robot turns");
}

/// ICL-NUIM was rendered by POV-Ray, whose frames are left-handed: x right, y up, z forward, so
/// that its fy is -480 (https://github.com/ankurhanda/living_room_iclnuim). With y down in the
/// camera and in the world the same motion is M T M, M = diag(1, -1, 1), and images stay as they
/// are.
void mirror_y(trajectory& poses) {
  Eigen::Vector3d const m(1, -1, 1);
  for (stamped_pose& pose : poses) {
    Eigen::Matrix3d const R = pose.T_world_camera.linear();
    Eigen::Vector3d const t = pose.T_world_camera.translation();
    pose.T_world_camera.linear() = m.asDiagonal() * R * m.asDiagonal();
    pose.T_world_camera.translation() = m.cwiseProduct(t);
  }
}

}  // namespace

/// Decides what load() does with images. @return what maps points of the loaded left camera into
/// the raw one
Eigen::Isometry3d sequence::impl::prepare_images(std::string const& directory,
                                                 open_options const& options) {
  Eigen::Isometry3d T_raw_loaded = Eigen::Isometry3d::Identity();
  bool const all_fisheye =
      raw.left.model == lens::kannala_brandt && raw.right.model == lens::kannala_brandt;
  std::string const source = options.calibration.empty() ? directory : options.calibration;
  mixed = options.rig == camera_kind::mixed;
  if (mixed) {
    detail::check_mixed(raw, source);
    return T_raw_loaded;
  }
  bool const pinhole =
      kind == camera_kind::stereo ? raw.rectified() : raw.left.model == lens::pinhole;
  if (all_fisheye && options.keep_fisheye && kind != camera_kind::rgbd) {
    fisheye = true;
  } else if (!pinhole) {
    stereo_rig pair = raw;
    // One camera: as the left one of a pair that needs no rotation.
    if (kind == camera_kind::mono) { pair.T_left_right.translation().x() = usual_virtual_baseline; }
    try {
      rectify.emplace(pair);
    } catch (error const& e) {
      throw error(
          source + ": " + e.what() +
          (kind == camera_kind::stereo
               ? "; --rig mixed (rig=\"mixed\") takes cameras as they are, mono the left one"
               : ""));
    }
    rig = rectify->rig();
    if (kind == camera_kind::mono) { rig.T_left_right = Eigen::Isometry3d::Identity(); }
    T_raw_loaded.linear() = rectify->left_rotation().transpose();
  }
  return T_raw_loaded;
}

void sequence::impl::set_depth_unit(layout_of_files const& files, calibration const& calib,
                                    open_options const& options) {
  detail::depth_unit unit = detail::depth_unit_of(files, calib, options);
  auto const check = [&](std::string const& first, camera_intrinsics const& camera,
                         double baseline) {
    check_depths(read_checked_depth(first, camera, no_depth), unit, first, baseline, warnings);
  };
  if (!mixed) { check(files.frames.front().second, raw.left, rig.baseline()); }
  for (std::size_t k = 0; k < raw.depth_cameras.size(); ++k) {
    unit.camera_txt = false;
    auto const first = std::find_if(files.frames.begin(), files.frames.end(),
                                    [&](auto const& frame) { return !frame.depths[k].empty(); });
    check(first->depths[k], raw.left, usual_virtual_baseline);  // all cameras have one size
  }
  depth_unit = unit.metres;
  depth_unit_from = std::move(unit.from);
}

void sequence::impl::open_masks(std::vector<std::string> const& paths) {
  std::size_t const cameras =
      kind != camera_kind::stereo ? 1 : 2 + (mixed ? raw.more.size() : std::size_t{0});
  if (paths.size() > cameras) {
    throw error(name + ": " + std::to_string(paths.size()) + " masks, for " +
                std::to_string(cameras) + (cameras == 1 ? " camera" : " cameras"));
  }
  for (std::size_t c = 0; c < paths.size(); ++c) {
    std::vector<std::string> images;
    for (detail::frame_files const& f : frames) {
      images.push_back(c == 0 ? f.left : c == 1 ? f.second : f.more[c - 2]);
    }
    detail::camera_masks::move_image move;
    if (rectify) {
      move = [r = &*rectify, c](image const& i) { return c == 0 ? r->left(i) : r->right(i); };
    }
    camera_intrinsics const& camera = c == 0   ? raw.left
                                      : c == 1 ? raw.right
                                               : raw.more[c - 2].camera;
    masks.emplace_back(paths[c], images, camera, std::move(move), warnings);
  }
}

/// Sensors of 10 to 14 bits are often stored in 16 without being scaled. That is said, not assumed:
/// the images that were not looked at may be brighter.
void sequence::impl::set_image_bits(open_options const& options) {
  if (options.image_bits > 0) {
    image_bits = options.image_bits;
    return;
  }
  constexpr std::size_t most_frames = 8;
  std::size_t const step = (frames.size() + most_frames - 1) / most_frames;
  int largest = -1;
  int looked_at = 0;
  for (std::size_t i = 0; i < frames.size(); i += step) {
    std::vector<std::string> files = frames[i].more;
    files.push_back(frames[i].left);
    if (kind == camera_kind::stereo) { files.push_back(frames[i].second); }
    for (std::string const& file : files) {
      if (file.empty()) { continue; }
      try {
        int const sample = largest_sample_of_16_bits(file);
        largest = std::max(largest, sample);
        if (sample >= 0) { ++looked_at; }
      } catch (error const&) {}  // load() says it
    }
    if (largest < 0 || largest >> 14 > 0) { return; }  // others, or all 16
  }
  if (largest <= 0) { return; }
  int bits = 10;
  while (largest >> bits != 0) { bits += 2; }
  warnings.push_back("images of 16 bits are dark: the largest sample of " +
                     std::to_string(looked_at) + " of them is " + std::to_string(largest) +
                     "; does the camera have " + std::to_string(bits) +
                     " bits? image_bits (--image-bits) says it");
}

sequence::sequence(std::unique_ptr<impl> p) : impl_(std::move(p)) {}
sequence::sequence(sequence&&) noexcept = default;
sequence& sequence::operator=(sequence&&) noexcept = default;
sequence::~sequence() = default;

sequence sequence::open(std::string const& directory, open_options const& options) {
  check_options(directory, options);
  layout_of_files files = detail::find_layout(directory, options);
  recording_source source;
  calibration calib = detail::find_calibration(files, options, source);
  detail::check_second_camera(files, options, calib);
  detail::add_cameras(calib, options, files);
  auto p = std::make_unique<impl>();
  p->name = files.root.filename().string();
  p->layout = files.name;
  p->kind = files.kind;
  p->no_depth = files.no_depth;
  p->warnings = std::move(files.warnings);
  p->warnings.insert(p->warnings.end(), calib.warnings.begin(), calib.warnings.end());
  p->settings = calib.settings;
  p->raw = calib.rig;
  p->rig = calib.rig;
  p->has_body_frame = calib.has_body_frame;
  Eigen::Isometry3d const T_raw_loaded = p->prepare_images(directory, options);
  if (files.kind == camera_kind::rgbd || !p->raw.depth_cameras.empty()) {
    p->set_depth_unit(files, calib, options);
  }

  raw_ground_truth truth = detail::find_ground_truth(files, p->warnings);
  if (truth.y_up || calib.y_up) { mirror_y(truth.poses); }
  keep_positions_of_body(truth, files, calib, p->warnings);
  p->has_orientation = truth.orientation;
  p->truth = std::move(truth.poses);
  if (truth.orientation) {
    p->truth = poses_of(p->truth, given_to_loaded(truth.of, calib, p->rig, T_raw_loaded));
  }
  if (!p->truth.empty()) {
    detail::check_overlap(files.frames, p->truth.front().time_ns, p->truth.back().time_ns,
                          "ground truth", p->warnings);
  }
  if (options.read_imu) {
    p->imu = detail::find_imu(files, calib, p->rig.T_body_left, source, p->warnings);
    if (p->imu) {
      auto const& samples = p->imu->samples;
      detail::check_overlap(files.frames, samples.front().time_ns, samples.back().time_ns, "IMU",
                            p->warnings);
    }
  }
  source.stamps = std::move(files.stamps_from);
  p->from = std::move(source);
  p->frames = std::move(files.frames);
  detail::check_frame_times(p->frames, p->warnings);
  p->unpaired = files.unpaired;
  if (options.max_frames > 0 && p->frames.size() > static_cast<std::size_t>(options.max_frames)) {
    p->frames.resize(static_cast<std::size_t>(options.max_frames));
  }
  p->set_image_bits(options);
  p->open_masks(options.masks);
  return sequence(std::move(p));
}

std::string const& sequence::name() const { return impl_->name; }
std::string const& sequence::layout() const { return impl_->layout; }
recording_source const& sequence::source() const { return impl_->from; }
stereo_rig const& sequence::raw_rig() const { return impl_->raw; }
stereo_rig const& sequence::rig() const { return impl_->rig; }
camera_kind sequence::kind() const { return impl_->kind; }
double sequence::depth_unit() const { return impl_->depth_unit; }
std::string const& sequence::depth_unit_from() const { return impl_->depth_unit_from; }
std::vector<std::string> const& sequence::warnings() const { return impl_->warnings; }
bool sequence::fisheye() const { return impl_->fisheye; }
bool sequence::mixed() const { return impl_->mixed; }
bool sequence::has_body_frame() const { return impl_->has_body_frame; }
bool sequence::masked() const {
  return std::any_of(impl_->masks.begin(), impl_->masks.end(),
                     [](auto const& m) { return !m.empty(); });
}
unpaired_images sequence::unpaired() const { return impl_->unpaired; }
orb_settings const& sequence::settings() const { return impl_->settings; }
int sequence::size() const { return static_cast<int>(impl_->frames.size()); }

std::int64_t sequence::time_ns(int i) const {
  if (i < 0 || i >= size()) {
    throw error(impl_->name + ": frame " + std::to_string(i) + " of " + std::to_string(size()));
  }
  return impl_->frames[static_cast<std::size_t>(i)].time_ns;
}

stereo_frame sequence::load(int i) const {
  stereo_frame frame;
  frame.time_ns = time_ns(i);
  detail::frame_files const& files = impl_->frames[static_cast<std::size_t>(i)];
  auto const& rectify = impl_->rectify;
  for (detail::camera_masks const& m : impl_->masks) {
    frame.masks.push_back(m.of(static_cast<std::size_t>(i)));
  }
  frame.left = read_checked(files.left, impl_->raw.left, impl_->image_bits);
  if (rectify) { frame.left = rectify->left(frame.left); }
  if (impl_->kind == camera_kind::stereo) {
    frame.right = read_checked(files.second, impl_->raw.right, impl_->image_bits);
    if (rectify) { frame.right = rectify->right(frame.right); }
    for (std::size_t k = 0; k < files.more.size(); ++k) {
      camera_intrinsics const& camera = impl_->raw.more[k].camera;
      frame.more.push_back(
          files.more[k].empty() ? image() : read_checked(files.more[k], camera, impl_->image_bits));
    }
    for (std::string const& depth : files.depths) {  // all cameras have one size
      frame.depths.push_back(depth.empty()
                                 ? depth_image()
                                 : read_checked_depth(depth, impl_->raw.left, impl_->no_depth));
    }
  } else if (impl_->kind == camera_kind::rgbd) {
    frame.depth = read_checked_depth(files.second, impl_->raw.left, impl_->no_depth);
    if (rectify) { frame.depth = moved(frame.depth, rectify->left_map()); }
  }
  return frame;
}

trajectory const& sequence::ground_truth() const { return impl_->truth; }
std::optional<imu_recording> const& sequence::imu() const { return impl_->imu; }
bool sequence::ground_truth_has_orientation() const { return impl_->has_orientation; }

}  // namespace seq
