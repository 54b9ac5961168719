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

int main(int argc, char** argv) {
  seq::generator_options options;
  seq::asl_options writing;
  std::string directory;
  bool steady_exposure = false;

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
  add("--threads", writing.threads, "0 = as many as the machine has");
  try {
    app.parse(argc, argv);
  } catch (CLI::ParseError const& e) { return app.exit(e) == 0 ? 0 : 2; }

  try {
    options.rig = rig == "fisheye" ? seq::rig_kind::fisheye : seq::rig_kind::pinhole;
    options.exposure_change = !steady_exposure;
    options.threads = writing.threads;
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
