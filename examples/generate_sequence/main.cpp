// SPDX-License-Identifier: Apache-2.0
/// @file Renders a textured room seen from a moving stereo pair and writes it in EuRoC (ASL)
/// layout, with IMU samples and exact ground truth: a test sequence that needs no download.
#include "examples/sequence/asl_writer.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/report.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>

#include <exception>
#include <iostream>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace {

/// Options that come as numbers in a row, several times.
struct time_options {
  std::vector<std::pair<double, double>> blind, drop;
  std::vector<std::tuple<double, double, double>> turn;
};

void add_times(CLI::App& app, time_options& times) {
  app.add_option("--blind", times.blind, "FROM TO, seconds: black images; may be repeated");
  app.add_option("--drop", times.drop, "FROM TO, seconds: no images; may be repeated");
  app.add_option("--fast-turn", times.turn,
                 "FROM TO DEGREES: turns about the vertical and back; may be repeated");
}

void take_times(time_options const& times, seq::generator_options& options) {
  for (auto const& [from, to] : times.blind) { options.blind.push_back({from, to}); }
  for (auto const& [from, to] : times.drop) { options.dropped.push_back({from, to}); }
  for (auto const& [from, to, degrees] : times.turn) {
    options.fast_turns.push_back({{from, to}, degrees});
  }
}

template <typename Add>
void add_scene(CLI::App& app, Add const& add, std::string& scene, seq::generator_options& options) {
  add("--scene", scene, "room, or corridor: straight along one")
      ->check(CLI::IsMember({"room", "corridor"}));
  add("--speed", options.speed, "in the corridor, m/s, after 2 s");
  add("--look-aside", options.look_aside, "in the corridor: degrees to the left of the way");
  add("--repeat", options.repeat, "the corridor looks the same after so many metres; 0 = never");
  add("--bonnet", options.hiding.bonnet, "percent: covers the lower edge, fixed to the cameras");
  add("--dirt", options.hiding.dirt, "percent: patches all over, fixed to the cameras");
  add("--companion", options.hiding.companion, "percent: a thing ahead that goes along");
  add("--crossing", options.hiding.crossing, "percent: a thing ahead that crosses to the left");
  add("--crossing-speed", options.hiding.crossing_speed, "m/s");
  app.footer("Shares are those of the left image.");
}

}  // namespace

int main(int argc, char** argv) {
  seq::generator_options options;
  seq::asl_options writing;
  std::string directory;
  bool steady_exposure = false;
  double exposure_ms = 0;
  double readout_ms = 0;
  time_options times;

  CLI::App app(
      "Generates a stereo sequence in EuRoC layout: the same options give the same files.");
  auto const add = [&app](char const* name, auto& value, char const* help) {
    return app.add_option(name, value, help)->capture_default_str();
  };
  std::string rig = "pinhole";
  app.add_option("--out", directory, "folder to create")->required();
  add("--rig", rig, "rectified pinhole pair, or fisheye (Kannala-Brandt) pair")
      ->check(CLI::IsMember({"pinhole", "fisheye"}));
  add("--frames", options.frames, "stereo pairs");
  add("--seed", options.seed, "textures, details of room and route, noise");
  add("--width", options.width, "pixels; 0 = 752 (pinhole) or 512 (fisheye)");
  add("--height", options.height, "pixels; 0 = 480 (pinhole) or 512 (fisheye)");
  add("--fps", options.fps, "frames per second");
  add("--noise", options.noise_sigma, "standard deviation, grey levels");
  add("--baseline", options.baseline, "metres; 0 = 0.11 (pinhole) or 0.101 (fisheye)");
  app.add_flag("--steady-exposure", steady_exposure, "keep the exposure constant");
  add("--exposure", exposure_ms,
      "exposure time, ms: images are blurred by motion, and take longer");
  add("--readout", readout_ms,
      "of rolling shutters: from the first row to the last one, ms; the stamp is the middle row's");
  add_times(app, times);
  std::string scene = "room";
  add_scene(app, add, scene, options);
  app.add_flag("--imu,!--no-imu", writing.imu, "write imu0; the default");
  add("--imu-rate", options.imu_rate, "samples per second");
  add("--imu-noise", options.imu_noise_scale,
      "times the IMU's densities and first biases; 0 = ideal samples");
  add("--gyro-noise", options.imu.gyro, "density, rad/s/sqrt(Hz)");
  add("--accel-noise", options.imu.accel, "density, m/s^2/sqrt(Hz)");
  add("--gyro-walk", options.imu.gyro_walk, "density of the bias' walk, rad/s^2/sqrt(Hz)");
  add("--accel-walk", options.imu.accel_walk, "density of the bias' walk, m/s^3/sqrt(Hz)");
  add("--gyro-bias", options.gyro_bias, "standard deviation of the first bias, rad/s");
  add("--accel-bias", options.accel_bias, "standard deviation of the first bias, m/s^2");
  add("--png-level", writing.png_compression,
      "zlib level of the images; 0: large files that are read fast")
      ->check(CLI::Range(0, 9));
  add("--threads", writing.threads, "0 = as many as the machine has");
  try {
    app.parse(argc, argv);
  } catch (CLI::ParseError const& e) { return app.exit(e) == 0 ? 0 : 2; }

  try {
    options.rig = rig == "fisheye" ? seq::rig_kind::fisheye : seq::rig_kind::pinhole;
    options.scene = scene == "corridor" ? seq::scene_kind::corridor : seq::scene_kind::room;
    options.exposure_change = !steady_exposure;
    options.threads = writing.threads;
    options.exposure_s = 1e-3 * exposure_ms;
    options.readout_s = 1e-3 * readout_ms;
    take_times(times, options);
    seq::generator const source(options);
    seq::progress progress(std::cerr, ::isatty(STDERR_FILENO) == 1, "generate", source.size());
    seq::write_asl(source, directory, writing, [&](int done) { progress.step(done); });
    progress.finish();
    std::cout << directory << ": " << source.size() << " stereo pairs of " << source.options().width
              << " x " << source.options().height << "\n";
  } catch (std::exception const& e) {
    std::cerr << "generate_sequence: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
