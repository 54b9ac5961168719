// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/options.hpp"

#include <CLI/CLI.hpp>
#include <string>

#include "ft/version.hpp"

namespace app {
namespace {

constexpr char const* footer =
    "The exit status is 0; 1 for an error, or where no frame could be tracked; 2 for a mistake in "
    "the options; 3 where Ctrl-C, SIGTERM or an image that cannot be read stopped the run: what "
    "was tracked until then is written.";

void add_input(CLI::App& app, arguments& a, std::string& folder) {
  app.add_option("FOLDER", folder, "folder of the sequence");
  app.add_option("--sequence", a.sequence, "the same as an option");
  app.add_option(
      "--calibration", a.calibration,
      "calibration: Kalibr's chain, OpenCV's YAML or XML of a pair (M1, D1, M2, D2, R, T), ROS "
      "camera_info (left.yaml beside right.yaml), basalt's JSON, what "
      "rs-enumerate-devices -c prints, DepthAI's JSON, COLMAP's cameras.txt, ORB-SLAM3 settings, "
      "KITTI's calib.txt or calib_cam_to_cam.txt, a camera.txt (fx fy cx cy), or a folder with "
      "one; default: the "
      "sequence's own");
  app.add_option("--fps", a.fps,
                 "images a second, of folders whose file names are no times, of ICL-NUIM, and of "
                 "7-Scenes (default: 30); times otherwise: the file names, or times.txt");
  app.add_option("--times", a.times, "file with the time of each image, of folders of images");
  app.add_option(
         "--mask", a.masks,
         "image that is 0 where no keypoints are wanted, or a folder with one for each frame "
         "that has the name of its image; once for each camera, left, right, cam2 ...; '' = "
         "none")
      ->allow_extra_args(false);
  app.add_option("--image-bits", a.image_bits,
                 "bits that hold the samples of grey images of 16 bits; default: 16")
      ->check(CLI::Range(8, 16));
  app.add_option("--max-time-difference", a.max_time_difference_ms,
                 "how far the time stamps of the two images of a frame may be apart, in ms; "
                 "default: 1 for a pair, 20 for colour and depth");
  app.add_option("--frames", a.frames, "stop after so many; 0 = all")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--read-ahead", a.read_ahead,
                 "pairs that other threads read, decode and rectify ahead of the tracking; 0 = "
                 "none, without threads; default: as many as suit the backend")
      ->check(CLI::Range(0, 4096));
  app.add_flag("--realtime", a.realtime,
               "frames arrive by their time stamps; of those that come while one is processed all "
               "but the newest are dropped");
}

void add_tracking(CLI::App& app, arguments& a) {
  app.add_option("--backend", a.backend, "auto (a GPU if there is one), host or cuda")
      ->check(CLI::IsMember({"auto", "host", "cuda"}))
      ->capture_default_str();
  app.add_option(
         "--threads", a.threads,
         "threads of each stage of the host backend; 0 = all; with 1 no frame is prefetched")
      ->check(CLI::Range(0, 4096));
  app.add_option(
         "--rig", a.rig,
         "auto (what the folder holds), stereo (fisheye pairs as they are, others rectified), "
         "mono (one camera, of a pair the left one; without an IMU the scale of the path is "
         "not known), rgbd (one camera with depth images), rectified (a pair), fisheye "
         "(two Kannala-Brandt cameras, not rectified) or mixed (all cameras of a rig, not "
         "rectified: pinhole, radtan, Kannala-Brandt or double sphere); monocular is mono")
      ->check(CLI::IsMember(
          {"auto", "stereo", "mono", "rgbd", "rectified", "fisheye", "mixed", "monocular"}))
      ->capture_default_str();
  app.add_option("--depth-unit", a.depth_unit,
                 "metres per unit of depth images; default: the calibration's, or 0.0002 (TUM)");
  app.add_option("--min-depth", a.min_depth, "metres; smaller depths are taken for none")
      ->capture_default_str();
  app.add_option("--max-depth", a.max_depth, "metres; larger depths are taken for none")
      ->capture_default_str();
  app.add_option(
      "--readout", a.readout_ms,
      "ms from the first row of an image to the last one, of all cameras, as rectified: those "
      "have rolling shutters, and stamps are those of the middle row; 0 = global shutters; "
      "default: the calibration's (Kalibr's line_delay), or 0");
  app.add_option(
         "--features", a.features,
         "keypoints per image; default: the settings file's, or 1200 (2000 for wide images)")
      ->check(CLI::Range(1, 1 << 20));
  app.add_option("--corner-ratio", a.corner_ratio,
                 "corners that are more like an edge are left out; 0 = the default, 1/16 where "
                 "there are depths; 1e-6 keeps all")
      ->capture_default_str();
  app.add_flag("--loops", a.loops,
               "recognises places seen before and corrects the path there: trajectory.txt is the "
               "path as all loops have corrected it, trajectory_online.txt as each frame told it");
  CLI::Option* const load = app.add_option(
      "--load-map", a.load_map,
      "file of --save-map, with the same rig, image size and options: the camera is searched for "
      "in it, and poses are in its world. Near the place where it was saved; anywhere if both runs "
      "have --loops");
  app.add_flag("--localize-only", a.localize_only,
               "the map is not changed, and a camera that is not found in it stays lost")
      ->needs(load);
  app.add_option("--near", a.near_depth,
                 "depth of near map points, in baselines; default: the settings file's, or 50");
}

void add_output(CLI::App& app, arguments& a) {
  app.add_option("--out", a.out,
                 "folder for trajectory.txt, groundtruth.txt, map.ply, times.csv, summary.json, "
                 "report.html")
      ->capture_default_str();
  app.add_option("--save-map", a.save_map,
                 "file for the map at the end, with --loops also for all places that are kept");
  app.add_option("--frame", a.frame,
                 "whose poses are written and compared: those of the (rectified) left camera, or "
                 "of the body (IMU)")
      ->check(CLI::IsMember({"camera", "body"}))
      ->capture_default_str();
  app.add_option("--poses", a.poses,
                 "tum, or kitti: also poses.txt with KITTI's 12 numbers for each frame")
      ->check(CLI::IsMember({"tum", "kitti"}))
      ->capture_default_str();
  app.add_option("--imu", a.imu, "auto (the default: used if the sequence has one), or off")
      ->check(CLI::IsMember({"auto", "off"}));
  app.add_option("--imu-time-offset", a.imu_time_offset_s,
                 "seconds that the IMU's clock is ahead of that of the images, as Kalibr's "
                 "timeshift_cam_imu; the default: what imu0/sensor.yaml has by that name, or 0. "
                 "Another one is found where the camera turns enough");
  app.add_option(
      "--record", a.record,
      "folder for a recording that `python -m ft view FOLDER` shows in the viewer rerun, "
      "or turns into one file with its --record FILE.rrd: recording.jsonl and the left "
      "images; with --timing it has the times of stages");
  app.add_flag("--timing", a.timing, "measures the stages of a frame");
  app.add_flag("--quiet", a.quiet, "no progress display");
}

/// @throws CLI::ValidationError for a number outside its limits, or NaN
void check_ranges(CLI::App const& app, arguments const& a) {
  auto const require = [&](char const* option, bool holds, std::string const& limit) {
    if (app.count(option) > 0 && !holds) {
      throw CLI::ValidationError(option, app.get_option(option)->as<std::string>() + ": " + limit);
    }
  };
  double const apart = a.max_time_difference_ms.value_or(0);
  double const offset = a.imu_time_offset_s.value_or(0);
  double const readout = a.readout_ms.value_or(0);
  require("--readout", readout >= 0 && readout <= 100, "must be 0 to 100 ms");
  require("--imu-time-offset", offset >= -10 && offset <= 10, "must be -10 to 10 s");
  require("--near", a.near_depth > 0 && a.near_depth <= 1e6, "must be above 0 and at most 1e6");
  require("--corner-ratio", a.corner_ratio >= 0 && a.corner_ratio <= 1, "must be 0 to 1");
  require("--max-time-difference", apart >= 0 && apart <= 1e4, "must be 0 to 10000 ms");
  require("--fps", a.fps >= 1e-3 && a.fps <= 1e5, "must be 0.001 to 100000 images a second");
  require("--depth-unit", a.depth_unit >= 1e-9 && a.depth_unit <= 1e3,
          "must be 1e-9 to 1000 metres a unit");
  require("--min-depth", a.min_depth >= 0 && a.min_depth <= 1e6, "must be 0 to 1e6 m");
  require("--max-depth", a.max_depth > a.min_depth,
          "must be above --min-depth, which is " + std::to_string(a.min_depth) + " m");
}

}  // namespace

int parse(int argc, char** argv, arguments& a) {
  CLI::App app(
      "Tracks a sequence with ft: a pair of cameras or one (layouts of EuRoC, KITTI odometry "
      "and KITTI raw, or folders of images), or a camera with depth images (layouts of TUM RGB-D, "
      "ICL-NUIM, OpenLORIS and 7-Scenes).");
  std::string folder;
  add_input(app, a, folder);
  add_tracking(app, a);
  add_output(app, a);
  app.set_version_flag("--version", "track_sequence " + std::to_string(ft::version_major) + "." +
                                        std::to_string(ft::version_minor) + "." +
                                        std::to_string(ft::version_patch));
  app.footer(footer);
  try {
    app.parse(argc, argv);
    check_ranges(app, a);
    if (!folder.empty() && !a.sequence.empty()) {
      throw CLI::ValidationError(folder, "--sequence names the folder already");
    }
    if (a.sequence.empty()) { a.sequence = folder; }
    if (a.sequence.empty()) { throw CLI::RequiredError("FOLDER or --sequence"); }
  } catch (CLI::ParseError const& e) { return app.exit(e) == 0 ? exit_done : exit_refused; }
  return -1;
}

}  // namespace app
