// SPDX-License-Identifier: Apache-2.0
// The shim's calls, frame by frame, with types of ORB-SLAM3's shape whose map points are scattered
// over the heap, as in that system.
#include <CLI/CLI.hpp>
#include <exception>
#include <fstream>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "bench/orbslam3/live_run.hpp"
#include "integration/orbslam3/executor_tracker.hpp"

#if FT_BENCH_HAS_CUDA
std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s);
#endif

int main(int argc, char** argv) {
  std::string backend = "host";
  std::string json;
  bench::live_options o;
  CLI::App app(
      "Times of the ORB-SLAM3 shim's calls: KITTI's size, every call computed, new points in "
      "bursts.");
  app.add_option("--backend", backend, "host or cuda")
      ->check(CLI::IsMember({"host", "cuda"}))
      ->capture_default_str();
  app.add_option("--points", o.points, "of the local map")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  app.add_option("--frames", o.frames, "measured ones")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  app.add_option("--keyframes", o.keyframe_every, "frames to a keyframe")
      ->check(CLI::Range(2, 1000))
      ->capture_default_str();
  app.add_option("--new-points", o.new_points, "of a keyframe")
      ->check(CLI::Range(0, 2000))
      ->capture_default_str();
  app.add_option("--moved-points", o.moved_points, "by the mapper, of a keyframe")
      ->check(CLI::Range(0, 100000))
      ->capture_default_str();
  app.add_option("--pause-us", o.pause_us, "between frames")
      ->check(CLI::Range(0, 1000000))
      ->capture_default_str();
  app.add_flag("--samples", o.samples, "the times of every frame in the file");
  app.add_option("--json", json, "also write the results to this file");
  CLI11_PARSE(app, argc, argv);
#if !FT_BENCH_HAS_CUDA
  if (backend == "cuda") {
    std::cerr << "orbslam3_bench: built without CUDA\n";
    return 2;
  }
#endif
  try {
    nlohmann::json out = bench::run_live(o, [&](ft::orbslam3::settings const& s) {
#if FT_BENCH_HAS_CUDA
      if (backend == "cuda") { return make_cuda(s); }
#endif
      return ft::orbslam3::make_host_tracker(s);
    });
    out["backend"] = backend;
    if (json.empty()) { return 0; }
    std::ofstream file(json);
    file << out.dump(2) << "\n";
    if (!file) { throw std::runtime_error("cannot write '" + json + "'"); }
  } catch (std::exception const& e) {
    std::cerr << "orbslam3_bench: " << e.what() << "\n";
    return 1;
  }
}
