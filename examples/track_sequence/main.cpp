// SPDX-License-Identifier: Apache-2.0
// Tracks a sequence with ft and writes a trajectory, times, a summary and a report.
#include <exception>
#include <iostream>
#include <string>
#include <vector>

#include "examples/sequence/odometry_input.hpp"
#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/sequence/warnings.hpp"
#include "examples/track_sequence/interrupt.hpp"
#include "examples/track_sequence/options.hpp"
#include "examples/track_sequence/outputs.hpp"
#include "examples/track_sequence/setup.hpp"
#include "examples/track_sequence/timed_odometry.hpp"
#include "examples/track_sequence/tracking_run.hpp"
#include "ft/version.hpp"

namespace {

char const* rig_name(ft::rig_kind kind) {
  switch (kind) {
    case ft::rig_kind::monocular:
      return "monocular";
    case ft::rig_kind::rgbd:
      return "rgbd";
    case ft::rig_kind::fisheye_pair:
      return "fisheye";
    case ft::rig_kind::multi:
      return "mixed";
    default:
      return "rectified";
  }
}

void describe(app::arguments const& a, seq::sequence const& sequence, app::odometry_setup const& o,
              app::timed_odometry& odometry, seq::run_report& report) {
  report.title = "Tracking of " + sequence.name();
  report.sequence = sequence.name();
  report.image_width = o.params.orb.width;
  report.image_height = o.params.orb.height;
  report.one_camera = o.rig.kind == ft::rig_kind::monocular;
  report.depth_images = o.rig.kind == ft::rig_kind::rgbd;
  report.metric = !report.one_camera;
  report.stages = odometry.stage_names();
  if (!a.timing) { report.stages = {report.stages.back()}; }
  report.prefetch = o.params.prefetch;
  report.calibration = odometry.odometry().calibration_warnings();
  report.options = {{"features", std::to_string(o.params.orb.features)},
                    {"levels", std::to_string(o.params.orb.levels)},
                    {"layout", sequence.layout()},
                    {"rig", rig_name(o.rig.kind)},
                    {"frame", a.frame},
                    {"read-ahead", std::to_string(*a.read_ahead)},
                    {"realtime", a.realtime ? "yes" : "no"},
                    {"near points, baselines", std::to_string(o.near_depth)}};
}

/// What was found in the folder.
void print_recording(seq::sequence const& sequence, app::arguments const& a,
                     app::odometry_setup const& o) {
  for (auto const& [name, text] : seq::describe(sequence, a.imu != "off")) {
    std::cout << name << std::string(10 - name.size(), ' ') << text << "\n";
  }
  if (sequence.depth_unit() > 0) {
    std::cout << "depth     taken from " << o.rig.min_depth << " to " << o.rig.max_depth << " m\n";
  }
  if (o.rig.kind == ft::rig_kind::monocular && !sequence.imu()) {
    std::cout << "scale     unknown: one camera without an IMU; errors are those after alignment "
                 "with Sim(3)\n";
  }
}

int run(app::arguments a, std::vector<std::string> const& words) {
  seq::sequence const sequence = app::open_sequence(a);
  app::odometry_setup const setup = app::setup_of(a, sequence);
  app::make_output_folder(a);
  seq::run_report report;
  app::timed_odometry odometry(app::make_odometry(a, setup, report.backend, report.device),
                               setup.rig);
  if (!a.read_ahead) { a.read_ahead = app::usual_read_ahead(report.backend); }
  describe(a, sequence, setup, odometry, report);
  report.version = std::to_string(ft::version_major) + "." + std::to_string(ft::version_minor) +
                   "." + std::to_string(ft::version_patch);
  report.command = seq::command_line(words);
  report.date = seq::utc_now();
  if (report.backend == "host") { report.threads = app::threads_of(setup); }
  print_recording(sequence, a, setup);
  bool const no_gpu = a.backend == "auto" && report.backend == "host";
  std::cout << "backend   " << report.backend << ", " << report.device
            << (no_gpu ? "; no GPU, or built without CUDA" : "") << "\n";
  for (std::string const& warning : report.calibration) {
    std::cout << "warning   calibration: " << warning << "\n";
  }

  app::watch_interrupts();
  app::tracking_run(a, sequence, setup, odometry, report).track_all();
  ft::tracking const& last = odometry.odometry().last();
  report.keyframes = last.keyframes;
  report.map_points = static_cast<int>(odometry.odometry().download_map().points.size());
  report.maps = last.maps;
  auto const map = [&](std::ostream& to, Eigen::Isometry3d const& T_file_world) {
    // The map's points are in the frame of the odometry.
    odometry.write_map(to, (seq::odometry_pose(T_file_world) * last.T_world_odom).cast<float>(),
                       static_cast<float>(last.odom_scale));
  };
  app::finish(a, sequence, map, report);
  if (!a.save_map.empty() && report.tracked > 0) { app::save_map(a.save_map, odometry.odometry()); }
  if (report.stopped_at) {
    std::cerr << "track_sequence: stopped at frame " << *report.stopped_at << ": "
              << report.stopped_by << "\n";
    return app::exit_stopped;
  }
  if (report.tracked == 0) {
    std::cerr << "track_sequence: " << a.sequence << ": no frame could be tracked: "
              << (a.localize_only ? "the camera was not found in the map"
                  : report.one_camera
                      ? "the camera does not move enough, or too few corners are seen"
                  : report.depth_images ? "too few corners have a depth"
                                        : "too few corners are seen by both cameras")
              << " (--features " << setup.params.orb.features << ")";
    for (std::string const& reason : seq::reasons_of(report)) { std::cerr << "; " << reason; }
    std::cerr << "\n";
    return app::exit_failed;
  }
  return app::exit_done;
}

}  // namespace

int main(int argc, char** argv) {
  app::arguments a;
  int const status = app::parse(argc, argv, a);
  if (status >= 0) { return status; }
  try {
    return run(a, {argv, argv + argc});
  } catch (std::exception const& e) {
    std::cerr << "track_sequence: " << e.what() << "\n";
    return app::exit_failed;
  }
}
