// SPDX-License-Identifier: Apache-2.0
// Times whole frames, their stages, batches, streams and camera models over rotating generated
// images; prints medians and 99th percentiles. bench/README.md describes each section.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "bench/plan.hpp"
#include "bench/sections.hpp"

namespace {

std::string processor() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    std::size_t const colon = line.find(": ");
    if (line.rfind("model name", 0) == 0 && colon != std::string::npos) {
      return line.substr(colon + 2);
    }
  }
  return {};
}

}  // namespace

int main(int argc, char** argv) {
  std::string json_path;
  std::string backend = "auto";
  std::string commit;
  std::vector<std::string> only;
  bench::settings how;
  CLI::App app(
      "Times ft's stereo frame (from images in staging memory to the result in host memory), its "
      "parts, batches, streams and camera models, over generated images in turn.");
  app.add_option(
      "--only", only,
      "sections, with commas between: cameras, frame, fisheye, stages, batch, streams, "
      "graph (launches and bytes a frame), kernels (their registers and memory), "
      "ablation (one choice switched at a time), tie_rules (of the quadtree), odometry "
      "(images in, poses out), map_stages (its stages, keyframes apart), gpus (a batch on "
      "each device), inertial (poses with an IMU), words (places, relocalisation, the start with "
      "one camera), host_stages (one host thread, next to OpenCV). Default: all");
  app.add_option("--json", json_path, "write all figures to this file");
  app.add_option("--backend", backend,
                 "auto (a device if one is found, else the host), host, cuda or both")
      ->check(CLI::IsMember({"auto", "host", "cuda", "both"}))
      ->capture_default_str();
  app.add_option("--frames", how.frames,
                 "timed frames of one pair; stages, batches and ablation take a share. 0 = 1000 on "
                 "a device, 48 on the host")
      ->check(CLI::Range(0, 1 << 24))
      ->capture_default_str();
  app.add_option("--warm-up", how.warm_up, "frames before. 0 = 100 on a device, 3 on the host")
      ->check(CLI::Range(0, 1 << 24))
      ->capture_default_str();
  app.add_option("--batch", how.batches,
                 "camera pairs at once. Default: 1 to 256 by twos on a device, to 8 on the host")
      ->check(CLI::Range(1, 2048));
  app.add_option("--streams", how.streams,
                 "trackers side by side, rising. Default: 1 to 64 by twos on a device, to 4 on the "
                 "host")
      ->check(CLI::Range(1, 1024));
  app.add_option("--images", how.images, "different frames, taken in turn")
      ->check(CLI::Range(2, 200))
      ->capture_default_str();
  app.add_option(
         "--sequence", how.sequence,
         "folder of a recorded stereo sequence with ground truth (EuRoC, KITTI layout): its "
         "first frames in place of generated ones, for the rectified pair")
      ->check(CLI::ExistingDirectory);
  app.add_option("--features", how.features, "keypoints per rectified image")
      ->check(CLI::Range(1, 1 << 16))
      ->capture_default_str();
  app.add_option("--fisheye-features", how.fisheye_features, "keypoints per fisheye image")
      ->check(CLI::Range(1, 1 << 16))
      ->capture_default_str();
  app.add_option("--local-points", how.local_points, "map points")
      ->check(CLI::Range(1, 4096))
      ->capture_default_str();
  app.add_option("--points", how.points,
                 "points a call of the camera models. 0 = 2^20 on a device, 2^16 on the host")
      ->check(CLI::Range(0, 1 << 24))
      ->capture_default_str();
  app.add_option("--gpus", how.gpus, "devices of the section gpus, at most. 0 = all")
      ->check(CLI::Range(0, 64))
      ->capture_default_str();
  app.add_option("--commit", commit, "noted in the file");
  CLI11_PARSE(app, argc, argv);
  try {
    auto const sections = bench::parse_sections(only);
    std::string const gpu = bench::cuda_description();
    if ((backend == "cuda" || backend == "both") && gpu.empty()) {
      throw std::runtime_error("--backend " + backend + ": no CUDA device");
    }
    if (!json_path.empty() && !std::ofstream(json_path, std::ios::app)) {
      throw std::runtime_error("cannot write '" + json_path + "'");
    }
    std::vector<bench::backend_type> backends;
    if (backend != "host" && !gpu.empty()) { backends.push_back(bench::backend_type::cuda); }
    if (backend == "host" || backend == "both" || gpu.empty()) {
      backends.push_back(bench::backend_type::host);
    }

    nlohmann::json out;
    char date[32];
    std::time_t const now = std::time(nullptr);
    std::strftime(date, sizeof date, "%Y-%m-%d", std::gmtime(&now));
    out["date"] = date;
    out["gpu"] = gpu;
    out["processor"] = processor();
    out["threads"] = std::thread::hardware_concurrency();
    out["commit"] = commit;
    std::string command = "ft_bench";
    for (int i = 1; i < argc; ++i) { command += std::string(" ") + argv[i]; }
    out["command"] = command;
    out["sequence"] = how.sequence;
    out["rows"] = nlohmann::json::array();
    std::printf("%s\n%s, %u threads\n", gpu.c_str(), out["processor"].get<std::string>().c_str(),
                std::thread::hardware_concurrency());

    bench::scenes scenes(how);
    bench::context const context{how, &scenes, &out};
    if (!how.sequence.empty()) {
      auto const& s = scenes.get(bench::rig_type::rectified);
      out["image"] = {s.width, s.height};
    } else {
      out["image"] = {752, 480};
    }
    auto const wanted = [&](char const* name) { return sections.count(name) != 0; };
    for (auto const b : backends) {
      using bench::rig_type;
      if (wanted("cameras")) { bench::cameras_section(context, b); }
      if (wanted("frame")) { bench::frame_section(context, b, rig_type::rectified); }
      if (wanted("batch")) { bench::batch_section(context, b); }
      if (wanted("stages")) { bench::stages_section(context, b, rig_type::rectified); }
      if (wanted("fisheye")) { bench::frame_section(context, b, rig_type::fisheye); }
      if (wanted("fisheye") && wanted("stages")) {
        bench::stages_section(context, b, rig_type::fisheye);
      }
      if (wanted("streams")) { bench::streams_section(context, b); }
      if (wanted("graph")) { bench::graph_section(context, b); }
      if (wanted("kernels")) { bench::kernels_section(context, b); }
      if (wanted("tie_rules")) { bench::tie_rules_section(context, b); }
      if (wanted("odometry")) { bench::odometry_section(context, b); }
      if (wanted("map_stages")) { bench::map_stages_section(context, b); }
      if (wanted("gpus") && b == bench::backend_type::cuda) { bench::gpus_section(context); }
      if (wanted("inertial")) { bench::inertial_section(context, b); }
      if (wanted("words")) { bench::words_section(context, b); }
      if (wanted("ablation")) { bench::ablation_section(context, b, backend != "cuda"); }
    }
    if (wanted("host_stages") && (backend != "cuda" || !only.empty())) {
      bench::host_stages_section(context);
    }
    if (!json_path.empty()) {
      std::ofstream file(json_path);
      file << out.dump(1) << "\n";
      if (!file) { throw std::runtime_error("cannot write '" + json_path + "'"); }
    }
  } catch (std::exception const& e) {
    std::cerr << "ft_bench: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
