// SPDX-License-Identifier: Apache-2.0
// Tracks a stereo sequence with ft and writes a trajectory, times, a summary and a report.
#include <unistd.h>

#include <tbb/task_arena.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/odometry.hpp"

namespace {

struct arguments {
  std::string sequence;
  std::string calibration;
  std::string backend = "auto";
  std::string optimize = "both";
  std::string rig = "auto";
  std::string out = "track_sequence_out";
  int features = 0;
  int threads = 0;
  int frames = 0;
  double near_depth = 0;
  bool realtime = false;
  bool quiet = false;
};

int parse(int argc, char** argv, arguments& a) {
  CLI::App app("Tracks a stereo sequence (EuRoC or KITTI odometry layout) with ft.");
  app.add_option("--sequence", a.sequence, "folder of the sequence")->required();
  app.add_option("--calibration", a.calibration,
                 "calibration file: an ORB-SLAM3 settings file, a KITTI calib.txt or a folder with "
                 "cam0, cam1; "
                 "default: the sequence's own");
  app.add_option("--backend", a.backend, "auto (a GPU if there is one), host or cuda")
      ->check(CLI::IsMember({"auto", "host", "cuda"}))
      ->capture_default_str();
  app.add_option("--rig", a.rig,
                 "auto (fisheye cameras as they are, others rectified), rectified or fisheye (two "
                 "Kannala-Brandt "
                 "cameras, not rectified)")
      ->check(CLI::IsMember({"auto", "rectified", "fisheye"}))
      ->capture_default_str();
  app.add_option(
         "--features", a.features,
         "keypoints per image; default: the settings file's, or 1200 (2000 for wide images)")
      ->check(CLI::Range(1, 1 << 20));
  app.add_option("--pose-optimization", a.optimize,
                 "both, last-frame (none after the local map) or off (the predicted pose is kept: "
                 "for timing)")
      ->check(CLI::IsMember({"both", "last-frame", "off"}))
      ->capture_default_str();
  app.add_option("--near", a.near_depth,
                 "depth of map points, in baselines; default: the settings file's, or 50");
  app.add_option("--threads", a.threads, "threads of the host backend; 0 = all")
      ->check(CLI::Range(0, 4096));
  app.add_option("--frames", a.frames, "stop after so many; 0 = all")
      ->check(CLI::NonNegativeNumber);
  app.add_flag("--realtime", a.realtime,
               "frames arrive by their time stamps; of those that come while one is processed all "
               "but the newest are "
               "dropped");
  app.add_option("--out", a.out, "folder for trajectory.txt, times.csv, summary.json, report.html")
      ->capture_default_str();
  app.add_flag("--quiet", a.quiet, "no progress display");
  try {
    app.parse(argc, argv);
    if (app.count("--near") > 0 && !(a.near_depth > 0 && a.near_depth <= 1e6)) {  // rejects NaN
      throw CLI::ValidationError("--near", "must be above 0 and at most 1e6");
    }
  } catch (CLI::ParseError const& e) { return app.exit(e) == 0 ? -1 : 2; }
  return 0;
}

std::array<double, 8> kannala_brandt_of(seq::camera_intrinsics const& c) {
  std::array<double, 8> p{c.fx, c.fy, c.cx, c.cy};
  for (std::size_t i = 0; i < 4 && i < c.distortion.size(); ++i) { p[4 + i] = c.distortion[i]; }
  return p;
}

app::odometry_options options_of(arguments const& a, seq::sequence const& sequence) {
  auto const& rig = sequence.rig();
  auto const& settings = sequence.settings();
  app::odometry_options o;
  o.width = rig.left.width;
  o.height = rig.left.height;
  o.fx = rig.left.fx;
  o.fy = rig.left.fy;
  o.cx = rig.left.cx;
  o.cy = rig.left.cy;
  o.baseline = rig.baseline();
  o.fps = rig.fps;
  o.fisheye = sequence.fisheye();
  if (o.fisheye) {
    o.left = kannala_brandt_of(rig.left);
    o.right = kannala_brandt_of(rig.right);
    Eigen::Isometry3d const T = rig.T_left_right.inverse();
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        o.T_right_left.R[static_cast<std::size_t>(3 * r + c)] = T.linear()(r, c);
      }
      o.T_right_left.t[static_cast<std::size_t>(r)] = T.translation()(r);
    }
  }
  o.features =
      a.features > 0 ? a.features : settings.features.value_or(rig.left.width > 1000 ? 2000 : 1200);
  o.levels = settings.levels.value_or(o.levels);
  o.scale_factor = settings.scale_factor.value_or(o.scale_factor);
  o.ini_threshold = settings.ini_threshold.value_or(o.ini_threshold);
  o.min_threshold = settings.min_threshold.value_or(o.min_threshold);
  o.near_depth = a.near_depth > 0 ? a.near_depth : settings.depth_threshold.value_or(o.near_depth);
  // TBB starts no more threads than there are cores, and warns on stderr if more are requested.
  o.threads = std::min(a.threads, tbb::this_task_arena::max_concurrency());
  o.optimize = a.optimize == "both"  ? app::pose_optimization::both
               : a.optimize == "off" ? app::pose_optimization::off
                                     : app::pose_optimization::last_frame;
  return o;
}

std::unique_ptr<app::odometry> make_odometry(arguments const& a, app::odometry_options const& o,
                                             std::string& backend) {
  std::string const gpu = a.backend == "host" ? std::string() : app::cuda_device_name();
  if (a.backend == "cuda" && gpu.empty()) {
    throw std::runtime_error(
        "--backend cuda: no CUDA device here, or the program was built without CUDA");
  }
  backend = gpu.empty() ? "host" : "cuda";
  try {
    return gpu.empty() ? app::make_host_odometry(o) : app::make_cuda_odometry(o);
  } catch (std::exception const& e) {  // options that contradict each other
    throw seq::error((a.calibration.empty() ? a.sequence : a.calibration) + ": " + e.what());
  }
}

seq::stamped_pose stamped(std::int64_t time_ns, app::rigid_pose const& T_cw) {
  app::rigid_pose const T = T_cw.inverse();
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

/// Selects frames for the report, spread over the run.
bool is_sample(int i, int frames) {
  constexpr int samples = 6;
  if (frames <= samples) { return true; }
  for (int k = 0; k < samples; ++k) {
    if (i == (2 * k + 1) * frames / (2 * samples)) { return true; }
  }
  return false;
}

seq::sample_frame sample_of(int index, seq::image picture,
                            std::vector<app::seen_keypoint> const& now,
                            std::vector<app::seen_keypoint> const& before, double scale_factor) {
  std::map<int, app::seen_keypoint const*> seen_before;
  for (auto const& k : before) {
    if (k.point >= 0) { seen_before[k.point] = &k; }
  }
  seq::sample_frame s;
  s.index = index;
  s.picture = std::move(picture);
  for (auto const& k : now) {
    seq::sample_frame::keypoint drawn;
    drawn.x = k.x;
    drawn.y = k.y;
    drawn.octave = k.octave;
    drawn.size = static_cast<float>(31.0 * std::pow(scale_factor, k.octave));
    drawn.depth = k.depth;
    drawn.matched = k.matched;
    auto const at = seen_before.find(k.point);
    if (k.matched && at != seen_before.end()) {
      drawn.from_x = at->second->x;
      drawn.from_y = at->second->y;
    }
    s.keypoints.push_back(drawn);
  }
  return s;
}

int run(arguments const& a) {
  seq::open_options open;
  open.calibration = a.calibration;
  open.keep_fisheye = a.rig != "rectified";
  open.max_frames = a.frames;
  auto const sequence = seq::sequence::open(a.sequence, open);
  if (a.rig == "fisheye" && !sequence.fisheye()) {
    throw seq::error("--rig fisheye: the cameras of " + a.sequence +
                     " are not a pair of Kannala-Brandt cameras");
  }
  app::odometry_options const options = options_of(a, sequence);
  std::filesystem::create_directories(a.out);

  seq::run_report report;
  auto const odometry = make_odometry(a, options, report.backend);
  report.title = "Tracking of " + sequence.name();
  report.sequence = sequence.name();
  report.device = odometry->device();
  report.image_width = options.width;
  report.image_height = options.height;
  report.stages = odometry->stage_names();
  report.options = {{"features", std::to_string(options.features)},
                    {"levels", std::to_string(options.levels)},
                    {"layout", sequence.layout()},
                    {"rig", options.fisheye ? "fisheye" : "rectified"},
                    {"pose-optimization", a.optimize},
                    {"realtime", a.realtime ? "yes" : "no"},
                    {"near points, baselines", std::to_string(options.near_depth)}};
  std::cout << "sequence  " << sequence.name() << ", " << sequence.size() << " stereo pairs of "
            << options.width << "x" << options.height << ", baseline " << options.baseline << " m\n"
            << "backend   " << report.backend << ", " << report.device << "\n";

  seq::progress progress(std::cout, isatty(STDOUT_FILENO) != 0, "track", sequence.size());
  std::vector<app::seen_keypoint> before;
  int before_index = -2;
  double busy_until_ms = 0;  // on the sequence's own clock, for --realtime
  for (int i = 0; i < sequence.size(); ++i) {
    double const arrival_ms = static_cast<double>(sequence.time_ns(i) - sequence.time_ns(0)) / 1e6;
    if (a.realtime && arrival_ms < busy_until_ms) {
      // The frame came while another was processed. Only the last such frame is taken.
      bool const newest =
          i + 1 >= sequence.size() ||
          static_cast<double>(sequence.time_ns(i + 1) - sequence.time_ns(0)) / 1e6 > busy_until_ms;
      if (!newest) {
        ++report.dropped;
        continue;
      }
    }
    seq::stereo_frame frame = sequence.load(i);
    app::frame_outcome const outcome =
        odometry->track(frame.time_ns, frame.left.pixels.data(), frame.right.pixels.data());
    busy_until_ms = std::max(busy_until_ms, arrival_ms) + outcome.stage_ms.back();
    ++report.frames;
    report.tracked += static_cast<int>(outcome.tracked);
    report.lost += static_cast<int>(!outcome.tracked);
    seq::frame_record record;
    record.index = i;
    record.time_ns = frame.time_ns;
    record.tracked = outcome.tracked;
    record.keyframe = outcome.keyframe;
    record.keypoints = outcome.keypoints;
    record.stereo_matches = outcome.stereo_matches;
    record.inliers = outcome.inliers;
    record.local_points = outcome.local_points;
    record.stage_ms = outcome.stage_ms;
    report.records.push_back(std::move(record));
    if (outcome.tracked) { report.estimate.push_back(stamped(frame.time_ns, outcome.T_cw)); }
    bool const sample = is_sample(i, sequence.size());
    if (sample || is_sample(i + 1, sequence.size())) {
      auto now = odometry->keypoints();
      if (sample) {
        report.samples.push_back(
            sample_of(i, std::move(frame.left), now,
                      before_index == i - 1 ? before : std::vector<app::seen_keypoint>(),
                      options.scale_factor));
      }
      before = std::move(now);
      before_index = i;
    }
    if (!a.quiet) { progress.step(i + 1, outcome.tracked ? std::string() : "lost"); }
  }
  if (!a.quiet) { progress.finish(); }

  report.keyframes = odometry->keyframes();
  report.map_points = odometry->map_points();
  report.maps = odometry->maps();
  report.truth = sequence.ground_truth();
  report.error =
      seq::evaluate(report.estimate, report.truth, sequence.ground_truth_has_orientation());
  seq::write_tum(a.out + "/trajectory.txt", report.estimate);
  seq::write_times_csv(a.out + "/times.csv", report);
  seq::write_summary_json(a.out + "/summary.json", report);
  seq::write_html(a.out + "/report.html", report);
  seq::print_summary(std::cout, report);
  std::cout << "report    " << std::filesystem::absolute(a.out + "/report.html").string() << "\n";
  if (report.tracked == 0) {
    std::cerr << "track_sequence: " << a.sequence
              << ": no frame could be tracked: too few corners are seen by both "
              << "cameras (--features " << options.features << ")\n";
    return 1;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  arguments a;
  int const parsed = parse(argc, argv, a);
  if (parsed != 0) { return parsed < 0 ? 0 : parsed; }
  try {
    return run(a);
  } catch (std::exception const& e) {
    std::cerr << "track_sequence: " << e.what() << "\n";
    return 1;
  }
}
