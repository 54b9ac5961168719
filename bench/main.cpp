// SPDX-License-Identifier: Apache-2.0
// Times whole frames and their stages over rotating generated images; medians and 99th percentiles.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/scene.hpp"
#include "sequence/generator.hpp"
#include "sequence/report.hpp"

namespace {

bench::scene make_scene(int frames, int features, int local_points) {
  seq::generator_options options;
  seq::generator const generator(options);
  auto const& rig = generator.rig();
  bench::scene s;
  s.width = rig.left.width;
  s.height = rig.left.height;
  s.fx = static_cast<float>(rig.left.fx);
  s.fy = static_cast<float>(rig.left.fy);
  s.cx = static_cast<float>(rig.left.cx);
  s.cy = static_cast<float>(rig.left.cy);
  s.baseline = static_cast<float>(rig.baseline());
  s.features = features;
  s.local_points = local_points;
  constexpr int first = 60;  // in motion
  for (int k = first; k < first + frames; ++k) {
    auto frame = generator.render(k);
    Eigen::Isometry3d const T = generator.T_world_camera(k).inverse();
    bench::scene_frame f;
    f.left = std::move(frame.left.pixels);
    f.right = std::move(frame.right.pixels);
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) { f.T_cw.R[3 * r + c] = static_cast<float>(T.linear()(r, c)); }
      f.T_cw.t[r] = static_cast<float>(T.translation()(r));
    }
    s.frames.push_back(std::move(f));
  }
  return s;
}

}  // namespace

int main(int argc, char** argv) {
  std::string json;
  std::string backend = "auto";
  std::string commit;
  bench::settings how;
  int images = 16;
  int features = 1200;
  int local_points = 3000;
  CLI::App app("Times ft's stereo frame: images staged (pinned beside a device) to result read.");
  app.add_option("--json", json, "write all figures to this file");
  app.add_option("--backend", backend, "auto (both where there is a device), host or cuda")
      ->check(CLI::IsMember({"auto", "host", "cuda"}))
      ->capture_default_str();
  app.add_option("--frames", how.frames, "timed frames")
      ->check(CLI::Range(4, 1 << 24))
      ->capture_default_str();
  app.add_option("--warm-up", how.warm_up, "frames before")
      ->check(CLI::Range(1, 1 << 24))
      ->capture_default_str();
  app.add_option("--batch", how.batches, "also these numbers of cameras at once");
  app.add_option("--images", images, "different frames, taken in turn")
      ->check(CLI::Range(2, 200))
      ->capture_default_str();
  app.add_option("--features", features, "keypoints per image")
      ->check(CLI::Range(1, 1 << 16))
      ->capture_default_str();
  app.add_option("--local-points", local_points, "map points")
      ->check(CLI::Range(1, 4096))
      ->capture_default_str();
  app.add_option("--commit", commit, "noted in the file");
  CLI11_PARSE(app, argc, argv);
  try {
    bench::scene const scene = make_scene(images, features, local_points);
    std::vector<bench::measurement> all;
    std::string const gpu = bench::cuda_description();
    if (backend == "cuda" && gpu.empty()) {
      throw std::runtime_error("--backend cuda: no CUDA device");
    }
    if (backend != "host") { all = bench::run_cuda(scene, how); }
    if (backend == "host" || (backend == "auto" && gpu.empty())) {
      all = bench::run_host(scene, how);
    }
    nlohmann::json out;
    char date[32];
    std::time_t const now = std::time(nullptr);
    std::strftime(date, sizeof date, "%Y-%m-%d", std::gmtime(&now));
    out["date"] = date;
    out["gpu"] = gpu;
    out["commit"] = commit;
    std::string command;
    for (int i = 0; i < argc; ++i) {
      command += std::string(i == 0 ? "" : " ") + (i == 0 ? "ft_bench" : argv[i]);
    }
    out["command"] = command;
    out["image"] = {scene.width, scene.height};
    std::printf("%s\n%-48s %6s %6s %9s %9s %9s %9s %9s\n", gpu.c_str(), "what", "batch", "calls",
                "mean us", "std us", "p50 us", "p99 us", "frames/s");
    for (auto const& m : all) {
      auto const s = seq::summarise(m.us);
      double const rate = s.p50 > 0 ? m.batch * 1e6 / s.p50 : 0;
      std::printf("%-48s %6d %6zu %9.1f %9.1f %9.1f %9.1f %9.0f\n", m.name.c_str(), m.batch,
                  m.us.size(), s.mean, s.std, s.p50, s.p99, rate);
      out["rows"].push_back({{"name", m.name},
                             {"backend", m.backend},
                             {"batch", m.batch},
                             {"calls", m.us.size()},
                             {"mean_us", s.mean},
                             {"std_us", s.std},
                             {"p50_us", s.p50},
                             {"p99_us", s.p99},
                             {"max_us", s.max},
                             {"frames_per_s", rate},
                             {"inliers", m.inliers},
                             {"map_points", m.map_points}});
    }
    if (!json.empty()) {
      std::ofstream file(json);
      file << out.dump(1) << "\n";
      if (!file) { throw std::runtime_error("cannot write '" + json + "'"); }
    }
  } catch (std::exception const& e) {
    std::cerr << "ft_bench: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
