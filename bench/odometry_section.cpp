// SPDX-License-Identifier: Apache-2.0
// The section of ft::odometry: times of track(), for one camera and for batches.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

#include "bench/clock.hpp"
#include "bench/plan.hpp"
#include "bench/sections.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

char const* row_name(scene const& s, frame_options const& o) {
  return o.imu ? "with IMU" : (o.prefetch > 0 ? "prefetched" : name_of(s.rig));
}

/// @param calls timed ones @param pause_us before each
void time_batch(context const& c, scene const& s, frame_options const& o, int warm_up, int calls,
                int pause_us = 0) {
  backend_type const b = o.backend;
  int const batch = o.batch;
  auto const runner = make_odometry_runner(s, o);
  std::vector<double> us;
  int tracked = 0;
  int keyframes = 0;
  int by_imu = 0;
  double begin = 0;
  for (int i = 0; i < warm_up + calls; ++i) {
    runner->prepare(i);
    if (pause_us > 0) { std::this_thread::sleep_for(std::chrono::microseconds(pause_us)); }
    double const start = now_us();
    if (i == warm_up) { begin = start; }
    runner->track();
    if (i < warm_up) { continue; }
    us.push_back(now_us() - start);
    tracked += runner->last().tracked;
    keyframes += runner->last().keyframes;
    by_imu += runner->last().by_imu;
  }
  double const sustained = 1e6 * calls * batch / (now_us() - begin);
  auto const t = seq::summarise(us);
  auto const last = runner->last();
  double const all = static_cast<double>(calls) * batch;
  char const* const rig = row_name(s, o);
  std::printf("%-12s %-5s %6d %6d %9.1f %9.1f %9.1f %9.1f %9.0f %8.1f%% %8.1f%% %8d %8d %8d\n", rig,
              name_of(b), batch, calls, t.mean, t.p50, t.p99, t.max, sustained, 100 * tracked / all,
              100 * keyframes / all, last.inliers, last.local_points, last.map_points);
  std::fflush(stdout);
  (*c.out)["odometry"].push_back({{"name", "odometry"},
                                  {"rig", rig},
                                  {"backend", name_of(b)},
                                  {"batch", batch},
                                  {"calls", calls},
                                  {"pause_us", pause_us},
                                  {"mean_us", t.mean},
                                  {"std_us", t.std},
                                  {"p50_us", t.p50},
                                  {"p99_us", t.p99},
                                  {"max_us", t.max},
                                  {"frames_per_s", sustained},
                                  {"tracked", tracked / all},
                                  {"keyframes", keyframes / all},
                                  {"by_imu", by_imu / all},
                                  {"inliers", last.inliers},
                                  {"local_points", last.local_points},
                                  {"map_points", last.map_points}});
}

/// Forward over a longer scene: the motion that the samples tell of is that of the images. The
/// IMU's state is known after two or three seconds, which are left out.
constexpr int imu_frames = 200;
constexpr int imu_warm_up = 80;
scene make_imu_scene(context const& c) {
  return make_scene(rig_type::rectified, 0, 0, imu_frames, c.how.features, c.how.local_points);
}
frame_options with_imu(backend_type b) {
  frame_options o;
  o.backend = b;
  o.imu = true;
  return o;
}

/// What there is no memory for is left out.
template <typename Call>
void in_memory(context const& c, std::string const& what, Call const& call) {
  try {
    call();
  } catch (no_memory const& e) {
    std::printf("%s left out: %s\n", what.c_str(), e.what());
    (*c.out)["left_out"].push_back(what + ": " + e.what());
  }
}

void print_memory(context const& c, scene const& s) {
  std::printf("\nMemory of an odometry of one rectified pair, %dx%d, %d features an image, bytes\n",
              s.width, s.height, s.features);
  std::printf("%-20s %8s %12s %12s\n", "of each", "number", "executor", "staging");
  for (auto const& row : odometry_memory(s)) {
    std::printf("%-20s %8d %12.0f %12.0f\n", row.what.c_str(), row.count, row.executor_bytes,
                row.staging_bytes);
    (*c.out)["odometry_memory"].push_back({{"name", row.what},
                                           {"number", row.count},
                                           {"executor_bytes", row.executor_bytes},
                                           {"staging_bytes", row.staging_bytes}});
  }
}

/// What an odometry of one pair takes of a device once it has tracked: also for CUDA's graphs, and
/// for the local memory of its kernels, which CUDA keeps.
void print_device_memory(context const& c, scene const& s) {
  constexpr double mib = 1 << 20;
  double const before = device_bytes_in_use();
  std::printf("\nMemory of a device, of an odometry of one rectified pair, MiB\n");
  for (bool const imu : {false, true}) {
    frame_options o;
    o.backend = backend_type::cuda;
    o.imu = imu;
    auto const runner = make_odometry_runner(s, o);
    for (int i = 0; i < 2 * static_cast<int>(s.frames.size()); ++i) {
      runner->prepare(i);
      runner->track();
    }
    double const taken = (device_bytes_in_use() - before) / mib;
    double const told = runner->memory_bytes() / mib;
    char const* const what = imu ? "with IMU" : "rectified";
    std::printf("%-12s %9.1f, of them told by memory_bytes() %9.1f\n", what, taken, told);
    (*c.out)["device_memory"].push_back({{"name", what}, {"mib", taken}, {"told_mib", told}});
  }
}

}  // namespace

void odometry_section(context const& c, backend_type b) {
  bool const cuda = b == backend_type::cuda;
  scene const& s = c.all_scenes->get(rig_type::rectified);
  if (cuda) { print_device_memory(c, make_imu_scene(c)); }
  std::printf(
      "\nOdometry of rectified pairs and of two such pairs in one rig, %dx%d, %d features an "
      "image, each with its own map\n",
      s.width, s.height, s.features);
  std::printf("%-12s %-5s %6s %6s %9s %9s %9s %9s %9s %9s %9s %8s %8s %8s\n", "rig", "on", "batch",
              "calls", "mean us", "p50 us", "p99 us", "max us", "frames/s", "tracked", "keyframes",
              "inliers", "local", "map");
  std::vector<int> const usual = cuda ? std::vector<int>{1, 8, 64} : std::vector<int>{1, 2};
  auto const time = [&](scene const& of, int batch, int prefetch = 0) {
    frame_options o;
    o.backend = b;
    o.batch = batch;
    o.prefetch = prefetch;
    int const warm_up = std::max(c.how.warm_up_on(b), 2 * static_cast<int>(of.frames.size()));
    in_memory(c, "odometry of " + std::string(name_of(of.rig)) + ", " + std::to_string(batch),
              [&] { time_batch(c, of, o, warm_up, calls_of_batch(c.how.frames_on(b), batch)); });
  };
  for (int batch : c.how.batches.empty() ? usual : c.how.batches) { time(s, batch); }
  time(s, 1, 3);
  time(c.all_scenes->get(rig_type::four_cameras), 1);
  scene const of_imu = make_imu_scene(c);
  for (int const pause_us : {5000, 0}) {
    in_memory(c, "odometry with IMU", [&] {
      time_batch(c, of_imu, with_imu(b), imu_warm_up, imu_frames - imu_warm_up, pause_us);
    });
  }
  if (!cuda) { print_memory(c, s); }
}

// ---- its stages

namespace {

/// Times of a stage, frame by frame.
struct stage_record {
  std::string name;
  std::vector<double> all;
  std::vector<double> of_keyframes;
};

void record(std::vector<stage_record>& to, stage_us const& t, bool keyframe) {
  auto const same = [&](stage_record const& r) { return r.name == t.name; };
  auto at = std::find_if(to.begin(), to.end(), same);
  if (at == to.end()) { at = to.insert(to.end(), {t.name, {}, {}}); }
  at->all.push_back(t.us);
  if (keyframe) { at->of_keyframes.push_back(t.us); }
}

/// @param calls timed ones
void time_stages(context const& c, scene const& s, frame_options o, int warm_up, int calls) {
  o.measure_stages = true;
  auto const runner = make_odometry_runner(s, o);
  std::vector<stage_record> stages;
  for (int i = 0; i < warm_up + calls; ++i) {
    runner->prepare(i);
    runner->track();
    if (i < warm_up) { continue; }
    for (auto const& t : runner->stage_times()) { record(stages, t, runner->last().keyframes > 0); }
  }
  for (auto& stage : stages) {
    auto const all = seq::summarise(stage.all);
    auto const keyframes = seq::summarise(stage.of_keyframes);
    auto const n = static_cast<int>(stage.of_keyframes.size());
    std::printf("%-12s %-5s %6d %-18s %9.1f %9.1f %9.1f %9d %9.1f %9.1f\n", row_name(s, o),
                name_of(o.backend), o.batch, stage.name.c_str(), all.p50, all.p99, all.max, n,
                keyframes.p50, keyframes.max);
    (*c.out)["map_stages"].push_back({{"name", stage.name},
                                      {"rig", row_name(s, o)},
                                      {"backend", name_of(o.backend)},
                                      {"batch", o.batch},
                                      {"calls", calls},
                                      {"p50_us", all.p50},
                                      {"p99_us", all.p99},
                                      {"max_us", all.max},
                                      {"keyframes", n},
                                      {"keyframes_p50_us", keyframes.p50},
                                      {"keyframes_max_us", keyframes.max}});
  }
  std::fflush(stdout);
}

}  // namespace

void map_stages_section(context const& c, backend_type b) {
  std::printf(
      "\nStages of the odometry, in all timed frames, and in those in which a camera makes a "
      "keyframe; \"motion\" is on a branch and has the end of an adjustment\n");
  std::printf("%-12s %-5s %6s %-18s %9s %9s %9s %9s %9s %9s\n", "rig", "on", "batch", "stage",
              "p50 us", "p99 us", "max us", "keyframes", "p50 us", "max us");
  auto const time = [&](rig_type rig, int batch) {
    auto const what = "stages of the odometry of " + std::string(name_of(rig));
    in_memory(c, what + ", " + std::to_string(batch), [&] {
      scene const& s = c.all_scenes->get(rig);
      frame_options o;
      o.backend = b;
      o.batch = batch;
      // All frames are seen before, unless --warm-up says otherwise: keyframes come with new ones.
      int const all = 2 * static_cast<int>(s.frames.size());
      time_stages(c, s, o, c.how.warm_up > 0 ? c.how.warm_up : all,
                  calls_of_batch(c.how.frames_on(b), batch));
    });
  };
  for (int batch : c.how.batches.empty() ? std::vector<int>{1} : c.how.batches) {
    time(rig_type::rectified, batch);
  }
  time(rig_type::four_cameras, 1);
  in_memory(c, "stages of the odometry with IMU", [&] {
    time_stages(c, make_imu_scene(c), with_imu(b), imu_warm_up, imu_frames - imu_warm_up);
  });
}

}  // namespace bench
