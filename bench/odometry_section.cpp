// SPDX-License-Identifier: Apache-2.0
// The section of ft::odometry: times of track(), for one camera and for batches.
#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "bench/clock.hpp"
#include "bench/plan.hpp"
#include "bench/sections.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

/// @param calls timed ones
void time_batch(context const& c, backend_type b, scene const& s, int batch, int calls) {
  frame_options o;
  o.backend = b;
  o.batch = batch;
  auto const runner = make_odometry_runner(s, o);
  int const warm_up = std::max(c.how.warm_up_on(b), 2 * static_cast<int>(s.frames.size()));
  std::vector<double> us;
  int tracked = 0;
  int keyframes = 0;
  double begin = 0;
  for (int i = 0; i < warm_up + calls; ++i) {
    runner->prepare(i);
    double const start = now_us();
    if (i == warm_up) { begin = start; }
    runner->track();
    if (i < warm_up) { continue; }
    us.push_back(now_us() - start);
    tracked += runner->last().tracked;
    keyframes += runner->last().keyframes;
  }
  double const sustained = 1e6 * calls * batch / (now_us() - begin);
  auto const t = seq::summarise(us);
  auto const last = runner->last();
  double const all = static_cast<double>(calls) * batch;
  char const* const rig = name_of(s.rig);
  std::printf("%-12s %-5s %6d %6d %9.1f %9.1f %9.1f %9.1f %9.0f %8.1f%% %8.1f%% %8d %8d %8d\n", rig,
              name_of(b), batch, calls, t.mean, t.p50, t.p99, t.max, sustained, 100 * tracked / all,
              100 * keyframes / all, last.inliers, last.local_points, last.map_points);
  std::fflush(stdout);
  (*c.out)["odometry"].push_back({{"name", "odometry"},
                                  {"rig", rig},
                                  {"backend", name_of(b)},
                                  {"batch", batch},
                                  {"calls", calls},
                                  {"mean_us", t.mean},
                                  {"std_us", t.std},
                                  {"p50_us", t.p50},
                                  {"p99_us", t.p99},
                                  {"max_us", t.max},
                                  {"frames_per_s", sustained},
                                  {"tracked", tracked / all},
                                  {"keyframes", keyframes / all},
                                  {"inliers", last.inliers},
                                  {"local_points", last.local_points},
                                  {"map_points", last.map_points}});
}

}  // namespace

void odometry_section(context const& c, backend_type b) {
  bool const cuda = b == backend_type::cuda;
  scene const& s = c.all_scenes->get(rig_type::rectified);
  std::printf(
      "\nOdometry of rectified pairs and of two such pairs in one rig, %dx%d, %d features an "
      "image, each with its own map\n",
      s.width, s.height, s.features);
  std::printf("%-12s %-5s %6s %6s %9s %9s %9s %9s %9s %9s %9s %8s %8s %8s\n", "rig", "on", "batch",
              "calls", "mean us", "p50 us", "p99 us", "max us", "frames/s", "tracked", "keyframes",
              "inliers", "local", "map");
  std::vector<int> const usual = cuda ? std::vector<int>{1, 8, 64} : std::vector<int>{1, 2};
  auto const time = [&](scene const& of, int batch) {
    try {
      time_batch(c, b, of, batch, calls_of_batch(c.how.frames_on(b), batch));
    } catch (no_memory const& e) {
      std::string const what = std::string(name_of(of.rig)) + ", " + std::to_string(batch);
      std::printf("odometry of %s left out: %s\n", what.c_str(), e.what());
      (*c.out)["left_out"].push_back("odometry of " + what + ": " + e.what());
    }
  };
  for (int batch : c.how.batches.empty() ? usual : c.how.batches) { time(s, batch); }
  time(c.all_scenes->get(rig_type::four_cameras), 1);
}

}  // namespace bench
