// SPDX-License-Identifier: Apache-2.0
// Times whole frames, their stages, batches, streams and camera models over rotating generated
// images; prints medians and 99th percentiles. bench/README.md describes each section.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <set>
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

/// What the command line says.
struct command {
  std::string json_path, commit;
  std::string backend = "auto";
  std::vector<std::string> only;
  bench::settings how;
};

void add_options(CLI::App& app, command& c) {
  auto const number = [&](char const* name, int& value, int least, int most, char const* what) {
    app.add_option(name, value, what)->check(CLI::Range(least, most))->capture_default_str();
  };
  app.add_option(
      "--only", c.only,
      "sections, with commas between: cameras, frame, fisheye, stages, batch, streams, "
      "graph (launches and bytes a frame), kernels (their registers and memory), "
      "ablation (one choice switched at a time), tie_rules (of the quadtree), odometry "
      "(images in, poses out), map_stages (its stages, keyframes apart), gpus (a batch on "
      "each device), inertial (poses with an IMU), words (places, relocalisation, the start with "
      "one camera), host_stages (one host thread, next to OpenCV). Default: all");
  app.add_option("--json", c.json_path, "write all figures to this file");
  app.add_option("--backend", c.backend,
                 "auto (a device if one is found, else the host), host, cuda or both")
      ->check(CLI::IsMember({"auto", "host", "cuda", "both"}))
      ->capture_default_str();
  number("--frames", c.how.frames, 0, 1 << 24,
         "timed frames of one pair; stages, batches and ablation take a share. 0 = 1000 on a "
         "device, 48 on the host");
  number("--warm-up", c.how.warm_up, 0, 1 << 24,
         "frames before. 0 = 100 on a device, 3 on the host");
  app.add_option("--batch", c.how.batches,
                 "camera pairs at once. Default: 1 to 256 by twos on a device, to 8 on the host")
      ->check(CLI::Range(1, 2048));
  app.add_option("--streams", c.how.streams,
                 "trackers side by side, rising. Default: 1 to 64 by twos on a device, to 4 on the "
                 "host")
      ->check(CLI::Range(1, 1024));
  number("--images", c.how.images, 2, 200, "different frames, taken in turn");
  app.add_option(
         "--sequence", c.how.sequence,
         "folder of a recorded stereo sequence with ground truth (EuRoC, KITTI layout): its "
         "first frames in place of generated ones, for the rectified pair")
      ->check(CLI::ExistingDirectory);
  number("--features", c.how.features, 1, 1 << 16, "keypoints per rectified image");
  number("--fisheye-features", c.how.fisheye_features, 1, 1 << 16, "keypoints per fisheye image");
  number("--local-points", c.how.local_points, 1, 4096, "map points");
  number("--points", c.how.points, 0, 1 << 24,
         "points a call of the camera models. 0 = 2^20 on a device, 2^16 on the host");
  number("--gpus", c.how.gpus, 0, 64, "devices of the section gpus, at most. 0 = all");
  app.add_option("--commit", c.commit, "noted in the file");
}

/// @throws std::runtime_error for a backend that is not there
std::vector<bench::backend_type> backends_of(std::string const& named, bool has_gpu) {
  if ((named == "cuda" || named == "both") && !has_gpu) {
    throw std::runtime_error("--backend " + named + ": no CUDA device");
  }
  std::vector<bench::backend_type> backends;
  if (named != "host" && has_gpu) { backends.push_back(bench::backend_type::cuda); }
  if (named == "host" || named == "both" || !has_gpu) {
    backends.push_back(bench::backend_type::host);
  }
  return backends;
}

/// What the file begins with.
nlohmann::json heading(command const& c, std::string const& gpu, int argc, char** argv) {
  nlohmann::json out;
  char date[32];
  std::time_t const now = std::time(nullptr);
  std::strftime(date, sizeof date, "%Y-%m-%d", std::gmtime(&now));
  out["date"] = date;
  out["gpu"] = gpu;
  out["processor"] = processor();
  out["threads"] = std::thread::hardware_concurrency();
  out["commit"] = c.commit;
  std::string line = "ft_bench";
  for (int i = 1; i < argc; ++i) { line += std::string(" ") + argv[i]; }
  out["command"] = line;
  out["sequence"] = c.how.sequence;
  out["rows"] = nlohmann::json::array();
  return out;
}

void run(command const& c, std::set<std::string> const& sections,
         std::vector<bench::backend_type> const& backends, bench::context const& context) {
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
    if (wanted("ablation")) { bench::ablation_section(context, b, c.backend != "cuda"); }
  }
  if (wanted("host_stages") && (c.backend != "cuda" || !c.only.empty())) {
    bench::host_stages_section(context);
  }
}

}  // namespace

int main(int argc, char** argv) {
  command c;
  CLI::App app(
      "Times ft's stereo frame (from images in staging memory to the result in host memory), its "
      "parts, batches, streams and camera models, over generated images in turn.");
  add_options(app, c);
  CLI11_PARSE(app, argc, argv);
  try {
    auto const sections = bench::parse_sections(c.only);
    std::string const gpu = bench::cuda_description();
    auto const backends = backends_of(c.backend, !gpu.empty());
    if (!c.json_path.empty() && !std::ofstream(c.json_path, std::ios::app)) {
      throw std::runtime_error("cannot write '" + c.json_path + "'");
    }
    nlohmann::json out = heading(c, gpu, argc, argv);
    std::printf("%s\n%s, %u threads\n", gpu.c_str(), out["processor"].get<std::string>().c_str(),
                std::thread::hardware_concurrency());
    bench::scenes scenes(c.how);
    out["image"] = {752, 480};
    if (!c.how.sequence.empty()) {
      auto const& s = scenes.get(bench::rig_type::rectified);
      out["image"] = {s.width, s.height};
    }
    run(c, sections, backends, {c.how, &scenes, &out});
    if (!c.json_path.empty()) {
      std::ofstream file(c.json_path);
      file << out.dump(1) << "\n";
      if (!file) { throw std::runtime_error("cannot write '" + c.json_path + "'"); }
    }
  } catch (std::exception const& e) {
    std::cerr << "ft_bench: " << e.what() << "\n";
    return 1;
  }
  return 0;
}
