// SPDX-License-Identifier: Apache-2.0
// Tracks a sequence with ft and writes a trajectory, times, a summary and a report.
#include <exception>
#include <iostream>
#include <string>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/sequence/warnings.hpp"
#include "examples/track_sequence/interrupt.hpp"
#include "examples/track_sequence/odometry.hpp"
#include "examples/track_sequence/options.hpp"
#include "examples/track_sequence/outputs.hpp"
#include "examples/track_sequence/setup.hpp"
#include "examples/track_sequence/tracking_run.hpp"

namespace {

void describe(app::arguments const& a, seq::sequence const& sequence,
              app::odometry_options const& options, app::odometry const& odometry,
              seq::run_report& report) {
  report.title = "Tracking of " + sequence.name();
  report.sequence = sequence.name();
  report.device = odometry.device();
  report.image_width = options.width;
  report.image_height = options.height;
  report.one_camera = options.monocular;
  report.depth_images = options.rgbd;
  report.metric = !options.monocular;
  report.stages = odometry.stage_names();
  if (!a.timing) { report.stages = {report.stages.back()}; }
  report.prefetch = options.prefetch;
  report.calibration = odometry.calibration_warnings();
  report.options = {{"features", std::to_string(options.features)},
                    {"levels", std::to_string(options.levels)},
                    {"layout", sequence.layout()},
                    {"rig", options.monocular ? "monocular"
                            : options.rgbd    ? "rgbd"
                            : options.fisheye ? "fisheye"
                                              : "rectified"},
                    {"frame", a.frame},
                    {"read-ahead", std::to_string(*a.read_ahead)},
                    {"realtime", a.realtime ? "yes" : "no"},
                    {"near points, baselines", std::to_string(options.near_depth)}};
}

/// What was found in the folder.
void print_recording(seq::sequence const& sequence, app::odometry_options const& o) {
  bool const pair = !o.monocular && !o.rgbd;
  std::cout << "sequence  " << sequence.name() << ", " << sequence.size()
            << (pair     ? " stereo pairs of "
                : o.rgbd ? " images with depth images of "
                         : " images of one camera, ")
            << o.width << "x" << o.height;
  if (pair) { std::cout << ", baseline " << o.baseline << " m"; }
  std::cout << "\n";
  if (o.rgbd) {
    std::cout << "depth     " << o.depth_unit << " m a unit, " << sequence.depth_unit_from()
              << "; taken from " << o.min_depth << " to " << o.max_depth << " m\n";
  }
  if (o.monocular && !sequence.imu()) {
    std::cout << "scale     unknown: one camera without an IMU; errors are those after alignment "
                 "with Sim(3)\n";
  }
  if (auto const& imu = sequence.imu()) {
    std::cout << "imu       " << imu->samples.size() << " samples, " << imu->calibration.rate_hz
              << " Hz\n";
  }
}

int run(app::arguments a) {
  seq::sequence const sequence = app::open_sequence(a);
  app::odometry_options const options = app::options_of(a, sequence);
  app::make_output_folder(a);
  seq::run_report report;
  auto const odometry = app::make_odometry(a, options, report.backend);
  if (!a.read_ahead) { a.read_ahead = app::usual_read_ahead(report.backend); }
  describe(a, sequence, options, *odometry, report);
  print_recording(sequence, options);
  std::cout << "backend   " << report.backend << ", " << report.device << "\n";
  for (std::string const& warning : report.calibration) {
    std::cout << "warning   calibration: " << warning << "\n";
  }

  app::watch_interrupts();
  app::tracking_run(a, sequence, *odometry, report).track_all();
  report.keyframes = odometry->keyframes();
  report.map_points = odometry->map_points();
  report.maps = odometry->maps();
  auto const map = [&](std::ostream& to, Eigen::Isometry3d const& T_file_world) {
    odometry->write_map(to, app::plain_pose(T_file_world));
  };
  app::finish(a, sequence, map, report);
  if (report.stopped_at) {
    std::cerr << "track_sequence: stopped at frame " << *report.stopped_at << ": "
              << report.stopped_by << "\n";
    return app::exit_stopped;
  }
  if (report.tracked == 0) {
    std::cerr << "track_sequence: " << a.sequence << ": no frame could be tracked: "
              << (options.monocular ? "the camera does not move enough, or too few corners are seen"
                  : options.rgbd    ? "too few corners have a depth"
                                    : "too few corners are seen by both cameras")
              << " (--features " << options.features << ")";
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
    return run(a);
  } catch (std::exception const& e) {
    std::cerr << "track_sequence: " << e.what() << "\n";
    return app::exit_failed;
  }
}
