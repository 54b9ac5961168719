// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/setup.hpp"

#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "examples/sequence/read_ahead.hpp"

namespace app {
namespace {

std::array<double, 8> kannala_brandt_of(seq::camera_intrinsics const& c) {
  std::array<double, 8> p{c.fx, c.fy, c.cx, c.cy};
  for (std::size_t i = 0; i < 4 && i < c.distortion.size(); ++i) { p[4 + i] = c.distortion[i]; }
  return p;
}

void set_rig(seq::sequence const& sequence, odometry_options& o) {
  auto const& rig = sequence.rig();
  o.width = rig.left.width;
  o.height = rig.left.height;
  o.fx = rig.left.fx;
  o.fy = rig.left.fy;
  o.cx = rig.left.cx;
  o.cy = rig.left.cy;
  o.baseline = rig.baseline();
  o.fps = rig.fps;
  o.fisheye = sequence.fisheye();
  o.monocular = sequence.kind() == seq::camera_kind::mono;
  o.rgbd = sequence.kind() == seq::camera_kind::rgbd;
  o.depth_unit = sequence.depth_unit();
  if (!o.fisheye) { return; }
  o.left = kannala_brandt_of(rig.left);
  o.right = kannala_brandt_of(rig.right);
  o.T_right_left = plain_pose(rig.T_left_right.inverse());
}

seq::camera_kind kind_of(std::string const& rig) {
  if (rig == "auto") { return seq::camera_kind::any; }
  if (rig == "rgbd") { return seq::camera_kind::rgbd; }
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
  if (depth && sequence.kind() != camera_kind::rgbd) {
    throw seq::error("--depth-unit, --min-depth, --max-depth: no depth images of " + a.sequence +
                     " are used");
  }
}

}  // namespace

seq::sequence open_sequence(arguments const& a) {
  seq::open_options open;
  open.rig = kind_of(a.rig);
  open.depth_unit = a.depth_unit;
  if (a.max_time_difference_ms) {
    open.max_time_difference_ns = std::llround(1e6 * *a.max_time_difference_ms);
  }
  open.calibration = a.calibration;
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

odometry_options options_of(arguments const& a, seq::sequence const& sequence) {
  auto const& settings = sequence.settings();
  odometry_options o;
  o.min_depth = a.min_depth;
  o.max_depth = a.max_depth;
  set_rig(sequence, o);
  o.features =
      a.features > 0 ? a.features : settings.features.value_or(o.width > 1000 ? 2000 : 1200);
  o.levels = settings.levels.value_or(o.levels);
  o.scale_factor = settings.scale_factor.value_or(o.scale_factor);
  o.ini_threshold = settings.ini_threshold.value_or(o.ini_threshold);
  o.min_threshold = settings.min_threshold.value_or(o.min_threshold);
  o.near_depth = a.near_depth > 0 ? a.near_depth : settings.depth_threshold.value_or(o.near_depth);
  // TBB starts no more threads than there are cores, and warns on stderr if more are requested.
  o.threads = std::min(a.threads, tbb::this_task_arena::max_concurrency());
  o.measure_stages = a.timing;
  // Nothing is prefetched where stages are timed, frames arrive in real time, or one thread is
  // asked for.
  bool const one_by_one =
      o.monocular || a.timing || a.realtime || a.read_ahead == 0 || a.threads == 1;
  o.prefetch = one_by_one ? 0 : 4;
  if (sequence.imu()) {
    auto const& imu = *sequence.imu();
    auto const& noise = imu.calibration.noise;
    o.imu = imu_options{plain_pose(imu.T_imu_left),
                        noise.gyro,
                        noise.accel,
                        noise.gyro_walk,
                        noise.accel_walk,
                        imu.calibration.rate_hz,
                        a.imu_time_offset_s.value_or(imu.calibration.time_offset_s)};
  }
  return o;
}

std::unique_ptr<odometry> make_odometry(arguments const& a, odometry_options const& options,
                                        std::string& backend) {
  std::string const gpu = a.backend == "host" ? std::string() : cuda_device_name();
  if (a.backend == "cuda" && gpu.empty()) {
    throw seq::error("--backend cuda: no CUDA device here, or the program was built without CUDA");
  }
  backend = gpu.empty() ? "host" : "cuda";
  try {
    return gpu.empty() ? make_host_odometry(options) : make_cuda_odometry(options);
  } catch (std::exception const& e) {  // options that contradict each other
    throw seq::error((a.calibration.empty() ? a.sequence : a.calibration) + ": " + e.what());
  }
}

int usual_read_ahead(std::string const& backend) {
  int const threads = seq::read_ahead::default_threads();
  return backend == "cuda" ? 2 * threads : std::max(2, 3 * (threads + 1) / 8);
}

rigid_pose plain_pose(Eigen::Isometry3d const& T) {
  rigid_pose p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R[static_cast<std::size_t>(3 * r + c)] = T.linear()(r, c); }
    p.t[static_cast<std::size_t>(r)] = T.translation()(r);
  }
  return p;
}

seq::stamped_pose stamped(std::int64_t time_ns, rigid_pose const& T) {
  seq::stamped_pose s;
  s.time_ns = time_ns;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      s.T_world_camera.linear()(r, c) = T.R[static_cast<std::size_t>(3 * r + c)];
    }
    s.T_world_camera.translation()(r) = T.t[static_cast<std::size_t>(r)];
  }
  return s;
}

}  // namespace app
