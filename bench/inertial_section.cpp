// SPDX-License-Identifier: Apache-2.0
// The section of the inertial stages: poses with an IMU, and integrals.
#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "bench/plan.hpp"
#include "bench/sections.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

void time_case(context const& c, inertial_case const& what) {
  auto const runner = make_inertial_runner(what);
  int const calls = calls_of_batch(c.how.frames_on(what.backend), what.problems);
  for (int i = 0; i < c.how.warm_up_on(what.backend); ++i) { runner->run(); }
  std::vector<double> us;
  for (int i = 0; i < calls; ++i) { us.push_back(runner->run()); }
  auto const t = seq::summarise(us);
  bool const integrates = what.observations == 0;
  char const* const name =
      integrates ? "integrate" : (what.from_last_frame ? "from last frame" : "from keyframe");
  double const inliers = runner->inlier_share();
  std::printf("%-16s %-5s %8d %8d %12d %6d %9.1f %9.1f %9.1f %8.1f%%\n", name,
              name_of(what.backend), what.host_threads, what.problems, what.observations, calls,
              t.mean, t.p50, t.p99, 100 * inliers);
  std::fflush(stdout);
  (*c.out)["inertial"].push_back({{"name", name},
                                  {"backend", name_of(what.backend)},
                                  {"host_threads", what.host_threads},
                                  {"problems", what.problems},
                                  {"observations", what.observations},
                                  {"imu_steps", what.steps},
                                  {"calls", calls},
                                  {"mean_us", t.mean},
                                  {"p50_us", t.p50},
                                  {"p99_us", t.p99},
                                  {"inliers", inliers}});
}

}  // namespace

void inertial_section(context const& c, backend_type b) {
  std::printf(
      "\nPoses of a rectified pair with an IMU, and integrals, of 10 steps; problems of one "
      "call\n");
  std::printf("%-16s %-5s %8s %8s %12s %6s %9s %9s %9s %9s\n", "what", "on", "threads", "problems",
              "observations", "calls", "mean us", "p50 us", "p99 us", "inliers");
  inertial_case what;
  what.backend = b;
  what.host_threads = 1;
  for (int const observations : {150, 1000}) {
    what.observations = observations;
    for (bool const last : {false, true}) {
      what.from_last_frame = last;
      time_case(c, what);
    }
  }
  what.host_threads = 0;
  what.problems = 64;
  what.observations = 150;
  time_case(c, what);
  what.problems = 1000;
  what.observations = 0;
  time_case(c, what);
}

}  // namespace bench
