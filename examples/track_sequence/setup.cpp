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

#include "examples/sequence/odometry_input.hpp"
#include "examples/sequence/read_ahead.hpp"
#include "examples/track_sequence/processor_name.hpp"

namespace app {
namespace {

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
  auto const& settings = sequence.settings();
  odometry_setup o;
  o.rig = seq::odometry_rig(sequence);
  o.rig.min_depth = a.min_depth;
  o.rig.max_depth = a.max_depth;
  for (ft::camera_description& camera : o.rig.camera) {
    if (a.readout_ms) { camera.readout_s = 1e-3 * *a.readout_ms; }
  }
  o.params = seq::odometry_settings(sequence, a.features);
  ft::odometry_params& p = o.params;
  o.scale_factor = settings.scale_factor.value_or(o.scale_factor);
  p.orb.corner_ratio = static_cast<float>(a.corner_ratio);
  o.near_depth = a.near_depth > 0 ? a.near_depth : settings.depth_threshold.value_or(o.near_depth);
  p.rules.near_depth = static_cast<float>(o.near_depth);
  if (sequence.imu() && a.imu_time_offset_s) { p.imu.time_offset_s = *a.imu_time_offset_s; }
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

}  // namespace app
