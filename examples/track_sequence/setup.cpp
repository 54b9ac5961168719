// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/setup.hpp"

#include <tbb/task_arena.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/read_ahead.hpp"
#include "examples/track_sequence/processor_name.hpp"

namespace app {
namespace {

ft::camera_kind kind_of(seq::camera_intrinsics const& c) {
  switch (c.model) {
    case seq::lens::radial_tangential:
      return c.distortion.size() == 4   ? ft::camera_kind::radtan4
             : c.distortion.size() == 5 ? ft::camera_kind::radtan5
                                        : ft::camera_kind::radtan8;
    case seq::lens::kannala_brandt:
      return ft::camera_kind::kannala_brandt;
    case seq::lens::double_sphere:
      return ft::camera_kind::double_sphere;
    default:
      return ft::camera_kind::pinhole;
  }
}

/// @param of the images that are tracked: a pinhole where they were rectified
ft::camera_description camera_description_of(seq::camera_intrinsics const& c) {
  auto camera = ft::camera_description::make(kind_of(c), {c.fx, c.fy, c.cx, c.cy});
  std::copy(c.distortion.begin(), c.distortion.end(), camera.parameters + 4);
  return camera;
}

/// The body is the left camera.
ft::rig_description mixed_description_of(arguments const& a, seq::sequence const& sequence) {
  ft::rig_description all;
  all.kind = ft::rig_kind::multi;
  all.cameras = 0;
  all.depth_scale = sequence.depth_unit();
  all.min_depth = a.min_depth;
  all.max_depth = a.max_depth;
  for (seq::rig_camera const& c : seq::rig_cameras(sequence.rig())) {
    ft::camera_description& to = all.camera[all.cameras++];
    to = camera_description_of(c.camera);
    to.right = c.right;
    to.has_depth_image = c.has_depth;
    to.baseline = c.has_depth ? seq::usual_virtual_baseline : 0;
    to.T_camera_body = rigid_of(c.T_left_this.inverse());
  }
  return all;
}

ft::rig_description rig_of(arguments const& a, seq::sequence const& sequence) {
  auto const& rig = sequence.rig();
  if (sequence.mixed()) { return mixed_description_of(a, sequence); }
  auto const baseline = static_cast<double>(static_cast<float>(rig.baseline()));
  auto const left = camera_description_of(rig.left);
  if (sequence.kind() == seq::camera_kind::mono) { return ft::rig_description::monocular(left); }
  if (sequence.kind() == seq::camera_kind::rgbd) {
    auto rgbd = ft::rig_description::rgbd(left, baseline, sequence.depth_unit());
    rgbd.min_depth = a.min_depth;
    rgbd.max_depth = a.max_depth;
    return rgbd;
  }
  if (sequence.fisheye()) {
    return ft::rig_description::fisheye_pair(left, camera_description_of(rig.right),
                                             rigid_of(rig.T_left_right.inverse()));
  }
  return ft::rig_description::rectified_pair(rig.left.fx, rig.left.fy, rig.left.cx, rig.left.cy,
                                             baseline);
}

ft::imu_params imu_params_of(arguments const& a, seq::sequence const& sequence) {
  auto const f = [](double v) { return static_cast<float>(v); };
  auto const& imu = *sequence.imu();
  auto const& noise = imu.calibration.noise;
  ft::imu_params p;
  p.present = true;
  p.T_bc = rigid_of(imu.T_imu_left);
  p.noise = {f(noise.gyro), f(noise.accel), f(noise.gyro_walk), f(noise.accel_walk),
             f(imu.calibration.rate_hz)};
  p.time_offset_s = a.imu_time_offset_s.value_or(imu.calibration.time_offset_s);
  return p;
}

seq::camera_kind kind_of(std::string const& rig) {
  if (rig == "auto") { return seq::camera_kind::any; }
  if (rig == "rgbd") { return seq::camera_kind::rgbd; }
  if (rig == "mixed") { return seq::camera_kind::mixed; }
  bool const one = rig == "mono" || rig == "monocular";
  return one ? seq::camera_kind::mono : seq::camera_kind::stereo;
}

/// @throws seq::error for options that do not fit the sequence
void check_fit(arguments const& a, seq::sequence const& sequence) {
  using seq::camera_kind;
  if (a.rig == "fisheye" && !sequence.fisheye()) {
    throw seq::error("--rig fisheye: the cameras of " + a.sequence +
                     " are not a pair of Kannala-Brandt cameras");
  }
  if (a.frame == "body" && sequence.kind() == camera_kind::mono) {
    throw seq::error(
        "--frame body: with one camera (--rig mono) the scale may be unknown, and then so are the "
        "poses of the body");
  }
  if (a.frame == "body" && !sequence.has_body_frame()) {
    throw seq::error("--frame body: the calibration of " + a.sequence +
                     " does not say where the body is");
  }
  bool const depth = a.depth_unit > 0 || a.min_depth > 0 || std::isfinite(a.max_depth);
  if (depth && sequence.depth_unit() == 0) {
    throw seq::error("--depth-unit, --min-depth, --max-depth: no depth images of " + a.sequence +
                     " are used");
  }
}

void load_map(std::string const& path, ft::any_odometry& odometry) {
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  if (!file) { throw seq::error("--load-map " + path + ": " + std::strerror(errno)); }
  try {
    odometry.load_map(file);
  } catch (std::exception const& e) {  // no map, or one of another rig
    throw seq::error("--load-map " + path + ": " + e.what());
  }
}

}  // namespace

seq::sequence open_sequence(arguments const& a) {
  seq::open_options open;
  open.rig = kind_of(a.rig);
  open.depth_unit = a.depth_unit;
  open.image_bits = a.image_bits;
  if (a.max_time_difference_ms) {
    open.max_time_difference_ns = std::llround(1e6 * *a.max_time_difference_ms);
  }
  open.calibration = a.calibration;
  open.fps = a.fps;
  open.times = a.times;
  open.masks = a.masks;
  open.keep_fisheye = a.rig != "rectified";
  open.max_frames = a.frames;
  open.read_imu = a.imu != "off";
  try {
    auto sequence = seq::sequence::open(a.sequence, open);
    check_fit(a, sequence);
    return sequence;
  } catch (seq::missing_calibration const& e) {
    throw seq::error(std::string(e.what()) + "; --calibration names one that is elsewhere");
  }
}

odometry_setup setup_of(arguments const& a, seq::sequence const& sequence) {
  auto const f = [](double v) { return static_cast<float>(v); };
  auto const& settings = sequence.settings();
  odometry_setup o;
  o.rig = rig_of(a, sequence);
  ft::odometry_params& p = o.params;
  p.orb.width = sequence.rig().left.width;
  p.orb.height = sequence.rig().left.height;
  if (sequence.masked()) {
    p.orb.mask_width = p.orb.width;
    p.orb.mask_height = p.orb.height;
  }
  p.orb.features =
      a.features > 0 ? a.features : settings.features.value_or(p.orb.width > 1000 ? 2000 : 1200);
  p.orb.levels = settings.levels.value_or(8);
  o.scale_factor = settings.scale_factor.value_or(o.scale_factor);
  p.orb.scale_factor = f(o.scale_factor);
  p.orb.ini_threshold = settings.ini_threshold.value_or(20);
  p.orb.min_threshold = settings.min_threshold.value_or(7);
  p.orb.corner_ratio = f(a.corner_ratio);
  o.near_depth = a.near_depth > 0 ? a.near_depth : settings.depth_threshold.value_or(o.near_depth);
  p.rules.near_depth = f(o.near_depth);
  p.map_slots = std::max(p.map_slots, 8 * p.orb.features);
  if (o.rig.kind == ft::rig_kind::multi) {  // of all cameras
    p.map_slots = std::max(1 << 15, p.map_slots);
    p.local_points = p.window_points = 12288;
  }
  // TBB starts no more threads than there are cores, and warns on stderr if more are requested.
  o.threads = std::min(a.threads, tbb::this_task_arena::max_concurrency());
  p.measure_stages = a.timing;
  p.loops.present = a.loops;
  p.rules.localize_only = a.localize_only;
  // Nothing is prefetched where stages are timed, frames arrive in real time, or one thread is
  // asked for.
  bool const one_by_one = o.rig.kind == ft::rig_kind::monocular || a.timing || a.realtime ||
                          a.read_ahead == 0 || a.threads == 1;
  p.prefetch = one_by_one ? 0 : 4;
  if (sequence.imu()) { p.imu = imu_params_of(a, sequence); }
  return o;
}

ft::any_odometry make_odometry(arguments const& a, odometry_setup const& setup,
                               std::string& backend, std::string& device) {
  std::vector<std::string> const gpus =
      a.backend == "host" ? std::vector<std::string>() : ft::gpu_names();
  if (a.backend == "cuda" && gpus.empty()) {
    throw seq::error("--backend cuda: no CUDA device here, or the program was built without CUDA");
  }
  backend = gpus.empty() ? "host" : "cuda";
  device = gpus.empty() ? processor_name() : gpus[0];
  ft::device const where{gpus.empty() ? ft::device::host : 0, setup.threads};
  ft::any_odometry odometry;
  try {
    odometry = ft::make_odometry(where, setup.rig, setup.params);
  } catch (std::exception const& e) {  // options that contradict each other
    throw seq::error((a.calibration.empty() ? a.sequence : a.calibration) + ": " + e.what());
  }
  if (!a.load_map.empty()) { load_map(a.load_map, odometry); }
  return odometry;
}

int usual_read_ahead(std::string const& backend) {
  int const threads = seq::read_ahead::default_threads();
  return backend == "cuda" ? 2 * threads : std::max(2, 3 * (threads + 1) / 8);
}

int threads_of(odometry_setup const& setup) {
  return setup.threads > 0 ? setup.threads : tbb::this_task_arena::max_concurrency();
}

ft::rigid<double> rigid_of(Eigen::Isometry3d const& T) {
  ft::rigid<double> p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R.m[3 * r + c] = T.linear()(r, c); }
  }
  p.t = {T.translation().x(), T.translation().y(), T.translation().z()};
  return p;
}

seq::stamped_pose stamped(std::int64_t time_ns, ft::rigid<double> const& T) {
  seq::stamped_pose s;
  s.time_ns = time_ns;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { s.T_world_camera.linear()(r, c) = T.R.m[3 * r + c]; }
  }
  s.T_world_camera.translation() = Eigen::Vector3d(T.t.x, T.t.y, T.t.z);
  return s;
}

}  // namespace app
