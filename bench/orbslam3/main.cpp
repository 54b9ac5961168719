// SPDX-License-Identifier: Apache-2.0
// The shim's cost on the host, frame by frame: the time in its calls outside of the device's. The
// types have the shape of ORB-SLAM3's, and their map points are scattered over the heap, as in that
// system.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/orbslam3/live_run.hpp"
#include "bench/orbslam3/replaying_device.hpp"
#include "bench/orbslam3/world.hpp"
#include "integration/orbslam3/accelerator.hpp"
#include "integration/orbslam3/executor_tracker.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

#if FT_BENCH_HAS_CUDA
std::unique_ptr<ft::orbslam3::device_tracker> make_cuda(ft::orbslam3::settings const& s);
#endif

namespace {

using accelerator = ft::orbslam3::accelerator<stand_in::types>;
using ft::orbslam3::change_detection;
using ft::orbslam3::stage;

constexpr int warm_up = 20;  ///< frames

double now_us() {
  return std::chrono::duration<double, std::micro>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// Microseconds per frame, by name.
using samples = std::map<std::string, std::vector<double>>;

double quantile(std::vector<double> v, double q) {
  std::sort(v.begin(), v.end());
  return v.empty() ? 0 : v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
}

/// The work of ORB-SLAM3's own loop for points in view, which is the same on CPU and GPU: counters,
/// and the positions that the viewer draws.
double bookkeeping_us(std::vector<stand_in::map_point*> const& local, bool projections) {
  std::map<unsigned long, stand_in::point2f> drawn;
  double const begin = now_us();
  for (auto* p : local) {
    if (!p->mbTrackInView) { continue; }
    p->IncreaseVisible(1);
    if (projections) { drawn[p->mnId] = stand_in::point2f(p->mTrackProjX, p->mTrackProjY); }
  }
  return now_us() - begin;
}

struct run_options {
  std::string backend = "host";
  int points = 3000;
  int frames = 300;
  bool replay = true;
};

nlohmann::json run(run_options const& o, change_detection detection, bool projections) {
  auto const s = bench::euroc();
  ft::orbslam3::options choices;
  choices.detection = detection;
  choices.fill_projections = projections;
  choices.statistics = true;
  std::unique_ptr<ft::orbslam3::device_tracker> device;
#if FT_BENCH_HAS_CUDA
  if (o.backend == "cuda") { device = make_cuda(s); }
#endif
  if (!device) { device = ft::orbslam3::make_host_tracker(s); }
  auto owned = std::make_unique<bench::replaying_device>(std::move(device), 2);
  bench::replaying_device& replaying = *owned;
  accelerator gpu(std::move(owned), s, choices);
  stand_in::matrix const left[2] = {bench::picture(s, 0), bench::picture(s, 2)};
  stand_in::matrix const right[2] = {bench::picture(s, 10), bench::picture(s, 12)};

  unsigned long id = 0;
  auto const construct = [&] {
    stand_in::frame f;
    f.mnId = id;
    f.mnMaxX = static_cast<float>(s.width);
    f.mnMaxY = static_cast<float>(s.height);
    gpu.extract(left[id % 2], right[id % 2], f);
    gpu.undistort(f);
    gpu.compute_stereo_matches(f);
    gpu.assign_to_grid(f);
    f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
    f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
    ++id;
    return f;
  };
  stand_in::frame last = construct();
  bench::scattered_map map(last, s, o.points);
  std::size_t const held = std::min<std::size_t>(400, last.mvpMapPoints.size());
  for (std::size_t i = 0; i < held; ++i) { last.mvpMapPoints[i] = map[i]; }

  samples times;
  ft::orbslam3::traffic moved;
  long in_view = 0, matches = 0, walked = 0;
  for (int k = 0; k < o.frames + warm_up; ++k) {
    bool const counted = k >= warm_up;
    if (k == warm_up / 2 && o.replay) { replaying.replay(); }
    gpu.reset_times();
    gpu.reset_bytes();
    stand_in::frame f = construct();
    int found = gpu.search_by_projection(f, last, 15, false);
    gpu.pose_optimization(f, stage::pose_last_frame);
    for (auto* p : f.mvpMapPoints) {
      if (p == nullptr) { continue; }
      p->mnLastFrameSeen = f.mnId;
      p->mbTrackInView = false;
    }
    // Tracking::UpdateLocalMap, which stays on the CPU, has just walked over all points.
    for (auto* p : map.local) { walked += static_cast<long>(p->isBad()); }
    found += gpu.search_local_points(f, map.local, 1);
    gpu.pose_optimization(f, stage::pose_local_map);
    f.SetPose({});
    last = f;
    if (!counted) { continue; }
    double wrap = 0;
    double total = 0;
    for (int i = 0; i < ft::orbslam3::stage_count; ++i) {
      auto const& t = gpu.times()[static_cast<std::size_t>(i)];
      std::string const name = name_of(static_cast<stage>(i));
      times[name].push_back(t.wrap);
      if (!o.replay) {
        times[name + " kernel"].push_back(t.kernel);
        times[name + " transfer"].push_back(t.transfer);
        times[name + " total"].push_back(t.total);
      }
      wrap += t.wrap;
      total += t.total;
    }
    double const own = bookkeeping_us(map.local, projections);
    times["wrap"].push_back(wrap);
    times["own_bookkeeping"].push_back(own);
    times["added"].push_back(wrap - own);
    times["total"].push_back(total);
    ft::orbslam3::traffic const now = gpu.bytes();
    moved.images += now.images;
    moved.frame += now.frame;
    moved.map += now.map;
    moved.results += now.results;
    moved.uploads += now.uploads;
    moved.downloads += now.downloads;
    matches += found;
    in_view += std::count_if(map.local.begin(), map.local.end(),
                             [](auto const* p) { return p->mbTrackInView; });
  }
  // The CPU's own search of the same points, to compare with.
  orbslam3_test::plain_search const plain(s);
  for (int k = 0; k < 20; ++k) {
    stand_in::frame f = last;
    f.mnId = ++id;
    double const begin = now_us();
    plain.search_local(f, map.local, 1);
    times["plain_loop_search_local_map"].push_back(now_us() - begin);
  }
  if (walked != 0) { throw std::runtime_error("a point is bad"); }
  nlohmann::json out;
  out["detection"] = detection == change_detection::hooks ? "hooks" : "compare";
  out["projections"] = projections;
  for (auto const& [name, v] : times) {
    out["us"][name] = {
        {"p50", quantile(v, 0.5)}, {"p90", quantile(v, 0.9)}, {"p99", quantile(v, 0.99)}};
  }
  auto const per_frame = [&](auto sum) {
    return static_cast<double>(sum) / static_cast<double>(o.frames);
  };
  if (!o.replay) {
    out["per_frame"] = {
        {"image_bytes_up", per_frame(moved.images)}, {"frame_bytes_up", per_frame(moved.frame)},
        {"map_bytes_up", per_frame(moved.map)},      {"bytes_down", per_frame(moved.results)},
        {"uploads", per_frame(moved.uploads)},       {"downloads", per_frame(moved.downloads)}};
  }
  out["matches_per_frame"] = per_frame(matches);
  out["in_view_per_frame"] = per_frame(in_view);
  return out;
}

/// Does nothing for an empty name.
void write(std::string const& name, nlohmann::json const& out) {
  if (name.empty()) { return; }
  std::ofstream file(name);
  file << out.dump(2) << "\n";
  if (!file) { throw std::runtime_error("cannot write '" + name + "'"); }
}

}  // namespace

int main(int argc, char** argv) {
  run_options o;
  std::string json;
  CLI::App app("Host time that the ORB-SLAM3 shim adds per frame.");
  app.add_option("--backend", o.backend, "host or cuda")
      ->check(CLI::IsMember({"host", "cuda"}))
      ->capture_default_str();
  app.add_option("--points", o.points, "points of the local map")->check(CLI::Range(1, 100000));
  app.add_option("--frames", o.frames, "measured frames")->check(CLI::Range(1, 100000));
  bool live = false;
  bench::live_options live_options;
  app.add_flag("--live", live,
               "KITTI's size, every call computed, new points in bursts: total and parts of each "
               "call");
  app.add_option("--keyframes", live_options.keyframe_every, "--live: frames to a keyframe")
      ->check(CLI::Range(2, 1000))
      ->capture_default_str();
  app.add_option("--new-points", live_options.new_points, "--live: of a keyframe")
      ->check(CLI::Range(0, 2000))
      ->capture_default_str();
  app.add_option("--moved-points", live_options.moved_points,
                 "--live: by the mapper, of a keyframe")
      ->check(CLI::Range(0, 100000))
      ->capture_default_str();
  app.add_option("--pause-us", live_options.pause_us, "--live: between frames")
      ->check(CLI::Range(0, 1000000))
      ->capture_default_str();
  app.add_flag("!--no-projections", live_options.projections, "--live: leave mmProjectPoints out");
  app.add_flag("--samples", live_options.samples, "--live: the times of every frame in the file");
  app.add_option("--json", json, "also write the results to this file");
  app.add_flag("!--no-replay", o.replay,
               "compute every frame; on the host backend kernels then empty the caches");
  CLI11_PARSE(app, argc, argv);
#if !FT_BENCH_HAS_CUDA
  if (o.backend == "cuda") {
    std::cerr << "orbslam3_bench: built without CUDA\n";
    return 2;
  }
#endif
  try {
    nlohmann::json out;
    if (live) {
      live_options.frames = o.frames;
      if (app.count("--points") > 0) { live_options.points = o.points; }
      out = bench::run_live(live_options, [&](ft::orbslam3::settings const& s) {
#if FT_BENCH_HAS_CUDA
        if (o.backend == "cuda") { return make_cuda(s); }
#endif
        return ft::orbslam3::make_host_tracker(s);
      });
      out["backend"] = o.backend;
      write(json, out);
      return 0;
    }
    out["backend"] = o.backend;
    out["points"] = o.points;
    out["frames"] = o.frames;
    out["replay"] = o.replay;
    std::printf("%-8s %-11s %9s %9s %9s %9s %9s %9s\n", "changes", "projections", "added us", "p90",
                "p99", "wrap us", "own us", "in view");
    for (auto const detection : {change_detection::hooks, change_detection::compare}) {
      for (bool const projections : {false, true}) {
        auto const r = run(o, detection, projections);
        auto const us = [&](char const* name, char const* q) {
          return r["us"][name][q].get<double>();
        };
        std::printf("%-8s %-11s %9.1f %9.1f %9.1f %9.1f %9.1f %9.0f\n",
                    r["detection"].get<std::string>().c_str(), projections ? "yes" : "no",
                    us("added", "p50"), us("added", "p90"), us("added", "p99"), us("wrap", "p50"),
                    us("own_bookkeeping", "p50"), r["in_view_per_frame"].get<double>());
        out["runs"].push_back(r);
      }
    }
    write(json, out);
  } catch (std::exception const& e) {
    std::cerr << "orbslam3_bench: " << e.what() << "\n";
    return 1;
  }
}
